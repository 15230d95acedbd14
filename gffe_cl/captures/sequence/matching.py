"""Lookup of a sequence's frames by time. No other module defines the tolerance."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

from gffe_cl.captures.sequence.description import KINDS, FrameEntry
from gffe_cl.engine.frame.camera import Camera

_TOLERANCE = 1 / 50  # of the interval of rendered frames
_NEAR = 3  # tolerances: a frame that is missed by less was probably meant


class Timeline:
    """The `frames` of a sequence, in order of time. `fps` is used where there is no interval."""

    def __init__(self, frames: list[FrameEntry], fps: float):
        self._fps = fps
        self._of_kind: dict[str, list[FrameEntry]] = {kind: [] for kind in (*KINDS, "camera_only")}
        for entry in frames:
            self._of_kind[entry.kind].append(entry)
        self._times = {kind: [entry.time for entry in entries] for kind, entries in self._of_kind.items()}

    def tolerance(self, time: float) -> float:
        """Return the seconds around `time` that count as the same time: 1/50 of the interval between the rendered
        frames around it; after the last one, or before a reset, of the interval before that frame; else of 1/fps."""
        rendered, times = self._of_kind["rendered"], self._times["rendered"]
        k = max(bisect_right(times, time) - 1, 0)
        interval = 1 / self._fps
        if k + 1 < len(rendered) and not rendered[k + 1].reset:
            interval = times[k + 1] - times[k]
        elif 0 < k < len(rendered) and not rendered[k].reset:
            interval = times[k] - times[k - 1]
        return _TOLERANCE * interval

    def at(self, kind: str, time: float) -> FrameEntry | None:
        entries, times, slack = self._of_kind[kind], self._times[kind], self.tolerance(time)
        found = entries[bisect_left(times, time - slack) : bisect_right(times, time + slack)]
        return min(found, key=lambda entry: abs(entry.time - time), default=None)

    def nearest(self, kind: str, time: float) -> FrameEntry | None:
        k = bisect_left(self._times[kind], time)
        return min(self._of_kind[kind][max(k - 1, 0) : k + 1], key=lambda entry: abs(entry.time - time), default=None)

    def near_miss(self, kind: str, time: float) -> str | None:
        near = self.nearest(kind, time)
        if near is None or self.at(kind, time) or abs(near.time - time) > _NEAR * self.tolerance(time):
            return None
        apart = 1e3 * abs(near.time - time)
        return f"{near.file} at {near.time:.6g} s is {apart:.3g} ms from {time:.6g} s, more than 1/50 of an interval"

    def camera_at(self, time: float) -> Camera | None:
        known = self.at("ground_truth", time), self.at("camera_only", time)
        cameras = [entry.display_camera or entry.render_camera for entry in known if entry is not None]
        return next(filter(None, cameras), None)

    def rendered_before(self, time: float) -> int | None:
        k = bisect_right(self._times["rendered"], time - self.tolerance(time)) - 1
        return k if k >= 0 else None
