"""Hole filling from the image downsampled 32 times (paper: 'Shading correction network')."""

from __future__ import annotations

import numpy as np

from gffe_cl.camera import Camera
from gffe_cl.device import Device
from gffe_cl.stage import BufferSpec, Sizes, Stage, int2, reprojection

BLOCK = 32


class HoleFilling(Stage):
    """Fills, in place, what is still invalid in the warped frame; filled pixels carry depth and motion."""

    name = "holes"
    buffers = (
        BufferSpec(
            "block_color",
            np.float32,
            ("R", "G", "B", "weight"),
            "blocks",
            "sum of valid colour and weight per 32×32 block",
        ),
        BufferSpec("block_inverse_depth", np.float32, (), "blocks", "sum of inverse depth per 32×32 block"),
    )

    def __init__(self, device: Device, sizes: Sizes, far_side: bool):
        """`far_side`: continue the far side of disocclusions; else, and beyond its reach, block means."""
        super().__init__(device, sizes)
        self.reach = max(16, sizes.target[0] // 10) if far_side else 0

    def fill_holes(self, frame, warp: Stage, target: Camera) -> None:
        color, depth, motion, filled_by = (warp.buffer[name] for name in ("color", "depth", "motion", "filled_by"))
        blocks = tuple(-(-n // BLOCK) for n in self.sizes.target)
        block_buffers = (self.buffer["block_color"], self.buffer["block_inverse_depth"])
        self.launch(
            "downsample",
            (blocks[0] * BLOCK, blocks[1]),
            *int2(self.sizes.target),
            *int2(self.sizes.source),
            np.int32(blocks[0]),
            color,
            depth,
            filled_by,
            frame.color,
            frame.depth,
            *block_buffers,
            group=BLOCK,
        )
        self.launch(
            "fill_holes",
            self.sizes.target,
            *int2(self.sizes.target),
            *int2(blocks),
            np.int32(self.reach),
            filled_by,
            *block_buffers,
            reprojection(target, frame.camera),
            color,
            depth,
            motion,
        )
