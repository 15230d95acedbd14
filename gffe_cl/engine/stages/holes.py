"""Disocclusions that the background does not know: hidden parts of movers, and hole filling (paper: 'Shading correction
network').

A way to fill holes is one entry of `FILLINGS`, and one of `HOLE_FILLINGS` in `options.py`."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

_HIDDEN = constants("hidden_parts.cl")
_COLORS = {name: f"frame.{name}" for name in ("color", "depth", "motion", "filled_by")}
_KEYS = {name: f"warp.{name}" for name in ("keys", "winners")}
_OFFERING = {
    "dynamic_mask": "history.dynamic_mask",
    "links": "connectivity.links",
    "met_depth": "history.met_depth",
    "target_position": "prediction.target_position",
} | _KEYS


class HiddenParts(NearestStage):
    """Decides which disocclusions are a mover's own, hidden in the rendered frame, and continues it into them. Prepares
    the keys for parts that reappear, which `Projection` shows."""

    name = "hidden_parts"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "offered",
            np.uint32,
            (),
            "list_target",
            "pixels to which parts that reappear are offered",
            scratch=True,
            transient=True,
        ),
    )
    kernels = (
        Kernel(
            "fill_hidden_parts",
            "flat_level0",
            {
                "source_depth": "rendered.depth",
                "source_motion": "rendered.motion",
                "source_color": "rendered.color",
                "depth_prev": "previous.depth",
                "open": "warp.open",
                "disoccluded": "frame.disoccluded",
                "is_dynamic": "frame.dynamic",
                "color": "frame.color",
                "depth": "frame.depth",
                "motion": "frame.motion",
            }
            | _OFFERING,
            _COLORS | _KEYS | {"offered": "hidden_parts.offered"},
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
    )

    @property
    def reach(self) -> int:
        """Distance in target pixels within which movers are searched for."""
        return max(_HIDDEN["MOVER_REACH"], self.sizes.target[0] // _HIDDEN["MOVER_REACH_SHARE"])

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.hidden_parts and options.motion

    def extrapolated(self, step: Step) -> None:
        self.launch("fill_hidden_parts", step, reappear=self.board.options.reappearing)


_CONSTANTS = constants("holes.cl")

_IMAGE = {name: f"frame.{name}" for name in ("color", "depth")}
_FILLED = {name: f"frame.{name}" for name in ("color", "depth", "motion")}
_SUMS = {name: f"holes.{name}" for name in ("downsampled_color", "downsampled_inverse_depth")}


class HoleFilling(Stage):
    """Fills invalid pixels in place. Filled pixels have depth and motion."""

    name = "holes"
    paper = "Shading correction network"
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
            step=("LANES", 1),
            group="WALK_GROUP",
        ),
    )

    def extrapolated(self, step: Step) -> None:
        for kernel in ("downsample", "fill_from_downsampled"):
            self.launch(kernel, step)


class FarSide(HoleFilling):
    """Continues the surface behind a disocclusion or, out of screen, the image's border."""

    kernels = (
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
            }
            | _IMAGE,
            _FILLED,
            step=("LANES", 1),
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
