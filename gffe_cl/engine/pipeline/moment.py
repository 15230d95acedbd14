"""Arguments of `Pipeline.extrapolate`, checked."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import as_float32, require_array, require_kind, require_number, shown
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.intervals import FAR_ALPHA, MOST_ALPHA
from gffe_cl.engine.pipeline.rendered_frames import RenderedFrames
from gffe_cl.engine.stages.base import Step
from gffe_cl.engine.stages.buffers import Sizes


def checked_moment(
    camera: Camera | None,
    time: Any,
    target_position: Any,
    seen_through: Any,
    frames: RenderedFrames,
    sizes: Sizes,
) -> Step:
    """Return the step that makes a new frame from the arguments of `extrapolate`. Raises GffeError for invalid ones."""
    time, alpha = _checked_time(time, frames.needed.time, frames.interval)
    if camera is None:
        camera = frames.predicted_camera(alpha)
    require_kind(camera, Camera, "extrapolate: camera", "a Camera or None")
    if target_position is None and seen_through is None:  # mostly
        return frames.step(camera, time, alpha)
    positions, geometry = _checked_positions(target_position, sizes), _checked_geometry(seen_through, sizes)
    return frames.step(camera, time, alpha, target_position=positions, geometry=geometry)


def _checked_time(time: Any, after: float, interval: float) -> tuple[float, float]:
    """Return the time of a new frame (seconds; None: half an interval ahead) and its α. `after`: the rendered frame's
    time. Warns of a time far ahead. Raises GffeError for one before the rendered frame's, or too far ahead."""
    time = after + interval / 2 if time is None else require_number(time, "extrapolate: time")
    alpha = (time - after) / interval
    if alpha < 0:
        raise GffeError(f"extrapolate: time {time:g} s is before the last rendered frame's ({after:g} s)")
    if not alpha <= MOST_ALPHA:
        raise GffeError(f"extrapolate: time {time:g} s is more than {MOST_ALPHA:g} intervals after {after:g} s")
    if alpha > FAR_ALPHA:  # a program may have stalled: it must not fail
        warnings.warn(
            f"extrapolate: time {time:g} s is {alpha:.0f} intervals after the last rendered frame's (expected up to"
            f" {FAR_ALPHA:g}, in seconds on the clock of the rendered frames)",
            stacklevel=5,
        )
    return time, alpha


def _checked_positions(target_position: Any, sizes: Sizes) -> np.ndarray | None:
    """Return positions that replace position prediction. Raises GffeError for another shape than (H, W, 4)."""
    if target_position is None:
        return None
    return as_float32(require_array(target_position, "extrapolate: target_position", *reversed(sizes.source), 4))


def _checked_geometry(seen_through: Any, sizes: Sizes) -> dict[str, np.ndarray]:
    """Return depth and motion that replace the new frame's, by name. Raises GffeError for other shapes than theirs."""
    if seen_through is None:
        return {}
    if not isinstance(seen_through, tuple | list) or len(seen_through) != 2:
        raise GffeError(f"extrapolate: seen_through must be (depth, motion), got {shown(seen_through)}")
    size, what = tuple(reversed(sizes.target)), "extrapolate: seen_through, "
    depth, motion = (
        require_array(seen_through[0], f"{what}depth", *size),
        require_array(seen_through[1], f"{what}motion", *size, 2),
    )
    return {"depth": as_float32(depth), "motion": as_float32(motion)}
