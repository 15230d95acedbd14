"""Rendered frames that a pipeline remembers, their times and cameras, and what follows from these."""

from __future__ import annotations

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.camera_prediction import POSES, predict_camera_at
from gffe_cl.engine.frame.intervals import interval_of
from gffe_cl.engine.options import MAX_ORDER
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import DeviceFrame
from gffe_cl.engine.stages.frame_block import MOST_NUMBER, MOST_RESTS, see_alike


class RenderedFrames:
    """The last rendered frames of a pipeline.

    `current` and `previous`, None after a reset, are as stages see them; `shown` is the current one with all of its
    depth. `times` are those since the last reset, newest first, seconds, and `path` their display cameras. `rest` has
    members of the frame block: the current frame's number, for how many intervals its camera has been the same, and
    whether all of its colors are encoded.
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
        self.rest = {"number": 0, "rests": 0, "coded": 0}

    @property
    def needed(self) -> DeviceFrame:
        """The current frame. Raises GffeError if there is none yet."""
        if self.current is None:
            raise GffeError(
                "pipeline: submit a rendered frame first (also after `change_options`, unless `keeps_frames` is true)"
            )
        return self.current

    def require_later(self, time: float) -> None:
        """Raise GffeError unless `time` is after the current frame's."""
        if self.times and time <= self.times[0]:
            raise GffeError(f"frame: time {time:g} s must be after the previous rendered frame's ({self.times[0]:g} s)")

    def take(self, frame: DeviceFrame, shown: DeviceFrame, is_reset: bool) -> None:
        """Make `frame` the current one, and number it. While the camera moves, history tracking encodes all colors."""
        self.previous, self.current, self.shown = None if is_reset else self.current, frame, shown
        if is_reset:
            self.times, self.path = [], []
        self.times, self.path = [frame.time, *self.times[: POSES - 1]], [frame.display_camera, *self.path[: POSES - 1]]
        rests = 0
        if self.previous and self._options.motion and see_alike(self.previous.camera, frame.camera):
            rests = min(self.rest["rests"] + 1, MOST_RESTS)
        self.rest = {"number": self.rest["number"] % MOST_NUMBER + 1, "rests": rests, "coded": int(not rests)}

    def forget(self) -> None:
        """Make the current frame one after a reset."""
        del self.times[1:], self.path[1:]
        self.previous, self.rest["rests"] = None, 0

    def rest_for(self, camera: Camera, is_replaced: bool) -> dict[str, int]:
        """Return `rest`, and whether points at rest stay where they are for a new `camera`: then not all colors are
        encoded. `is_replaced`: predicted positions are the caller's."""
        copies = self._copies and not is_replaced and self.previous is not None
        return self.rest | {"stays": copies and see_alike(self.needed.camera, camera)}

    @property
    def recent_times(self) -> list[float]:
        """Times of the frames that stages use."""
        return self.times[: MAX_ORDER + 1]

    @property
    def interval(self) -> float:
        """Seconds between the last two frames; 1/fps after a reset."""
        return interval_of(self.times, self._fps)

    def predicted_camera(self, alpha: float) -> Camera:
        """Return the predicted camera C̄ at t + α."""
        time = self.times[0] + alpha * self.interval
        return predict_camera_at(time, self.path, self.times, self._options.camera_order)
