"""A and B: settings that are kept, taken from elsewhere, exchanged, or told as a command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gffe_cl.engine.core.errors import GffeError
from ..engine.engine import Engine
from .baseline import Baseline
from .comparing import Comparison
from .parameters import Parameters
from .presets import KeptSettings
from .survey import Survey


class Sides:
    """Makes B of A's settings, or of what is stored, and A of B. `say` takes messages."""

    def __init__(
        self, engine: Engine, parameters: Parameters, kept: KeptSettings, comparison: Comparison,
        survey: Survey, say: Callable[..., None],
    ):  # fmt: skip
        self._engine, self._parameters, self._kept = engine, parameters, kept
        self._comparison, self._survey, self._say = comparison, survey, say

    def keep(self) -> None:
        """Keep A's settings as B."""
        setup = self._parameters.setup
        kept = self._kept.keep(setup, self._engine.recipe(setup).kernels)
        self._comparison.with_settings(kept.name)
        self._say(f"kept as B: {kept.name}. W wipes between A and B, D shows their difference")

    def take_b_from(self, place: str) -> None:
        """Compare as `load_b` does. Errors give a message."""
        try:
            self.load_b(place)
        except GffeError as error:
            self._say(str(error), error=True)

    def load_b(self, place: str) -> None:
        """Compare with what is stored at `place`: kernels, with A's settings, the pictures of a sequence, or figures of
        frames. Raises GffeError."""
        path, setup = Path(place).expanduser().absolute(), self._parameters.setup
        if path.is_file():
            self._survey.baseline = baseline = Baseline.load(path)
            self._comparison.without_settings()
            self._say(f"B is the figures of {baseline.name}: Plot, Regions and Compare show them beside A's")
            return
        try:
            kernels = self._engine.take_kernels(path) if next(path.glob("*.cl"), None) is not None else ""
        except OSError as error:
            raise GffeError(f"{path}: {error.strerror or error}") from None
        kept = self._kept.keep(setup, kernels, path) if kernels else self._kept.keep_stored(str(path), setup.options)
        self._comparison.with_settings(kept.name)
        self._comparison.show()

    def take_second(self) -> None:
        """Go on with B's settings as A."""
        kept = self._kept.b
        assert kept is not None  # there is a B
        self._parameters.take(kept.options, kept.window)
        self._say(f"A has B's settings now: {kept.name}" + (", with the newest kernels" if kept.kernels else ""))
