"""Display of layers: false colors, settings, frame of reference, and ranges that fit the images."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection.layers import NATIVE, LayerSpec
from gffe_cl.engine.stages.buffers import Sizes, grid_of

# "heat" is for errors, "diverging" for signed differences: blue below the middle, which is dark, and red above it
COLOR_MAPS = ("turbo", "viridis", "gray", "heat", "diverging")

Rgb = tuple[float, float, float]

SKY: Rgb = (0.62, 0.78, 0.95)
MASK_OFF: Rgb = (0.09, 0.09, 0.10)
WHEEL_CENTER = 0.08  # gray of a motion of no length
_LABEL_COLORS = (
    "29292e 3880de 29b880 f5db40 a043b8 85d1f5 751442 fab3c2 8c572e 006e73 7d851f 00f0f0 9ee659 ccb8ff fa7a10 e62442"
)
LABEL_COLORS: tuple[Rgb, ...] = tuple(  # of value & 15: 0 is the usual case; 14 and 15 are 254 and 255 of `filled_by`
    (red / 255, green / 255, blue / 255) for red, green, blue in map(bytes.fromhex, _LABEL_COLORS.split())
)


def label_flip(spec: LayerSpec) -> int:
    """Return the number that is XORed with the low bits of a label to choose its color: of sets of bits (no names) the
    full one is usual."""
    return 0 if spec.labels else 15


def color_table(name: str) -> np.ndarray:
    """Return (256, 3) float32 in [0, 1]: display values from low to high.

    "turbo": A. Mikhailov's, "viridis": S. van der Walt's and N. Smith's, both as polynomials.
    """
    t = np.linspace(0, 1, 256)[:, None]
    if name == "gray":
        rgb = np.repeat(t, 3, 1)
    elif name == "heat":
        rgb = 3 * t - (0, 1, 2)
    elif name == "diverging":
        sign, size = np.sign(2 * t - 1), abs(2 * t - 1)
        rgb = np.where(sign > 0, 1.6 * size - (0, 0.6, 1.4), 1.6 * size - (1.4, 0.6, 0))
    else:
        rgb = np.polynomial.polynomial.polyval(t[:, 0], np.transpose(_POLYNOMIALS[name])).T
    return np.clip(rgb, 0, 1).astype(np.float32)


_POLYNOMIALS = {  # of R, G and B; coefficients, constant first
    "turbo": (
        (0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943),
        (0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604),
        (0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973),
    ),
    "viridis": (
        (0.27772733, 0.10509304, -0.33086183, -4.63423050, 6.22826994, 4.77638500, -5.43545586),
        (0.00540734, 1.40461353, 0.21484756, -5.79910097, 14.17993337, -13.74514538, 4.64585261),
        (0.33409981, 1.38459016, 0.09509516, -19.33244096, 56.69055260, -65.35303263, 26.31243525),
    ),
}


def wheel_color(direction: ArrayLike, length: ArrayLike) -> np.ndarray:
    """Return the display colors (…, 3) of motions: `direction` in turns from x (right) towards y (down), `length` in
    motion scales."""
    direction, length = (np.asarray(values, np.float64)[..., None] for values in (direction, length))
    hue = np.clip(abs((direction * 6 + (0, 4, 2)) % 6 - 3) - 1, 0, 1)
    return WHEEL_CENTER + (hue - WHEEL_CENTER) * np.sqrt(np.clip(length, 0, 1))


def ramp_color(display: Display, values: np.ndarray, view: str) -> np.ndarray:
    """Return the display colors (N, 3) of numbers (N,), which `view`, one of VIEWS, shows along a color map."""
    low, high = display.low, display.high
    if view == "depth" and display.inverse:
        values, low, high = 1 / np.maximum(values, 1e-30), 1 / max(low, 1e-6), 1 / max(high, 2e-6)
    at = np.clip((values - low) / (high - low if high != low else abs(low) * 1e-6 + 1e-12), 0, 1)
    return np.stack([np.interp(255 * at, np.arange(256), column) for column in color_table(display.color_map).T], -1)


TONE_MAPS = ("sRGB", "Reinhard", "ACES", "linear")

_SAMPLES = 65536
_FEW = 8  # different values: a code, such as the input mask, whose rare values are as good as the others
_NO_MOTION = 0.01  # pixels: a range that shows nothing

_NOT_LAID = ("tiles", "cut_samples", "levels")  # grids that are not laid over an image

Area = tuple[float, float, float, float]  # x0, y0, x1, y1


@dataclass
class Display:
    """Display settings of one layer.

    Attributes
    ----------
    exposure : stops on top of the sequence's exposure
    tone_map : one of TONE_MAPS; "linear" only clips
    channel : one of `LayerSpec.channels`; anything else counts as the first
    low, high : range of the color map, in the layer's units (world units for depth, `inverse` or not)
    color_map : one of COLOR_MAPS
    inverse : spread the color map evenly over 1/z
    motion_scale : length in pixels that has full color
    reverse : show motion the other way round
    plane : which of several planes
    tint : color of 1 in a mask
    """

    exposure: float = 0.0
    tone_map: str = "sRGB"
    channel: str = ""
    low: float = 0.0
    high: float = 1.0
    color_map: str = "viridis"
    inverse: bool = False
    motion_scale: float = 16.0
    reverse: bool = False
    plane: int = 0
    tint: Rgb = (0.95, 0.95, 0.95)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, as JSON has them."""
        return asdict(self) | {"tint": list(self.tint)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Display:
        """Return the display from `to_dict`; unknown or invalid values get their default."""
        display, choices = cls(), {"tone_map": TONE_MAPS, "color_map": COLOR_MAPS}
        for field in fields(cls):
            value, usual = values.get(field.name), field.default
            if field.name == "tint":
                sound = isinstance(value, list) and [is_sound(part, 0.0) for part in value] == [True] * 3
            else:
                sound = is_sound(value, usual, choices.get(field.name, ()), _LEAST.get(field.name, -math.inf))
            if sound:
                setattr(display, field.name, type(usual)(value))
        return display


_LEAST = {"plane": 0, "motion_scale": 1e-6}


def is_sound(value: Any, like: Any, choices: Sequence[Any] = (), least: float = -math.inf) -> bool:
    """Return whether a remembered value is of the kind of `like`, and one of `choices` if there are any; of a number,
    whether it is finite and at least `least`."""
    if isinstance(like, bool) or not isinstance(like, (int, float)):
        return isinstance(value, type(like)) and (not choices or value in choices)
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) and value >= least


@dataclass(frozen=True)
class FrameInfo:
    """Frame of reference of the layers of one slot.

    Attributes
    ----------
    display_size : (width, height) of the image that is looked at; all layers are stretched over it
    render_size : of the rendered frame; None: as the display
    exposure : of the sequence
    source : render camera of the rendered frame shown, where known
    source_area : the part (x0, y0, x1, y1) of the rendered image that covers the display, in fractions of its sides
        (see `area_of`)
    """

    display_size: tuple[int, int]
    render_size: tuple[int, int] | None = None
    exposure: float = 1.0
    source: Camera | None = None
    source_area: Area = (0.0, 0.0, 1.0, 1.0)

    def pixel_of(self, spec: LayerSpec, place: tuple[float, float]) -> tuple[int, int] | None:
        """Return the display pixel at `place`, in fractions of a layer's sides; None out of the display."""
        wide, high, left, top = self.placed(spec)
        x, y = math.floor(place[0] * wide + left), math.floor(place[1] * high + top)
        return (x, y) if 0 <= x < self.display_size[0] and 0 <= y < self.display_size[1] else None

    def area(self, spec: LayerSpec) -> tuple[float, float, float, float]:
        """Return the part of a layer that covers the display, in fractions of its sides. Where texels cover several
        pixels, the last ones may reach beyond the image."""
        area, image = (0.0, 0.0, 1.0, 1.0), self.display_size
        if grid_of(spec.grid).lies_on_source:
            area, image = self.source_area, self.render_size or self.display_size
        if grid_of(spec.grid).kind in _NOT_LAID:
            return area
        texels = Sizes(image, image).of(spec.grid)
        x, y = (n / (m * side) for n, m, side in zip(image, texels, grid_of(spec.grid).texel, strict=True))
        return area[0] * x, area[1] * y, area[2] * x, area[3] * y

    def placed(self, spec: LayerSpec) -> tuple[float, float, float, float]:
        """Return (scale x, scale y, offset x, offset y): a position in fractions of a layer's sides is seen at the
        display position scale · position + offset."""
        x0, y0, x1, y1 = self.area(spec)
        wide, high = self.display_size[0] / (x1 - x0), self.display_size[1] / (y1 - y0)
        return wide, high, -x0 * wide, -y0 * high

    def own_place(self, spec: LayerSpec) -> tuple[float, float, float, float]:
        """Return (scale x, scale y, offset x, offset y): a texel's own position in the image that its place lies in is
        scale · (position in fractions of the layer) + offset."""
        if spec.places_in == "target":
            return self.placed(spec)
        width, height = self.render_size or self.display_size
        return float(width), float(height), 0.0, 0.0


def area_of(image: Camera, image_size: tuple[int, int], seen: Camera, seen_size: tuple[int, int]) -> Area:
    """Return the part of an image (camera `image`, `image_size` in pixels) that a camera of the same pose `seen` sees:
    (x0, y0, x1, y1) in fractions of the image's sides."""

    def at(x: float, y: float) -> tuple[float, float]:
        px = (x - seen.cx) / seen.fx * image.fx + image.cx
        py = (y - seen.cy) / seen.fy * image.fy + image.cy
        return px / image_size[0], py / image_size[1]

    return (*at(0, 0), *at(*seen_size))


def default_display(spec: LayerSpec) -> Display:
    display = Display(channel=spec.channels[0])
    if spec.view == "depth":
        display = replace(display, color_map="turbo", low=1.0, high=100.0)
    if grid_of(spec.grid).kind == "network":
        display = replace(display, color_map="gray")
    if spec.limits:
        display = replace(display, low=spec.limits[0], high=spec.limits[1], motion_scale=spec.limits[1])
    return display


def shown_as(spec: LayerSpec, display: Display) -> tuple[str, int]:
    """Return the form in which the chosen channel is displayed, one of VIEWS, and the channel's index, −1 for all of
    them."""
    channel = display.channel if display.channel in spec.channels else spec.channels[0]
    if channel not in spec.components:
        return spec.view, -1 if channel == NATIVE.get(spec.view) else 0
    index = spec.components.index(channel)
    if spec.view == "color":
        return ("color" if channel in ("R", "G", "B") else "scalar"), index
    if spec.view in ("motion", "place", "world"):
        return {"depth": "depth", "known": "mask"}.get(channel, "scalar"), index
    return spec.view, index


def fitted(spec: LayerSpec, image, display: Display, frame: FrameInfo | None = None, depth=None) -> Display:
    """Return `display` with the range that suits `image`: `low`, `high` hold 98% of the finite values (depths > 0), or
    zero and all of a scalar that has only a few; `motion_scale` 99% of the lengths. Color, masks, labels stay as they
    are.

    `image`: (planes?, H, W, channels?). A "place" needs `frame` where its sizes differ; a "world" needs `depth` (H, W)
    of the rendered frame and `frame.source`, or it stays as it is.
    """
    view, _ = shown_as(spec, display)
    if view in ("color", "mask", "label"):
        return display
    values = shown_values(spec, image, display, frame, depth)
    if values is None:
        return display
    values = values[:, 0]
    if view == "world":
        return replace(_with_range(display, values), low=0.0)
    if view in ("motion", "place"):
        scale = float(np.quantile(values, 0.99)) if values.size else 0.0
        return replace(display, motion_scale=scale) if scale > _NO_MOTION else display
    codes = np.unique(values) if view == "scalar" else np.empty(0)
    if 0 < len(codes) <= _FEW:
        low, high = min(float(codes[0]), 0.0), max(float(codes[-1]), 0.0)
        return replace(display, low=low, high=max(high, low + 1e-6))
    return _with_range(display, values, view == "depth")


def shown_values(
    spec: LayerSpec, image, display: Display, frame: FrameInfo | None = None, depth=None, most: int = _SAMPLES
) -> np.ndarray | None:
    """Return the finite values that colors are made of, of about `most` pixels: (N, 3) of all channels of a color, else
    (N, 1): of one channel (depths > 0), or lengths. None if there are none: of masks and labels, of an empty image, and
    of a "world" without `depth` (H, W) of the rendered frame and `frame.source`."""
    view, channel = shown_as(spec, display)
    if view in ("mask", "label") or not np.size(image):
        return None
    plane = image[min(display.plane, len(image) - 1)] if spec.planes > 1 else image
    height, width = plane.shape[:2]
    step = math.ceil(height * width / most)
    while math.gcd(step, width) > 1:  # or only some columns would be seen
        step += 1
    at = np.arange(0, height * width, step)
    values = plane.reshape(height * width, -1)[at].astype(np.float64)
    uv = np.stack([(at % width + 0.5) / width, (at // width + 0.5) / height], -1)
    with np.errstate(invalid="ignore", over="ignore"):
        if view == "world":
            if depth is None or frame is None or frame.source is None:
                return None
            rows, columns = (uv[:, 1] * depth.shape[0]).astype(int), (uv[:, 0] * depth.shape[1]).astype(int)
            z = depth[rows, columns].astype(np.float64)
            by, known = off_fragments(values, uv, z, depth.shape[::-1], frame.source)
            values = np.linalg.norm(by, axis=-1)
            values = values[known & np.isfinite(values) & (values > 1e-4 * z)][:, None]
        elif view in ("motion", "place"):
            if view == "place":
                by, there = displaced(values, uv, (frame or FrameInfo((width, height))).own_place(spec))
                values = by[there]
            values = np.hypot(values[:, :1], values[:, 1:2])
        elif view == "color" and channel < 0:
            values = values[:, :3]
        else:
            values = values[:, [max(channel, 0)]]
    values = values[np.isfinite(values).all(-1)]
    return values[values[:, 0] > 0] if view == "depth" else values


def off_fragments(
    values: np.ndarray, uv: np.ndarray, z: np.ndarray, size: tuple[int, int], camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3), world units: positions (N, 4) in view space from the points at depth `z` (N,) of their pixels in
    an image of `size`; and (N,) bool, whether both are known."""
    rays = (uv * size - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return values[:, :3] - np.insert(rays, 2, 1.0, axis=1) * z[:, None], (values[:, 3] != 0) & np.isfinite(z)


def displaced(values: np.ndarray, uv: np.ndarray, own: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2), pixels: the displacements of places (N, 2 …) from where they are stored; and (N,) bool, whether
    there are any; `own` as in `FrameInfo`."""
    there = values[:, 2] > 0 if values.shape[1] > 2 else (values != 0).any(-1)
    return values[:, :2] - (uv * own[:2] + own[2:]), there


def _with_range(display: Display, values: np.ndarray, depth: bool = False) -> Display:
    if not values.size:
        return display
    least, low, high, most = np.quantile(values, (0, 0.01, 0.99, 1)).tolist()
    if high - low <= 1e-6 * (abs(low) + abs(high)):  # nearly all are one value: show the others, and zero
        low, high = (least, most) if depth else (min(least, 0.0), max(most, 0.0))
    return replace(display, low=low, high=max(high, low + max(abs(low) * 1e-3, 1e-6)))
