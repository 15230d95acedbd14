"""What the viewer can show, and how it is displayed: layers, their display settings, ranges, legends and texts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from gffe_cl.camera import Camera
from gffe_cl.stage import RGBA, XY, BufferSpec, Sizes

VIEWS = ("color", "depth", "motion", "place", "world", "mask", "label", "scalar")
TONE_MAPS = ("sRGB", "Reinhard", "ACES", "linear")
COLOR_MAPS = ("turbo", "viridis", "grey", "heat")  # "heat" is for errors
FRAME_GROUP = "frame"

Rgb = tuple[float, float, float]

SKY: Rgb = (0.62, 0.78, 0.95)
MASK_OFF: Rgb = (0.09, 0.09, 0.10)
WHEEL_CENTRE = 0.08  # grey of a motion of no length
_LABEL_COLORS = (
    "29292e 3880de 29b880 f5db40 a043b8 85d1f5 9ee659 fab3c2 8c572e 006e73 7d851f bfbfc7 751442 ccb8ff fa7a10 e62442"
)
LABEL_COLORS: tuple[Rgb, ...] = tuple(  # of value & 15: 0 is the usual case; 14 and 15 are 254 and 255 of `filled_by`
    tuple(byte / 255 for byte in bytes.fromhex(text)) for text in _LABEL_COLORS.split()
)
_LIMITS = {"focus_mask": (0.0, 1.0)}  # by the buffer's name
_SAMPLES = 65536
_FEW = 8  # different values: a code, such as the input mask, whose rare values are as good as the others
_NATIVE = {"color": "RGB", "motion": "vector", "place": "vector", "world": "distance"}  # what is shown of all channels


@dataclass(frozen=True)
class LayerSpec:
    """One image that can be shown.

    `name` is "final", "rendered.color" … or "<stage>.<buffer>"; `group` heads it in lists. `view`, `components`,
    `planes`, `labels`, `grid` are those of `BufferSpec`. The positions of a "place" are `places_in` pixels of the
    "rendered" or the "target" image. `limits`: of a scalar's usual range; None: fitted to the picture.
    """

    name: str
    label: str
    group: str
    view: str
    components: tuple[str, ...] = ()
    planes: int = 1
    labels: tuple[tuple[int, str], ...] = ()
    description: str = ""
    grid: str = "target"
    places_in: str = "rendered"
    limits: tuple[float, float] | None = None

    @property
    def channels(self) -> tuple[str, ...]:
        """Choices of `Display.channel`, the usual one first."""
        native = _NATIVE.get(self.view)
        return (native, *self.components) if native else self.components or ("value",)


@dataclass
class Display:
    """How one layer is displayed.

    Attributes
    ----------
    exposure : stops on top of the sequence's exposure
    tone_map : one of TONE_MAPS; "linear" only clips
    channel : one of `LayerSpec.channels`; anything else counts as the first
    low, high : range of the colour map, in the layer's units (world units for depth, `inverse` or not)
    color_map : one of COLOR_MAPS
    inverse : spread the colour map evenly over 1/z
    motion_scale : length in pixels that has full colour
    reverse : show motion the other way round
    plane : which of several planes
    tint : colour of 1 in a mask
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
        """Plain values, as JSON has them."""
        return asdict(self) | {"tint": list(self.tint)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Display:
        """From `to_dict`; what is unknown or makes no sense is left at its default."""
        display = cls()
        for field in fields(cls):
            value = values.get(field.name) if isinstance(values, Mapping) else None
            if value is not None and _makes_sense(field.name, value, getattr(display, field.name)):
                setattr(display, field.name, tuple(value) if field.name == "tint" else type(field.default)(value))
        return display


def _makes_sense(name: str, value: Any, default: Any) -> bool:
    def number(x):
        return isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x)

    if name == "tint":
        return isinstance(value, (list, tuple)) and len(value) == 3 and all(map(number, value))
    if name == "plane":
        return number(value) and value >= 0
    if name == "motion_scale":
        return number(value) and value > 0
    if isinstance(default, float):
        return number(value)
    choices = {"tone_map": TONE_MAPS, "color_map": COLOR_MAPS}.get(name)
    return isinstance(value, type(default)) and (choices is None or value in choices)


@dataclass(frozen=True)
class FrameInfo:
    """What the layers of one slot refer to.

    Attributes
    ----------
    display_size : (width, height) of the image that is looked at; all layers are stretched over it
    render_size : of the rendered frame; None: as the display
    target_size : of the extrapolated frame; None: as the display
    exposure : of the sequence
    source, previous : render cameras of the rendered frame shown and of the one before it, where known
    source_area, target_area : the part (x0, y0, x1, y1) of the rendered and of the extrapolated image that covers the
        display, in fractions of their sides (see `area_of`)
    """

    display_size: tuple[int, int]
    render_size: tuple[int, int] | None = None
    target_size: tuple[int, int] | None = None
    exposure: float = 1.0
    source: Camera | None = None
    previous: Camera | None = None
    source_area: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    target_area: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    def area(self, spec: LayerSpec) -> tuple[float, float, float, float]:
        if spec.grid == "network":
            size = self.target_size or self.display_size
            padded = BufferSpec("", np.float32, (), "network", "").size(Sizes(size, size))
            x, y = (n / 2 / m for n, m in zip(size, padded, strict=True))
            left, top, right, bottom = self.target_area
            return left * x, top * y, right * x, bottom * y
        return self.source_area if spec.grid == "source" or spec.grid.startswith("level") else self.target_area

    def own_place(self, spec: LayerSpec) -> tuple[float, float, float, float]:
        """(scale x, scale y, offset x, offset y): a texel's own position in the image that its place lies in is
        scale · (position in fractions of the layer) + offset."""
        if spec.places_in != "target":
            return (*map(float, self.render_size or self.display_size), 0.0, 0.0)
        size = self.target_size or self.display_size
        layer, target = self.area(spec), self.target_area
        scale = [(target[i + 2] - target[i]) / (layer[i + 2] - layer[i]) for i in (0, 1)]
        offset = [target[i] - layer[i] * scale[i] for i in (0, 1)]
        return (scale[0] * size[0], scale[1] * size[1], offset[0] * size[0], offset[1] * size[1])


def area_of(image: Camera, image_size: tuple[int, int], seen: Camera, seen_size: tuple[int, int]) -> tuple[float, ...]:
    """The part of an image (camera `image`, `image_size` in pixels) that a camera of the same pose `seen` sees:
    (x0, y0, x1, y1) in fractions of the image's sides."""

    def at(x: float, y: float) -> tuple[float, float]:
        px = (x - seen.cx) / seen.fx * image.fx + image.cx
        py = (y - seen.cy) / seen.fy * image.fy + image.cy
        return px / image_size[0], py / image_size[1]

    return (*at(0, 0), *at(*seen_size))


FRAME_LAYERS: dict[str, LayerSpec] = {
    name: LayerSpec(name, label, FRAME_GROUP, view, components, description=description, grid=grid)
    for name, label, view, components, description, grid in (
        ("final", "Final", "color", RGBA, "what is shown at this time, linear RGB", "target"),
        ("rendered.color", "Rendered colour", "color", RGBA, "colour of the rendered frame, linear RGB", "source"),
        ("rendered.depth", "Rendered depth", "depth", (), "its view depth, world units, +inf sky", "source"),
        ("rendered.motion", "Rendered motion", "motion", XY, "its motion t → t−1, pixels", "source"),
        ("gae", "GAE", "color", RGBA, "the extrapolated frame before shading correction, linear RGB", "target"),
        ("truth", "Ground truth", "color", RGBA, "what a renderer makes at this time, linear RGB", "target"),
        ("focus_truth", "True focus mask", "mask", (), "static, and unlike the ground truth around", "target"),
    )
}


def layer_of(stage: str, spec: BufferSpec) -> LayerSpec:
    """The layer of a stage's buffer; `stage` is the stage's name."""
    return LayerSpec(
        name=f"{stage}.{spec.name}",
        label=spec.name.replace("_", " ").capitalize(),
        group=stage,
        view=spec.view if spec.view in VIEWS else "scalar",
        components=spec.components,
        planes=spec.planes,
        labels=spec.labels,
        description=spec.description,
        grid=spec.grid,
        places_in="target" if spec.name.startswith("target_") else "rendered",
        limits=_LIMITS.get(spec.name),
    )


def layers_of(pipeline) -> dict[str, LayerSpec]:
    """All layers by name: the frame's own ("gae" where it is not "final"), then those of every stage in the order of
    the pipeline, with what each stage leaves of the extrapolated frame."""
    found = {(owner.name, spec.name): spec for owner, spec in pipeline.named_buffers() if spec.grid != "once"}
    found |= {(stage, spec.name): spec for stage, spec in pipeline.outputs()}
    order = [FRAME_GROUP, *pipeline.stages]
    places = sorted(found, key=lambda name: order.index(name[0]) if name[0] in order else len(order))
    made = (layer_of(owner, found[owner, name]) for owner, name in places)
    frame = {name: spec for name, spec in FRAME_LAYERS.items() if name != "gae" or "correction" in pipeline.stages}
    return frame | {spec.name: spec for spec in made}


def label_flip(spec: LayerSpec) -> int:
    """XORed with the low bits of a label to choose its colour: of sets of bits (no names) the full one is usual."""
    return 0 if spec.labels else 15


def default_display(spec: LayerSpec) -> Display:
    display = Display(channel=spec.channels[0])
    if spec.view == "depth":
        display = replace(display, color_map="turbo", low=1.0, high=100.0)
    if spec.grid == "network":
        display = replace(display, color_map="grey")
    if spec.limits:
        display = replace(display, low=spec.limits[0], high=spec.limits[1])
    return display


def shown_as(spec: LayerSpec, display: Display) -> tuple[str, int]:
    """How the chosen channel is displayed: one of VIEWS, and the channel's index, −1 for all of them."""
    channel = display.channel if display.channel in spec.channels else spec.channels[0]
    if channel not in spec.components:
        return spec.view, -1 if channel == _NATIVE.get(spec.view) else 0
    index = spec.components.index(channel)
    if spec.view == "color":
        return ("color" if channel in ("R", "G", "B") else "scalar"), index
    if spec.view in ("motion", "place", "world"):
        return {"depth": "depth", "known": "mask"}.get(channel, "scalar"), index
    return spec.view, index


def fitted(spec: LayerSpec, image, display: Display, frame: FrameInfo | None = None, depth=None) -> Display:
    """`display` with the range that suits `image`: `low`, `high` hold 98% of the finite values (depths > 0), or zero
    and all of a scalar that has only a few; `motion_scale` 99% of the lengths. Colour, masks, labels stay as they are.

    `image`: (planes?, H, W, channels?). A "place" needs `frame` where its sizes differ; a "world" needs `depth` (H, W)
    of the rendered frame and `frame.source`, or it stays as it is.
    """
    view, channel = shown_as(spec, display)
    if view in ("color", "mask", "label") or not np.size(image):
        return display
    plane = image[min(display.plane, len(image) - 1)] if spec.planes > 1 else image
    height, width = plane.shape[:2]
    step = math.ceil(height * width / _SAMPLES)
    while math.gcd(step, width) > 1:  # or only some columns would be seen
        step += 1
    at = np.arange(0, height * width, step)
    values = plane.reshape(height * width, -1)[at].astype(np.float64)
    uv = np.stack([(at % width + 0.5) / width, (at // width + 0.5) / height], -1)
    with np.errstate(invalid="ignore", over="ignore"):
        if view == "world":
            if depth is None or frame is None or frame.source is None:
                return display
            return replace(_with_range(display, _distances(values, uv, depth, frame.source)), low=0.0)
        if view in ("motion", "place"):
            if view == "place":
                values = _displacements(values, uv, (frame or FrameInfo((width, height))).own_place(spec))
            lengths = np.hypot(values[:, 0], values[:, 1])
            scale = (
                np.quantile(lengths[np.isfinite(lengths)], 0.99) if np.isfinite(lengths).any() else display.motion_scale
            )
            return replace(display, motion_scale=max(float(scale), 0.01))
    values = values[:, max(channel, 0)]
    values = values[np.isfinite(values) & ((values > 0) | (view != "depth"))]
    codes = np.unique(values) if view == "scalar" else ()
    if 0 < len(codes) <= _FEW:
        low, high = min(float(codes[0]), 0.0), max(float(codes[-1]), 0.0)
        return replace(display, low=low, high=max(high, low + 1e-6))
    return _with_range(display, values, view == "depth")


def _distances(values: np.ndarray, uv: np.ndarray, depth: np.ndarray, camera: Camera) -> np.ndarray:
    """World units from positions (N, 4) in view space to what `depth` gives at their pixels, if known and different."""
    height, width = depth.shape
    z = depth[(uv[:, 1] * height).astype(int), (uv[:, 0] * width).astype(int)].astype(np.float64)
    rays = (uv * (width, height) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    distance = np.linalg.norm(values[:, :3] - np.insert(rays, 2, 1.0, axis=1) * z[:, None], axis=-1)
    return distance[(values[:, 3] != 0) & np.isfinite(distance) & (distance > 1e-4 * z)]


def _displacements(values: np.ndarray, uv: np.ndarray, own: tuple[float, ...]) -> np.ndarray:
    """(M, 2) pixels: of the places (N, 2 …) that there are from where they are stored; `own` as in `FrameInfo`."""
    there = values[:, 2] > 0 if values.shape[1] > 2 else (values != 0).any(-1)
    return (values[:, :2] - (uv * own[:2] + own[2:]))[there]


def _with_range(display: Display, values: np.ndarray, depth: bool = False) -> Display:
    if not values.size:
        return display
    least, low, high, most = np.quantile(values, (0, 0.01, 0.99, 1)).tolist()
    if high - low <= 1e-6 * (abs(low) + abs(high)):  # nearly all are one value: show the others, and zero
        low, high = (least, most) if depth else (min(least, 0.0), max(most, 0.0))
    return replace(display, low=low, high=max(high, low + max(abs(low) * 1e-3, 1e-6)))


def color_table(name: str) -> np.ndarray:
    """(256, 3) float32 in [0, 1], display values from low to high.

    "turbo": A. Mikhailov's, "viridis": S. van der Walt's and N. Smith's, both as polynomials.
    """
    t = np.linspace(0, 1, 256)[:, None]
    if name == "grey":
        rgb = np.repeat(t, 3, 1)
    elif name == "heat":
        rgb = 3 * t - (0, 1, 2)
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


def wheel_color(direction: float, length: float) -> Rgb:
    """Display colour of a motion: `direction` in turns from x (right) towards y (down), `length` in motion scales."""
    hue = [min(max(abs((direction * 6 + shift) % 6 - 3) - 1, 0), 1) for shift in (0, 4, 2)]
    share = math.sqrt(min(max(length, 0), 1))
    return tuple(WHEEL_CENTRE + (value - WHEEL_CENTRE) * share for value in hue)


@dataclass(frozen=True)
class Legend:
    """What a legend shows.

    `kind` is "none", "ramp" (`ticks` from 0, low, to 1, high, along `color_table(display.color_map)`) or "wheel"
    (`ticks` in turns, see `wheel_color`); each tick is (position, text, colour). `labels` are (text, colour) of single
    values, "ramp" or not. `unit` says what the numbers are.
    """

    kind: str
    ticks: tuple[tuple[float, str, Rgb], ...] = ()
    labels: tuple[tuple[str, Rgb], ...] = ()
    unit: str = ""


_DIRECTIONS = ("right", "right, down", "down", "left, down", "left", "left, up", "up", "right, up")


def legend(spec: LayerSpec, display: Display) -> Legend:
    """Of the channel that is shown; a ramp has five ticks."""
    view = shown_as(spec, display)[0]
    if view == "color":
        return Legend("none")
    if view == "mask":
        return Legend("none", labels=(("0", MASK_OFF), ("1", display.tint)))
    if view == "label":
        named = spec.labels or tuple((value, str(value)) for value in range(16))
        return Legend(
            "none", labels=tuple((text, LABEL_COLORS[value & 15 ^ label_flip(spec)]) for value, text in named)
        )
    if view in ("motion", "place"):
        wheel = ((turn / 8, text, wheel_color(turn / 8, 1)) for turn, text in enumerate(_DIRECTIONS))
        return Legend("wheel", tuple(wheel), unit=f"full colour from {display.motion_scale:.3g} px")
    colors, marks = color_table(display.color_map), []
    for position in (0.0, 0.25, 0.5, 0.75, 1.0):
        value = display.low + (display.high - display.low) * position
        if view == "depth" and display.inverse and min(display.low, display.high) > 0:
            value = 1 / (1 / display.low + (1 / display.high - 1 / display.low) * position)
        marks.append((position, f"{value:.4g}", tuple(colors[round(position * 255)].tolist())))
    special = (("sky", SKY),) if view == "depth" else ()
    pixels = spec.view in ("motion", "place") and view == "scalar"
    unit = "px" if pixels else "world units" if view in ("depth", "world") or spec.view == "world" else ""
    return Legend("ramp", tuple(marks), special, unit)


def value_text(spec: LayerSpec, values) -> str:
    """One line for the value (channels,) of one pixel of `spec`."""
    values = [float(value) for value in np.ravel(values)]
    if spec.view == "color":
        return "  ".join(f"{n} {_text(v)}" for n, v in zip(spec.components, values, strict=False) if n != "A")
    first = values[0]
    if spec.view == "label":
        return f"{first:g}: {dict(spec.labels)[first]}" if first in dict(spec.labels) else f"{first:g}"
    if spec.view == "mask":
        return "yes" if first else "no"
    if spec.view == "depth":
        return (
            "sky" if first == math.inf else f"{_text(first)} world units" if first > 0 else f"no depth ({_text(first)})"
        )
    if spec.view == "motion":
        return f"({first:+.2f}, {values[1]:+.2f}) px, {math.hypot(*values[:2]):.2f} px long"
    if spec.view == "place":
        if not (values[2] > 0 if len(values) > 2 else any(values)):
            return "nothing"
        depth = f", depth {'sky' if values[2] == math.inf else _text(values[2])}" if len(values) > 2 else ""
        return f"({first:.2f}, {values[1]:.2f}) px{depth}"
    if spec.view == "world":
        return f"({', '.join(map(_text, values[:3]))}) world units" if values[3:] != [0.0] else "not known"
    return "  ".join(map(_text, values))


def _text(value: float) -> str:
    return "NaN" if math.isnan(value) else f"{value:.4g}"
