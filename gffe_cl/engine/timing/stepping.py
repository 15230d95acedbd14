"""Stepping between better and cheaper options while a program runs, by the times that its frames took."""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from gffe_cl.engine.core.validation import require_kind, require_list, require_within
from gffe_cl.engine.options import Options
from gffe_cl.engine.timing.choice import BUDGETS

_COMPARED = 5  # frames, whose median counts: two that were late by chance change nothing
_PATIENCE, _MOST_PATIENCE = 60, 3840  # frames at a level before a better one is tried
_REMEMBERED = 10  # times that long; from then on, what a better level would take counts less and less
_ROOM = 0.9  # of the budget, which a better level may take


class Stepper:
    """Chooses options while a program runs: the best whose frames fit into a budget. It has no clock and changes no
    pipeline: the caller passes times, and changes the options. ::

        best = gffe.Options()
        stepper = gffe.Stepper(4, best)
        pipeline = gffe.Pipeline(device, width, height, best)  # a later one, too, as for a resized window
        while playing:
            ...
            if stepper.took(milliseconds_of_the_new_frame):
                pipeline.change_options(stepper.options)

    The levels are the options given, the same without shading correction, and without hidden parts as well. Between
    these a pipeline that was made with the first keeps its frames (`Pipeline.keeps_frames`), unless it upscales.

    It goes a level down when the median of five frames is over the budget. It goes up after 60 frames at a level, if
    the better one would fit by the ratio of the times that both took when it went down. After 600 frames this ratio
    counts less and less, as it may be wrong. After a step up that was wrong, both waits are twice as long.

    Parameters
    ----------
    budget_ms : float
        Milliseconds of what `took` is told, 0.001 to 100000.
    options : Options or None
        The best options; None: the defaults.
    below : sequence of Options
        Further levels, each cheaper than the one before, such as `Options.preset("performance")`. Where the pipeline
        does not keep its frames, change to them best before a frame with `reset`.

    Attributes
    ----------
    options : Options
        The present choice.
    level : int
        Its number, 0 for the best.

    Raises
    ------
    GffeError
        For arguments of other types, and for times that are out of range.
    """

    def __init__(self, budget_ms: float, options: Options | None = None, below: Iterable[Options] = ()):
        self.budget_ms = require_within(budget_ms, "stepper: budget_ms", *BUDGETS)
        best = Options() if options is None else require_kind(options, Options, "stepper: options", "Options")
        self._levels = [best]
        if best.corrects_shading:
            self._levels.append(replace(self._levels[-1], shading_correction=False))
        if best.hidden_parts and best.motion and best.warps_footprints:
            self._levels.append(replace(self._levels[-1], hidden_parts=False))
        self._levels += require_list(below, Options, "stepper: below", "a list of Options")
        self.level, self._ratios = 0, [1.0] * len(self._levels)  # of a level's time to that of the next one
        self._times: deque[float] = deque(maxlen=_COMPARED)
        self._frames, self._patience = 0, _PATIENCE  # at this level so far
        self._before: float | None = None  # time at the level above, if the last step went down
        self._rose = False

    @property
    def options(self) -> Options:
        """The present choice."""
        return self._levels[self.level]

    def took(self, milliseconds: float) -> bool:
        """Note the time that a new frame took, and return whether `options` changed. Pass no times of frames that were
        shown again. Raises GffeError unless it is a number from 0 to 1e12."""
        self._times.append(require_within(milliseconds, "stepper: milliseconds", 0, 1e12))
        self._frames += 1
        if len(self._times) < _COMPARED:
            return False
        now, has_time = statistics.median(self._times), self._frames >= self._patience
        if self._before is not None:
            self._ratios[self.level - 1] = max(self._before / max(now, 1e-9), 1.0)
            self._before = None
        if now > self.budget_ms and self.level + 1 < len(self._levels):
            self._patience = min(2 * self._patience, _MOST_PATIENCE) if self._rose and not has_time else _PATIENCE
            self._before = now
            return self._step(1)
        if not self.level or not has_time:
            return False
        known = min(_REMEMBERED * self._patience / self._frames, 1)
        ratio = 1 + known * (self._ratios[self.level - 1] - 1)
        return now * ratio <= _ROOM * self.budget_ms and self._step(-1)

    def _step(self, down: int) -> bool:
        self.level += down
        self._times.clear()
        self._frames, self._rose = 0, down < 0
        return True
