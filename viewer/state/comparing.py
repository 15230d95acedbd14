"""Comparing A with B: layers and settings, and the scores of both against ground truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inspection import names
from gffe_cl.lab.metrics import METRICS
from ..engine.engine import Engine
from ..engine.jobs import Derived, Jobs
from ..picture.current_frame import Contents
from ..picture.displays import Display, is_sound
from ..picture.looks import Looks
from ..picture.view import DIFFERENCES, FLIP_MAP, FLIP_SPEC, View, flip_map
from .parameters import Parameters
from .presets import Kept, KeptSettings

FORMULAS = {"absolute": "|A − B|", "signed": "(A − B)", "relative": "|A − B| / the larger one", "mean": "mean |A − B|"}
WAYS = {
    "off": "off",
    "split": "split wipe",
    "flip": "flip (hold B)",
    "difference": "difference",
    "flip error": "FLIP error",
}
NEIGHBORS: tuple[str, ...] = (
    "rendered frame before",
    "rendered frame after",
    "new frame before",
)  # as B: A's layer in that frame
FLIP_HIGH = 0.5
BUILD_LETTERS = 6  # of the identity of a build
_NUMBERS = {"split": (0.0, 1.0), "gain": (1.0, 32.0)}  # of a view, with their ranges


class Comparison:
    """Comparison of A and B of a view; "flip error" is a map that is computed on the host."""

    def __init__(self, view: View, contents: Contents, looks: Looks, settings: KeptSettings, background: Jobs):
        self._view, self._contents, self._looks, self._settings = view, contents, looks, settings
        self._by_settings = False
        self.neighbor = ""  # one of NEIGHBORS that is B
        self.follows = False  # a neighbor is shown where motion vectors lead
        self.same_settings = False  # B's settings are A's
        self.flipped = False  # B is shown as long as a key is held
        self.flip_high = FLIP_HIGH
        self.flip_map: np.ndarray | None = None  # of FLIP errors, as it is shown
        self._nothing = False  # A or B does not exist for this frame
        self._flip_missing = METRICS["flip"].missing()
        self._maps = Derived(background)
        self._truth_instead_of = names.FINAL

    def why_not(self, way: str) -> str | None:
        """Return why A and B cannot be compared in this way; None if they can."""
        if way != "flip error":
            return None
        if self._flip_missing:
            return self._flip_missing
        view = self._view
        specs = [self._contents.spec(name) for name in (view.a, view.b or self._usual_b())]
        if any(spec is not None and spec.view != "color" for spec in specs):
            return "FLIP compares colors: choose two of them as A and B"
        return None

    @property
    def by_settings(self) -> bool:
        """Whether B is A's layer as the kept settings make it, not another layer."""
        return self._by_settings and self._settings.b is not None

    @property
    def is_shown(self) -> bool:
        """Whether something of B is to be shown."""
        return self._view.compare != "off" or self.flipped

    @property
    def second(self) -> Kept | None:
        """B's settings while something of them is to be shown, else None."""
        return self._settings.b if self.by_settings and self.is_shown else None

    def slot_of_b(self, slot: int, n: int, count: int) -> int | None:
        """Return the slot that B shows beside A's; None if there is no such neighbor. `count`: of rendered frames."""
        k, j = divmod(slot, n + 1)
        neighbors = (k - (j == 0)) * (n + 1), (k + 1) * (n + 1), slot - 1 if j != 1 else slot - 2
        found = neighbors[NEIGHBORS.index(self.neighbor)] if self.neighbor else slot
        return found if 0 <= found < count * (n + 1) else None

    @property
    def nothing(self) -> str:
        """Why there is nothing to compare, although a comparison is on: A and B are the same. Empty if they are not."""
        if self._view.compare == "off":
            return ""
        if self.neighbor:
            return "" if self._contents.second is not None else f"there is no {self.neighbor} here"
        if self.by_settings:
            return "A and B have the same settings" if self.same_settings else ""
        return "A and B are the same layer" if self._view.b == self._view.a else ""

    @property
    def builds(self) -> tuple[str, str]:
        """The kernels that the displayed frames of A and B were made with, where these differ; else empty texts."""
        shown = self._contents.result, self._contents.second
        a, b = (frame.key.recipe.kernels if frame else "" for frame in shown)
        if not self.by_settings or a == b or not b:
            return "", ""
        return f"kernels {a[:BUILD_LETTERS]}   ", f"kernels {b[:BUILD_LETTERS]}   "

    def with_settings(self, name: str | None = None) -> None:
        """Compare with kept settings, by default with those that are B already."""
        if name is not None:
            self._settings.choose(name)
        self._by_settings, self.neighbor = self._settings.b is not None, ""
        self.follow()

    def with_layer(self, name: str) -> None:
        """Compare with another layer."""
        self._by_settings, self.neighbor, self._view.b = False, "", name

    def with_neighbor(self, which: str) -> None:
        """Compare with A's layer in a neighbor of the frame, one of NEIGHBORS; by difference, unless it is compared
        already."""
        self._by_settings, self.neighbor = False, which
        self.follow()
        if self._view.compare == "off":
            self.set("difference")

    def follow(self) -> None:
        """Make B's layer that of A where settings or frames are compared. Where they no longer are, B is given up."""
        view = self._view
        if self.by_settings or self.neighbor:
            view.b = names.of_second(view.a)
        elif names.is_second(view.b):
            view.b, view.compare = None, "off"

    def set(self, way: str) -> None:
        view = self._view
        view.compare = way
        if way != "off" and view.b in (None, view.a):
            view.b = self._usual_b()

    def show(self) -> None:
        """Show A beside B unless they are compared already."""
        if self._view.compare == "off":
            self.set("split")

    def toggle(self, way: str) -> None:
        if way == "difference" and self._view.difference == "mean":
            self._view.difference, self._view.compare = "absolute", "off"
        self.set("off" if self._view.compare == way else way)

    def subtract(self, how: str) -> None:
        """Show the difference of A and B as `how`, one of DIFFERENCES; if it is shown already, A."""
        is_shown = (self._view.compare, self._view.difference) == ("difference", how)
        self._view.difference = how
        self.set("off" if is_shown else "difference")

    def flip(self, down: bool) -> None:
        """Show B instead of A as long as the key is held; from then on B is read back with A."""
        if down and self._view.compare == "off":
            self.set("flip")
        self.flipped = down

    def toggle_truth(self) -> None:
        """Show ground truth as A, or the layer before it again."""
        view = self._view
        if view.a == names.TRUTH:
            view.a = self._truth_instead_of
        else:
            self._truth_instead_of, view.a = view.a, names.TRUTH

    def shown(self) -> View:
        """Return the view with the displays of its layers, for the canvas."""
        self.follow()
        looks = self._looks
        view = replace(self._view, a_display=looks.of(self._view.a))
        if view.b:
            view.b_display = looks.of(view.b)
        if self.nothing and view.compare != "split":
            view.compare = "off"  # a map without errors would pass for a perfect result
        elif self.flipped and view.b and view.b_display:
            view.a, view.a_display, view.compare = view.b, view.b_display, "off"
        elif view.compare == "flip error":
            view.a, view.a_display, view.compare = FLIP_MAP, self.error_display, "off"
        return view

    @property
    def error_display(self) -> Display:
        """Display settings of FLIP's error map."""
        return Display(high=self.flip_high, color_map="heat")

    def scale_text(self) -> str:
        """Return the meaning of the colors of a difference or an error; empty where layers are shown as they are."""
        view = self._view
        if self.nothing:
            return f"{self.nothing}: nothing is compared"
        if self.flipped or view.compare not in ("difference", "flip error"):
            return ""
        if view.compare == "difference":
            lost = ", along vectors (checkered: none)" * bool(self.neighbor and self.follows)
            return f"{FORMULAS[view.difference]} × {view.gain:g}{lost}"
        return f"FLIP error, brightest from {self.flip_high:.3g}"

    @property
    def ready(self) -> bool:
        """Whether the displayed map belongs to the present images."""
        return self._view.compare != "flip error" or self._nothing or bool(self.nothing) or self._maps.ready

    def update(self, canvas) -> str | None:
        """Take the finished map, and request the next. Call once per frame of the interface. Returns an error message,
        if any; then the comparison is switched off."""
        self.follow()
        view, contents = self._view, self._contents
        if view.compare != "flip error" or self.nothing:
            return None
        if self.why_not("flip error"):
            view.compare = "off"
            return None
        a, b = contents.image(view.a), contents.image(view.b)
        self._nothing = (a is None or b is None) and {view.a, view.b} <= contents.asked
        if self._nothing:
            self._maps.forget()
            self.flip_map = None
            if canvas is not None:
                canvas.forget([FLIP_MAP])
        if a is None or b is None:
            return None
        if a.shape != b.shape:
            view.compare = "off"
            return "FLIP compares images of one size"
        key = contents.changes, view.a, view.b
        made = self._maps.get(key, flip_map, a, b, contents.source.exposure)
        if error := self._maps.error:
            self._maps.forget()
            view.compare = "off"
            return f"FLIP failed: {error}"
        if made is not None and made is not self.flip_map:
            self.flip_map = made
            if canvas is not None:
                canvas.upload(FLIP_MAP, made, FLIP_SPEC)
        return None

    def drop_missing(self) -> None:
        """Stop showing and comparing layers that this sequence does not have."""
        view, why_not = self._view, self._contents.why_not
        if why_not(view.a):
            view.a = names.FINAL
        if view.b and why_not(view.b):
            view.b, view.compare = None, "off"

    def preferences(self) -> dict[str, Any]:
        """Return the choices to remember, as plain JSON."""
        saved = {name: getattr(self._view, name) for name in ("compare", "b", "difference", *_NUMBERS)}
        return saved | ({"compare": "off", "b": None} if names.is_second(self._view.b) else {})

    def restore(self, saved: dict[str, Any]) -> None:
        """Restore the result of `preferences`. A damaged value affects only itself."""
        view = self._view
        for name, choices in (("compare", tuple(WAYS)), ("difference", DIFFERENCES)):
            if saved.get(name) in choices:
                setattr(view, name, saved[name])
        for name, (low, high) in _NUMBERS.items():
            if is_sound(saved.get(name), 0.0):
                setattr(view, name, min(max(float(saved[name]), low), high))
        if isinstance(saved.get("b"), str):
            view.b = saved["b"]
        elif view.compare != "off":
            view.compare = "off"

    def _usual_b(self) -> str:
        usual = names.TRUTH if self._contents.why_not(names.TRUTH) is None else names.RENDERED_COLOR
        return usual if self._view.a != usual else names.FINAL


class Sides:
    """Makes B of A's settings, or of what is stored, and A of B. `say` takes messages."""

    def __init__(
        self,
        engine: Engine,
        parameters: Parameters,
        kept: KeptSettings,
        comparison: Comparison,
        say: Callable[..., None],
    ):
        self._engine, self._parameters, self._kept = engine, parameters, kept
        self._comparison, self._say = comparison, say

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
        """Compare with what is stored at `place`: kernels, with A's settings, or the pictures of a sequence. Raises
        GffeError."""
        path, setup = Path(place).expanduser().absolute(), self._parameters.setup
        if not path.exists():
            raise GffeError(f"{path}: no such file or folder")
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
