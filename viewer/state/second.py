"""B where it is not another layer but other settings: the same slot and layers, computed beside A's."""

from __future__ import annotations

from dataclasses import replace

from gffe_cl.viewer.engine.messages import EngineError, Metrics, Request, Result
from gffe_cl.viewer.state.beside import Beside
from gffe_cl.viewer.state.kept import Kept


class Second:
    """Brings B's slots together with A's: what is shown is of one slot, or A waits.

    Attributes
    ----------
    kept : Kept or None
        B's settings while there is something to show of them.
    metrics : dict
        Of B by slot.
    fault : str
        Why there is nothing of B; empty if there is.
    """

    def __init__(self, beside: Beside):
        self._beside = beside
        self.kept: Kept | None = None
        self.metrics: dict[int, Metrics] = {}
        self.fault = ""
        self._asked: Request | None = None
        self._measured = None
        self._first: Result | None = None  # A's, which waits for B's
        self._made: Result | None = None  # B's

    def compare_with(self, kept: Kept | None) -> None:
        """With these settings from now on; None: with none."""
        if kept is None or self.kept is None or replace(kept, name=self.kept.name) != self.kept:
            self.forget()
        self.kept = kept

    def forget(self) -> None:
        """There is another picture."""
        self._asked = self._first = self._made = None
        self.fault = ""
        self.metrics = {}
        self._beside.give_up("show")

    @property
    def active(self) -> bool:
        return self.kept is not None

    @property
    def waits(self) -> bool:
        """Whether a slot of B is under way."""
        return self.active and self._asked is not None and self._made is None and not self.fault

    def request(self, first: Request) -> Request:
        """What is asked of B where `first` is asked of A."""
        return replace(first, setup=self.kept.setup(first.setup.n))

    def ask(self, request: Request) -> None:
        """The slot of B that belongs to the one of A that is asked for now."""
        if self._measured != request.setup:
            self._measured, self.metrics = request.setup, {}
        self._asked, self._made, self._first, self.fault = request, None, None, ""
        self._beside.show(request)

    def pair(self, first: Result) -> None:
        """A's slot is there."""
        self._first = first

    def take(self) -> tuple[Result, Result | None] | None:
        """A's and B's results of one slot when both are there; B's is None if it failed."""
        while (answer := self._beside.take("show")) is not None:
            request, made = answer
            if request != self._asked:
                continue
            if isinstance(made, EngineError):
                self.fault = made.message
            else:
                self._made = made
                if made.metrics:
                    self.metrics[request.slot] = Metrics(request.slot, request.setup, made.metrics)
        while (metrics := self._beside.take_metrics()) is not None:
            if metrics.setup == self._measured:
                self.metrics[metrics.slot] = metrics
        if self._first is None or (self._made is None and not self.fault):
            return None
        pair = self._first, self._made
        self._first = None
        return pair
