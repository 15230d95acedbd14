"""Hole filling: pixels that neither the rendered frame nor the background shows (paper: 'Shading correction network').

A way to fill holes is one entry of `FILLINGS`, and one of `HOLE_FILLINGS` in `options.py`.
"""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.backward_blocks import SPLATTED_PIXELS
from gffe_cl.engine.stages.base import Access, Board, Kernel, Share, Stage, Step, share_of
from gffe_cl.engine.stages.buffers import BY_HOLE_FILLING, BY_NOTHING, BufferSpec
from gffe_cl.engine.stages.warp import DISOCCLUDED

_CONSTANTS = constants("holes.cl")

UNFILLED = share_of("unfilled", "frame.filled_by", lambda label: (label == BY_HOLE_FILLING) | (label == BY_NOTHING))
BORDER = Share("border", lambda board: _share_of_border(*board.sizes.of("cells")))
BEYOND_REACH = share_of("beyond reach", "holes.downsampled_color", lambda sums: sums[..., 3] != 0)


def _share_of_border(width: int, height: int) -> float:
    """Return the share of texels at the border of an image."""
    return 1 - max(width - 2, 0) * max(height - 2, 0) / (width * height)


def _image(share: Share) -> dict[str, Access]:
    """Return accesses to color and depth of the new frame, as far as they are read around a share of the pixels."""
    return {name: Access(f"frame.{name}", share) for name in ("color", "depth")}


def _filled(share: Share) -> dict[str, Access]:
    return {name: Access(f"frame.{name}", share) for name in ("color", "depth", "motion")}


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
    )
    kernels = (
        Kernel(
            "fill_from_downsampled",
            "tiles",
            {
                "filled_by": "frame.filled_by",
                "codes": Access("color_code.codes", BEYOND_REACH),
                "source_color": Access("rendered.color", BEYOND_REACH),
                "source_depth": Access("rendered.depth", BEYOND_REACH),
            }
            | _image(BEYOND_REACH),
            _filled(BEYOND_REACH)
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
            "target",
            {
                "codes": Access("color_code.codes", BORDER),
                "disoccluded": "frame.disoccluded",
                "filled_by": Access("frame.filled_by", DISOCCLUDED),
            }
            | _image(DISOCCLUDED),
            {"border_lines": Access("holes.border_lines", BORDER), "color": Access("frame.color", DISOCCLUDED)},
            step=("RUN", 1),
        ),
        Kernel(
            "fill_far_side",
            "target",
            {
                "block_class": "backward_blocks.block_class",
                "filled_by": Access("frame.filled_by", SPLATTED_PIXELS),
                "codes": Access("color_code.codes", UNFILLED),
                "source_depth": Access("rendered.depth", UNFILLED),
                "is_dynamic": Access("frame.dynamic", UNFILLED),
                "border_lines": Access("holes.border_lines", BORDER),
            }
            | _image(UNFILLED),
            _filled(UNFILLED),
            step=("RUN", "LANES"),
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
