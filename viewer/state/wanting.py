"""Wants of the engine beside the picture itself: the layers that it needs, and frames ahead."""

from __future__ import annotations

from itertools import islice

from gffe_cl.engine.inspection import names
from ..engine.messages import Key, Recipe
from ..engine.store import Playhead, Store, Want
from ..picture.current_frame import Contents
from ..picture.view import View
from .playback import Playback

_MEASURED = frozenset({names.FINAL, names.TRUTH})


class Needed:
    """Names of layers of A and of B."""

    def __init__(self, view: View, contents: Contents):
        self._view, self._contents = view, contents

    def all(self) -> frozenset[str]:
        """Return the names of all layers; the displayed image alone while they are not known."""
        return frozenset(spec.name for spec in self._contents.layers) or frozenset({names.FINAL})

    def of_first(self, measures: bool) -> frozenset[str]:
        """Return what is read back of A; `measures`: for metrics, too."""
        view, wanted = self._view, {self._view.a} | (_MEASURED if measures else frozenset())
        if view.compare != "off" and view.b and not names.is_second(view.b):
            wanted.add(view.b)
        if view.overlay in ("edges", "residual motion"):
            wanted |= {names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION}
        specs = [self._contents.spec(name) for name in wanted]
        if any(spec is not None and spec.view == "world" for spec in specs):
            wanted.add(names.RENDERED_DEPTH)
        return frozenset(wanted)

    def of_second(self, measures: bool) -> frozenset[str]:
        return frozenset({self._view.a}) | (_MEASURED if measures else frozenset())


_STILL = 0.3  # seconds that a still picture must have stood
_PLANNED = 16  # slots that are wanted ahead at once


class Ahead:
    """Slots that are made for the cache while nothing else is to be done.

    Attributes
    ----------
    cached : frozenset of int
        The slots that are there as the picture needs them.
    """

    def __init__(self, store: Store, playback: Playback):
        self._store, self._playback = store, playback
        self.cached: frozenset[int] = frozenset()
        self._seen = self._planned = None
        self._since = 0.0
        self._wants: list[Want] = []

    def forget(self) -> None:
        """Drop everything after a change of the source."""
        self.cached, self._seen, self._planned, self._wants = frozenset(), None, None, []

    def wants(self, now: float, picture: Want, others: set[Recipe], nbytes: int, may_run: bool) -> list[Want]:
        """Return the slots to make in advance, the next one first. Call once per frame of the interface. `picture`: the
        one on screen, whose slots take `nbytes` each; `others`: recipes of what else is on screen; `may_run`: whether
        computation in advance is allowed."""
        store, playback, recipe = self._store, self._playback, picture.key.recipe
        if not store.most:
            return []
        playhead = Playhead(picture.key.slot, playback.first, playback.last)
        seen = recipe, picture.layers, playhead, frozenset(others)
        if seen != self._seen:
            store.use({recipe, *others}, playhead)
            self._seen, self._since, self._planned = seen, now, None
        due = may_run and (playback.playing or now - self._since > _STILL)
        if (store.changes, due) != self._planned:
            self._planned = store.changes, due
            self.cached = store.slots(recipe, picture.layers)
            self._wants = self._plan(picture, playhead, nbytes) if due else []
        return self._wants

    def _plan(self, picture: Want, playhead: Playhead, nbytes: int) -> list[Want]:
        length = playhead.last - playhead.first + 1
        start = min(max(playhead.slot, playhead.first), playhead.last) - playhead.first
        ahead = (playhead.first + (start + i) % length for i in range(min(length, self._store.room(nbytes))))
        missing = islice((slot for slot in ahead if slot not in self.cached), _PLANNED)
        return [Want(Key(picture.key.recipe, slot), picture.layers, hold=False) for slot in missing]
