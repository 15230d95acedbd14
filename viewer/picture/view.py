"""View of a canvas: the layers it shows, and which part of them; and differences between two: what they are of, their
full scale and unit, and the numbers that display.frag draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.lab.metrics import flip_error, to_display
from .displays import Display, Rgb, shown_as

COMPARISONS = ("off", "split", "difference", "flip")  # "flip": the caller shows b as a
OVERLAYS = ("none", "clipping")
CLIPPING: dict[str, Rgb] = {"below 0": (0.1, 0.35, 1.0), "above white": (1.0, 0.15, 0.1)}

Size = tuple[int, int]


@dataclass
class View:
    """Layers and display settings of a canvas.

    Attributes
    ----------
    a, b : names of layers; one that is not uploaded shows the background
    compare : "off" and "flip" show a; "split" a left of `split` (fraction of the canvas' width) and b right of it;
        "difference" a − b, as `difference` of DIFFERENCES, times `gain`
    zoom : screen pixels per display pixel
    center : display pixel (x, y) in the middle of the canvas
    overlay : one of OVERLAYS, over whatever is compared; clipping marks colors of a by CLIPPING, as they are exposed
    grid : lines between pixels when zoomed in
    line : width of the wipe's line, screen pixels
    """

    a: str
    a_display: Display
    b: str | None = None
    b_display: Display | None = None
    compare: str = "off"
    split: float = 0.5
    zoom: float = 1.0
    center: tuple[float, float] = (0.0, 0.0)
    overlay: str = "none"
    background: Rgb = (0.11, 0.11, 0.12)
    gain: float = 4.0
    difference: str = "absolute"
    grid: bool = True
    line: float = 2.0

    def display_at(self, size: Size, x: float, y: float) -> tuple[float, float]:
        """Return the display position, in pixels, under the screen position (x, y) of a canvas of `size`."""
        right, down = (c + (p - s / 2) / self.zoom for c, p, s in zip(self.center, (x, y), size, strict=True))
        return right, down

    def screen_at(self, size: Size, x: float, y: float) -> tuple[float, float]:
        """Return the screen position of the display pixel position (x, y) on a canvas of `size`."""
        right, down = (s / 2 + (p - c) * self.zoom for c, p, s in zip(self.center, (x, y), size, strict=True))
        return right, down

    def fit(self, size: Size, display_size: Size) -> None:
        """Zoom and center so that the whole display fits a canvas of `size`."""
        self.zoom = max(min(s / d for s, d in zip(size, display_size, strict=True)), 1e-6)
        self.center = (display_size[0] / 2, display_size[1] / 2)


FLIP_MAP = "flip error"
FLIP_SPEC = LayerSpec(
    FLIP_MAP, "FLIP error", "compare", "scalar", description="visible difference when A and B alternate, 0 to 1"
)


def flip_map(a: np.ndarray, b: np.ndarray, exposure: float) -> np.ndarray:
    """Return the map between linear colors `a` and `b` (H, W, 4): (H, W) float32 in 0 … 1."""
    return flip_error(*(to_display(color[..., :3], exposure) for color in (a, b)))


DIFFERENCES = ("absolute", "signed", "relative", "mean")  # "mean": over the channels of a color
COLOR = "color"
_VECTORS = ("motion", "place")  # a signed difference has a direction
_NAMED = ("label", "mask")  # values that are equal or not
_UNITS = {"depth": "world units", "world": "world units", "motion": "px", "place": "px"}

Side = tuple[LayerSpec, Display]


def compared_as(a: Side, b: Side) -> str:
    """Return the kind of values that are compared, one of VIEWS. Layers of different kinds have only their displayed
    colors in common."""
    kinds = {shown_as(*side)[0] for side in (a, b)}
    return kinds.pop() if len(kinds) == 1 else COLOR


def has_direction(kind: str, how: str) -> bool:
    """Return whether differences of this kind are shown as directions."""
    return how == "signed" and kind in _VECTORS


def full_scale(kind: str, how: str, gain: float, display: Display) -> float:
    """Return the difference with full color: of values, the range of A's `display` by `gain`."""
    if how == "relative" or kind in (COLOR, *_NAMED):
        return 1.0 / gain
    span = display.motion_scale if kind in _VECTORS else abs(display.high - display.low)
    return max(span / gain, 1e-12)


def unit_of(a: Side, b: Side, how: str = "absolute") -> str:
    """Return the unit of the differences."""
    if how == "relative":
        return "of the larger one"
    kind = compared_as(a, b)
    if kind == COLOR:
        return "of display values" if shown_as(*a)[0] == COLOR == shown_as(*b)[0] else "of displayed colors"
    return _UNITS.get(kind, _UNITS.get(a[0].view, ""))


def difference(kind: str, how: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (N, channels) of the difference between values (N, channels) of one kind, which are display values of a
    color; NaN where a value is missing."""
    if kind in _NAMED:
        return (a != b).any(-1, keepdims=True).astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        by = np.where(a == b, 0.0, a - b)
        if kind == COLOR:
            mean = by.mean(-1, keepdims=True)
            if how in ("absolute", "mean"):
                return np.abs(by) if how == "absolute" else np.abs(by).mean(-1, keepdims=True)
            if how == "signed":
                return mean
            larger = np.maximum(a.mean(-1, keepdims=True), b.mean(-1, keepdims=True))
            return _share(np.abs(by).mean(-1, keepdims=True), larger)
        if how == "signed" and kind != "world":
            return by
        length = np.linalg.norm(by, axis=-1, keepdims=True)
        if how != "relative":
            return length
        sizes = (np.linalg.norm(side, axis=-1, keepdims=True) for side in (a, b))
        return _share(length, np.maximum(*sizes))


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return part / whole; 0 of nothing, and 1 where both are infinite."""
    return np.where(part == 0, 0.0, np.where(np.isinf(part), 1.0, part / whole))
