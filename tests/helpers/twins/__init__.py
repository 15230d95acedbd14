"""NumPy twins of the kernels: the oracles of the device tests.

Plain float32 arithmetic in the kernels' order, whole images at a time. Cameras come as the same packed
`Reprojection` arrays that kernels get, (6, 4) float32. Constants are read from the kernels' sources.

One module per stage.
"""

from twins.acceleration import track_acceleration
from twins.background import (
    EDGE,
    REMEMBERED,
    SHOWN,
    collect_levels,
    collect_shown,
    mix_far_side,
    project_background,
    shown_state,
)
from twins.common import COMMON, centers, move, unproject
from twins.composition import compose
from twins.convolutions import judge_with
from twins.correction import choose_flow, correct, follow_flow, judge
from twins.hidden_parts import fill_hidden_parts, show_reappearing
from twins.history import EXACT, last_stir, residual_histogram, static_threshold, track_history
from twins.holes import border_lines, downsample, fill_far_side, fill_from_downsampled
from twins.network_input import decode, depth_median, encode, network_input
from twins.prediction import entering_depth, predict_positions
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
from twins.warp import BLOCKS, block_classes, link_surfaces, load_color, resolve, smooth_blocks, splat, unmixed

__all__ = [
    "BLOCKS",
    "COMMON",
    "EDGE",
    "EXACT",
    "REMEMBERED",
    "SHOWN",
    "block_classes",
    "border_lines",
    "carry_trends",
    "centers",
    "choose_flow",
    "collect_levels",
    "collect_shown",
    "compose",
    "convert_color",
    "convert_described_color",
    "convert_described_geometry",
    "convert_geometry",
    "correct",
    "decode",
    "depth_median",
    "downsample",
    "encode",
    "entering_depth",
    "fill_far_side",
    "fill_from_downsampled",
    "fill_hidden_parts",
    "find_candidates",
    "find_change",
    "find_followed",
    "find_texture",
    "find_trend",
    "follow_flow",
    "judge",
    "judge_with",
    "last_stir",
    "link_surfaces",
    "load_color",
    "measure_changes",
    "mix_far_side",
    "motion_by_camera",
    "move",
    "network_input",
    "predict_positions",
    "prepare_inputs",
    "present",
    "project_background",
    "residual_histogram",
    "resolve",
    "show_reappearing",
    "shown_state",
    "smooth_blocks",
    "splat",
    "spread_geometry",
    "static_threshold",
    "track_acceleration",
    "track_history",
    "undilated",
    "unmixed",
    "unproject",
]
