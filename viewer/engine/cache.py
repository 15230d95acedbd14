"""Computed slots that are kept in memory, by everything they depend on."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from .messages import Recipe, Result

CACHE_MIB = 2048


@dataclass(frozen=True)
class FrameKey:
    """A slot, and all that its pictures depend on."""

    recipe: Recipe
    slot: int


@dataclass
class _Kept:
    """A slot as far as it was asked for: `asked` layers, those of them in `result` that exist."""

    result: Result
    asked: frozenset[str]
    nbytes: int


@dataclass(frozen=True)
class Playhead:
    """Playback position: frames are needed next from `slot` on, and from `first` again after `last`."""

    slot: int = 0
    first: int = 0
    last: int = 0

    def distance(self, slot: int) -> int:
        """Return the number of slots until `slot` is shown; slots outside of `first` to `last` come after all
        others."""
        length = self.last - self.first + 1
        if not self.first <= slot <= self.last:
            return length + abs(slot - self.slot)
        return (slot - self.slot) % length


class FrameCache:
    """Results of slots, at most `most` bytes of pictures; may be used from any thread.

    Where room is needed, recipes that are not in use go first, the one used longest ago first of all; then, of those in
    use, what will be shown last from the playhead on. A result that would itself have to go is not taken in.

    Attributes
    ----------
    most, nbytes : int
        Bytes: that may be kept, and that are.
    changes : int
        How often what is kept has changed.
    """

    def __init__(self, most: int = CACHE_MIB << 20):
        self.most, self.nbytes, self.changes = most, 0, 0
        self._lock = threading.Lock()
        self._kept: OrderedDict[Recipe, dict[int, _Kept]] = OrderedDict()  # the latest used is the last
        self._in_use: frozenset[Recipe] = frozenset()
        self._playhead = Playhead()

    def use(self, recipes: Iterable[Recipe], playhead: Playhead) -> None:
        """Set the current view: these recipes, from the playhead on."""
        with self._lock:
            self._in_use, self._playhead = frozenset(recipes), playhead

    def get(self, key: FrameKey, layers: frozenset[str], metrics: bool = False) -> Result | None:
        """Return the slot with those of `layers` that exist, and measured if `metrics` are wanted; None if it is not
        cached so."""
        with self._lock:
            kept = self._kept.get(key.recipe, {}).get(key.slot)
            if kept is None or not (layers <= kept.asked and (kept.result.request.metrics or not metrics)):
                return None
            self._kept.move_to_end(key.recipe)
            result = kept.result
        return replace(result, images={name: result.images[name] for name in layers if name in result.images})

    def slots(self, recipe: Recipe, layers: frozenset[str], metrics: bool = False) -> frozenset[int]:
        """Return the slots that `get` would find."""
        with self._lock:
            kept = self._kept.get(recipe, {})
            return frozenset(
                slot
                for slot, one in kept.items()
                if layers <= one.asked and (one.result.request.metrics or not metrics)
            )

    def put(self, key: FrameKey, result: Result) -> bool:
        """Store a result together with the layers already stored for its slot. Returns whether it was accepted. Its
        pictures must not be changed afterwards."""
        for image in result.images.values():
            image.flags.writeable = False
        with self._lock:
            before = self._forget(key)
            kept = _merged(before, result)
            if not self._make_room(key, kept.nbytes):
                return False
            self._kept.setdefault(key.recipe, {})[key.slot] = kept
            self._kept.move_to_end(key.recipe)
            self.nbytes += kept.nbytes
            self.changes += 1
        return True

    def room(self, nbytes: int) -> int:
        """Return how many slots of `nbytes` bytes each the cache can hold."""
        return self.most // max(nbytes, 1)

    def forget(self, outdated: Callable[[FrameKey], bool]) -> None:
        with self._lock:
            keys = [FrameKey(recipe, slot) for recipe, slots in self._kept.items() for slot in slots]
            for key in filter(outdated, keys):
                self._forget(key)

    def clear(self) -> None:
        with self._lock:
            self._kept.clear()
            self.nbytes = 0
            self.changes += 1

    def _forget(self, key: FrameKey) -> _Kept | None:
        slots = self._kept.get(key.recipe, {})
        kept = slots.pop(key.slot, None)
        if kept is not None:
            self.nbytes -= kept.nbytes
            self.changes += 1
            if not slots:
                del self._kept[key.recipe]
        return kept

    def _make_room(self, key: FrameKey, nbytes: int) -> bool:
        if nbytes > self.most:
            return False
        while self.nbytes + nbytes > self.most:
            victim = self._victim()
            if self._is_nearer(victim, key):
                return False
            self._forget(victim)
        return True

    def _victim(self) -> FrameKey:
        """Return the entry that is needed least."""
        idle = next((recipe for recipe in self._kept if recipe not in self._in_use), None)
        candidates = [idle] if idle is not None else list(self._kept)
        distance = self._playhead.distance
        return max(
            (FrameKey(recipe, slot) for recipe in candidates for slot in self._kept[recipe]),
            key=lambda key: distance(key.slot),
        )

    def _is_nearer(self, kept: FrameKey, new: FrameKey) -> bool:
        """Return whether `kept` is needed before `new`."""
        used = kept.recipe in self._in_use, new.recipe in self._in_use
        if used[0] != used[1]:
            return used[0]
        distance = self._playhead.distance
        return used[0] and distance(kept.slot) <= distance(new.slot)


def _merged(before: _Kept | None, result: Result) -> _Kept:
    asked, images, metrics = result.request.layers, result.images, result.request.metrics
    if before is not None:
        asked, images = asked | before.asked, before.result.images | images
        metrics |= before.result.request.metrics
    request = replace(result.request, metrics=metrics)
    kept = replace(result, request=request, images=images)
    return _Kept(kept, asked, sum(image.nbytes for image in images.values()) + 4096)
