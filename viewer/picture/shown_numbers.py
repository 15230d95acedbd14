"""Numbers that the picture shows: the values of A or of B, or those of a comparison of both, by texel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.lab.metrics import to_display
from .current_frame import Contents
from .displays import Display, FrameInfo, displaced, off_fragments, shown_as
from .view import FLIP_MAP, FLIP_SPEC, View, difference, error


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

    def beside(self, other: Texels, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns of this layer's texels where the centers of `other`'s are displayed."""
        place = [
            (start + (at + 0.5) * scale - own_start) / own_scale
            for at, start, scale, own_start, own_scale in zip(
                (columns, rows), other.start, other.scale, self.start, self.scale, strict=True
            )
        ]
        x, y = (
            np.clip(np.floor(at).astype(int), 0, size - 1)
            for at, size in zip(place, self.image.shape[1::-1], strict=True)
        )
        return y, x

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
        height, width = self.image.shape[:2]
        uv = np.stack([(columns + 0.5) / width, (rows + 0.5) / height], -1)
        if view == "place":
            by, there = displaced(values, uv, self.frame.own_place(self.spec))
        elif self.depth is None or self.frame.source is None:
            return np.full((len(values), 3), np.nan)
        else:
            z = self.depth[rows, columns].astype(np.float64)
            by, there = off_fragments(values, uv, z, (width, height), self.frame.source)
        return np.where(there[:, None], by, np.nan)

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
    if view.compare not in ("difference", "error"):
        return [] if a is None else [Numbers(a, a.values)]
    if a is None or b is None:
        return []
    kinds = {shown_as(side.spec, side.display)[0] for side in (a, b)}
    if len(kinds) > 1:
        return []
    kind, first, second = kinds.pop(), a, b

    def compared(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        values = first.compared(rows, columns), second.compared(*second.beside(first, rows, columns))
        if view.compare == "error":
            return error(kind, view.error == "squared", *values)
        return difference(kind, view.difference, *values)

    return [Numbers(first, compared)]


def largest(view: View, contents: Contents, flip: np.ndarray | None) -> tuple[tuple[int, int], float] | None:
    """Return the display pixel with the largest difference or error that a view shows, and that number; None where
    there is none. Arguments as of `numbers_of`."""
    if view.compare not in ("difference", "error") and view.a != FLIP_MAP:
        return None
    for shown in numbers_of(view, contents, flip):
        height, width = shown.grid.image.shape[:2]
        rows, columns = np.divmod(np.arange(height * width), width)
        errors = np.nan_to_num(np.abs(shown.of(rows, columns)).max(-1), nan=-1.0)
        at = int(errors.argmax())
        if errors[at] > 0:
            place = (columns[at] + 0.5) / width, (rows[at] + 0.5) / height
            pixel = shown.grid.frame.pixel_of(shown.grid.spec, place)
            return None if pixel is None else (pixel, float(errors[at]))
    return None


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
