"""Asking for the slot that is due, of A and where they are compared of B, and taking it when it is there."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

from gffe_cl.viewer.engine.engine import Engine
from gffe_cl.viewer.engine.messages import Recipe, Request, Result
from gffe_cl.viewer.state.contents import Contents
from gffe_cl.viewer.state.filling import Filling
from gffe_cl.viewer.state.second import Second


class Asking:
    """Looks into the cache first, else asks the engine.

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
        self, engine: Engine, contents: Contents, filling: Filling, second: Second,
        show: Callable[[Result, Result | None], None],
    ):  # fmt: skip
        self._engine, self._contents, self._filling, self._second, self._show = engine, contents, filling, second, show
        self.asked: Request | None = None
        self.from_cache = False
        self._wanted: tuple[Request, Recipe | None, Request | None] | None = None
        self._serial = itertools.count(1)

    def serial(self) -> int:
        """Another number for everything that is asked of the engine."""
        return next(self._serial)

    def forget(self) -> None:
        """What was asked for does not come, or is not the right thing any more."""
        self.asked = None

    def ask(self, request: Request, recipe: Recipe | None, second: Request | None, anew: bool, source) -> bool:
        """Have slots of A and B shown, unless they are asked for already; whether they were not. `recipe`: of A, None
        where nothing that is kept will do; `anew`: also the same request again."""
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
        """A's result has been computed; one that was asked for before what is shown is too old."""
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
        """Once per frame of the interface: have what is ahead made beside."""
        result = self._contents.result
        if result is None or self._wanted is None:
            return
        nbytes, request = sum(image.nbytes for image in result.images.values()), self._wanted[0]
        self._filling.update(now, recipe, request, nbytes, may_run and request.slot == result.request.slot)

    @property
    def answered(self) -> bool:
        """Whether what is shown is what was asked for."""
        result = self._contents.result
        return result is not None and result.request == self.asked and not self._second.waits

    def _came(self, result: Result) -> None:
        """A's result is there; where it is compared with B's it waits for that."""
        if self._second.belongs(result):
            self._second.pair(result)
        else:
            self._show(result, None)
