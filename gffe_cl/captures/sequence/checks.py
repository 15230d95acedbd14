"""Checks of input that is legal but suspicious (warnings), and of bad pixels in strict mode."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.sequence.description import FrameEntry
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import BadPixels

_SLOW_INTERVAL = 5.0  # seconds between rendered frames that look like milliseconds
_SEEN_MOVING = 0.5  # pixels


def require_clean(file: str, bad: BadPixels) -> None:
    """Raise GffeError if a frame holds bad pixels (strict mode)."""
    if bad:
        raise GffeError(f"{file}: {bad} (strict)")


def time_warnings(frames: list[FrameEntry], fps: float) -> list[str]:
    """Return sentences about frame times that look wrong; `frames` are the rendered ones, by time."""
    steps = np.diff([entry.time for entry in frames])
    steps = [step for step, entry in zip(steps, frames[1:], strict=True) if not entry.reset]
    if not steps:
        return []
    step = float(np.median(steps))
    if step > _SLOW_INTERVAL:
        return [f"frame interval {step:.3g} s: milliseconds? (times are in seconds)"]
    if not 0.5 <= step * fps <= 2:
        return [f"fps is {fps:g}, but rendered frames are {step:.3g} s apart ({1 / step:.3g} per second)"]
    return []


def zero_motion_warning(motion, depth, camera: Camera, previous: Camera) -> str | None:
    """Return a sentence if `motion` (H, W, 2) is zero everywhere although the camera moved since the frame before, else
    None.

    The camera moved if the center or a corner of the image, at the median of `depth` (H, W), moved by more
    than half a pixel.
    """
    with np.errstate(invalid="ignore"):  # signaling NaN
        moves = motion is None or np.any(motion)
    if moves:
        return None
    surface = depth[np.isfinite(depth) & (depth > 0)]
    if not surface.size:
        return None
    height, width = depth.shape
    px = np.array([(x * width, y * height) for x, y in ((0.5, 0.5), (0, 0), (1, 0), (0, 1), (1, 1))])
    world_pos = camera.unproject(px, np.full(5, np.median(surface)))
    px_previous, depth_previous = previous.project(world_pos)
    shift = np.linalg.norm(px_previous - px, axis=-1)[depth_previous > 0]
    if shift.size and shift.max() <= _SEEN_MOVING:
        return None
    return "motion is zero everywhere although the camera moved"
