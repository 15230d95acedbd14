"""Wants of the engine: the picture that is due, pixels of it, and frames ahead; and the part of them that is shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

from gffe_cl.engine.inspection import names
from ..engine.messages import Failure, Frame, Key, Recipe
from ..engine.store import Playhead, Store, Want
from ..picture.current_frame import Contents
from ..picture.disocclusions import Disocclusions
from ..picture.regions import Regions
from ..picture.selection import Selection
from ..picture.view import View
from ..picture.worst_pixels import WorstPixels
from .playback import Playback

_MEASURED = frozenset({names.FINAL, names.TRUTH})


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

    def of_first(self, measures: bool) -> frozenset[str]:
        """Return what is read back of A; `measures`: for metrics, too."""
        view, wanted = self._view, {self._view.a} | (_MEASURED if measures else frozenset())
        if view.compare != "off" and view.b and not names.is_second(view.b):
            wanted.add(view.b)
        wanted |= self._regions.needed | self._disocclusions.needed | self._selection.needed | self._worst.needed
        if view.overlay in ("edges", "residual motion"):
            wanted |= {names.RENDERED_COLOR, names.RENDERED_DEPTH, names.RENDERED_MOTION}
        specs = [self._contents.spec(name) for name in wanted]
        if any(spec is not None and spec.view == "world" for spec in specs):
            wanted.add(names.RENDERED_DEPTH)
        return frozenset(wanted)

    def of_second(self, measures: bool) -> frozenset[str]:
        final = {names.FINAL} & self._regions.needed
        return frozenset({self._view.a} | final | (_MEASURED if measures else frozenset()))


@dataclass(frozen=True)
class Picture:
    """A picture that is due: a slot as A's settings make it, and as B's do where these are compared."""

    a: Want
    b: Want | None = None

    @property
    def wants(self) -> list[Want]:
        return [want for want in (self.a, self.b) if want is not None]

    def is_like(self, other: Picture) -> bool:
        """Return whether both are of the same settings and layers: one may be shown on the way to the other."""
        return len(self.wants) == len(other.wants) and all(
            mine.key.recipe.continues(its.key.recipe) and mine.layers == its.layers
            for mine, its in zip(self.wants, other.wants, strict=True)
        )


class Showing:
    """The picture that is made for the screen, and the one that is on it: A and B of one slot, or neither.

    Parameters
    ----------
    contents : Contents
        Takes A's frame and B's, or None, as soon as they are there.
    fail : callable
        Called with the failure of A's or of B's, and whether it is B's, once for each picture. Without B's A is shown.

    Attributes
    ----------
    awaited : Picture or None
        What is made first. While frames pass, it is finished before the next one is due.
    shown : Picture or None
    from_cache : bool
        What is shown was there before it was wanted.
    fault_of_b : str
        Why there is nothing of B; empty if there is.
    """

    def __init__(self, store: Store, contents: Contents, fail: Callable[[Failure, bool], None]):
        self._store, self._contents, self._fail = store, contents, fail
        self.awaited: Picture | None = None
        self.shown: Picture | None = None
        self._due: Picture | None = None
        self._told: set[Want] = set()  # failures
        self.from_cache = self._was_there = False
        self.fault_of_b = ""

    def forget(self) -> None:
        """Drop the picture after a change of the source."""
        self.awaited = self.shown = self._due = None
        self.fault_of_b = ""

    def update(self, due: Picture, passing: bool, may_show: bool = True) -> bool:
        """Show what is there of the awaited picture, and await the one that is due. Call once per frame of the
        interface; `passing`: frames pass (it plays, for example): none is given up for the next one. Returns whether
        another picture is shown."""
        before, changes = self.awaited, self._contents.changes
        self._due = due
        there = before is not None and may_show and self._take(before)
        if before is None or (before != due and (there or not passing or not before.is_like(due))):
            self.awaited, self._told = due, set()
            for want in due.wants:
                self._store.retry(want)
            self._was_there = not self.is_waiting
            if may_show:
                self._take(due)
        return self._contents.changes != changes

    @property
    def wants(self) -> list[Want]:
        """Parts of the awaited picture to make."""
        return self.awaited.wants if self.awaited is not None else []

    @property
    def following(self) -> list[Want]:
        """Parts of the picture that is due by now, to make next."""
        return self._due.wants if self._due is not None and self._due != self.awaited else []

    @property
    def is_waiting(self) -> bool:
        """Whether anything is still to be made of the awaited picture."""
        return any(self._store.get(want) is None for want in self.wants)

    @property
    def failed(self) -> bool:
        """Whether A of the awaited picture cannot be made."""
        return self.awaited is not None and isinstance(self._store.get(self.awaited.a), Failure)

    @property
    def shows_like_due(self) -> bool:
        """Whether the picture on the screen has the settings and layers of the one that is due."""
        return self._due is not None and self.shown is not None and self.shown.is_like(self._due)

    @property
    def shows_due(self) -> bool:
        """Whether the picture that is due is on the screen."""
        return self._due is not None and self.shown == self._due and not self.is_waiting

    @property
    def shows_slot_due(self) -> bool:
        """Whether the slot that is due is on the screen, made as it is now, with whichever layers."""
        if self._due is None or self.shown is None or (self.shown.b is None and self._due.b is not None):
            return False
        return all(mine.key == its.key for mine, its in zip(self.shown.wants, self._due.wants, strict=False))

    def _take(self, picture: Picture) -> bool:
        """Show a picture if all of it is there. Returns whether nothing of it is to be made any more."""
        made = [self._store.get(want) for want in picture.wants]
        for want, one in zip(picture.wants, made, strict=True):
            if isinstance(one, Failure) and want not in self._told:
                self._told.add(want)
                self._fail(one, want is not picture.a)
        if not made or any(one is None for one in made):
            return False
        first, second = made[0], made[1] if len(made) > 1 else None
        self.fault_of_b = second.error if isinstance(second, Failure) else ""
        if isinstance(first, Frame):
            second, contents = second if isinstance(second, Frame) else None, self._contents
            if first is not contents.result or second is not contents.second:
                self.from_cache, self.shown = self._was_there, picture
                contents.take(first, second)
        return True


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
