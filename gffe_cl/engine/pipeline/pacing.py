"""Pacing: when frames are shown, and for which time they are made.

Three numbers decide. None of them lets a stall last longer than it did:

- the usual interval of rendered frames: the shorter of the last two, as one of them may have been a stall, and at most
  4/fps;
- the time to make a frame: the second longest of the last eight, so that a single one does not count. What took longer
  than an interval was a stall, and is left out;
- the delay from a rendered frame's time to its display: the least of the last thirty, so that frames which come
  unevenly are shown evenly. It begins anew with a frame that is over an interval later than that.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from dataclasses import dataclass

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_bool, require_frame_rate, require_within
from gffe_cl.engine.frame.camera import FAR_ALPHA, HELD_ALPHA, interval_of

_RECENT = 120  # refreshes over which jitter is measured
_COMPARED = 30  # rendered frames, whose quickest gives the delay
_STALLED = 4.0  # times 1/fps: what takes longer is a stall, however often it does
_MADE = 8  # frames, whose second longest making time counts
_SAME = 1e-3  # of a refresh: times closer than that are one
_LEAST_ALPHA = 1e-6
_MOST_SECONDS = 1e12  # of a clock: beyond, numbers cannot tell tenths of a millisecond apart


@dataclass(frozen=True)
class Plan:
    """Frame to show at a refresh.

    `refresh`: when it is, seconds of the caller's clock; `time`: of the frame, on the renderer's clock, for
    `Pipeline.extrapolate`; `alpha`: the same in intervals from the last rendered frame on, 0 for that one itself;
    `held`: keep showing the present frame, whose `time` and `alpha` these are.
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
    """Paces rendered and extrapolated frames on a display of a steady or a variable rate. It has no clock and no
    thread: the caller passes times in seconds, of one clock that only goes forward (`time.perf_counter`). ::

        pacer = gffe.Pacer(display_rate=120)
        while playing:
            if frame := newest_rendered_frame():
                pipeline.submit(frame)
                pacer.rendered(frame.time, frame.reset)
            plan = pacer.plan(clock())
            if not plan.held:
                picture = pipeline.extrapolate(camera_at(plan.time), plan.time) if plan.alpha else frame
            pacer.ready(clock())
            present(picture, plan.refresh)

    Times are displayed with a delay: that of the quickest of the last rendered frames, from its time to the refresh
    that can show it. Where others come later, more is extrapolated, so that the steps of time stay even. Where the next
    rendered frame is missing, time continues until `most_alpha` intervals after the last one, and is held there. It
    never goes back, but at a reset.

    After a stall every refresh has its frame again from the second rendered frame on, at the latest: a pause is neither
    taken for an interval nor for the time to make a frame.

    Parameters
    ----------
    display_rate : float
        Refreshes per second, 1e-6 to 1e6; of a `variable` display the most that it can do.
    most_alpha : float
        Largest extrapolation, up to 16 intervals of rendered frames: of `Pipeline.interval`, or of the one before where
        that was shorter.
    fps : float
        Rendered frames per second, as of the `Pipeline`: used until two frames are known. What takes longer than four
        such frames is a stall.
    variable : bool
        Whether the display refreshes whenever a frame is presented (VRR). Every rendered frame then has its refresh,
        and between two of them there are as many refreshes, evenly, as the display can do.

    Raises
    ------
    GffeError
        For arguments out of range, for times beyond ±1e12 s, and for times that go back.
    """

    def __init__(self, display_rate: float, most_alpha: float = HELD_ALPHA, fps: float = 30.0, variable: bool = False):
        self._is_variable = require_bool(variable, "pacer: variable")
        self._period = 1.0 / require_frame_rate(display_rate, "pacer: display_rate")
        self._most_alpha = require_within(most_alpha, "pacer: most_alpha", _LEAST_ALPHA, FAR_ALPHA)
        self._fps = require_frame_rate(fps, "pacer: fps")
        self._longest = _STALLED / self._fps
        self._now = -_MOST_SECONDS
        self._times: list[float] = []  # of up to three rendered frames since the last reset, newest first
        self._is_new = False  # nothing was planned since the last rendered frame came
        self._delays: deque[float] = deque(maxlen=_COMPARED)  # from a rendered frame's time to its first refresh
        self._making: deque[float] = deque(maxlen=_MADE)  # seconds
        self._last: Plan | None = None
        self._began = 0.0  # when the last plan was asked for
        self._shown = -math.inf  # time of the frame on display; -inf: of before the last reset
        self._steps: deque[float] = deque(maxlen=_RECENT)  # of time, less those of refreshes, seconds
        self._counts = dict.fromkeys(("rendered", "extrapolated", "held", "late", "dropped"), 0)

    def rendered(self, time: float, reset: bool = False) -> None:
        """Note that a rendered frame of this `time`, on the renderer's clock, is here. `reset`: no frame before it may
        be used, as of `RenderedFrame`; then its time may be any."""
        time = require_within(time, "pacer: time", -_MOST_SECONDS, _MOST_SECONDS)
        if require_bool(reset, "pacer: reset"):
            self._times.clear()
            self._delays.clear()
            self._shown = -math.inf
        elif self._times and time <= self._times[0]:
            raise GffeError(f"pacer: time {time:g} s must be after the rendered frame's before ({self._times[0]:g} s)")
        self._counts["dropped"] += self._is_new
        self._times = [time, *self._times[:2]]
        self._is_new = True

    def plan(self, now: float) -> Plan:
        """Return the frame to show at the next refresh for which one can be ready. Refreshes of a steady display are
        counted from the first plan's `now`, seconds. Raises GffeError before the first rendered frame."""
        now = self._advanced(now)
        if not self._times:
            raise GffeError("pacer: nothing to show (expected a rendered frame first)")
        self._began = now
        newest, interval, soonest = self._times[0], self._usual_interval, now + self._usual_making
        if self._is_new or not self._delays:
            delay = self._refresh_from(soonest) - newest
            if delay - min(self._delays, default=delay) > interval:  # the renderer's clock may have stood still
                self._delays.clear()
            self._delays.append(delay)
        refresh = self._even_refresh_from(soonest)
        ahead = min(max(refresh - min(self._delays) - newest, 0.0), self._most_alpha * interval)
        time = newest + ahead if ahead >= _SAME * self._period else newest
        alpha = min((time - newest) / interval_of(self._times, self._fps), self._most_alpha)
        plan = Plan(refresh, time, alpha)
        if self._last and time <= self._shown + _SAME * self._period:
            plan = Plan(self._even_refresh_from(now), max(self._shown, newest), self._last.alpha, held=True)
        if self._last and self._shown > -math.inf:
            self._steps.append((plan.time - self._shown) - (plan.refresh - self._last.refresh))
        self._counts["held" if plan.held else "extrapolated" if alpha else "rendered"] += 1
        self._is_new = False
        self._last, self._shown = plan, plan.time
        return plan

    def ready(self, now: float) -> None:
        """Note that the frame planned last is ready `now`: made and passed to the display."""
        now = self._advanced(now)
        if self._last is None:
            raise GffeError("pacer: nothing was planned")
        self._counts["late"] += now > self._last.refresh
        if not self._last.held:
            if len(self._making) < 2:
                self._delays.clear()  # of a refresh that was too early, as the time to make a frame was not known
            self._making.append(now - self._began)

    @property
    def statistics(self) -> PacingStatistics:
        """Counts since the beginning, and the jitter of recent steps."""
        jitter = 1e3 * statistics.pstdev(self._steps) if len(self._steps) > 1 else 0.0
        return PacingStatistics(**self._counts, jitter=jitter)

    @property
    def _usual_interval(self) -> float:
        """The shorter of the last two intervals of rendered frames, seconds, unless both were stalls."""
        last, before = (interval_of(self._times[k:], self._fps) for k in range(2))
        return min(last, before, self._longest)

    @property
    def _usual_making(self) -> float:
        """The second longest of the last making times without stalls, seconds; 0 before the first. It is the shortest
        where all took longer than an interval."""
        if within := [seconds for seconds in self._making if seconds <= self._usual_interval]:
            return sorted(within)[-2:][0]
        return min(*self._making, self._longest) if self._making else 0.0

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

    def _refresh_from(self, now: float) -> float:
        """Return the time of the first refresh from `now` on for which nothing is planned. A steady display's refreshes
        are counted from the first one on, a variable one's from the last one on."""
        if self._last is None:
            return now
        if self._is_variable:
            return max(now, self._last.refresh + self._step)
        periods = math.ceil((now - self._last.refresh) / self._period - _SAME)
        return self._last.refresh + max(periods, 1) * self._period

    def _even_refresh_from(self, now: float) -> float:
        """Return the same; for a variable display that is quicker than the renderer the first refresh of those that
        divide the interval of rendered frames evenly, counted from that of the newest frame."""
        if not self._is_variable or self._last is None or self._step == self._period:
            return self._refresh_from(now)
        first, soonest = self._times[0] + min(self._delays), max(now, self._last.refresh + self._period)
        return max(first + math.ceil((soonest - first) / self._step - _SAME) * self._step, soonest)

    @property
    def _step(self) -> float:
        """Seconds between refreshes of a variable display: the interval of rendered frames in as many equal parts as
        it can show."""
        parts = math.floor(self._usual_interval / self._period + _SAME)
        return self._usual_interval / parts if parts else self._period
