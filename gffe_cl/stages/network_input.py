"""Frames as the shading correction network sees them (paper: 'Shading Correction Network')."""

from __future__ import annotations

import numpy as np

from gffe_cl.inference.model_interface import INPUT_PLANES, MULTIPLE
from gffe_cl.opencl.program import constants
from gffe_cl.stages.base import Access, Kernel, Stage, Step, share_of
from gffe_cl.stages.buffers import BufferSpec
from gffe_cl.stages.shading import SEEN

_CONSTANTS = constants("network_input.cl")
assert _CONSTANTS["TILE"] == MULTIPLE

STILL_TILES = share_of("still tiles", "network_input.changed_tiles", lambda changed: changed == 0)


class NetworkInput(Stage):
    """The extrapolated frame and the warped previous one at half resolution, encoded, with inverse depth and input
    mask.

    The code of colour c is e(c) = ln(1 + μ x) / ln(1 + μ), x = exposure · c / 8.

    `is_still`: whether there is nothing to correct: in no tile of 32×32 pixels more than an eighth changes by more than
    1/256 (encoded) from frame t − 1 on. False without a focus mask, where the whole image is to be the network's.
    """

    name = "network_input"
    buffers = (
        BufferSpec(
            "frames", np.float32, (), "network", "what the network sees: encoded GAE colour (1–3), encoded warped"
            " previous frame (4–6), inverse depth (7), input mask (8); half resolution",
            planes=INPUT_PLANES, mapped=True,
        ),
        BufferSpec(
            "histogram", np.uint32, (), "once", "of the depths' leading bits",
            planes=_CONSTANTS["BINS"], scratch=True,
        ),
        BufferSpec("median_depth", np.float32, (), "once", "of the finite depths of every eighth row, to 1/256"),
        BufferSpec(
            "changed_tiles", np.uint8, (), "network4", "1 where a tile of 32×32 pixels changes by more than noise from"
            " t − 1 on", "mask",
        ),
        BufferSpec("changed", np.int32, (), "once", "1 where the frame changes, else there is nothing to correct"),
    )  # fmt: skip
    is_still = False
    kernels = (
        Kernel(
            "depth_histogram",
            "target",
            {"depth": Access("frame.depth", 1 / 8), "histogram": "network_input.histogram"},
            {"histogram": "network_input.histogram"},
            step=("LANES", "STRIP"),
        ),
        Kernel(
            "find_median",
            "once",
            {"histogram": "network_input.histogram"},
            {"median_depth": "network_input.median_depth"},
            group="SCANNERS",
        ),
        Kernel(
            "network_input",
            "network",
            {
                **SEEN,
                "median_depth": "network_input.median_depth",
            },
            {"planes": "network_input.frames"},
            step=("LANES", 1),
        ),
        Kernel(
            "find_changed_tiles",
            "network4",
            {"planes": Access("network_input.frames", planes=6)},
            {"changed_tiles": "network_input.changed_tiles"},
            group=1,
        ),
        Kernel(
            "find_change",
            "once",
            {"changed_tiles": "network_input.changed_tiles"},
            {"changed": "network_input.changed"},
            group="SCANNERS",
        ),
    )

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.corrects_shading

    def extrapolated(self, step: Step) -> None:
        """Fill `frames` and wait for whether anything changes; after a reset there is nothing to go by."""
        self.is_still = False
        if step.previous is None:
            return
        self.fill("histogram", 0)
        self.launch("depth_histogram", step)
        self.launch("find_median")
        self.launch("network_input", step)
        self.launch("find_changed_tiles", step)
        self.launch("find_change", step)
        if self.recorder is None and self.board.options.focus_mask:
            self.is_still = not self.read("changed").item()
