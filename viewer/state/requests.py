"""Requests to the engine: the slot that is due, the layers that are read back, and slots ahead for the cache."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import islice

from ..engine import names
from ..engine.cache import FrameKey, Playhead
from ..engine.engine import Engine
from ..engine.messages import Recipe, Request, Result
from ..picture.current_frame import Contents
from ..picture.disocclusions import Disocclusions
from ..picture.regions import Regions
from ..picture.selection import Selection
from ..picture.view import View
from ..picture.worst_pixels import WorstPixels
from .compare_b import Second
from .playback import Playback


class Needed:
    """Names of layers of A and of B."""

    def __init__(
        self, view: View, contents: Contents, regions: Regions, disocclusions: Disocclusions, selection: Selection,
        worst: WorstPixels,
    ):  # fmt: skip
        self._view, self._contents = view, contents
        self._regions, self._disocclusions, self._selection, self._worst = regions, disocclusions, selection, worst

    def all(self) -> frozenset[str]:
        """Return the names of all layers; the displayed image alone while they are not known."""
        return frozenset(spec.name for spec in self._contents.layers) or frozenset({names.FINAL})

    def of_first(self) -> frozenset[str]:
        view, wanted = self._view, {self._view.a}
        if view.compare != "off" and view.b and not names.is_second(view.b):
            wanted.add(view.b)
        wanted |= self._regions.needed | self._disocclusions.needed | self._selection.needed | self._worst.needed
        if view.overlay in ("edges", "residual motion"):
            wanted |= {names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION}
        specs = [self._contents.spec(name) for name in wanted]
        if any(spec is not None and spec.view == "world" for spec in specs):
            wanted.add(names.RENDERED_DEPTH)
        return frozenset(wanted)

    def of_second(self) -> frozenset[str]:
        return frozenset({self._view.a} | ({names.FINAL} & self._regions.needed))


_STILL = 0.3  # seconds that a still picture must have stood
_PLANNED = 16  # slots sent to the engine at once


class Prefetch:
    """Plan of slots to compute in advance.

    Attributes
    ----------
    cached : frozenset of int
        The slots that are there as the picture needs them.
    others : frozenset of Recipe
        Of what else is looked at.
    background : list of callables
        Each gives requests of role "ahead" that are wanted when all of the above is there, most wanted first.
    """

    def __init__(self, engine: Engine, playback: Playback):
        self._engine, self._cache, self._playback = engine, engine.cache, playback
        self.cached: frozenset[int] = frozenset()
        self.background: list[Callable[[], Iterable[Request]]] = []
        self.others: frozenset[Recipe] = frozenset()
        self._seen = self._planned = None
        self._since = 0.0

    def forget(self) -> None:
        """Drop what is known of the cache, after a change of the source."""
        self.cached, self._seen, self._planned = frozenset(), None, None

    def find(self, recipe: Recipe, request: Request) -> Result | None:
        """Return the requested result, if it is there."""
        return self._cache.get(FrameKey(recipe, request.slot), request.layers, request.metrics)

    def update(self, now: float, recipe: Recipe, request: Request, nbytes: int, beside: bool) -> None:
        """Plan the slots to compute in advance. Call once per frame of the interface. `request`: the picture's, whose
        slots take `nbytes` each; `beside`: whether computation in advance is allowed."""
        if not self._cache.most:
            return
        playback, wanted = self._playback, (recipe, request.layers, request.metrics)
        playhead = Playhead(request.slot, playback.first, playback.last)
        if (wanted, playhead) != self._seen:
            self._cache.use({recipe, *self.others}, playhead)
            self._seen, self._since = (wanted, playhead), now
            self._planned = None
        due = beside and (playback.playing or now - self._since > _STILL)
        state = self._cache.changes, due, len(self.background)
        if state == self._planned:
            return
        self._planned = state
        self.cached = self._cache.slots(*wanted)
        self._engine.prefetch(self._plan(request, playhead, nbytes) if due else ())

    def _plan(self, request: Request, playhead: Playhead, nbytes: int) -> list[Request]:
        length = playhead.last - playhead.first + 1
        start = min(max(playhead.slot, playhead.first), playhead.last) - playhead.first
        ahead = (playhead.first + (start + i) % length for i in range(min(length, self._cache.room(nbytes))))
        missing = islice((slot for slot in ahead if slot not in self.cached), _PLANNED)
        plan = [Request(slot, request.setup, request.layers, 0, request.metrics, "ahead") for slot in missing]
        for more in self.background:
            plan += islice(more(), _PLANNED - len(plan)) if len(plan) < _PLANNED else ()
        return plan


class Asking:
    """Requests for slots: it looks into the cache first, else it asks the engine.

    Parameters
    ----------
    show : callable
        Called with A's result and B's of one slot, or None, as soon as they are there.

    Attributes
    ----------
    asked : Request or None
        What was asked of A last.
    from_cache : bool
        What is shown came from the cache.
    """

    def __init__(
        self, engine: Engine, contents: Contents, filling: Prefetch, second: Second,
        show: Callable[[Result, Result | None], None],
    ):  # fmt: skip
        self._engine, self._contents, self._filling, self._second, self._show = engine, contents, filling, second, show
        self.asked: Request | None = None
        self.from_cache = False
        self._wanted: tuple[Request, Recipe | None, Request | None] | None = None
        self._serial = itertools.count(1)

    def serial(self) -> int:
        """Return another number for each request to the engine."""
        return next(self._serial)

    def forget(self) -> None:
        """Forget the request: it does not come, or is outdated."""
        self.asked = None

    def ask(self, request: Request, recipe: Recipe | None, second: Request | None, anew: bool, source) -> bool:
        """Request slots of A and B unless they are requested already; returns whether they were not. `recipe`: of A,
        None if no cached slot will do; `anew`: repeat an equal request."""
        wanted = request, recipe, second
        if wanted == self._wanted and self.asked is not None and not anew:
            return False
        if self._second.waits and second is not None:
            return False  # one after the other, or the faster one would never be shown with the slower one
        self._wanted = wanted
        self.asked = replace(request, serial=self.serial())
        if second is not None:
            self._second.ask(replace(second, serial=self.serial()), source)
        kept = None if recipe is None else self._filling.find(recipe, request)
        if kept is None:
            self._engine.submit(self.asked, source)
            return True
        self._engine.withdraw()
        self.from_cache = True
        self._came(replace(kept, request=self.asked))
        return True

    def take(self, result: Result) -> None:
        """Take A's computed result. Results requested before the displayed one are too old."""
        shown = self._contents.result
        if shown is None or result.request.serial >= shown.request.serial:
            self.from_cache = False
            self._came(result)

    def take_pair(self) -> None:
        """Show A's and B's results of one slot, when both are there."""
        pair = self._second.take()
        if pair is not None:
            self._show(*pair)

    def fill(self, now: float, recipe: Recipe, may_run: bool) -> None:
        """Request slots in advance, where `may_run` allows it. Call once per frame of the interface."""
        result = self._contents.result
        if result is None or self._wanted is None:
            return
        nbytes, request = sum(image.nbytes for image in result.images.values()), self._wanted[0]
        self._filling.update(now, recipe, request, nbytes, may_run and request.slot == result.request.slot)

    @property
    def answered(self) -> bool:
        """Whether the displayed frame is the requested one."""
        result = self._contents.result
        return result is not None and result.request == self.asked and not self._second.waits

    @property
    def shows_wanted(self) -> bool:
        """Whether the displayed frame was requested with the present layers and setup."""
        result = self._contents.result
        wanted = self._wanted[0] if self._wanted else None
        return result is not None and bool(wanted) and wanted == replace(result.request, serial=wanted.serial)

    def _came(self, result: Result) -> None:
        """Show A's result, which has come; where it is compared with B's it waits for that."""
        if self._second.belongs(result):
            self._second.pair(result)
        else:
            self._show(result, None)
