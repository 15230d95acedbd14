"""View of a canvas: the layers it shows, and which part of them."""

from __future__ import annotations

from dataclasses import dataclass

from .displays import Display, Rgb

COMPARISONS = ("off", "split", "difference", "flip", "error")  # "flip": the caller shows b as a
OVERLAYS = ("none", "edges", "residual motion", "clipping")
CLIPPING: dict[str, Rgb] = {"below 0": (0.1, 0.35, 1.0), "above white": (1.0, 0.15, 0.1)}
ERRORS = ("absolute", "squared")

Size = tuple[int, int]


@dataclass
class View:
    """Layers and display settings of a canvas.

    Attributes
    ----------
    a, b : names of layers; one that is not uploaded shows the background
    compare : "off" and "flip" show a; "split" a left of `split` (fraction of the canvas' width) and b right of it;
        "difference" a − b, as `difference` of DIFFERENCES, times `gain`; "error" an error map, `error` of ERRORS up to
        `error_high`
    zoom : screen pixels per display pixel
    center : display pixel (x, y) in the middle of the canvas
    overlay : one of OVERLAYS, over whatever is compared; residual motion has full color at `residual_scale` pixels;
        clipping marks colors of a by CLIPPING, as they are exposed
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
    error: str = "absolute"
    error_high: float = 0.1
    residual_scale: float = 4.0
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
