"""Encodings: exact frames as engines and captures keep them, by precision and by the conditions of games.

    encoding = Encoding.parse("half-uv,half-depth")
    stored = encoding.frame(frame, exposure)

Most parts are functions on finished frames, so one rendering serves all of them (`gffe render --encode`, `gffe import
--encode`). Those that need jittered samples (`is_rendered`) are made by `EncodedFrames` of the built-in scenes.

Post-processing of games, on exact frames: temporal antialiasing, a user interface. It is deterministic. Colors are
linear and scene-referred: (H, W, 3).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.transfer_function import linear_values, to_display

NEW_SHARE = 0.1  # of the current frame, in temporal antialiasing
_FILTER = 2.29  # weight of a sample: exp(−_FILTER · distance²), pixels
_LINE = 0.008  # of the image's height: a stroke of text
_REACH = 1  # pixels: of the neighborhood


class TemporalAntialiasing:
    """Temporal antialiasing as engines do it: jittered samples, one per pixel and frame, are blended into a history
    that follows the motion vectors and is clamped to the colors around each pixel.

    History is read by a bicubic filter (Catmull-Rom) along the vector of the nearest surface within a pixel. All colors
    are blended as c / (1 + max(exposure · c)).
    """

    def __init__(self, exposure: float = 1.0):
        self._exposure = exposure
        self._history: np.ndarray | None = None

    def resolve(self, sample: RenderedFrame, start: np.ndarray) -> np.ndarray:
        """Return the color of the next frame, (H, W, 3) float16. `sample`: its jittered samples, with depth and motion,
        motion without jitter, and `geometry_jitter`. After a reset the history begins with the color `start`, as if it
        had converged to that."""
        samples = self._compressed(sample.color)
        if sample.reset or self._history is None:
            history = self._compressed(start)
            known = np.ones(history.shape[:2], bool)
        else:
            history, known = bicubic(self._history, nearest_motion(sample.motion, sample.depth))
        around = neighborhood(samples)
        x, y = sample.geometry_jitter
        offsets = np.mgrid[-_REACH : _REACH + 1, -_REACH : _REACH + 1].reshape(2, -1).T
        weights = np.exp(-_FILTER * np.square(offsets - (y, x)).sum(-1)).astype(np.float32)
        current = np.tensordot(weights / weights.sum(), around, 1)
        clamped = np.clip(history, around.min(0), around.max(0))
        share = np.where(known, np.float32(NEW_SHARE), np.float32(1))[..., None]
        self._history = clamped + share * (current - clamped)
        return self._expanded(self._history).astype(np.float16)

    def _compressed(self, color: np.ndarray) -> np.ndarray:
        color = np.nan_to_num(color.astype(np.float32))
        return color / (1 + np.float32(self._exposure) * np.maximum(color.max(-1, keepdims=True), 0))

    def _expanded(self, color: np.ndarray) -> np.ndarray:
        most = np.float32(self._exposure) * np.maximum(color.max(-1, keepdims=True), 0)
        return np.clip(color / np.maximum(1 - most, np.float32(1e-4)), 0, 65504)


def neighborhood(image: np.ndarray) -> np.ndarray:
    """Return the nine images (9, H, W, …) of each pixel's neighbors, row by row; beyond the border its own pixels."""
    height, width = image.shape[:2]
    padded = np.pad(image, [(_REACH, _REACH), (_REACH, _REACH), *[(0, 0)] * (image.ndim - 2)], "edge")
    steps = range(2 * _REACH + 1)
    return np.stack([padded[y : y + height, x : x + width] for y in steps for x in steps])


def nearest_motion(motion: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return dilated motion (H, W, 2): that of the nearest of the 3×3 pixels around, by `depth` (H, W); the pixel's own
    where no other is nearer. NaN and depth ≤ 0 are the farthest."""
    depths = neighborhood(np.where(depth > 0, depth, np.inf))
    own = len(depths) // 2
    best = depths.argmin(0)
    best = np.where(np.take_along_axis(depths, best[None], 0)[0] < depths[own], best, own)
    return np.take_along_axis(neighborhood(motion), best[None, ..., None], 0)[0]


def bicubic(image: np.ndarray, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return `image` (H, W, C) float32 at each pixel's center + `motion` (H, W, 2), by Catmull-Rom's filter, and a mask
    (H, W) of pixels whose place is known and inside."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    place = np.stack([x, y], -1) + motion
    with np.errstate(invalid="ignore"):
        inside = (place >= -0.5) & (place < np.array((width - 0.5, height - 0.5)))
    known = np.logical_and(inside[..., 0], inside[..., 1])
    place = np.where(known[..., None], place, 0).astype(np.float32)
    low = np.floor(place)
    weights = _catmull_rom(place - low)
    low, total = low.astype(int), np.zeros_like(image)
    for row in range(4):
        at_y = np.clip(low[..., 1] + row - 1, 0, height - 1)
        for column in range(4):
            at_x = np.clip(low[..., 0] + column - 1, 0, width - 1)
            total += (weights[row][..., 1] * weights[column][..., 0])[..., None] * image[at_y, at_x]
    return total, known


def _catmull_rom(part: np.ndarray) -> tuple[np.ndarray, ...]:
    a, b, c = part, part * part, part * part * part
    return (-0.5 * a + b - 0.5 * c, 1 - 2.5 * b + 1.5 * c, 0.5 * a + 2 * b - 1.5 * c, -0.5 * b + 0.5 * c)


def with_ui(color: np.ndarray, ui: np.ndarray) -> np.ndarray:
    """Return `color` under the layer `ui` (H, W, 4), premultiplied, float16."""
    shown = ui[..., 3] > 0
    made = np.array(color[..., :3], np.float16)
    layer = ui[shown].astype(np.float32)
    made[shown] = layer[:, :3] + (1 - layer[:, 3:]) * color[..., :3][shown].astype(np.float32)
    return made


@lru_cache(maxsize=4)
def user_interface(width: int, height: int, exposure: float = 1.0) -> np.ndarray:
    """Return the user interface of an imaginary game, (H, W, 4) float16 as for `Overlays.ui`: an opaque panel with
    bars, half-transparent ones with marks, text on the picture, a crosshair. The same size has the same one.
    Read-only."""
    layer = np.zeros((height, width, 4), np.float32)
    canvas = _Canvas(layer, exposure)
    unit = height  # lengths are parts of the height
    right = width / unit
    # Bottom left: opaque, with two bars and a name.
    canvas.rectangle(0.03, 0.86, 0.37, 0.97, (0.10, 0.11, 0.13))
    for y, length, hue in ((0.885, 0.27, (0.80, 0.16, 0.14)), (0.915, 0.19, (0.20, 0.52, 0.86))):
        canvas.rectangle(0.045, y, 0.355, y + 0.018, (0.22, 0.23, 0.25))
        canvas.rectangle(0.045, y, 0.045 + length, y + 0.018, hue)
    canvas.text(0.045, 0.942, 14, (0.92, 0.92, 0.88))
    # Top right: a map under half-transparent glass.
    canvas.rectangle(right - 0.28, 0.03, right - 0.03, 0.25, (0.05, 0.08, 0.12), 0.5)
    for x, y in ((0.24, 0.07), (0.17, 0.14), (0.09, 0.10), (0.12, 0.20), (0.21, 0.18)):
        canvas.rectangle(right - x, y, right - x + 0.016, y + 0.016, (0.95, 0.78, 0.20))
    # Top: a compass.
    canvas.rectangle(right / 2 - 0.25, 0.03, right / 2 + 0.25, 0.065, (0.02, 0.02, 0.02), 0.4)
    for k in range(-6, 7):
        x = right / 2 + 0.036 * k
        canvas.rectangle(x, 0.035 if k % 3 else 0.032, x + 0.003, 0.05 if k % 3 else 0.06, (0.95, 0.95, 0.95))
    # Text directly on the picture: tasks at the left, ammunition at the bottom right.
    for line, letters in enumerate((18, 13, 21)):
        canvas.text(0.03, 0.10 + 0.035 * line, letters, (0.96, 0.93, 0.80))
    canvas.text(right - 0.2, 0.93, 6, (1.0, 1.0, 1.0), scale=2)
    # Crosshair.
    for x, y in ((-0.03, 0), (0.01, 0), (0, -0.03), (0, 0.01)):
        left, top, (w, h) = right / 2 + x, 0.5 + y, (0.02, 0.004) if x else (0.004, 0.02)
        canvas.rectangle(left, top, left + w, top + h, (0.85, 1.0, 0.85), 0.9)
    made = layer.astype(np.float16)
    made.flags.writeable = False
    return made


class _Canvas:
    """Draws into `layer` (H, W, 4), premultiplied; places are in parts of the image's height, colors display values."""

    def __init__(self, layer: np.ndarray, exposure: float):
        self._layer, self._exposure = layer, exposure

    def rectangle(self, x0: float, y0: float, x1: float, y1: float, color, alpha: float = 1.0) -> None:
        """Draw a rectangle; pixels at its border get the share that it covers."""
        height, width = self._layer.shape[:2]
        spans = []
        for n, low, high in ((height, y0 * height, y1 * height), (width, x0 * height, x1 * height)):
            first, last = (int(np.clip(edge, 0, n)) for edge in (np.floor(low), np.ceil(high)))
            at = np.arange(first, last)
            spans.append((slice(first, last), np.clip(np.minimum(at + 1, high) - np.maximum(at, low), 0, 1)))
        (rows, cover_y), (columns, cover_x) = spans
        cover = (alpha * cover_y[:, None] * cover_x).astype(np.float32)[..., None]
        linear = linear_values(np.array(color, np.float32), self._exposure)
        part = self._layer[rows, columns]
        part *= 1 - cover
        part += cover * np.append(linear, np.float32(1))

    def text(self, x: float, y: float, letters: int, color, scale: float = 1.0) -> None:
        """Draw a line of letters, each of random strokes on a grid of 3×5; the same place has the same ones."""
        rng = np.random.default_rng((round(1000 * y), letters))
        stroke = _LINE * scale / 2
        for letter in range(letters):
            if rng.random() < 0.15:  # a space
                continue
            left = x + 4 * stroke * letter
            for row, column in np.argwhere(rng.random((5, 3)) < 0.6):
                x0, y0 = left + stroke * column, y + stroke * row
                self.rectangle(x0, y0, x0 + stroke, y0 + stroke, color)


_CODE_SIZE = np.array((1920.0, 1080.0))  # pixels, of the image in whose sides motion is stored
PLANES = 0.01, 1e5  # world units, of logarithmic depth
_SHORT_RANGE = 1 / 16  # of the image: the longest motion in 8 bits

Code = Callable[[np.ndarray], np.ndarray]


def _half(uv: np.ndarray) -> np.ndarray:
    return 2 * (0.5 * uv + 0.5).astype(np.float16).astype(np.float64) - 1


def _unorm8(uv: np.ndarray) -> np.ndarray:
    return (2 * np.round(np.clip(0.5 * uv / _SHORT_RANGE + 0.5, 0, 1) * 255) / 255 - 1) * _SHORT_RANGE


# Of motion in units of the image's sides, by name.
MOTION_CODES: dict[str, tuple[str, Code]] = {
    "half-uv": ("motion as half floats of 0.5 · uv + 0.5", _half),
    "unorm8": ("motion in 8 bits, at most 1/16 of the image", _unorm8),
    "half-motion": ("motion as half floats of uv", lambda uv: uv.astype(np.float16).astype(np.float64)),
}
HALF_DEPTH, LOG_DEPTH, COLOR_8BIT = "half-depth", "log-depth", "8bit-color"
TAA, JITTERED, HALF, DILATED, HUD = "taa", "jittered", "half", "dilated", "hud"
PARTS: dict[str, str] = {name: sentence for name, (sentence, _) in MOTION_CODES.items()} | {
    HALF_DEPTH: "depth as half floats",
    LOG_DEPTH: "depth as its logarithm, 0 to 1 between the planes {:g} and {:g}".format(*PLANES),
    COLOR_8BIT: "display values of 8 bits",
    TAA: "color by temporal antialiasing of jittered samples, one per pixel",
    JITTERED: "depth and motion jittered by parts of a pixel, color not",
    HALF: "depth and motion at half the resolution, each way, and jittered",
    DILATED: "motion is that of the nearest surface within a pixel",
    HUD: "a user interface in the color",
}
PRESETS = {
    "exact": (),
    "engine": ("half-uv", HALF_DEPTH, COLOR_8BIT),
    "game": (TAA, HALF, DILATED, "half-motion", HALF_DEPTH, HUD),
}
_RENDERED, _ON_DISPLAY = {TAA, JITTERED, HALF}, {TAA, JITTERED, HALF, HUD}


@dataclass(frozen=True)
class Encoding:
    """Encoding of a frame's buffers. `parts`: names of PARTS."""

    parts: frozenset[str] = frozenset()

    @classmethod
    def parse(cls, text: str) -> Encoding:
        """Return the encoding of a text PART[,PART…]; the names of PRESETS stand for several parts. Raises
        GffeError."""
        parts: set[str] = set()
        for name in text.split(","):
            if name not in PARTS and name not in PRESETS:
                expected = ", ".join((*PRESETS, *PARTS))
                raise GffeError(f"--encode: unknown encoding '{name}' (expected some of {expected})")
            parts |= set(PRESETS.get(name, (name,)))
        if len(parts & set(MOTION_CODES)) > 1:
            codes = ", ".join(MOTION_CODES)
            raise GffeError(f"--encode: '{text}' stores motion in several ways (expected one of {codes})")
        return cls(frozenset(parts))

    @property
    def is_rendered(self) -> bool:
        """Whether frames need jittered samples, which only a renderer has."""
        return bool(self.parts & _RENDERED)

    @property
    def is_on_display(self) -> bool:
        """Whether rendered images must be the displayed ones: neither windows nor other sizes."""
        return bool(self.parts & _ON_DISPLAY)

    @property
    def format(self) -> FrameFormat | None:
        """Description of the frames, None where our conventions hold."""
        changed: dict[str, Any] = {"motion_dilated": True} if DILATED in self.parts else {}
        if LOG_DEPTH in self.parts:
            changed |= {"depth": "logarithmic", "near_z": PLANES[0], "far_z": PLANES[1]}
        return FrameFormat(**changed) if changed else None

    def motion(self, motion: np.ndarray) -> np.ndarray:
        """Return motion (H, W, 2) float32, pixels, after being stored. NaN stays NaN."""
        code = next((MOTION_CODES[name][1] for name in self.parts if name in MOTION_CODES), None)
        if code is None:
            return motion
        with np.errstate(over="ignore"):
            return (code(motion / _CODE_SIZE) * _CODE_SIZE).astype(np.float32)

    def frame(self, frame: RenderedFrame, exposure: float = 1.0) -> RenderedFrame:
        """Return `frame`, of host arrays, after being stored. Where `is_rendered`, it must be antialiased and jittered
        already."""
        motion = frame.motion
        if motion is not None:
            motion = self.motion(np.asarray(motion))
            if DILATED in self.parts:
                motion = nearest_motion(motion, np.asarray(frame.depth))
        depth = np.asarray(frame.depth)
        if LOG_DEPTH in self.parts:
            near, far = PLANES
            with np.errstate(invalid="ignore"):  # sky is at the far plane
                depth = (np.log(np.minimum(depth, far) / near) / np.log(far / near)).astype(np.float32)
        if HALF_DEPTH in self.parts:
            with np.errstate(over="ignore"):
                depth = depth.astype(np.float16).astype(np.float32)
        return replace(frame, color=self.color(self.truth(frame.color, exposure), exposure), depth=depth, motion=motion)

    def truth(self, color: np.ndarray, exposure: float = 1.0) -> np.ndarray:
        """Return linear color (H, W, 3) of ground truth: with the user interface, if there is one."""
        ui = self.user_interface((color.shape[1], color.shape[0]), exposure)
        return color if ui is None else with_ui(color, ui)

    def user_interface(self, size: tuple[int, int], exposure: float = 1.0) -> np.ndarray | None:
        """Return the user interface over images of `size` (width, height): (H, W, 4), as for `Overlays.ui`; None if
        there is none."""
        return user_interface(*size, exposure) if HUD in self.parts else None

    def color(self, color: np.ndarray, exposure: float = 1.0) -> np.ndarray:
        """Return linear color (H, W, 3) after being stored."""
        if COLOR_8BIT not in self.parts:
            return color
        return linear_values(np.round(to_display(color, exposure) * 255) / 255, exposure).astype(np.float16)


EXACT = Encoding()
