"""NumPy forms of kernels whose arithmetic is a formula: the oracles of their tests. recorded_bits.py holds the bits of
all kernels.

Plain float32 arithmetic in the kernels' order, whole images at a time. Cameras come as the same packed
`Reprojection` arrays that kernels get, (6, 4) float32. Constants are read from the kernels' sources.
"""

from twins.common import codes_of, decode_color, encode_color, load_color, reproject
from twins.composition import compose
from twins.convolutions import judge_with
from twins.correction import choose_flow, correct, follow_flow, judge
from twins.network_input import decode, depth_median, encode, network_input
from twins.presentation import present
from twins.shading import prepare_inputs
from twins.shading_flow import find_candidates, find_followed, find_texture
from twins.shading_trend import carry_trends, find_change, find_trend, measure_changes
from twins.upload import (
    convert_color,
    convert_described_color,
    convert_described_geometry,
    convert_geometry,
    motion_by_camera,
    spread_geometry,
    undilated,
)

__all__ = [
    "carry_trends",
    "choose_flow",
    "codes_of",
    "compose",
    "convert_color",
    "convert_described_color",
    "convert_described_geometry",
    "convert_geometry",
    "correct",
    "decode",
    "decode_color",
    "depth_median",
    "encode",
    "encode_color",
    "find_candidates",
    "find_change",
    "find_followed",
    "find_texture",
    "find_trend",
    "follow_flow",
    "judge",
    "judge_with",
    "load_color",
    "measure_changes",
    "motion_by_camera",
    "network_input",
    "prepare_inputs",
    "present",
    "reproject",
    "spread_geometry",
    "undilated",
]
