"""The survey: the quality of every generated slot, for A and B, measured while the engine is idle."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..engine.figures import NEEDED, QUANTITIES, Figures, Measurements
from ..engine.messages import Failure, Frame, Key, Recipe
from ..engine.store import Store, Want
from .playback import Playback

NO_B = "B is a layer. K keeps settings as B"
_AHEAD = 3  # slots that are wanted, or wait to be measured, at once
_HISTORY = 2  # rendered frames before the one that a slot is made of


class Survey:
    """Figures of slots, by recipe.

    Attributes
    ----------
    on : bool
        Whether slots are measured that are not known yet.
    quantity : str
        The one of `QUANTITIES` that is plotted, and by which frames are found.
    a, b : Recipe or None
        What is surveyed; B where settings are compared.
    resets : sequence of int
        Rendered frames that have none before them, in order. Slots without two rendered frames of history are plotted,
        but neither found nor counted in means, as `gffe compare` has it.
    """

    def __init__(self, store: Store, measured: Measurements, playback: Playback):
        self._store, self._measured, self._playback = store, measured, playback
        self.on, self.quantity = False, "psnr"
        self.a: Recipe | None = None
        self.b: Recipe | None = None
        self.resets: Sequence[int] = ()
        self._wants: list[Want] = []
        self._found: tuple[str, list[int], int] | None = None  # how, the slots in order, and the one gone to

    # ---- measuring -----------------------------------------------------------------------------------------

    def update(self, a: Recipe, b: Recipe | None, exposure: float, may_run: bool) -> list[Want]:
        """Have the slots measured that are there, and return those that are missing. Call once per frame of the
        interface; `may_run`: whether there is nothing else to do."""
        self.a, self.b = a, b
        for want in self._wants:
            made = self._store.get(want)
            if isinstance(made, Frame):
                self._measured.survey(made, exposure)
            elif isinstance(made, Failure):
                self._measured.note(want.key, Figures(surveyed=True))
        self._wants = self._missing() if self.on and may_run else []
        return self._wants

    def forget(self) -> None:
        """Drop everything after a change of the source."""
        self._wants, self._found = [], None

    @property
    def busy(self) -> bool:
        """Whether slots are left to measure."""
        done, total = self.progress
        return self.on and done < total

    @property
    def progress(self) -> tuple[int, int]:
        """Slots that are known, and all of them, of A and B together; once where both are the same."""
        slots, recipes = self.slots, set(self._named.values())
        known = sum(len(self._known(recipe) & set(slots)) for recipe in recipes)
        return known, len(slots) * len(recipes)

    @property
    def slots(self) -> list[int]:
        """Generated slots between the in and the out point."""
        playback = self._playback
        return [slot for slot in range(playback.first, playback.last + 1) if slot % (playback.n + 1)]

    def _known(self, recipe: Recipe) -> set[int]:
        return {slot for slot, figures in self._measured.of(recipe).items() if figures.surveyed}

    def _missing(self) -> list[Want]:
        """Return the next slots: A's from the playhead on and round, then B's."""
        slots, here, coming = self.slots, self._playback.slot, self._measured.surveying
        order = [slot for slot in slots if slot >= here] + [slot for slot in slots if slot < here]
        for side in self._named.values():
            known = self._known(side)
            missing = [key for slot in order if slot not in known and (key := Key(side, slot)) not in coming]
            if missing:
                return [Want(key, NEEDED, keep=False) for key in missing[: max(_AHEAD - len(coming), 0)]]
        return []

    # ---- results -------------------------------------------------------------------------------------------

    def figures(self, side: Recipe | None) -> dict[int, Figures]:
        """Return the figures of A or B by slot."""
        return {} if side is None else self._measured.of(side)

    def curve(self, side: Recipe | None, quantity: str | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return slots and values of a quantity, in order."""
        quantity = quantity or self.quantity
        known = sorted((s, f.values[quantity]) for s, f in self.figures(side).items() if quantity in f.values)
        return np.array([s for s, _ in known], np.float64), np.array([v for _, v in known], np.float64)

    def means(self, quantity: str) -> tuple[dict[str, tuple[float, float]], int]:
        """Return the means of A and B over the slots that both have and that are counted, with what 95% of these reach
        or are better than, and how many they are. A side without any is left out."""
        curves = {name: self.curve(side, quantity) for name, side in self._named.items()}
        values = {name: dict(zip(*curve, strict=True)) for name, curve in curves.items() if curve[0].size}
        common = self._of_both(list(values.values()))
        counted = {name: [of[slot] for slot in common] for name, of in values.items() if common}
        worst = 0.05 if QUANTITIES[quantity].worse < 0 else 0.95
        return {name: (float(np.mean(of)), float(np.quantile(of, worst))) for name, of in counted.items()}, len(common)

    def _of_both(self, sides: Sequence[Mapping[int, object]]) -> list[int]:
        """Return the slots that all sides have: those with history, or all if none has."""
        common = sorted(set.intersection(*map(set, sides))) if sides else []
        return [slot for slot in common if self._has_history(int(slot))] or common

    @property
    def _named(self) -> dict[str, Recipe]:
        return {name: side for name, side in (("A", self.a), ("B", self.b)) if side is not None}

    def _counted(self, side: Recipe | None) -> tuple[np.ndarray, np.ndarray]:
        """Return those slots and values of `curve` that have history, or all if none has."""
        xs, ys = self.curve(side)
        counted = np.array([self._has_history(int(x)) for x in xs], bool)
        return (xs[counted], ys[counted]) if counted.any() else (xs, ys)

    def _has_history(self, slot: int) -> bool:
        k = slot // (self._playback.n + 1)
        before = bisect_right(self.resets, k)
        return before == 0 or k - self.resets[before - 1] >= _HISTORY

    # ---- finding frames ------------------------------------------------------------------------------------

    def search(self, find: Callable[[], int | None]) -> tuple[int | None, str]:
        """Return the slot by `find` (`worst`, `next`, `most_different`), and a message. Measuring starts if it has
        not."""
        started, self.on = not self.on, True
        slot, (done, total) = find(), self.progress
        if slot is not None:
            return slot, self.place + (f" measured so far ({total} in all)" if done < total else "")
        if started or done < total:
            return None, "every generated frame is being measured: ask again in a moment"
        return None, self.why_not() or "no frame can be found by this"

    def why_not(self, difference: bool = False) -> str | None:
        """Return why no frame can be found; None where one can be, or nothing is known yet."""
        if difference and self.b is None:
            return NO_B
        quantity = QUANTITIES[self.quantity]
        if self.on and self.busy:
            return None
        xs = self.curve(self.a)[0]
        if self.on and not xs.size:
            return f"{quantity.label} is not known of this sequence"
        return None

    def worst(self) -> int | None:
        """Return the slot that is worst in `quantity`; None if none is known yet."""
        return self._go("worst", 0)

    def most_different(self) -> int | None:
        """Return the slot with the largest difference between A and B, at each further call the next one; None if none
        is known yet."""
        found = self._found
        again = found is not None and found[0] == f"difference {self.quantity}"
        return self._go("difference", found[2] + 1 if found is not None and again else 0)

    def next(self) -> int | None:
        """Return the next slot in the order of the last search, by default the worst; None if none is known yet."""
        if self._found is None or not self._found[0].endswith(f" {self.quantity}"):
            return self.worst()
        return self._go(self._found[0].split()[0], self._found[2] + 1)

    def _go(self, how: str, rank: int) -> int | None:
        order = self._ranked() if how == "worst" else self._ranked_by_difference()
        if not order:
            return None
        rank %= len(order)
        self._found = f"{how} {self.quantity}", order, rank
        return order[rank]

    @property
    def place(self) -> str:
        """Return the last target of navigation, in words."""
        if self._found is None:
            return ""
        how, order, rank = self._found
        what = "worst" if how.startswith("worst") else "largest difference of A and B"
        return f"{what}: {rank + 1} of {len(order)}"

    def _ranked(self) -> list[int]:
        xs, ys = self._counted(self.a)
        return [int(x) for x in xs[np.argsort(-ys * (QUANTITIES[self.quantity].worse or 1), kind="stable")]]

    def _ranked_by_difference(self) -> list[int]:
        a, b = (dict(zip(*self._counted(side), strict=True)) for side in (self.a, self.b))
        common = sorted(a.keys() & b.keys())
        return [int(slot) for slot in sorted(common, key=lambda slot: -abs(a[slot] - b[slot]))]
