"""B as other settings instead of another layer: the same slot, made in addition to A's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..engine.engine import Engine
from ..engine.messages import EngineError, Recipe, Request, Result
from .presets import Kept


class Second:
    """Synchronizes B's slots with A's, because both must show one slot: the first result waits for the other.

    Parameters
    ----------
    find : callable
        What the cache has for a recipe and a request.

    Attributes
    ----------
    kept : Kept or None
        B's settings while there is something to show of them.
    fault : str
        Why there is nothing of B; empty if there is.
    asked : Request or None
        What was asked of B last.
    """

    def __init__(self, engine: Engine, find: Callable[[Recipe, Request], Result | None]):
        self._engine, self._find = engine, find
        self.kept: Kept | None = None
        self.fault = ""
        self.asked: Request | None = None
        self._first: Result | None = None  # A's, which waits for B's
        self._made: Result | None = None  # B's
        self._shown: Request | None = None  # of B, that was given to be shown

    def compare_with(self, kept: Kept | None) -> None:
        """Compare with these settings from now on; None: with none."""
        if kept is None or self.kept is None or replace(kept, name=self.kept.name) != self.kept:
            self.forget()
        self.kept = kept

    def forget(self) -> None:
        """Withdraw the request to B, and drop the results that wait."""
        if self.asked is not None:
            self._engine.withdraw("b")
        self.asked = self._first = self._made = None
        self.fault = ""

    @property
    def waits(self) -> bool:
        """Whether A's or B's result of the last request is missing."""
        return self.kept is not None and self.asked is not None and self._shown != self.asked

    def request(self, first: Request, layers: frozenset[str]) -> Request:
        """Return the request to B for the request `first` to A."""
        assert self.kept is not None  # there is a B
        return replace(first, setup=self.kept.setup(first.setup.n), layers=layers, role="b")

    def ask(self, request: Request, source) -> None:
        """Request the slot of B that belongs to the one of A that is asked for now; a cached one is taken at once."""
        self.asked, self.fault = request, ""
        self._first = self._shown = None
        kept = self._find(self._engine.recipe(request.setup), request) if request.keep else None
        self._made = None if kept is None else replace(kept, request=request)
        if kept is None:
            self._engine.submit(request, source)

    def failed(self, error: EngineError) -> bool:
        """Return whether a fault is B's: then A is shown alone."""
        if self.asked is None or error.serial != self.asked.serial:
            return False
        self.fault = error.message
        return True

    def belongs(self, first: Result) -> bool:
        """Return whether a result of A is to be shown together with one of B."""
        return self.asked is not None and self.asked.slot == first.request.slot

    def pair(self, first: Result) -> None:
        """Take A's result, which waits for B's."""
        self._first = first

    def take(self) -> tuple[Result, Result | None] | None:
        """Return A's and B's results when both are ready; B's is None if it failed."""
        made = self._engine.poll("b")
        if isinstance(made, Result) and made.request == self.asked:
            self._made = made
        if self._first is None or (self._made is None and not self.fault):
            return None
        pair = self._first, self._made
        self._first, self._shown = None, self.asked
        return pair
