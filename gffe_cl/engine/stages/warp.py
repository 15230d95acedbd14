"""Warp with crack closing and sub-pixel resampling (paper: 'Warping')."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.stages.backward_blocks import SPLATTED_PIXELS, SPLATTING_BLOCKS
from gffe_cl.engine.stages.base import Access, Board, Kernel, NearestStage, Share, Step, share_of
from gffe_cl.engine.stages.buffers import BY_HOLE_FILLING, BY_NOTHING, BufferSpec

DISOCCLUDED = share_of("disoccluded", "frame.disoccluded")
MIXED = share_of("mixed", "warp.mixed")
_MIXED = BufferSpec(
    "mixed", np.uint8, (), "target",
    "1 where the fragment's color was mixed with a silhouette's that moves away, and its neighbor's is shown", "mask",
    transient=True,
)  # fmt: skip


def _keys(share: Share) -> dict[str, Access]:
    return {name: Access(f"warp.{name}", share) for name in ("keys", "winners")}


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
                "depth": Access("rendered.depth", SPLATTING_BLOCKS),
                "links": Access("connectivity.links", SPLATTING_BLOCKS),
                "target_position": Access("prediction.target_position", SPLATTING_BLOCKS),
            }
            | _keys(SPLATTED_PIXELS),
            _keys(SPLATTED_PIXELS),
            step=("LANES", 1),
        ),
        Kernel(
            "resolve",
            "target",
            {
                "block_class": "backward_blocks.block_class",
                "block_source": "backward_blocks.block_source",
                "source_smooth": "backward_blocks.smooth",
                "color": Access("rendered.color", 0.0),  # where nothing moves
                "codes": "color_code.codes",
                "depth": Access("rendered.depth", SPLATTED_PIXELS),
                "links": Access("connectivity.links", SPLATTED_PIXELS),
                "dynamic_mask": "history.dynamic_mask",
                "target_position": "prediction.target_position",
            }
            | _keys(SPLATTED_PIXELS),
            _keys(MIXED) | NEW_FRAME | {"mixed": "warp.mixed"},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        self.buffers = (_MIXED, *self.keys(board, "", "target", transient=True))
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        for splat_pass in self.passes:
            self.launch("splat", step, **{"pass": splat_pass})
        fills = self.board.options.hole_filling != "none"
        self.launch("resolve", step, unfilled_label=BY_HOLE_FILLING if fills else BY_NOTHING)
