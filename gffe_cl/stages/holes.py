"""Hole filling: what neither the rendered frame nor the background shows (paper: 'Shading correction network')."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.camera import Camera
from gffe_cl.opencl.device import Device
from gffe_cl.stage import BufferSpec, Sizes, Stage, int2, reprojection

BLOCK = 32


class HoleFilling(Stage):
    """Fills, in place, what is still invalid in the warped frame; filled pixels carry depth and motion."""

    name = "holes"

    def fill_holes(self, frame, warp: Stage, target: Camera) -> None:
        raise NotImplementedError


class Downsampled(HoleFilling):
    """From the means of 32×32 blocks (the paper's)."""

    reach = 0  # px, in which the far side is looked for
    buffers = (
        BufferSpec(
            "block_color",
            np.float32,
            ("R", "G", "B", "weight"),
            "blocks",
            "weighted sum of valid colour per 32×32 block",
            "color",
        ),
        BufferSpec(
            "block_inverse_depth", np.float32, (), "blocks", "weighted sum of inverse depth per block, 1/world units"
        ),
    )

    def fill_holes(self, frame, warp: Stage, target: Camera) -> None:
        color, depth, motion, filled_by = (warp.buffer[name] for name in ("color", "depth", "motion", "filled_by"))
        blocks = self.buffers[0].size(self.sizes)
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


class FarSide(Downsampled):
    """Continues the far side of a disocclusion, and takes block means beyond its reach."""

    def __init__(self, device: Device, sizes: Sizes):
        self.reach = max(16, sizes.target[0] // 10)
        super().__init__(device, sizes)


class PushPull(HoleFilling):
    """From a pyramid of means."""

    def __init__(self, device: Device, sizes: Sizes):
        self.levels = _level_count(sizes)
        self.buffers = tuple(spec for level in range(1, self.levels + 1) for spec in _level_buffers(level))
        super().__init__(device, sizes)

    def fill_holes(self, frame, warp: Stage, target: Camera) -> None:
        color, depth, motion, filled_by = (warp.buffer[name] for name in ("color", "depth", "motion", "filled_by"))
        sizes = {spec.name: spec.size(self.sizes) for spec in self.buffers}

        def level(number: int) -> tuple:
            return sizes[f"mean_{number}"], self.buffer[f"mean_{number}"], self.buffer[f"weight_{number}"]

        size, mean, weight = level(1)
        self.launch("push_image", size, *int2(self.sizes.target), *int2(size), filled_by, color, depth, mean, weight)
        for number in range(1, self.levels):
            (fine, *fine_buffers), (size, *buffers) = level(number), level(number + 1)
            self.launch("push_level", size, *int2(fine), *int2(size), *fine_buffers, *buffers)
        for number in range(self.levels - 1, 0, -1):
            (size, mean, weight), (coarse, coarse_mean, _) = level(number), level(number + 1)
            self.launch("pull_level", size, *int2(size), *int2(coarse), coarse_mean, mean, weight)
        size, mean, _ = level(1)
        self.launch(
            "fill_from_pyramid",
            self.sizes.target,
            *int2(self.sizes.target),
            *int2(size),
            filled_by,
            mean,
            reprojection(target, frame.camera),
            color,
            depth,
            motion,
        )


@dataclass(frozen=True)
class Filling:
    """A way to fill holes: a `sentence` for help and for the story of a pixel, and its stage, None to leave holes."""

    sentence: str
    stage: type[HoleFilling] | None


FILLINGS = {
    "far-side": Filling("continues the far side of the hole", FarSide),
    "push-pull": Filling("is a mean of the surroundings, from a pyramid of means", PushPull),
    "downsample": Filling("comes from the image downsampled 32 times, as in the paper", Downsampled),
    "none": Filling("stays black, at infinite depth", None),
}


def _level_count(sizes: Sizes) -> int:
    """Levels of halving until one texel is left; at least one."""
    return max(1, (max(sizes.target) - 1).bit_length())


def _level_buffers(level: int) -> tuple[BufferSpec, ...]:
    grid = f"mip{level}"
    return (
        BufferSpec(
            f"mean_{level}",
            np.float32,
            ("R", "G", "B", "inverse_depth"),
            grid,
            f"push-pull level {level}: completed means",
            "color",
        ),
        BufferSpec(
            f"weight_{level}", np.float32, (), grid, f"push-pull level {level}: how much of it was valid, 0 to 1"
        ),
    )
