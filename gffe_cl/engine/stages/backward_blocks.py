"""Search for backward blocks: parts of the new frame that need no splatting (for 'Warping')."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.silhouettes import Silhouettes

_CONSTANTS = constants("backward_blocks.cl")
SPLATTED, BACKWARD, COPIED = (_CONSTANTS[name] for name in ("SPLATTED", "BACKWARD", "COPIED"))
CLASSES = (
    (SPLATTED, "splatted: edges that move apart, movers, disocclusions"),
    (BACKWARD, "nothing moves apart: warped backward"),
    (COPIED, "nothing moves, nor does the camera: copied"),
)
SMOOTHNESS = (
    (0, "not smooth"),
    (_CONSTANTS["SMOOTH"], "smooth"),
    (_CONSTANTS["RESTING"], "stays in place"),
)


class BackwardBlocks(NearestStage):
    """Finds the blocks of 8×4 pixels in which nothing moves apart, to be warped backward; the others are splatted."""

    name = "backward_blocks"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "smooth", np.uint8, (), "source_blocks", "what the block shows if predicted positions are linear over it",
            "label", labels=SMOOTHNESS,
        ),
        BufferSpec("block_class", np.uint8, (), "target_blocks", "how the block is warped", "label", labels=CLASSES),
        BufferSpec(
            "reach", np.int16, ("x0", "y0", "x1", "y1"), "source_blocks", "target blocks that a block reaches",
            transient=True,
        ),
        BufferSpec(
            "reached_by", np.int32, ("x0", "y0", "x1", "y1"), "target_blocks", "source blocks that reach a block",
            scratch=True,
        ),
        BufferSpec(
            "block_source", np.float32, ("x", "y", "xx", "xy", "yx", "yy", "unused", "unused"), "target_blocks",
            "where the block's center comes from, and the inverse of its flow", scratch=True, transient=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "find_reach",
            "source_blocks",
            {
                "depth": "rendered.depth",
                "links": "connectivity.links",
                "target_position": "prediction.target_position",
                "last_stir": "history.last_stir",
                "reached_by": "backward_blocks.reached_by",
            },
            {
                "smooth": "backward_blocks.smooth",
                "reach": "backward_blocks.reach",
                "reached_by": "backward_blocks.reached_by",
            },
        ),
        Kernel(
            "classify_blocks",
            "target_blocks",
            {
                "smooth": "backward_blocks.smooth",
                "reached_by": "backward_blocks.reached_by",
                "target_position": "prediction.target_position",
            },
            {
                "reached_by": "backward_blocks.reached_by",
                "block_class": "backward_blocks.block_class",
                "block_source": "backward_blocks.block_source",
                "marked": "silhouettes.marked",
                "keys": "warp.keys",
                "winners": "warp.winners",
            },
        ),
    )

    def __init__(self, board: Board):
        self.finds = board.options.blocks and board.options.crack_closing
        board.facts["softens"] = Silhouettes.is_wanted(board.options)
        board.facts["copies"] = board.options.motion and self.finds
        if not self.finds:  # nothing is written to it
            self.buffers = tuple(replace(spec, scratch=spec.scratch or spec.name == "reach") for spec in self.buffers)
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        if self.finds:
            self.launch("find_reach", step)
        self.launch("classify_blocks", step)
