"""Trail of a fragment through the last rendered frames, along their motion vectors."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection.buffers import moved

REMEMBERED = 9  # rendered frames, the one that is shown included
_SAME = 0.25  # relative depth within which a surface, which may move, is taken for the one of the frame after
_AROUND = sorted(itertools.product((-1, 0, 1), repeat=2), key=lambda step: (step[0] ** 2 + step[1] ** 2, step))


@dataclass(frozen=True)
class Passed:
    """A rendered frame that was submitted: its cameras, and depth (H, W) and motion (H, W, 2), float32, as arrays or in
    buffers on the device. `begins`: nothing older is known of it."""

    k: int
    camera: Camera
    display_camera: Camera
    size: tuple[int, int]
    depth: np.ndarray | cl.Buffer
    motion: np.ndarray | cl.Buffer
    begins: bool

    def at(self, queue: cl.CommandQueue, x: int, y: int) -> tuple[float, np.ndarray]:
        """Return depth and motion of a pixel inside."""
        if isinstance(self.depth, np.ndarray) and isinstance(self.motion, np.ndarray):
            return float(self.depth[y, x]), self.motion[y, x].astype(np.float64)
        depth, motion, place = np.empty(1, np.float32), np.empty(2, np.float32), y * self.size[0] + x
        cl.enqueue_copy(queue, depth, self.depth, src_offset=4 * place)
        cl.enqueue_copy(queue, motion, self.motion, src_offset=8 * place)
        return float(depth[0]), motion.astype(np.float64)


@dataclass(frozen=True)
class WayPoint:
    """Position of a fragment in rendered frame `k`: `px` of that frame's display."""

    k: int
    px: tuple[float, float]


def way_of(queue: cl.CommandQueue, passed: Iterable[Passed], px: tuple[float, float]) -> tuple[WayPoint, ...]:
    """Return the trail of a surface from rendered position `px` of the first of `passed` (newest first) back, as far as
    it is known: not before a reset, out of the image, over sky, or where something nearer hides it."""
    way, expected = [], None
    for frame in passed:
        met = _met(queue, frame, px, expected)
        if met is None:
            break
        px, depth, motion = met
        way.append(WayPoint(frame.k, moved(px, frame.camera, frame.display_camera)))
        if frame.begins or not (0 < depth < np.inf) or not np.isfinite(motion).all():
            break
        px, expected = (px[0] + motion[0], px[1] + motion[1]), depth
    return tuple(way)


def _met(queue: cl.CommandQueue, frame: Passed, px: tuple[float, float], expected: float | None):
    """Return (position, depth, motion) of the surface at depth `expected` at `px` or one pixel beside it, because
    motion vectors at silhouettes miss by a pixel; None if there is none. `expected`: None for any depth."""
    best, least = None, _SAME
    for dx, dy in _AROUND:
        at = px[0] + dx, px[1] + dy
        x, y = (int(np.floor(c)) for c in at)
        if not (0 <= x < frame.size[0] and 0 <= y < frame.size[1]):
            continue
        depth, motion = frame.at(queue, x, y)
        if expected is None:
            return at, depth, motion
        fault = abs(depth - expected) / expected
        if fault <= least and (best is None or fault < least):
            best, least = (at, depth, motion), fault
        if (dx, dy) == (0, 0) and best:
            break
    return best
