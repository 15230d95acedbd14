"""Histogram of the displayed layer, counted in the background."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from ..engine.background import Derived
from .current_frame import Contents
from .display_settings import Looks
from .displays import Display, FrameInfo, shown_as, shown_values
from .view import View

BINS = 128
_PIXELS = 1 << 19  # that are counted
_OUTLIERS = 0.001  # on each side: they are counted in the first and the last bin


@dataclass(frozen=True)
class Counts:
    """Numbers of pixels, (channels, BINS), in bins between `edges` (BINS + 1,), of the channels of these names."""

    channels: tuple[str, ...]
    edges: np.ndarray
    pixels: np.ndarray


class Histogram:
    """Counts of the layer A; with `log` their logarithms are shown.

    Attributes
    ----------
    counts : Counts or None
        None until they are known, and where there is nothing to count.
    """

    def __init__(self, view: View, contents: Contents, looks: Looks):
        self._view, self._contents, self._looks = view, contents, looks
        self._derived = Derived("histogram")
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

    def close(self) -> None:
        self._derived.close()


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
    return Counts(channels, edges, pixels.astype(np.float64))
