"""Hole filling: pixels that neither the rendered frame nor the background shows (paper: 'Shading correction network').

A way to fill holes is one entry of `FILLINGS`, and one of `HOLE_FILLINGS` in `options.py`.
"""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

_CONSTANTS = constants("holes.cl")

_IMAGE = {name: f"frame.{name}" for name in ("color", "depth")}
_FILLED = {name: f"frame.{name}" for name in ("color", "depth", "motion")}
_SUMS = {name: f"holes.{name}" for name in ("downsampled_color", "downsampled_inverse_depth")}


class HoleFilling(Stage):
    """Fills invalid pixels in place. Filled pixels have depth and motion."""

    name = "holes"
    needs_footprints = True
    reach = 0  # px, in which the far side is looked for


class Downsampled(HoleFilling):
    """Fills holes from the image downsampled 32×, as the paper does."""

    buffers = (
        BufferSpec(
            "downsampled_color",
            np.float32,
            ("R", "G", "B", "weight"),
            "downsampled",
            "weighted sum of valid color over 32×32 pixels",
            "color",
        ),
        BufferSpec(
            "downsampled_inverse_depth",
            np.float32,
            (),
            "downsampled",
            "weighted sum of inverse depth over them, 1/world units",
        ),
    )
    kernels = (
        Kernel(
            "downsample",
            "target",
            {
                "filled_by": "frame.filled_by",
                "source_color": "rendered.color",
                "source_depth": "rendered.depth",
            }
            | _IMAGE,
            _SUMS,
            step=(1, "DOWNSAMPLING"),
            group="DOWNSAMPLING",
        ),
        Kernel(
            "fill_from_downsampled",
            "walk",
            {"open": "warp.open", "filled_by": "frame.filled_by"} | _SUMS,
            _FILLED,
            group="WALK_GROUP",
        ),
    )

    def extrapolated(self, step: Step) -> None:
        for kernel in ("downsample", "fill_from_downsampled"):
            self.launch(kernel, step)


class FarSide(HoleFilling):
    """Continues the surface behind a disocclusion or, out of screen, the lines at the image's border."""

    kernels = (
        Kernel(
            "fill_far_side",
            "walk",
            {
                "open": "warp.open",
                "filled_by": "frame.filled_by",
                "codes": "color_code.codes",
                "source_depth": "rendered.depth",
                "is_dynamic": "frame.dynamic",
                "border_lines": "warp.border_lines",
            }
            | _IMAGE,
            _FILLED,
            group="WALK_GROUP",
        ),
    )

    def __init__(self, board: Board):
        self.reach = max(_CONSTANTS["LEAST_REACH"], board.sizes.target[0] // _CONSTANTS["REACH_SHARE"])
        board.facts["far_side"] = True
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        self.launch("fill_far_side", step)


# By the option `hole_filling`; None leaves holes.
FILLINGS: dict[str, type[HoleFilling] | None] = {
    "far-side": FarSide,
    "downsample": Downsampled,
    "none": None,
}
