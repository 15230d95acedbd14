"""Pacing: when frames are shown, and for which time they are made."""

from __future__ import annotations

import math
import statistics
from collections import deque
from dataclasses import dataclass

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_frame_rate, require_within
from gffe_cl.engine.frame.camera import MOST_ALPHA

_RECENT = 120  # refreshes over which jitter is measured
_COMPARED = 120  # rendered frames, whose fastest gives the least delay from a frame's time to its display
_LASTING = 16  # frames whose slowest gives the time to make one
_SAME = 1e-3  # of a refresh: times closer than that are one
_LEAST_ALPHA = 1e-6
_MOST_SECONDS = 1e12  # of a clock: beyond, numbers cannot tell tenths of a millisecond apart


@dataclass(frozen=True)
class Plan:
    """Frame to show at a refresh.

    `refresh`: when it is, seconds of the caller's clock; `time`: of the frame, on the renderer's clock, for
    `Pipeline.extrapolate`; `alpha`: the same in intervals from the last rendered frame on, 0 for that one itself;
    `held`: keep showing the present frame.
    """

    refresh: float
    time: float
    alpha: float
    held: bool = False


@dataclass(frozen=True)
class PacingStatistics:
    """Counts since the beginning: refreshes that were planned; of these shown as `rendered`, `extrapolated` or `held`;
    frames that were ready too `late` for their refresh; rendered frames `dropped`, since a newer one came before their
    turn. `jitter`: how evenly time goes on, the standard deviation of recent steps from refresh to refresh, ms."""

    rendered: int = 0
    extrapolated: int = 0
    held: int = 0
    late: int = 0
    dropped: int = 0
    jitter: float = 0.0


class Pacer:
    """Paces rendered and extrapolated frames on a display of a steady rate. It has no clock and no thread: the caller
    passes times in seconds, of one clock that only goes forward (`time.perf_counter`). ::

        pacer = gffe.Pacer(display_rate=120)
        while playing:
            if frame := newest_rendered_frame():
                pipeline.submit(frame)
                pacer.rendered(frame.time)
            plan = pacer.plan(clock())
            if not plan.held:
                picture = pipeline.extrapolate(camera_at(plan.time), plan.time) if plan.alpha else frame
            pacer.ready(clock())
            present(picture, plan.refresh)

    Times are displayed with a delay: that of the quickest of the last rendered frames, from its time to the refresh
    that can show it. Where others come later, more is extrapolated, so that the steps of time stay even. Where the next
    rendered frame is missing, time continues until `most_alpha` intervals after the last one, and is held there. It
    never goes back.

    Parameters
    ----------
    display_rate : float
        Refreshes per second, 1e-6 to 1e6.
    most_alpha : float
        Largest extrapolation, in intervals of rendered frames, up to a million.

    Raises
    ------
    GffeError
        For arguments out of range, for times beyond ±1e12 s, and for times that go back.
    """

    def __init__(self, display_rate: float, most_alpha: float = 2.0):
        self._period = 1.0 / require_frame_rate(display_rate, "pacer: display_rate")
        self._most_alpha = require_within(most_alpha, "pacer: most_alpha", _LEAST_ALPHA, MOST_ALPHA)
        self._now = -_MOST_SECONDS
        self._newest: float | None = None  # time of the last rendered frame
        self._interval = 0.0
        self._delays: deque[float] = deque(maxlen=_COMPARED)  # from a rendered frame's time to its first refresh
        self._is_new = False  # nothing was planned since the last rendered frame came
        self._last: Plan | None = None
        self._began = 0.0  # when the last plan was asked for
        self._making: deque[float] = deque(maxlen=_LASTING)  # seconds
        self._steps: deque[float] = deque(maxlen=_RECENT)  # of time, seconds
        self._counts = dict.fromkeys(("rendered", "extrapolated", "held", "late", "dropped"), 0)

    def rendered(self, time: float) -> None:
        """Note that a rendered frame of this `time`, on the renderer's clock, is here."""
        time = require_within(time, "pacer: time", -_MOST_SECONDS, _MOST_SECONDS)
        if self._newest is not None:
            if time <= self._newest:
                raise GffeError(
                    f"pacer: time {time:g} s must be after the rendered frame's before ({self._newest:g} s)"
                )
            self._counts["dropped"] += self._is_new
            self._interval = time - self._newest
        self._newest, self._is_new = time, True

    def plan(self, now: float) -> Plan:
        """Return the frame to show at the next refresh for which one can be ready. Raises GffeError before the first
        rendered frame."""
        now = self._advanced(now)
        if self._newest is None:
            raise GffeError("pacer: nothing to show (expected a rendered frame first)")
        self._began = now
        refresh = self._refresh_after(now + max(self._making, default=0.0))
        if self._is_new or not self._delays:
            self._delays.append(refresh - self._newest)
        most = self._newest + self._most_alpha * self._interval
        time = max(min(refresh - min(self._delays), most), self._newest)
        if time - self._newest < _SAME * self._period:
            time = self._newest
        last = self._last
        held = False
        if last is not None and time <= last.time + _SAME * self._period:
            time, held = last.time, True
        alpha = (time - self._newest) / self._interval if self._interval else 0.0
        if last is not None:
            self._steps.append((time - last.time) - (refresh - last.refresh))
        self._counts["held" if held else "extrapolated" if alpha else "rendered"] += 1
        self._is_new = False
        self._last = Plan(refresh, time, alpha, held)
        return self._last

    def ready(self, now: float) -> None:
        """Note that the frame planned last is ready `now`: made and passed to the display."""
        now = self._advanced(now)
        if self._last is None:
            raise GffeError("pacer: nothing was planned")
        if not self._making:
            self._delays.clear()  # of a refresh that was too early
        if not self._last.held:
            self._making.append(max(now - self._began, 0.0))
        self._counts["late"] += now > self._last.refresh

    @property
    def statistics(self) -> PacingStatistics:
        """Counts since the beginning, and the jitter of recent steps."""
        jitter = 1e3 * statistics.pstdev(self._steps) if len(self._steps) > 1 else 0.0
        return PacingStatistics(**self._counts, jitter=jitter)

    def _advanced(self, now: float) -> float:
        """Return `now`, the latest time of the caller's clock so far. Raises GffeError if it goes back."""
        now = require_within(now, "pacer: now", -_MOST_SECONDS, _MOST_SECONDS)
        if now < self._now:
            raise GffeError(
                f"pacer: now {now:.9g} s is before the last call's ({self._now:.9g} s, expected a clock that only goes"
                " forward)"
            )
        self._now = now
        return now

    def _refresh_after(self, now: float) -> float:
        """Return the time of the first refresh from `now` on for which nothing is planned; refreshes are counted from
        the first one on."""
        if self._last is None:
            return now
        periods = math.ceil((now - self._last.refresh) / self._period - _SAME)
        return self._last.refresh + max(periods, 1) * self._period
