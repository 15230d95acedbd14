"""Background collection and projection (paper: 'Hierarchical Background Collection')."""

from __future__ import annotations

import numpy as np

from gffe_cl.camera import Camera
from gffe_cl.opencl.device import Device
from gffe_cl.stage import RGBA, XY, BufferSpec, NearestStage, Sizes, Stage, halved, int2, reprojection, zoom

MAX_LEVELS = 4
_OWN_TEXEL, _TOUCHED_TEXELS = 0, 1  # phases of scatter_level
_STATES = ((0, "empty"), (1, "shown by the current frame"), (2, "remembered"))
_PER_LEVEL = ("color", "depth", "px", "state")


class Background(NearestStage):
    """Remembers, in L levels, the static fragments that are hidden now, and fills disocclusions from them."""

    name = "background"

    def __init__(self, device: Device, sizes: Sizes, levels: int, int64: bool | None = None):
        """`levels`: L, 1 … 4. `int64`: use 64-bit atomics; None: if the device has them."""
        self.levels = levels
        self.buffers = tuple(spec for level in range(levels) for spec in _level_buffers(level))
        super().__init__(device, sizes, int64)
        self._previous = self.allocate(self.buffers)
        pixels = sizes.source[0] * sizes.source[1]
        self._fill, self._push = self.key_buffers(pixels), self.key_buffers(-(-pixels // 2))
        self._target = self.key_buffers(sizes.target[0] * sizes.target[1])

    def collect(self, frame, previous, history: Stage, warp: Stage) -> None:
        """Update the levels for rendered `frame`; `previous` is None after a reset: then nothing is kept,
        nor collected, because what moves is not known yet."""
        self.buffer, self._previous = self._previous, self.buffer
        current = self._of_level(self.buffer, 0)
        self.launch(
            "collect_shown",
            self.sizes.source,
            *int2(self.sizes.source),
            np.int32(previous is not None),
            frame.color,
            frame.depth,
            history.buffer["dynamic_mask"],
            *current,
        )
        if previous is None:
            for level in range(1, self.levels):
                self.fill(self.buffer[f"state_{level}"], 0)
            return
        to_current = reprojection(previous.camera, frame.camera)
        for level in range(self.levels):
            size, size_below = (halved(self.sizes.source, number) for number in (level, level + 1))
            current, old = (self._of_level(buffers, level) for buffers in (self.buffer, self._previous))
            arguments = (
                to_current,
                frame.depth,
                history.buffer["dynamic_mask"],
                warp.buffer["links"],
                *old[1:],
                current[1],
                current[3],
            )
            self.clear_keys(self._push, size_below)
            self._scatter(level, _OWN_TEXEL, arguments)
            self._settle(size, False, to_current, self._fill, old, current)
            if level + 1 < self.levels:
                below = self._of_level(self.buffer, level + 1)
                self._settle(size_below, True, to_current, self._push, old, below)
            self._scatter(level, _TOUCHED_TEXELS, arguments)
            self._settle(size, False, to_current, self._fill, old, current)

    def _scatter(self, level: int, phase: int, arguments: tuple) -> None:
        size = halved(self.sizes.source, level)
        self.clear_keys(self._fill, size)
        for scatter_pass in self.passes:
            self.launch(
                "scatter_level",
                size,
                *int2(self.sizes.source),
                np.int32(level),
                np.int32(self.levels - 1),
                np.int32(phase),
                np.int32(scatter_pass),
                *arguments,
                *self._fill,
                *self._push,
            )

    def _settle(self, size, restart, to_current, keys, old, current) -> None:
        self.launch("settle_level", size, *int2(size), np.int32(restart), to_current, *keys, *old[:3], *current)

    def project(self, frame, warp: Stage, target: Camera) -> None:
        """Fill the pixels that `warp` left invalid, nearest fragment of all levels first."""
        magnification = zoom(frame.camera, target)
        to_target, to_source = reprojection(frame.camera, target), reprojection(target, frame.camera)
        self.clear_keys(self._target, self.sizes.target)
        for project_pass in self.passes:
            for level in range(self.levels):
                self.launch(
                    "project_level",
                    halved(self.sizes.source, level),
                    *int2(self.sizes.source),
                    np.int32(level),
                    *int2(self.sizes.target),
                    np.int32(project_pass),
                    magnification,
                    to_target,
                    *self._of_level(self.buffer, level)[1:],
                    *(warp.buffer[name] for name in ("disoccluded", "mixed", "depth")),
                    *self._target,
                )
        for level in range(self.levels):
            self.launch(
                "fill_from_level",
                self.sizes.target,
                *int2(self.sizes.source),
                np.int32(level),
                *int2(self.sizes.target),
                magnification,
                to_target,
                to_source,
                *self._of_level(self.buffer, level),
                warp.buffer["disoccluded"],
                warp.buffer["dynamic"],
                *self._target,
                *(warp.buffer[name] for name in ("color", "depth", "motion", "filled_by")),
            )

    def _of_level(self, buffers: dict, level: int) -> list:
        return [buffers[f"{name}_{level}"] for name in _PER_LEVEL]


def _level_buffers(level: int) -> tuple[BufferSpec, ...]:
    grid = f"level{level}"
    return (
        BufferSpec(
            f"color_{level}", np.float16, RGBA, grid, f"colour of background level {level} (B_{level})", "color"
        ),
        BufferSpec(
            f"depth_{level}", np.float32, (), grid, f"view depth of background level {level}, world units", "depth"
        ),
        BufferSpec(
            f"px_{level}", np.float32, XY, grid, "where its fragment lies in the rendered image, pixels", "place"
        ),
        BufferSpec(f"state_{level}", np.uint8, (), grid, "what the level knows there", "label", labels=_STATES),
    )
