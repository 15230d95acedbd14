"""Rendered frames that a pipeline remembers, their times and cameras, and what follows from these."""

from __future__ import annotations

from typing import Any

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.camera_prediction import POSES, predict_camera_at
from gffe_cl.engine.frame.intervals import interval_of
from gffe_cl.engine.options import MAX_ORDER
from gffe_cl.engine.stages.base import Board, Step
from gffe_cl.engine.stages.buffers import DeviceFrame
from gffe_cl.engine.stages.frame_block import MOST_NUMBER, MOST_RESTS, see_alike


class RenderedFrames:
    """The last rendered frames of a pipeline.

    `current` and `previous`, None after a reset, are as stages see them; `shown` is the current one with all of its
    depth. `times` are those since the last reset, newest first, seconds, and `path` their display cameras. `number`,
    `rests` and `coded` are members of the frame block: the current frame's number, for how many intervals its camera
    has been the same, and whether all of its colors are encoded. `exposure` is that of the current frame.
    """

    def __init__(self, board: Board, fps: float):
        self._options, self._fps = board.options, fps
        # Whether blocks at rest are copied.
        self._copies = bool(board.facts.get("copies")) and board.sizes.source == board.sizes.target
        self.current: DeviceFrame | None = None
        self.previous: DeviceFrame | None = None
        self.shown: DeviceFrame | None = None
        self.times: list[float] = []
        self.path: list[Camera] = []
        self.number = self.rests = self.coded = 0
        self.exposure = 1.0

    @property
    def needed(self) -> DeviceFrame:
        """The current frame. Raises GffeError if there is none yet."""
        if self.current is None:
            raise GffeError("pipeline: submit a rendered frame first (also after `change_options`)")
        return self.current

    def require_later(self, time: float) -> None:
        """Raise GffeError unless `time` is after the current frame's."""
        if self.times and time <= self.times[0]:
            raise GffeError(f"frame: time {time:g} s must be after the previous rendered frame's ({self.times[0]:g} s)")

    def take(self, frame: DeviceFrame, shown: DeviceFrame, is_reset: bool, exposure: float) -> None:
        """Make `frame` the current one, and number it. While the camera moves, history tracking encodes all colors."""
        if is_reset:
            self.current, self.times, self.path = None, [], []
        self.previous, self.current, self.shown, self.exposure = self.current, frame, shown, exposure
        self.times, self.path = [frame.time, *self.times[: POSES - 1]], [frame.display_camera, *self.path[: POSES - 1]]
        is_alike = self.previous and self._options.motion and see_alike(self.previous.camera, frame.camera)
        self.rests = min(self.rests + 1, MOST_RESTS) if is_alike else 0
        self.number, self.coded = self.number % MOST_NUMBER + 1, int(not self.rests)

    def forget(self) -> None:
        """Make the current frame one after a reset."""
        del self.times[1:], self.path[1:]
        self.previous, self.rests = None, 0

    def step(self, camera: Camera | None = None, time: float = 0.0, alpha: float = 0.0, **given: Any) -> Step:
        """Return the step of the current frame or, with a `camera`, of a new one; `given`: what replaces parts of it.
        Points at rest stay where they are for a camera that sees alike, unless predicted positions are the caller's:
        then not all colors are encoded."""
        stays = (
            self._copies
            and camera is not None
            and self.previous is not None
            and given.get("target_position") is None
            and see_alike(self.needed.camera, camera)
        )
        rest = self.number, self.rests, stays, self.coded
        times = self.times[: MAX_ORDER + 1]
        return Step(self.needed, self.previous, times, camera, time, alpha, self.exposure, rest=rest, **given)

    def note_made(self, step: Step) -> None:
        """Note that a new frame was made: unless points at rest stay, all colors are encoded now."""
        if not step.rest[2]:
            self.coded = 1

    @property
    def interval(self) -> float:
        """Seconds between the last two frames; 1/fps after a reset."""
        return interval_of(self.times, self._fps)

    def predicted_camera(self, alpha: float) -> Camera:
        """Return the predicted camera C̄ at t + α."""
        time = self.times[0] + alpha * self.interval
        return predict_camera_at(time, self.path, self.times, self._options.camera_order)
