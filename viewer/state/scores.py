"""What was measured of slots against ground truth."""

from __future__ import annotations

from gffe_cl.viewer.engine.engine import Engine
from gffe_cl.viewer.engine.messages import Metrics, Recipe, Result


class Scores:
    """Metrics by what slots were made with, and by slot."""

    def __init__(self, engine: Engine):
        self._engine = engine
        self._known: dict[Recipe, dict[int, Metrics]] = {}

    def of(self, recipe: Recipe) -> dict[int, Metrics]:
        return self._known.setdefault(recipe, {})

    def add(self, metrics: Metrics) -> None:
        self.of(self._engine.recipe(metrics.setup))[metrics.slot] = metrics

    def add_result(self, result: Result | None) -> None:
        """Those that a slot came with."""
        if result is not None and result.metrics:
            self.add(Metrics(result.request.slot, result.request.setup, result.metrics))

    def update(self) -> None:
        """Once per frame of the interface: those that became known."""
        while (metrics := self._engine.poll_metrics()) is not None:
            self.add(metrics)

    def forget(self) -> None:
        """There is another source."""
        self._known.clear()
