"""How each layer is displayed: fitted to its picture at the first look, changed by the user, remembered."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gffe_cl.viewer.engine.layers import Display, LayerSpec, default_display, fitted, shown_as

_SAMPLES = 65536
_LARGEST_EXPOSURE = 16.0  # stops


class Looks:
    """Displays of a model's layers by name. A display is never changed in place."""

    def __init__(self, model):
        self._model = model
        self._displays: dict[str, Display] = {}

    def of(self, name: str) -> Display:
        """How the layer `name` is displayed now."""
        if name not in self._displays:
            saved = self._model.settings.displays.get(name)
            spec = self._model.spec_of(name)
            if saved is None:
                return Display() if spec is None else default_display(spec)
            self._displays[name] = Display.from_dict(saved)
        return self._displays[name]

    def meet(self, names) -> None:
        """Layers whose images are there: those that were never looked at get a range that fits."""
        for name in names:
            spec = self._model.spec_of(name)
            if name not in self._displays and name not in self._model.settings.displays and spec is not None:
                self._displays[name] = self._first(spec)

    def forget(self) -> None:
        """Other pictures: what was fitted to the old ones does not hold for them."""
        self._displays.clear()

    def change(self, **values) -> None:
        """Display the shown layer with these `values` from now on."""
        self._keep(self._model.view.a, replace(self.of(self._model.view.a), **values))

    def choose_plane(self, plane: int) -> None:
        """Show another plane; of a scalar with a range of its own."""
        self.change(plane=plane)
        spec = self._model.spec_of(self._model.view.a)
        if spec is not None and shown_as(spec, self.of(spec.name))[0] == "scalar":
            self._keep(spec.name, self._fitted(spec, self.of(spec.name)))

    def expose(self, stops: float) -> None:
        self.change(exposure=self.of(self._model.view.a).exposure + stops)

    def fit(self) -> None:
        """Range from the picture; of a colour its exposure."""
        spec = self._model.spec_of(self._model.view.a)
        if spec is None:
            return
        display = self.of(spec.name)
        if shown_as(spec, display)[0] == "color":
            display = replace(display, exposure=self._exposure(spec.name, display.exposure))
        self._keep(spec.name, self._fitted(spec, display))

    def _exposure(self, name: str, now: float) -> float:
        """Stops that make the brightest of 99% of the pixels just white."""
        image = self._model.image_of(name)
        if image is None:
            return now
        pixels = image[..., :3].reshape(-1, 3)
        brightest = pixels[:: max(len(pixels) // _SAMPLES, 1)].astype(np.float64).max(-1)
        brightest = brightest[np.isfinite(brightest)]
        white = float(np.quantile(brightest, 0.99)) * self._model.info.exposure if brightest.size else 0.0
        return min(max(-math.log2(white), -_LARGEST_EXPOSURE), _LARGEST_EXPOSURE) if white > 0 else now

    def reset(self) -> None:
        spec = self._model.spec_of(self._model.view.a)
        if spec is not None:
            self._displays[spec.name] = self._first(spec)
            self._model.settings.displays.pop(spec.name, None)

    def next_channel(self) -> None:
        spec = self._model.spec_of(self._model.view.a)
        if spec is not None:
            now = self.of(spec.name).channel
            index = spec.channels.index(now) if now in spec.channels else 0
            self.change(channel=spec.channels[(index + 1) % len(spec.channels)])

    def _keep(self, name: str, display: Display) -> None:
        self._displays[name] = display
        self._model.settings.displays[name] = display.to_dict()

    def _first(self, spec: LayerSpec) -> Display:
        display = default_display(spec)
        return display if spec.limits else self._fitted(spec, display)

    def _fitted(self, spec: LayerSpec, display: Display) -> Display:
        model = self._model
        image = model.image_of(spec.name)
        if image is None:
            return display
        return fitted(spec, image, display, model.frame_info(model.result), model.image_of("rendered.depth"))
