"""Display settings of each layer: fitted to its picture at the first look, changed by the user, remembered."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from .current_frame import Contents
from .displays import Display, default_display, fitted, shown_as

_SAMPLES = 65536
_LARGEST_EXPOSURE = 16.0  # stops


class Looks:
    """Displays of layers by name. The user's choices are in `saved`, too. A display is never changed in place."""

    def __init__(self, contents: Contents, saved: dict[str, dict]):
        self._contents, self._saved = contents, saved
        self._displays: dict[str, Display] = {}

    def of(self, name: str) -> Display:
        """Return the display of the layer `name` now, whichever settings made the layer. At the first look its range is
        fitted to the picture, if that is there."""
        name = names.plain(name)
        if name in self._displays:
            return self._displays[name]
        spec = self._contents.spec(name)
        if name in self._saved:
            self._displays[name] = Display.from_dict(self._saved[name])
        elif spec is None or self._contents.image(name) is None:
            return Display() if spec is None else default_display(spec)
        else:
            self._displays[name] = self._first(spec)
        return self._displays[name]

    def tiles(self) -> list[tuple[str, Display]]:
        """Return all layers that generated frames have, with their displays: tiles keep their places."""
        contents = self._contents
        shown = [spec.name for spec in contents.layers if spec.of_generated or contents.image(spec.name) is not None]
        return [(name, self.of(name)) for name in shown]

    def forget(self) -> None:
        """Drop values that were fitted to the pictures, after a change of the source."""
        self._displays.clear()

    def change(self, name: str, **values) -> None:
        """Display a layer with these `values` from now on."""
        self._keep(name, replace(self.of(name), **values))

    def choose_plane(self, name: str, plane: int) -> None:
        """Show another plane; a scalar plane gets a range of its own."""
        self.change(name, plane=plane)
        spec = self._contents.spec(name)
        if spec is not None and shown_as(spec, self.of(name))[0] == "scalar":
            self._keep(name, self._fitted(spec, self.of(name)))

    def expose(self, name: str, stops: float) -> None:
        self.change(name, exposure=self.of(name).exposure + stops)

    def fit(self, name: str) -> None:
        """Fit the range of a layer to its picture; of a color, its exposure."""
        spec = self._contents.spec(name)
        if spec is None:
            return
        display = self.of(name)
        if shown_as(spec, display)[0] == "color":
            display = replace(display, exposure=self._exposure(name, display.exposure))
        self._keep(name, self._fitted(spec, display))

    def _exposure(self, name: str, now: float) -> float:
        """Return the stops that make the brightest of 99% of the pixels just white; `now` where there are none to go
        by."""
        image = self._contents.image(name)
        if image is None:
            return now
        pixels = image[..., :3].reshape(-1, 3)
        brightest = pixels[:: max(len(pixels) // _SAMPLES, 1)].astype(np.float64).max(-1)
        brightest = brightest[np.isfinite(brightest)]
        white = float(np.quantile(brightest, 0.99)) * self._contents.source.exposure if brightest.size else 0.0
        return min(max(-math.log2(white), -_LARGEST_EXPOSURE), _LARGEST_EXPOSURE) if white > 0 else now

    def reset(self, name: str) -> None:
        spec = self._contents.spec(name)
        if spec is not None:
            self._displays[name] = self._first(spec)
            self._saved.pop(name, None)

    def next_channel(self, name: str) -> None:
        spec = self._contents.spec(name)
        if spec is not None:
            now = self.of(name).channel
            index = spec.channels.index(now) if now in spec.channels else 0
            self.change(name, channel=spec.channels[(index + 1) % len(spec.channels)])

    def _keep(self, name: str, display: Display) -> None:
        self._displays[name] = display
        self._saved[name] = display.to_dict()

    def _first(self, spec: LayerSpec) -> Display:
        display = default_display(spec)
        return display if spec.limits else self._fitted(spec, display)

    def _fitted(self, spec: LayerSpec, display: Display) -> Display:
        contents = self._contents
        image = contents.image(spec.name)
        if image is None:
            return display
        return fitted(spec, image, display, contents.frame_info(), contents.image(names.RENDERED_DEPTH))
