"""Filling the cache while there is nothing else to do: what is ahead of the playhead first."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice

from gffe_cl.viewer.engine.cache import FrameKey, Playhead
from gffe_cl.viewer.engine.engine import Engine
from gffe_cl.viewer.engine.messages import Recipe, Request, Result
from gffe_cl.viewer.state.playback import Playback

_STILL = 0.3  # seconds that a still picture must have stood
_PLANNED = 16  # slots that the engine is told of at once


class Filling:
    """Plans what the engine computes beside.

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

    def find(self, recipe: Recipe, request: Request) -> Result | None:
        """What was asked for, if it is there."""
        return self._cache.get(FrameKey(recipe, request.slot), request.layers, request.metrics)

    def update(self, now: float, recipe: Recipe, request: Request, nbytes: int, beside: bool) -> None:
        """Once per frame of the interface. `request`: the one of the picture, whose slots take `nbytes` each; `beside`:
        whether there may be computed beside."""
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
