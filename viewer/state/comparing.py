"""Comparing two layers: wipe, flip, difference and maps of errors."""

from __future__ import annotations

from dataclasses import replace

from gffe_cl.viewer.engine.layers import Display
from gffe_cl.viewer.engine.scoring import flip_available
from gffe_cl.viewer.picture import flip_map
from gffe_cl.viewer.picture.canvas import View

FLIP_HIGH = 0.5


class Comparison:
    """How A and B of a model's view are compared; "flip error" is a map that is computed on the host."""

    def __init__(self, model):
        self._model = model
        self.flipped = False  # B is shown as long as a key is held
        self.flip_high = FLIP_HIGH
        self._nothing = False  # A or B does not exist for this frame
        self._flip_missing = flip_available()
        self._maps = flip_map.FlipMaps()
        self._truth_instead_of = "final"

    def why_not(self, way: str) -> str | None:
        """Why it cannot be compared in this way."""
        if way != "flip error":
            return None
        if self._flip_missing:
            return self._flip_missing
        view = self._model.view
        specs = [self._model.spec_of(name) for name in (view.a, view.b or self._usual_b())]
        if any(spec is not None and spec.view != "color" for spec in specs):
            return "FLIP compares colours: choose two of them as A and B"
        return None

    def set(self, way: str) -> None:
        view = self._model.view
        view.compare = way
        if way != "off" and view.b is None:
            view.b = self._usual_b()

    def toggle(self, way: str) -> None:
        self.set("off" if self._model.view.compare == way else way)

    def flip(self, down: bool) -> None:
        """Show B instead of A as long as the key is held; from then on B is read back with A."""
        if down and self._model.view.compare == "off":
            self.set("flip")
        self.flipped = down

    def toggle_truth(self) -> None:
        """Ground truth as A, and back."""
        view = self._model.view
        if view.a == "truth":
            view.a = self._truth_instead_of
        else:
            self._truth_instead_of, view.a = view.a, "truth"

    def shown(self) -> View:
        """The view with the displays of its layers, for the canvas."""
        looks = self._model.looks
        view = replace(self._model.view, a_display=looks.of(self._model.view.a))
        if view.b:
            view.b_display = looks.of(view.b)
        if self.flipped and view.b:
            view.a, view.a_display, view.compare = view.b, view.b_display, "off"
        elif view.compare == "flip error":
            view.a, view.a_display, view.compare = flip_map.NAME, self.error_display, "off"
        return view

    @property
    def error_display(self) -> Display:
        """Of maps of errors."""
        return Display(high=self.brightest, color_map="heat")

    @property
    def brightest(self) -> float:
        """The error that is shown in the brightest colour; maps of FLIP have their own."""
        return self.flip_high if self._model.view.compare == "flip error" else self._model.view.error_high

    @brightest.setter
    def brightest(self, error: float) -> None:
        if self._model.view.compare == "flip error":
            self.flip_high = error
        else:
            self._model.view.error_high = error

    def scale_text(self) -> str:
        """What the colours of a difference or an error mean; empty where layers are shown as they are."""
        view = self._model.view
        if self.flipped or view.compare not in ("difference", "error", "flip error"):
            return ""
        if view.compare == "difference":
            return f"|A − B| × {view.gain:g}"
        kind = "FLIP error" if view.compare == "flip error" else f"{view.error} error"
        return f"{kind}, brightest from {self.brightest:.3g}"

    @property
    def ready(self) -> bool:
        """Whether what is shown belongs to the present images."""
        return self._model.view.compare != "flip error" or self._nothing or self._maps.ready

    def update(self, canvas) -> None:
        """Once per frame of the interface: take the map that is made, and have the next one made."""
        model, view = self._model, self._model.view
        if view.compare != "flip error":
            return
        if self.why_not("flip error"):
            view.compare = "off"
            return
        try:
            made = self._maps.take()
        except Exception as error:  # whatever a binary package throws
            view.compare = "off"
            model.say(f"FLIP failed: {error}", error=True)
            return
        if made is not None and canvas is not None:
            canvas.upload(flip_map.NAME, made, flip_map.SPEC)
        a, b = model.image_of(view.a), model.image_of(view.b)
        self._nothing = (a is None or b is None) and {view.a, view.b} <= model.asked_layers
        if self._nothing and canvas is not None:
            canvas.forget([flip_map.NAME])
        if a is None or b is None:
            return
        if a.shape != b.shape:
            view.compare = "off"
            model.say("FLIP compares images of one size", error=True)
            return
        self._maps.want((model.taken, view.a, view.b), a, b, model.info.exposure)

    def close(self) -> None:
        self._maps.close()

    def _usual_b(self) -> str:
        return "truth" if self._model.why_not("truth") is None else "rendered.color"
