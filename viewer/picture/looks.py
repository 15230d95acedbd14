"""Display settings of each layer, remembered; and the histogram of the displayed one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from ..engine.jobs import Derived, Jobs
from .current_frame import Contents
from .displays import Display, FrameInfo, default_display, fitted, shown_as, shown_values
from .view import View

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
        elif (made := self._first(spec)) == default_display(spec) and spec.view == "motion":
            return made  # nothing moves here: a later picture gives the range
        else:
            self._displays[name] = made
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


BINS = 128
_PIXELS = 1 << 19  # that are counted; of more a part
_OUTLIERS = 0.001  # on each side: they are counted in the first and the last bin


@dataclass(frozen=True)
class Counts:
    """Shares of the pixels in percent, (channels, BINS), in bins between `edges` (BINS + 1,), of the channels of these
    names; `least`: the share of one pixel of those that were counted."""

    channels: tuple[str, ...]
    edges: np.ndarray
    shares: np.ndarray
    least: float


class Histogram:
    """Shares of the layer A; with `log` on a logarithmic axis.

    Attributes
    ----------
    counts : Counts or None
        None until they are known, and where there is nothing to count.
    """

    def __init__(self, view: View, contents: Contents, looks: Looks, background: Jobs):
        self._view, self._contents, self._looks = view, contents, looks
        self._derived = Derived(background)
        self.counts: Counts | None = None
        self.log = False

    def update(self) -> None:
        """Take the counts, and request the next. Call once per frame of the interface in which they are shown."""
        contents, name = self._contents, self._view.a
        spec, image = contents.spec(name), contents.image(name)
        if spec is None or image is None:
            self.counts = None
            return
        display = self._looks.of(name)
        key = contents.changes, name, display.channel, display.plane
        depth = contents.image(names.RENDERED_DEPTH)
        exposure = contents.source.exposure if spec.view == "color" else 1.0
        self.counts = self._derived.get(key, counted, spec, image, display, contents.frame_info(), depth, exposure)

    def handles(self) -> dict[str, float]:
        """Return the limits that can be dragged, by name, on the histogram's axis."""
        spec = self._contents.spec(self._view.a)
        if spec is None:
            return {}
        display = self._looks.of(spec.name)
        view = shown_as(spec, display)[0]
        if view == "color":
            return {"white": 2.0**-display.exposure}
        if view in ("motion", "place"):
            return {"full length": display.motion_scale}
        return {"low": display.low, "high": display.high}

    def drag(self, handle: str, value: float) -> None:
        """Move a limit, which changes the display of the layer."""
        name, display = self._view.a, self._looks.of(self._view.a)
        if handle == "white":
            self._looks.change(name, exposure=float(-np.log2(max(value, 2.0**-16))))
        elif handle == "full length":
            self._looks.change(name, motion_scale=max(value, 0.01))
        elif handle == "low":
            self._looks.change(name, low=min(value, display.high))
        else:
            self._looks.change(name, high=max(value, display.low))


def counted(
    spec: LayerSpec, image: np.ndarray, display: Display, frame: FrameInfo, depth: np.ndarray | None, exposure: float
) -> Counts | None:
    """Return the histogram of what a layer shows; of a color linear values times the sequence's `exposure`, so that 1
    is white at +0 EV."""
    values = shown_values(spec, image, display, frame, depth, _PIXELS)
    if values is None or not len(values):
        return None
    values = values * exposure
    low, high = np.quantile(values, (_OUTLIERS, 1 - _OUTLIERS)).tolist()
    high = max(high, low + 1e-3 * max(abs(low), 1e-3))
    edges = np.linspace(low, high, BINS + 1)
    pixels = np.stack([np.histogram(np.clip(column, low, high), edges)[0] for column in values.T])
    channel = display.channel if display.channel in spec.components else ""
    channels = ("R", "G", "B") if len(pixels) == 3 else (channel or "value",)
    return Counts(channels, edges, 100.0 * pixels / len(values), 100.0 / len(values))
