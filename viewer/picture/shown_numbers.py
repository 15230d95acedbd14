"""Numbers that the picture shows: the values of A or of B, or those of a comparison of both, by texel; and their
colors, as display.frag has them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.lab.metrics import to_display
from .current_frame import Contents
from .displays import (
    LABEL_COLORS,
    MASK_OFF,
    SKY,
    Display,
    FrameInfo,
    Rgb,
    displaced,
    label_flip,
    off_fragments,
    ramp_color,
    shown_as,
    wheel_color,
)
from .view import FLIP_MAP, FLIP_SPEC, View, difference


@dataclass(frozen=True)
class Texels:
    """A layer as it is displayed: `image` (H, W, channels) is its chosen plane; `depth`: of the rendered frame."""

    spec: LayerSpec
    display: Display
    image: np.ndarray
    frame: FrameInfo
    depth: np.ndarray | None = None

    @property
    def scale(self) -> tuple[float, float]:
        """Display pixels per texel."""
        wide, high, *_ = self.frame.placed(self.spec)
        return wide / self.image.shape[1], high / self.image.shape[0]

    @property
    def start(self) -> tuple[float, float]:
        """Position on the display where the first texel begins."""
        _, _, x, y = self.frame.placed(self.spec)
        return x, y

    def values(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (N, channels) of these texels: the chosen channel, or all of them."""
        values = self.image[rows, columns]
        if self.display.channel in self.spec.components:
            index = self.spec.components.index(self.display.channel)
            values = values[:, index : index + 1]
        return values

    def at(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return rows and columns of the texels at these display positions, the nearest ones outside of the layer; and
        whether the layer covers them."""
        place = [
            (at - start) / scale for at, start, scale in zip((y, x), self.start[::-1], self.scale[::-1], strict=True)
        ]
        size = self.image.shape[:2]
        covers = np.logical_and.reduce([(at >= 0) & (at < most) for at, most in zip(place, size, strict=True)])
        rows, columns = (np.clip(at.astype(int), 0, most - 1) for at, most in zip(place, size, strict=True))
        return rows, columns, covers

    def beside(self, other: Texels, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns of this layer's texels where the centers of `other`'s are displayed."""
        (x, y), (wide, high) = other.start, other.scale
        return self.at(x + (columns + 0.5) * wide, y + (rows + 0.5) * high)[:2]

    def compared(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (N, channels) of these texels as they are compared: display values of a color, vectors, or the chosen
        channel; NaN where there is nothing."""
        view, channel = shown_as(self.spec, self.display)
        values = self.image[rows, columns].astype(np.float64)
        if view == "color":
            return self._display_values(values, channel)
        if view == "motion":
            return values[:, :2]
        if view not in ("place", "world"):
            return values[:, [max(channel, 0)]]
        by, there = self._vectors(view, values, rows, columns)
        return np.where(there[:, None], by, np.nan)

    def _vectors(
        self, view: str, values: np.ndarray, rows: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (N, channels) of the vectors to places or positions, and (N,) bool, whether there are any."""
        height, width = self.image.shape[:2]
        uv = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], -1)
        if view == "place":
            return displaced(values, uv, self.frame.own_place(self.spec))
        if self.depth is None or self.frame.source is None:
            return np.zeros((len(values), 3)), np.zeros(len(values), bool)
        z = self.depth[rows, columns].astype(np.float64)
        return off_fragments(values, uv, z, (width, height), self.frame.source)

    def on_display(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `at` of the centers of all display pixels, row by row."""
        width, height = self.frame.display_size
        y, x = np.divmod(np.arange(width * height), width)
        return self.at(x + 0.5, y + 0.5)

    def picture(self, background: Rgb) -> np.ndarray:
        """Return (H, W, 3) uint8: the display, pixel by pixel. Where nothing is known it is hatched, and where numbers
        are invalid checkered."""
        rows, columns, covers = self.on_display()
        width, height = self.frame.display_size
        y, x = np.divmod(np.arange(width * height), width)
        colors, there, sound = self._colors(rows, columns)
        checker = np.where((((x // 4) + (y // 4)) & 1)[:, None], 0.05, (1.0, 0.0, 1.0))
        hatch = np.where((x + y) & 7 < 2, 0.30, 0.12)[:, None]
        colors = np.where(sound[:, None], colors, checker)
        colors = np.where(covers[:, None], np.where(there[:, None], colors, hatch), background)
        return np.rint(255 * colors).astype(np.uint8).reshape(height, width, 3)

    def _colors(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (N, 3) display values of these texels, and (N,) bool: whether there is a value, and a valid one."""
        display, (view, channel) = self.display, shown_as(self.spec, self.display)
        values = self.image[rows, columns].astype(np.float64)
        there = sound = np.ones(len(values), bool)
        if view == "color":
            if self.spec.components[3:] == ("weight",):
                there = np.asarray(values[:, 3] != 0)
            sound = np.isfinite(values[:, [channel]] if channel >= 0 else values[:, :3]).min(-1)
            return self._display_values(values, channel), there, sound
        if view in ("place", "world"):
            values, there = self._vectors(view, values, rows, columns)
        value = values[:, max(channel, 0)]
        if view == "label":
            return np.array(LABEL_COLORS)[(value.astype(int) & 15) ^ label_flip(self.spec)], there, sound
        if view == "mask":
            return np.where(value[:, None] != 0, display.tint, MASK_OFF), there, sound
        sky = (value == np.inf) & (view == "depth")
        if view == "depth":
            there = ~(value <= 0)
        shown = values[:, : 3 if view == "world" else 2] if view in ("motion", "place", "world") else value[:, None]
        sound = np.isfinite(shown).min(-1) | sky
        shown = np.where(sound[:, None] & ~sky[:, None], shown, 1.0)
        if view in ("motion", "place"):
            turns = np.arctan2(shown[:, 1], shown[:, 0]) / (2 * np.pi) + (0.5 if display.reverse else 0.0)
            return wheel_color(turns, np.hypot(*shown.T) / max(display.motion_scale, 1e-6)), there, sound
        colors = ramp_color(display, np.linalg.norm(shown, axis=-1) if view == "world" else shown[:, 0], view)
        return np.where(sky[:, None], SKY, colors), there, sound

    def _display_values(self, values: np.ndarray, channel: int) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.spec.components[3:] == ("weight",):
                values = values / values[:, 3:4]
            color = np.repeat(values[:, [channel]], 3, 1) if channel >= 0 else values[:, :3]
            c = np.maximum(color, 0) * 2.0**self.display.exposure * self.frame.exposure
            if self.display.tone_map == "Reinhard":
                c = c / (1 + c)
            elif self.display.tone_map == "ACES":  # K. Narkowicz's fit
                c = (c * (2.51 * c + 0.03)) / (c * (2.43 * c + 0.59) + 0.14)
        return np.minimum(c, 1) if self.display.tone_map == "linear" else to_display(c)


@dataclass(frozen=True)
class Numbers:
    """Numbers `of` rows and columns of the texels of `grid`, (N, channels), in a `part` of the picture: from where to
    where, in fractions of its width."""

    grid: Texels
    of: Callable[[np.ndarray, np.ndarray], np.ndarray]
    part: tuple[float, float] = (0.0, 1.0)


def numbers_of(view: View, contents: Contents, flip: np.ndarray | None) -> list[Numbers]:
    """Return the numbers of a view as it is drawn (`Comparison.shown`); `flip`: the FLIP error map. Layers of different
    kinds have no difference in numbers."""
    a = texels(view.a, view.a_display, contents, flip)
    b = texels(view.b, view.b_display, contents, flip)
    if view.compare == "split":
        sides = ((a, (0.0, view.split)), (b, (view.split, 1.0)))
        return [Numbers(side, side.values, part) for side, part in sides if side is not None]
    if view.compare != "difference":
        return [] if a is None else [Numbers(a, a.values)]
    if a is None or b is None:
        return []
    kinds = {shown_as(side.spec, side.display)[0] for side in (a, b)}
    if len(kinds) > 1:
        return []
    kind, first, second = kinds.pop(), a, b

    def compared(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        values = first.compared(rows, columns), second.compared(*second.beside(first, rows, columns))
        return difference(kind, view.difference, *values)

    return [Numbers(first, compared)]


def largest(view: View, contents: Contents, flip: np.ndarray | None) -> tuple[tuple[int, int], float] | None:
    """Return the display pixel with the largest difference or FLIP error that a view shows, and that number; None where
    there is none. Infinite ones, of sky and a surface, count where there are no others. Arguments as of
    `numbers_of`."""
    if view.compare != "difference" and view.a != FLIP_MAP:
        return None
    for shown in numbers_of(view, contents, flip):
        height, width = shown.grid.image.shape[:2]
        rows, columns = np.divmod(np.arange(height * width), width)
        errors = np.nan_to_num(np.abs(shown.of(rows, columns)).max(-1), nan=-1.0, posinf=np.inf)
        finite = np.where(np.isinf(errors), -1.0, errors)
        at = int((finite if finite.max() > 0 else errors).argmax())
        if errors[at] > 0:
            place = (columns[at] + 0.5) / width, (rows[at] + 0.5) / height
            pixel = shown.grid.frame.pixel_of(shown.grid.spec, place)
            return None if pixel is None else (pixel, float(errors[at]))
    return None


Rectangle = tuple[int, int, int, int]  # x0, y0, x1, y1 on the display, pixels; x1 and y1 are outside
STATISTICS = ("min", "max", "mean", "median")


def sides_of(view: View, contents: Contents) -> list[tuple[str, Texels]]:
    """Return the layers A and, where it is compared, B, by these letters; those that are there."""
    found = [("B" if names.is_second(view.a) else "A", texels(view.a, view.a_display, contents))]
    found += [("B", texels(view.b, view.b_display, contents))] if view.compare != "off" else []
    return [(letter, side) for letter, side in found if side is not None]


def values_in(sides: list[tuple[str, Texels]], rectangle: Rectangle) -> dict[str, np.ndarray]:
    """Return (N, channels) float64, in the layers' own units: the values of texels whose centers lie in a rectangle of
    the display, at least of one texel: of A's, of B's at these places, and A − B of numbers of one kind."""
    made = {}
    for letter, side in sides:
        x, y = (
            np.arange(*_between(first, last, start, scale, count))
            for first, last, start, scale, count in zip(
                rectangle[:2], rectangle[2:], side.start, side.scale, side.image.shape[1::-1], strict=True
            )
        )
        rows, columns = (at.ravel() for at in np.meshgrid(y, x, indexing="ij"))
        made[letter] = side.image[rows, columns, : 3 if side.spec.view == "color" else None].astype(np.float64)
    if len(made) < 2:
        return made
    (_, a), (_, b) = sides
    alike = a.spec.view == b.spec.view not in ("label", "mask") and a.image.shape == b.image.shape
    if not alike or made["A"].shape != made["B"].shape:
        return made
    with np.errstate(invalid="ignore"):
        return made | {"A − B": np.where(made["A"] == made["B"], 0, made["A"] - made["B"])}


def _between(first: float, last: float, start: float, scale: float, count: int) -> tuple[int, int]:
    """Return the first texel, and the one after the last, whose centers lie between two positions on the display, else
    that in their middle."""
    low, high = (min(max(math.ceil((at - start) / scale - 0.5), 0), count) for at in (first, last))
    middle = min(max(math.floor(((first + last) / 2 - start) / scale), 0), count - 1)
    return (low, high) if low < high else (middle, middle + 1)


def statistics(sides: list[tuple[str, Texels]], rectangle: Rectangle) -> list[tuple[str, list[float], float]]:
    """Return a name ("A R"), the `STATISTICS` of the finite values and their share, for each channel of `values_in`."""
    made, names_of = [], sides[0][1].spec.components if sides else ()
    for letter, values in values_in(sides, rectangle).items():
        for index, channel in enumerate(values.T):
            known = channel[np.isfinite(channel)]
            found = [float(of(known)) for of in (np.min, np.max, np.mean, np.median)] if known.size else []
            name = names_of[index] if len(names_of) > index else ""
            made.append((f"{letter} {name}".strip(), found, known.size / channel.size))
    return made


def texels(
    name: str | None, display: Display | None, contents: Contents, flip: np.ndarray | None = None
) -> Texels | None:
    """Return a layer as it is displayed; None if there is none."""
    spec, image = contents.spec(name), contents.image(name)
    if name == FLIP_MAP:
        spec, image = FLIP_SPEC, flip
    if spec is None or image is None or display is None or not image.size:
        return None
    plane = image[min(display.plane, spec.planes - 1)] if spec.planes > 1 else image
    second = names.is_second(name)
    frame = contents.frame_info(contents.second if second else None)
    depth = contents.image(names.of_second(names.RENDERED_DEPTH) if second else names.RENDERED_DEPTH)
    return Texels(spec, display, plane.reshape(*plane.shape[:2], -1), frame, depth)
