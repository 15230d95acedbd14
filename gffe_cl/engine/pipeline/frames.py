"""Frames of a pipeline: those rendered so far, their display, and the moment of a new one."""

from __future__ import annotations

import warnings
from typing import Any

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_kind, require_number
from gffe_cl.engine.frame.camera import FAR_ALPHA, MOST_ALPHA, Camera, interval_of
from gffe_cl.engine.frame.camera_prediction import POSES, predict_camera_at
from gffe_cl.engine.frame.rendered_frame import is_shown_whole, require_later
from gffe_cl.engine.options import MAX_ORDER
from gffe_cl.engine.stages.base import Board, Rest, Step
from gffe_cl.engine.stages.buffers import DeviceFrame
from gffe_cl.engine.stages.frame_block import MOST_NUMBER, MOST_RESTS, see_alike
from gffe_cl.engine.stages.presentation import Presentation


class RenderedFrames:
    """The last rendered frames of a pipeline.

    `current` and `previous`, None after a reset, are as stages see them. `times` are those since the last reset, newest
    first, seconds, and `path` their display cameras. `number`, `rests` and `coded` are those of `Rest`. `exposure` is
    that of the current frame.
    """

    def __init__(self, board: Board, fps: float):
        self._options, self._fps = board.options, fps
        # Whether blocks at rest are copied.
        self._copies = bool(board.facts.get("copies")) and board.sizes.source == board.sizes.target
        self.current: DeviceFrame | None = None
        self.previous: DeviceFrame | None = None
        self.times: list[float] = []
        self.path: list[Camera] = []
        self.number = self.rests = 0
        self.coded = False
        self.exposure = 1.0

    @property
    def needed(self) -> DeviceFrame:
        """The current frame. Raises GffeError if there is none yet."""
        if self.current is None:
            raise GffeError("pipeline: submit a rendered frame first (also after `change_options`)")
        return self.current

    def require_later(self, time: float) -> None:
        """Raise GffeError unless `time` is after the current frame's."""
        if self.times:
            require_later(time, self.times[0])

    def take(self, frame: DeviceFrame, is_reset: bool, exposure: float) -> None:
        """Make `frame` the current one, and number it. While the camera moves, history tracking encodes all colors."""
        if is_reset:
            self.current, self.times, self.path = None, [], []
        self.previous, self.current, self.exposure = self.current, frame, exposure
        self.times, self.path = [frame.time, *self.times[: POSES - 1]], [frame.display_camera, *self.path[: POSES - 1]]
        is_alike = self.previous and self._options.motion and see_alike(self.previous.camera, frame.camera)
        self.rests = min(self.rests + 1, MOST_RESTS) if is_alike else 0
        self.number, self.coded = self.number % MOST_NUMBER + 1, not self.rests

    def forget(self) -> None:
        """Make the current frame one after a reset."""
        del self.times[1:], self.path[1:]
        self.previous, self.rests = None, 0

    def step(self, camera: Camera | None = None, time: float = 0.0, alpha: float = 0.0) -> Step:
        """Return the step of the current frame or, with a `camera`, of a new one. Points at rest stay where they are
        for a camera that sees alike: then not all colors are encoded."""
        stays = (
            self._copies and camera is not None and self.previous is not None and see_alike(self.needed.camera, camera)
        )
        rest = Rest(self.number, self.rests, stays, self.coded)
        times = self.times[: MAX_ORDER + 1]
        return Step(self.needed, self.previous, times, camera, time, alpha, self.exposure, rest=rest)

    def note_made(self, step: Step) -> None:
        """Note that a new frame was made: unless points at rest stay, all colors are encoded now."""
        if not step.rest.stays:
            self.coded = True

    @property
    def interval(self) -> float:
        """Seconds between the last two frames; 1/fps after a reset."""
        return interval_of(self.times, self._fps)

    def predicted_camera(self, alpha: float) -> Camera:
        """Return the predicted camera C̄ at t + α."""
        time = self.times[0] + alpha * self.interval
        return predict_camera_at(time, self.path, self.times, self._options.camera_order)


def checked_moment(camera: Camera | None, time: Any, frames: RenderedFrames) -> Step:
    """Return the step that makes a new frame from the arguments of `extrapolate`. Raises GffeError for invalid ones."""
    time, alpha = _checked_time(time, frames.needed.time, frames.interval)
    if camera is None:
        camera = frames.predicted_camera(alpha)
    require_kind(camera, Camera, "extrapolate: camera", "a Camera or None")
    return frames.step(camera, time, alpha)


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


class DisplayedFrames:
    """Display of a pipeline's rendered `frames`. `presentation` is the stage that resamples them, None until a frame
    needs it."""

    def __init__(self, board: Board, frames: RenderedFrames):
        self._board, self._frames = board, frames
        self.presentation: Presentation | None = None

    def prepare(self) -> None:
        """Make the stage if the current frame needs it."""
        if self.presentation is None and not self._shown_whole(self._frames.needed):
            self.presentation = Presentation(self._board)

    @property
    def resampling(self) -> Presentation | None:
        """The stage if the current frame is resampled, or the one before was, whose motion must be converted."""
        frames = self._frames.current, self._frames.previous
        return self.presentation if any(frame and not self._shown_whole(frame) for frame in frames) else None

    def show(self, with_color: bool) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
        """Return color, depth and motion of the current frame as displayed, color as rendered unless `with_color`."""
        frame = self._frames.needed.shown
        if not (stage := self.resampling):
            return frame.buffers
        stage.present(frame, self._frames.previous, with_color)
        return stage.buffer["color"], stage.buffer["depth"], stage.buffer["motion"]

    def _shown_whole(self, frame: DeviceFrame) -> bool:
        sizes = self._board.sizes
        return sizes.source == sizes.target and is_shown_whole(frame.camera, frame.display_camera)
