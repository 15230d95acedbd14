"""Measurement of slots against ground truth, on a thread of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gffe_cl.lab.metrics import METRICS, measurable, to_display
from .buffers import Moment
from .messages import Metrics
from .worker import Worker

_SLOW = 4  # slots that wait for metrics that are slow
_TO_MEASURE = 256 << 20  # bytes of slots that wait for their metrics; beyond that the oldest are given up


class Scorer:
    """Measures slots by every metric on a thread of its own, the latest first, and stores the results."""

    def __init__(self, notify: Callable[[], None], report: Callable[[Exception], None]):
        self._notify, self._report = notify, report
        self._worker = Worker("metrics", self._next, self._do)
        self._news = self._worker.lock
        self._known: dict[tuple, Metrics] = {}
        self._waiting: deque[tuple] = deque()
        self._slow: deque[tuple] = deque(maxlen=_SLOW)  # slots of which slow metrics are missing
        self._busy_with: tuple | None = None
        self._made: deque[Metrics] = deque()
        self._ready = False  # modules for metrics are imported
        self._measured = [metric for metric in METRICS.values() if not metric.slow]

    def score(self, metrics: Metrics, moment: Moment, final: np.ndarray, truth: np.ndarray, exposure: float) -> Metrics:
        """Return the known metrics of the slot of `metrics` as `moment`; the rest will be measured."""
        key = (metrics.slot, metrics.setup, moment.camera.world_to_view.tobytes(), moment.camera.intrinsics)
        with self._news:
            known = self._known.get(key, metrics)
            complete = all(metric.name in known.values for metric in self._measured)
            planned = {job[0] for job in (*self._waiting, *self._slow)} | {self._busy_with}
            if not complete and key not in planned:
                self._waiting.append((key, known, final, truth, exposure))
                while len(self._waiting) > _TO_MEASURE // (final.nbytes + truth.nbytes) + 1:
                    self._waiting.popleft()
                self._worker.wake()
        return known

    def take(self) -> Metrics | None:
        with self._news:
            return self._made.popleft() if self._made else None

    def clear(self) -> None:
        with self._news:
            self._known, self._busy_with = {}, None
            self._waiting.clear()
            self._slow.clear()
            self._made.clear()

    def close(self) -> None:
        self._worker.close()

    def _next(self) -> tuple | None:
        job = (self._waiting or self._slow).pop() if self._waiting or self._slow else None
        self._busy_with = job and job[0]
        return job

    def _do(self, job: tuple) -> None:
        if not self._ready:
            self._measured, self._ready = measurable(), True
        try:
            self._measure(*job)
        except Exception as error:
            self._report(error)
        with self._news:
            self._busy_with = None

    def _measure(self, key: tuple, known: Metrics, final: np.ndarray, truth: np.ndarray, exposure: float) -> None:
        shown, true = (to_display(color[..., :3], exposure) for color in (final, truth))
        for metric in sorted(self._measured, key=lambda metric: metric.slow):
            if metric.name in known.values:
                continue
            if metric.slow and self._waiting:
                with self._news:
                    if self._busy_with == key:
                        self._slow.append((key, known, final, truth, exposure))
                return
            known = replace(known, values={**known.values, metric.name: metric.measure(shown, true)})
            self._tell(key, known)

    def _tell(self, key: tuple, metrics: Metrics) -> None:
        with self._news:
            if self._busy_with == key:  # not forgotten meanwhile
                self._known[key] = metrics
                self._made.append(metrics)
        self._notify()
