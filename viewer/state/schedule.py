"""Schedule of a sequence: the times at which its slots are due.

A sequence of `count` rendered frames with `n` generated frames after each has count·(n+1) slots.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

from gffe_cl.engine.core.errors import GffeError

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

    def __post_init__(self):
        if self.count < 1:
            raise GffeError(f"playback: a sequence has at least one rendered frame, got {self.count}")
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise GffeError(f"playback: fps must be positive, got {self.fps}")
        if not 0 <= self.n <= MOST_GENERATED:
            raise GffeError(f"playback: n must be 0 to {MOST_GENERATED} generated frames, got {self.n}")
        times = self.times
        if times is not None and len(times) != self.count:
            raise GffeError(f"playback: {len(times)} times for {self.count} rendered frames")
        if times is not None and not all(a < b < math.inf for a, b in zip((-math.inf, *times), times, strict=False)):
            raise GffeError("playback: times must be finite and increase")

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
