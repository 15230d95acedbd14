"""Warp with crack closing and sub-pixel resampling (paper: 'Warping')."""

from __future__ import annotations

import numpy as np

from gffe_cl.stages.base import Access, Board, Kernel, NearestStage, Step
from gffe_cl.stages.buffers import BY_HOLE_FILLING, BY_NOTHING, BufferSpec

_MIXED = BufferSpec(
    "mixed", np.uint8, (), "target",
    "1 where the fragment's colour was mixed with a silhouette's that moves away, and its neighbour's is shown", "mask",
    transient=True,
)  # fmt: skip


def _keys(share: str) -> dict[str, Access]:
    return {name: Access(f"warp.{name}", share) for name in ("keys", "winners")}


class Warp(NearestStage):
    """Splats every fragment's footprint, nearest first, and resamples the rendered frame."""

    name = "warp"
    kernels = (
        Kernel(
            "splat",
            "source",
            {
                "reach": "backward_blocks.reach",
                "block_class": "backward_blocks.block_class",
                "depth": Access("rendered.depth", "splatting"),
                "links": Access("connectivity.links", "splatting"),
                "target_position": Access("prediction.target_position", "splatting"),
            }
            | _keys("splatted"),
            _keys("splatted"),
            step=("LANES", 1),
        ),
        Kernel(
            "resolve",
            "target",
            {
                "block_class": "backward_blocks.block_class",
                "block_source": "backward_blocks.block_source",
                "source_smooth": "backward_blocks.smooth",
                "color": "rendered.color",
                "depth": Access("rendered.depth", "splatted"),
                "links": Access("connectivity.links", "splatted"),
                "dynamic_mask": "history.dynamic_mask",
                "target_position": "prediction.target_position",
            }
            | _keys("splatted"),
            _keys("mixed")
            | {
                "out_color": "frame.color",
                "out_depth": "frame.depth",
                "out_motion": "frame.motion",
                "out_dynamic": "frame.dynamic",
                "disoccluded": "frame.disoccluded",
                "filled_by": "frame.filled_by",
                "mixed": "warp.mixed",
            },
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
