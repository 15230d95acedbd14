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
            "weighted sum of valid color over 32×32 pixels; 0 where no hole asks for it",
            "color",
        ),
        BufferSpec(
            "downsampled_inverse_depth",
            np.float32,
            (),
            "downsampled",
            "weighted sum of inverse depth over them, 1/world units",
        ),
        BufferSpec("beyond", np.uint32, (), "once", "whether pixels are left by the far side", scratch=True),
    )
    kernels = (
        Kernel(
            "fill_from_downsampled",
            "tiles",
            {
                "filled_by": "frame.filled_by",
                "codes": "color_code.codes",
                "source_color": "rendered.color",
                "source_depth": "rendered.depth",
                "beyond": "holes.beyond",
            }
            | _IMAGE,
            _FILLED
            | {
                "downsampled_color": "holes.downsampled_color",
                "downsampled_inverse_depth": "holes.downsampled_inverse_depth",
            },
            group="GROUP",
        ),
    )

    def extrapolated(self, step: Step) -> None:
        self.launch("fill_from_downsampled", step, after_far_side=self.reach > 0)


class FarSide(Downsampled):
    """Continues the surface behind a disocclusion. Beyond its reach the downsampled image is used. Colors from the
    background are mixed with the far side."""

    buffers = (
        *Downsampled.buffers,
        BufferSpec(
            "border_lines",
            np.float32,
            (),
            "cells",
            "structure tensor of the color code, xx, xy and yy, in cells at the image's border; 0 elsewhere; while the "
            "camera stays, an older one",
            planes=3,
        ),
    )
    kernels = (
        Kernel(
            "prepare_far_side",
            "walk",
            {
                "open": "warp.open",
                "codes": "color_code.codes",
                "disoccluded": "frame.disoccluded",
                "filled_by": "frame.filled_by",
                "color_prev": "previous.color",
                "depth_prev": "previous.depth",
            }
            | _IMAGE,
            {
                "border_lines": "holes.border_lines",
                "color": "frame.color",
                "beyond": "holes.beyond",
            },
            group="WALK_GROUP",
        ),
        Kernel(
            "fill_far_side",
            "walk",
            {
                "open": "warp.open",
                "filled_by": "frame.filled_by",
                "codes": "color_code.codes",
                "source_depth": "rendered.depth",
                "source_is_dynamic": "history.dynamic_mask",
                "is_dynamic": "frame.dynamic",
                "border_lines": "holes.border_lines",
            }
            | _IMAGE,
            _FILLED | {"beyond": "holes.beyond"},
            group="WALK_GROUP",
        ),
        *Downsampled.kernels,
    )

    def __init__(self, board: Board):
        self.reach = max(_CONSTANTS["LEAST_REACH"], board.sizes.target[0] // _CONSTANTS["REACH_SHARE"])
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        self.launch("prepare_far_side", step)
        self.launch("fill_far_side", step)
        super().extrapolated(step)


# By the option `hole_filling`; None leaves holes.
FILLINGS: dict[str, type[HoleFilling] | None] = {
    "far-side": FarSide,
    "downsample": Downsampled,
    "none": None,
}
