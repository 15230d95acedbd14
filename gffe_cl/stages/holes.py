"""Hole filling: what neither the rendered frame nor the background shows (paper: 'Shading correction network').

A way to fill holes is one entry of `FILLINGS`: its stage and the sentence that tells about it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.buffers import BufferSpec
from gffe_cl.opencl.program import constants
from gffe_cl.stage import Access, Board, Kernel, Stage, Step, reprojection

BLOCK = constants("holes.cl")["BLOCK"]
_VALID = {"color": "frame.color", "depth": "frame.depth", "filled_by": "frame.filled_by"}
_FILLED = {
    "color": Access("frame.color", "unfilled"),
    "depth": Access("frame.depth", "unfilled"),
    "motion": Access("frame.motion", "unfilled"),
}
_LABELLED = Kernel(
    "label_filled",
    "target",
    {"filled_by": "frame.filled_by"},
    {"filled_by": Access("frame.filled_by", "unfilled")},
)


class HoleFilling(Stage):
    """Fills, in place, what is still invalid; filled pixels carry depth and motion."""

    name = "holes"
    reach = 0  # px, in which the far side is looked for

    def extrapolated(self, step: Step) -> None:
        self.fill_holes(reprojection(step.camera, step.frame.camera))
        self.launch("label_filled")

    def fill_holes(self, to_source: np.ndarray) -> None:
        """`to_source`: from the new frame's camera to the rendered frame's."""
        raise NotImplementedError


class Downsampled(HoleFilling):
    """From the means of 32×32 blocks (the paper's)."""

    buffers = (
        BufferSpec(
            "block_color",
            np.float32,
            ("R", "G", "B", "weight"),
            "blocks",
            "weighted sum of valid colour per 32×32 block; 0 where no hole asks for it",
            "color",
        ),
        BufferSpec(
            "block_inverse_depth", np.float32, (), "blocks", "weighted sum of inverse depth per block, 1/world units"
        ),
        BufferSpec("beyond_reach", np.uint32, (), "once", "1 if a hole has no far side within reach"),
    )
    kernels = (
        Kernel(
            "fill_far_side",
            "target",
            {
                "filled_by": "frame.filled_by",
                "color": Access("frame.color", "unfilled"),
                "depth": Access("frame.depth", "unfilled"),
                "beyond_reach": "holes.beyond_reach",
            },
            _FILLED | {"beyond_reach": "holes.beyond_reach"},
        ),
        Kernel(
            "downsample",
            "target",
            {name: Access(buffer, "beyond reach") for name, buffer in _VALID.items()}
            | {
                "beyond_reach": "holes.beyond_reach",
                "source_color": Access("rendered.color", "beyond reach"),
                "source_depth": Access("rendered.depth", "beyond reach"),
            },
            {"block_color": "holes.block_color", "block_inverse_depth": "holes.block_inverse_depth"},
            group="BLOCK",
        ),
        Kernel(
            "fill_from_blocks",
            "target",
            {
                "beyond_reach": "holes.beyond_reach",
                "filled_by": Access("frame.filled_by", "beyond reach"),
                "color": Access("frame.color", "beyond reach"),
                "depth": Access("frame.depth", "beyond reach"),
                "block_color": Access("holes.block_color", "beyond reach"),
                "block_inverse_depth": Access("holes.block_inverse_depth", "beyond reach"),
            },
            {name: Access(access.buffer, "beyond reach") for name, access in _FILLED.items()},
        ),
        _LABELLED,
    )

    def fill_holes(self, to_source: np.ndarray) -> None:
        """The blocks are made only if a hole has no far side within reach, which the device finds out."""
        blocks = self.sizes.of("blocks")
        self.fill("beyond_reach", 0)
        self.launch("fill_far_side", reach=self.reach, to_source=to_source)
        self.launch("downsample", (blocks[0] * BLOCK, blocks[1]))
        self.launch("fill_from_blocks", reach=self.reach, to_source=to_source)


class FarSide(Downsampled):
    """Continues the far side of a disocclusion, and takes block means beyond its reach."""

    def __init__(self, board: Board):
        self.reach = max(16, board.sizes.target[0] // 10)
        super().__init__(board)


class PushPull(HoleFilling):
    """From a pyramid of means."""

    kernels = (
        Kernel("push_image", "mip1", _VALID, {"mean": "holes.mean_1", "weight": "holes.weight_1"}),
        Kernel(
            "push_level",
            "mip{level}",
            {"fine_mean": "holes.mean_{fine}", "fine_weight": "holes.weight_{fine}"},
            {"mean": "holes.mean_{level}", "weight": "holes.weight_{level}"},
        ),
        Kernel(
            "pull_level",
            "mip{level}",
            {
                "coarse_mean": "holes.mean_{coarse}",
                "mean": "holes.mean_{level}",
                "weight": "holes.weight_{level}",
            },
            {"mean": "holes.mean_{level}"},
        ),
        Kernel(
            "fill_from_pyramid",
            "target",
            {"filled_by": "frame.filled_by", "level_mean": Access("holes.mean_1", "unfilled")},
            _FILLED,
        ),
        _LABELLED,
    )

    def __init__(self, board: Board):
        self.levels = max(1, (max(board.sizes.target) - 1).bit_length())  # halved until one texel is left
        self.buffers = tuple(spec for level in range(1, self.levels + 1) for spec in _level_buffers(level))
        super().__init__(board)

    def fill_holes(self, to_source: np.ndarray) -> None:
        self.launch("push_image")
        for fine in range(1, self.levels):
            self.launch("push_level", level=fine + 1, **self._sides(fine=fine))
        for level in range(self.levels - 1, 0, -1):
            self.launch("pull_level", level=level, **self._sides(coarse=level + 1))
        self.launch("fill_from_pyramid", to_source=to_source, **self._sides(level=1))

    def _sides(self, **levels: int) -> dict[str, int]:
        """The levels by name, with their widths and heights."""
        sides = {}
        for name, level in levels.items():
            sides[f"{name}_width"], sides[f"{name}_height"] = self.sizes.of(f"mip{level}")
        return levels | sides


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


def _level_buffers(level: int) -> tuple[BufferSpec, ...]:
    about = f"push-pull level {level}"
    return (
        BufferSpec(
            f"mean_{level}",
            np.float32,
            ("R", "G", "B", "inverse_depth"),
            f"mip{level}",
            f"{about}: completed means",
            "color",
        ),
        BufferSpec(f"weight_{level}", np.float32, (), f"mip{level}", f"{about}: how much of it was valid, 0 to 1"),
    )
