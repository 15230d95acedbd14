"""Store of computed slots: the interface says what it wants, the engine makes the first of it that is not there."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection
from .messages import Failure, Frame, Key, Recipe

CACHE_MIB = 2048

Pixel = tuple[int, int]
Subject = tuple[Key, frozenset[str], Pixel | None]


@dataclass(frozen=True)
class Want:
    """A slot that is wanted: `layers` of it, or the values of display pixel `pixel`.

    `keep`: it stays in the store for as long as there is room. `hold`: it is there for as long as it is wanted, even if
    there is no room. `preview`: it is for the eye, so a provisional slot is made first where the exact one takes long.
    """

    key: Key
    layers: frozenset[str] = frozenset()
    pixel: Pixel | None = None
    keep: bool = True
    hold: bool = True
    preview: bool = field(default=False, compare=False)

    @property
    def subject(self) -> Subject:
        return self.key, self.layers, self.pixel

    @property
    def provisional(self) -> Want:
        """The provisional slot in its place. Stored slots are always exact."""
        return self if self.key.recipe.setup.place else replace(self, key=replace(self.key, provisional=True))


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


class Store:
    """Frames by key and layers. The interface calls `want` and `get`, the engine's thread `next` and `put`.

    At most `most` bytes are kept, less `others` and the frames that are only held. Where room is needed, recipes that
    are not in use go first, the one used longest ago first of all; then, of those in use, what will be shown last from
    the playhead on. A frame that would itself have to go is not kept.

    Attributes
    ----------
    most, nbytes, others : int
        Bytes: that may be held, that are kept here, and that are held elsewhere: by pipelines, sources and textures.
    changes : int
        How often what is there has changed.
    outdated : int
        How often slots were dropped because they are other ones now.
    source : int
        The source, by `Recipe.source`, whose slots are made.
    news : threading.Condition
        Guards all of it; notified when something else is wanted.
    """

    def __init__(self, most: int = CACHE_MIB << 20):
        self.most, self.nbytes, self.others, self.changes, self.source = most, 0, 0, 0, 0
        self.outdated = 0
        self.news = threading.Condition()
        self._wants: tuple[Want, ...] = ()
        self._subjects: set[Subject] = set()  # of the wants, and of their previews
        self._held: dict[Subject, Frame | Inspection | Failure] = {}  # what was made of them, by subject
        self._kept: OrderedDict[Recipe, dict[int, Frame]] = OrderedDict()  # the latest used is the last
        self._in_use: frozenset[Recipe] = frozenset()
        self._playhead = Playhead()

    # ---- the interface's side --------------------------------------------------------------------------------

    def want(self, wants: Sequence[Want]) -> None:
        """Replace the list of what is wanted, the most urgent first. What is not in it any more is not made, and given
        up if it is under way."""
        with self.news:
            if tuple(wants) == self._wants:
                return
            self._wants = tuple(wants)
            previews = {want.provisional.subject for want in self._wants if want.preview}
            self._subjects = previews.union(want.subject for want in self._wants)
            self._held = {subject: made for subject, made in self._held.items() if subject in self._subjects}
            self.news.notify_all()

    def get(self, want: Want) -> Frame | Inspection | Failure | None:
        """Return what was made of a want: the same object for as long as it is wanted. None if it is not there yet."""
        with self.news:
            found = self._held.get(want.subject)
            if found is None and want.pixel is None:
                found = self._find(want)
                if found is not None:
                    self._held[want.subject] = found
            return found

    def retry(self, want: Want) -> None:
        """Forget a failure to make this."""
        with self.news:
            if isinstance(self._held.get(want.subject), Failure):
                del self._held[want.subject]
                self.news.notify_all()

    def use(self, recipes: Iterable[Recipe], playhead: Playhead) -> None:
        """Set the current view: these recipes, from the playhead on."""
        with self.news:
            self._in_use, self._playhead = frozenset(recipes), playhead

    def slots(self, recipe: Recipe, layers: frozenset[str]) -> frozenset[int]:
        """Return the slots of a recipe that are kept with these layers."""
        with self.news:
            kept = self._kept.get(recipe, {})
            return frozenset(slot for slot, frame in kept.items() if layers <= frame.layers)

    def room(self, nbytes: int) -> int:
        """Return how many slots of `nbytes` bytes each can be kept."""
        return self._room // max(nbytes, 1)

    def leave(self, others: int) -> None:
        """Note how many bytes are held elsewhere, and give up what has no room beside them."""
        with self.news:
            self.others = others
            while self.nbytes > self._room:
                self._drop(self._victim())
                self.changes += 1

    @property
    def _room(self) -> int:
        held = (frame for frame in self._held.values() if isinstance(frame, Frame))
        only_held = sum(frame.nbytes for frame in held if self._kept_frame(frame.key, frame.layers) is None)
        return max(self.most - self.others - only_held, 0)

    # ---- the engine's side -----------------------------------------------------------------------------------

    def next(self) -> Want | None:
        """Return the most urgent want that is not there; None if all are."""
        with self.news:
            return next((want for want in self._wants if self._is_missing(want)), None)

    def unseen(self) -> list[Want]:
        """Return the wants that are not there, nor their provisional slots, the most urgent first."""
        with self.news:
            missing = (want for want in self._wants if want.preview and self._is_missing(want))
            return [want for want in missing if want.provisional.subject not in self._held]

    def above(self, want: Want) -> set[Key]:
        """Return the slots of more urgent wants."""
        with self.news:
            place = self._wants.index(want) if want in self._wants else 0
            return {other.key for other in self._wants[:place]}

    def beside(self, want: Want) -> Frame | None:
        """Return the computed frame of the same slot that is there for the most urgent want; None if there is none."""
        with self.news:
            others = [other for other in self._wants if other.key.slot == want.key.slot and other.pixel is None]
            computed = (other for other in others if not other.key.recipe.setup.place)
            found = (self._held.get(other.subject) or self._find(other) for other in computed)
            return next((made for made in found if isinstance(made, Frame)), None)

    def put(self, want: Want, made: Frame | Inspection | Failure) -> None:
        """Store what was made of a want, under its key and no other. A frame is kept together with the layers that are
        there of its slot; its pictures must not be changed afterwards."""
        if want.key.recipe.source != self.source:
            return
        with self.news:
            may_keep = want.keep and not want.key.provisional
            is_kept = isinstance(made, Frame) and may_keep and self._keep(want.key, made)
            if want.subject in self._subjects:
                if want.hold or isinstance(made, Failure):
                    self._held[want.subject] = made
                elif not is_kept:
                    self._held[want.subject] = Failure("there is no room for it")
            self.changes += 1

    def open(self, source: int) -> None:
        """Drop everything; from now on slots of `source` are made."""
        with self.news:
            self.source, self._wants, self._subjects, self._held = source, (), set(), {}
            self._kept.clear()
            self.nbytes = 0
            self.changes += 1

    def forget(self, outdated: Callable[[Key], bool]) -> None:
        """Drop the slots that are outdated."""
        with self.news:
            for key in [Key(recipe, slot) for recipe, slots in self._kept.items() for slot in slots]:
                if outdated(key):
                    self._drop(key)
            self._held = {subject: made for subject, made in self._held.items() if not outdated(subject[0])}
            self.changes += 1
            self.outdated += 1
            self.news.notify_all()

    # ---- what is kept ----------------------------------------------------------------------------------------

    def _is_missing(self, want: Want) -> bool:
        if want.key.recipe.source != self.source or want.subject in self._held:
            return False
        return want.pixel is not None or self._kept_frame(want.key, want.layers) is None

    def _kept_frame(self, key: Key, layers: frozenset[str]) -> Frame | None:
        kept = self._kept.get(key.recipe, {}).get(key.slot)
        return kept if kept is not None and layers <= kept.layers else None

    def _find(self, want: Want) -> Frame | None:
        frame = self._kept_frame(want.key, want.layers)
        if frame is None:
            return None
        self._kept.move_to_end(want.key.recipe)
        images = {name: frame.images[name] for name in want.layers if name in frame.images}
        return replace(frame, layers=want.layers, images=images)

    def _keep(self, key: Key, frame: Frame) -> bool:
        """Keep a frame; returns whether there is room for it."""
        for image in frame.images.values():
            image.flags.writeable = False
        before = self._drop(key)
        if before is not None:
            frame = replace(frame, layers=frame.layers | before.layers, images=before.images | frame.images)
        if not self._make_room(key, frame.nbytes):
            return False
        self._kept.setdefault(key.recipe, {})[key.slot] = frame
        self._kept.move_to_end(key.recipe)
        self.nbytes += frame.nbytes
        return True

    def _drop(self, key: Key) -> Frame | None:
        slots = self._kept.get(key.recipe, {})
        kept = slots.pop(key.slot, None)
        if kept is None:
            return None
        self.nbytes -= kept.nbytes
        if not slots:
            del self._kept[key.recipe]
        return kept

    def _make_room(self, key: Key, nbytes: int) -> bool:
        if nbytes > self._room:
            return False
        while self.nbytes + nbytes > self._room:
            victim = self._victim()
            if self._is_nearer(victim, key):
                return False
            self._drop(victim)
        return True

    def _victim(self) -> Key:
        """Return the kept slot that is needed least."""
        idle = next((recipe for recipe in self._kept if recipe not in self._in_use), None)
        candidates = [idle] if idle is not None else list(self._kept)
        return max(
            (Key(recipe, slot) for recipe in candidates for slot in self._kept[recipe]),
            key=lambda key: self._playhead.distance(key.slot),
        )

    def _is_nearer(self, kept: Key, new: Key) -> bool:
        """Return whether `kept` is needed before `new`."""
        used = kept.recipe in self._in_use, new.recipe in self._in_use
        if used[0] != used[1]:
            return used[0]
        distance = self._playhead.distance
        return used[0] and distance(kept.slot) <= distance(new.slot)
