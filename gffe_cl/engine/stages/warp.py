"""Warp with crack closing and sub-pixel resampling (paper: 'Warping')."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import BY_HOLE_FILLING, BY_NOTHING, BufferSpec

_OPEN = BufferSpec(
    "open", np.uint32, (), "list_target", "how many pixels are holes, then their indices", scratch=True, transient=True,
)  # fmt: skip
_LINES = BufferSpec(
    "border_lines", np.float32, (), "cells",
    "structure tensor of the color code, xx, xy and yy, in cells at the rendered image's border; 0 elsewhere; while"
    " the camera stays, an older one",
    planes=3,
)  # fmt: skip
_KEYS = {name: f"warp.{name}" for name in ("keys", "winners")}
NEW_FRAME = {
    "out_color": "frame.color",
    "out_depth": "frame.depth",
    "out_motion": "frame.motion",
    "out_dynamic": "frame.dynamic",
    "disoccluded": "frame.disoccluded",
    "filled_by": "frame.filled_by",
}


class Warp(NearestStage):
    """Splats every fragment's footprint, keeps the nearest fragment of each pixel, and resamples the rendered frame."""

    name = "warp"
    needs_footprints = True
    kernels = (
        Kernel(
            "splat",
            "source",
            {
                "reach": "backward_blocks.reach",
                "block_class": "backward_blocks.block_class",
                "smooth": "backward_blocks.smooth",
                "depth": "rendered.depth",
                "codes": "color_code.codes",
                "links": "connectivity.links",
                "target_position": "prediction.target_position",
            }
            | {f"level_{name}": f"background.{name}_0" for name in ("state", "depth", "color")}
            | _KEYS,
            _KEYS
            | {"open": "warp.open"}
            | {name: f"silhouettes.{name}" for name in ("layer", "behind", "share", "marked", "soft")},
            step=("LANES", 1),
        ),
        Kernel(
            "resolve",
            "target",
            {
                "block_class": "backward_blocks.block_class",
                "block_source": "backward_blocks.block_source",
                "source_smooth": "backward_blocks.smooth",
                "color": "rendered.color",  # where nothing moves
                "codes": "color_code.codes",
                "depth": "rendered.depth",
                "links": "connectivity.links",
                "dynamic_mask": "history.dynamic_mask",
                "target_position": "prediction.target_position",
                "sharpness": "sharpness.sharpness",
            }
            | _KEYS,
            NEW_FRAME | {"open": "warp.open", "border_lines": "warp.border_lines"},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        self.buffers = (_OPEN, _LINES, *self.keys(board, "", "target", transient=True))
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        for splat_pass in self.passes:
            self.launch("splat", step, **{"pass": splat_pass})
        fills = self.board.options.hole_filling != "none"
        self.launch("resolve", step, unfilled_label=BY_HOLE_FILLING if fills else BY_NOTHING)
