"""NumPy forms of kernels whose arithmetic is a formula: the oracles of their tests. recorded_bits.py holds the bits of
all kernels.

Plain float32 arithmetic in the kernels' order, whole images at a time. Cameras come as the same packed
`Reprojection` arrays that kernels get, (6, 4) float32. Constants are read from the kernels' sources.
"""

from twins.common import codes_of, decode_color, doubled, encode_color, load_color, reproject
from twins.composition import compose
from twins.convolutions import judge_with
from twins.network_input import decode, depth_median, encode
from twins.presentation import present
from twins.shading_trend import find_trend
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
    "codes_of",
    "compose",
    "convert_color",
    "convert_described_color",
    "convert_described_geometry",
    "convert_geometry",
    "decode",
    "decode_color",
    "depth_median",
    "doubled",
    "encode",
    "encode_color",
    "find_trend",
    "judge_with",
    "load_color",
    "motion_by_camera",
    "present",
    "reproject",
    "spread_geometry",
    "undilated",
]
