"""Playback: the slots that are due, requested and shown. The wall clock is handed in; nothing here waits."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ..picture.displays import is_sound

MOST_GENERATED = 7
ROUNDING = 1e-6  # seconds by which a slot may be early: clocks are sums of many small steps


@dataclass(frozen=True)
class Schedule:
    """Times at which slots are due, in seconds of the sequence.

    Without `times` rendered frames are 1/fps apart. With them (seconds, one per rendered frame, increasing) the frames
    generated after one are spread over the interval before it, as the pipeline extrapolates, or over the one
    after it where that is shorter; so nothing new is due during a gap.
    """

    count: int = 1
    fps: float = 30.0
    n: int = 1
    times: tuple[float, ...] | None = None

    @property
    def slots(self) -> int:
        return self.count * (self.n + 1)

    @property
    def rate(self) -> float:
        """Slots per second at normal speed, on average."""
        if self.times is None or self.count == 1:
            return self.fps * (self.n + 1)
        return (self.n + 1) * (self.count - 1) / (self.times[-1] - self.times[0])

    def time_of(self, slot: int) -> float:
        """Return when `slot` is due, in seconds; for the slot after the last one, when that one has been shown long
        enough."""
        k = min(slot // (self.n + 1), self.count - 1)
        return self._rendered(k) + self._span(k) * ((slot - k * (self.n + 1)) / (self.n + 1))

    def slot_at(self, time: float) -> int:
        """Return the last slot that is due at `time` (seconds); the first one before its time."""
        return max(bisect_right(range(self.slots), time + ROUNDING, key=self.time_of) - 1, 0)

    def duration(self, slot: int) -> float:
        """Return the seconds from `slot` until the next one is due."""
        return self.time_of(slot + 1) - self.time_of(slot)

    def _rendered(self, k: int) -> float:
        return k / self.fps if self.times is None else self.times[k]

    def _span(self, k: int) -> float:
        if self.times is None:
            return 1 / self.fps
        before = self.times[k] - self.times[k - 1] if k else 1 / self.fps
        return before if k == self.count - 1 else min(before, self.times[k + 1] - self.times[k])


REAL_TIME = "real time"
EVERY_FRAME = "every frame"
MODES = (REAL_TIME, EVERY_FRAME)
SPEEDS = (0.1, 4.0)
_LONGEST_STALL = 1.0  # seconds: a longer pause between two ticks (suspended machine) is not played over
_RATE_WINDOW = 1.0  # seconds


class Tick(NamedTuple):
    """Outcome of a tick. `request`: slot to ask the engine for; `visible`: slot to have on screen, None before the
    first delivery."""

    request: int
    visible: int | None


class Playback:
    """Position in a sequence, moved by hand or by the clock.

    "real time": slots are due by the clock, those that come too late are dropped and counted. "every frame":
    the next slot is asked for as soon as the present one has been delivered, but not before it is due.

    Counted since `play`: `due` = `shown` + `dropped` + `waiting`, where `waiting` are those that are due and
    neither delivered nor overtaken by a later one. A slot that is still awaited when playback stops stays
    requested as a still image and is not counted.
    """

    def __init__(self, count: int = 1, fps: float = 30.0, n: int = 1, times: Sequence[float] | None = None):
        self._schedule = Schedule(count, fps, n, None if times is None else tuple(map(float, times)))
        self._mode, self._speed, self._loop = REAL_TIME, 1.0, True
        self._in: float | None = None  # seconds: points stay where they are when n changes
        self._out: float | None = None
        self._playing = self._scrubbing = False
        self.slot = 0
        self.visible: int | None = None
        self.due = self.shown = self.dropped = self.waiting = 0
        self.rate = 0.0
        self._time = self._schedule.time_of(0)
        self._spent = 0.0  # seconds of the sequence since the present slot was asked for ("every frame")
        self._ready: int | None = None
        self._now: float | None = None
        self._started = 0.0
        self._stamps: deque[float] = deque()  # when slots were shown, during the last second

    def open(self, count: int, fps: float, times: Sequence[float] | None = None, *, keep: bool = False) -> None:
        """Take over another sequence: stop at its start without in and out points. `keep`: the same one reloaded,
        stay."""
        schedule = Schedule(count, fps, self.n, None if times is None else tuple(map(float, times)))
        self.pause()
        self._schedule, self._ready, self.visible = schedule, None, None
        if not keep:
            self._in = self._out = None
        self._place(schedule.slot_at(self._time) if keep else 0)

    def extend(self, count: int, times: Sequence[float] | None = None) -> None:
        """Take over the same sequence with more frames at its end. Paused at the last slot, it goes to the new last
        one."""
        at_end = not self._playing and self.slot == self.slots - 1
        self._schedule = Schedule(count, self.fps, self.n, None if times is None else tuple(map(float, times)))
        if at_end:
            self._place(self.slots - 1)

    @property
    def count(self) -> int:
        """Rendered frames."""
        return self._schedule.count

    @property
    def fps(self) -> float:
        """Rendered frames per second."""
        return self._schedule.fps

    @property
    def slots(self) -> int:
        return self._schedule.slots

    @property
    def n(self) -> int:
        """Generated frames after each rendered one. Setting it keeps the time, and goes on playing."""
        return self._schedule.n

    @n.setter
    def n(self, n: int) -> None:
        if n == self.n:
            return
        old = self._schedule
        self._schedule = Schedule(old.count, old.fps, n, old.times)
        self._ready = None
        if self.visible is not None:
            self.visible = self._schedule.slot_at(old.time_of(self.visible))
        time = self._time  # stays exact: going back to the old n restores the slot
        self.slot = self._schedule.slot_at(time)
        if self._playing:
            self._jump(min(max(self.slot, self.first), self.last))
        self._time = max(self._time, time)

    def time_of(self, slot: int) -> float:
        """Return the seconds of the sequence at which `slot` is due."""
        return self._schedule.time_of(slot)

    @property
    def target_rate(self) -> float:
        """Slots per second that are due, on average."""
        return self._schedule.rate * self._speed

    @property
    def mode(self) -> str:
        return self._mode

    @mode.setter
    def mode(self, mode: str) -> None:
        self._overtake()
        self._mode = mode

    @property
    def speed(self) -> float:
        """Seconds of the sequence per second, 0.1 to 4; other numbers are clamped."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._speed = min(max(float(speed), SPEEDS[0]), SPEEDS[1])

    @property
    def loop(self) -> bool:
        """Whether playback wraps from out to in; otherwise it stops at out."""
        return self._loop

    @loop.setter
    def loop(self, loop: bool) -> None:
        self._overtake()
        self._loop = bool(loop)

    def preferences(self) -> dict:
        """Return mode, speed and loop, as plain JSON to remember."""
        return {"mode": self._mode, "speed": self._speed, "loop": self._loop}

    def restore(self, saved: dict) -> None:
        """Restore the result of `preferences`. Damaged values are ignored."""
        for name, usual in self.preferences().items():
            if is_sound(saved.get(name), usual, MODES if name == "mode" else ()):
                setattr(self, name, saved[name])

    @property
    def playing(self) -> bool:
        return self._playing

    def play(self) -> None:
        """Play from here; from the in point if this is outside of the points or, without a loop, at the end."""
        if self._playing or self._scrubbing:
            return
        outside = not self.first <= self.slot <= self.last
        self._place(self.first if outside or (self.slot == self.last and not self._loop) else self.slot)
        self.waiting = int(self.visible != self.slot)
        self.due, self.shown, self.dropped = self.waiting, 0, 0
        self._spent, self._now = 0.0, None
        self._stamps.clear()
        self._playing = True

    def pause(self) -> None:
        """Stay at the slot that is due now."""
        if self._playing:
            self._overtake()
            self.due -= self.waiting
            self.waiting, self.rate, self._playing = 0, 0.0, False
            self._place(self.slot)

    def toggle(self) -> None:
        """Play or pause."""
        (self.pause if self._playing else self.play)()

    @property
    def scrubbing(self) -> bool:
        """Whether the user scrubs: then nothing plays; playback stays paused afterwards."""
        return self._scrubbing

    @scrubbing.setter
    def scrubbing(self, scrubbing: bool) -> None:
        self._scrubbing = bool(scrubbing)
        if scrubbing:
            self.pause()

    def seek(self, slot: int) -> None:
        """Go to `slot`. Like all moves by hand this pauses, and goes no further than the ends of the sequence."""
        self.pause()
        self._place(self._clamped(slot))

    def step(self, slots: int = 1) -> None:
        self.seek(self.slot + slots)

    def step_rendered(self, frames: int = 1) -> None:
        """Go to the next (1) or previous (−1) rendered frame; from a generated one, back to the frame it was made
        of."""
        k, j = divmod(self.slot, self.n + 1)
        target = min(max(k + frames + (j > 0 and frames < 0), 0), self.count - 1) * (self.n + 1)
        self.seek(target if frames < 0 else max(target, self.slot))

    def home(self) -> None:
        """Go to the in point; from there, or before it, to the first slot."""
        self.seek(self.first if self.slot > self.first else 0)

    def end(self) -> None:
        """Go to the out point; from there, or after it, to the last slot."""
        self.seek(self.last if self.slot < self.last else self.slots - 1)

    @property
    def first(self) -> int:
        """First slot that is played."""
        return 0 if self._in is None else self._schedule.slot_at(self._in)

    @property
    def last(self) -> int:
        """Last slot that is played."""
        return self.slots - 1 if self._out is None else self._schedule.slot_at(self._out)

    def set_in(self, slot: int | None = None) -> None:
        """Play from `slot` (default: this one) on. An out point before it is cleared."""
        slot = self._clamped(self.slot if slot is None else slot)
        self._points(self.time_of(slot), None if slot > self.last else self._out)

    def set_out(self, slot: int | None = None) -> None:
        """Play up to and including `slot` (default: this one). An in point after it is cleared."""
        slot = self._clamped(self.slot if slot is None else slot)
        self._points(None if slot < self.first else self._in, self.time_of(slot))

    def clear_points(self) -> None:
        """Play the whole sequence."""
        self._points(None, None)

    def tick(self, now: float, ready: int | None) -> Tick:
        """Move on, once per frame of the interface, and return the slots to request and to show. `now`: wall clock in
        seconds; `ready`: slot that the engine has delivered last, counted with the present n and in the present
        sequence (None: nothing yet)."""
        if self._now is None:
            self._started = self._now = now
        elapsed = min(max(now - self._now, 0.0), _LONGEST_STALL)
        self._now = now
        news, self._ready = ready != self._ready, ready
        if self._playing:
            if ready is not None and self.first <= ready <= self.last:
                self._deliver(now, ready, news)
            while self._stamps and self._stamps[0] <= now - _RATE_WINDOW:
                self._stamps.popleft()
            self.rate = len(self._stamps) / min(max(now - self._started, _RATE_WINDOW / 4), _RATE_WINDOW)
            advance = self._advance_real_time if self._mode == REAL_TIME else self._advance_every_frame
            advance(elapsed * self._speed)
        elif ready is not None and 0 <= ready < self.slots:
            self.visible = ready
        return Tick(self.slot, self.visible)

    def rest(self, now: float) -> float:
        """Return the seconds until the next slot is due, where nothing is waited for until then; 0 if it does not
        play."""
        if not self._playing or self.waiting or self._now is None:
            return 0.0
        if self._mode == REAL_TIME:
            left = self.time_of(self.slot + 1) - self._time
        else:
            left = self._schedule.duration(self.slot) - self._spent
        return max(left / self._speed - (now - self._now), 0.0)

    def _deliver(self, now: float, ready: int, news: bool) -> None:
        """Count `ready` as delivered, a slot between the points; `news`: it was not yet there at the last tick."""
        behind = self.slot - ready
        if self._loop:
            behind %= self.last - self.first + 1
        if behind == 0:
            self.visible = ready
        # an old delivery must not pass for the same slot of a later lap, unless that is the one due
        if 0 <= behind < self.waiting and (news or behind == 0):
            self.visible = ready
            self.shown += 1
            self.dropped += self.waiting - 1 - behind
            self.waiting = behind
            self._stamps.append(now)

    def _advance_real_time(self, seconds: float) -> None:
        first, last = self.first, self.last
        start, end = self.time_of(first), self.time_of(last + 1)
        time, laps = self._time + seconds, 0
        if time >= end - ROUNDING and self._loop:
            laps = max(int((time - start) / (end - start)), 1)
            time = max(time - laps * (end - start), start)
        slot = min(max(self._schedule.slot_at(time), first), last)
        passed = laps * (last - first + 1) + slot - self.slot
        if passed == 2 and not self.waiting:  # a tick came late: a slot that is due for less than its time can wait
            slot, passed = slot - 1 if slot > first else last, 1
        self.due, self.waiting = self.due + passed, self.waiting + passed
        self.slot, self._time = slot, min(time, end)
        if slot == last and not self._loop and not self.waiting:
            self.pause()

    def _advance_every_frame(self, seconds: float) -> None:
        self._spent += seconds
        over = self._spent - self._schedule.duration(self.slot)
        if self.waiting or over < -ROUNDING:
            return
        if self.slot >= self.last and not self._loop:
            self.pause()
            return
        self._place(self.slot + 1 if self.slot < self.last else self.first)
        self.due, self.waiting = self.due + 1, 1
        # a late tick is compensated by the next slot, a slow engine is not
        self._spent = min(max(over, 0.0), seconds, self._schedule.duration(self.slot))

    def _clamped(self, slot: int) -> int:
        return min(max(int(slot), 0), self.slots - 1)

    def _place(self, slot: int) -> None:
        self.slot, self._time = slot, self._schedule.time_of(slot)

    def _points(self, first: float | None, last: float | None) -> None:
        self._overtake()
        self._in, self._out = first, last
        if self._playing and not self.first <= self.slot <= self.last:
            self._jump(self.first)

    def _overtake(self) -> None:
        """Drop the slots that are waited for, except the one due now, which can still come."""
        self.dropped += max(self.waiting - 1, 0)
        self.waiting = min(self.waiting, 1)
        self._spent = 0.0

    def _jump(self, slot: int) -> None:
        """Go on playing elsewhere."""
        self.dropped += self.waiting
        self._place(slot)
        self.waiting = int(self.visible != self.slot)
        self.due += self.waiting
        self._spent = 0.0
