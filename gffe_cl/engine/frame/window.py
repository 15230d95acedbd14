"""Adaptive rendering window (paper: 'Adaptive rendering window' and its appendix).

A renderer that draws a little more than it displays has the pixels that turn into view until its next frame. Before
rendering frame t an engine does this:

    predicted = [predict_camera(previous, current, alpha) for alpha in (0.25, 0.5, 0.75)]
    window = adaptive_window(current, predicted, size=(1920, 1080), distance=2.0)
    camera = window.camera(current, (1920, 1080))            # an off-center pinhole: render through it,
    matrix = camera.projection_matrix("vulkan", 1920, 1080, near=0.1)  # at the same resolution
    frame = RenderedFrame(color, depth, motion, camera, time, display_camera=current)
    shown = present(frame)                                   # the displayed part

A window is given in the coordinates of the displayed image, which is (−1, −1, 1, 1); u to the right, v down.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    require_array,
    require_kind,
    require_list,
    require_positive,
    require_size,
    require_vector,
    require_whole,
    require_within,
)
from gffe_cl.engine.frame import vectors
from gffe_cl.engine.frame.camera import Camera, predict_camera

_BASES = (2, 3)
_MOST = 1024


@dataclass(frozen=True)
class Jitter:
    """Camera jitter by Halton's sequence of bases 2 and 3, its first `length` points over and over. A length of 1 is
    the middle of the pixel.

    Raises GffeError unless `length` is a whole number from 1 to 1024.
    """

    length: int = 1

    def __post_init__(self):
        object.__setattr__(self, "length", require_whole(self.length, "jitter: length", 1, _MOST))

    @classmethod
    def parse(cls, text: str) -> Jitter:
        """Return the jitter of a text: "halton:16" (16 points) or "off". Raises GffeError for others."""
        if require_kind(text, str, "jitter", "a text") == "off":
            return cls()
        kind, _, length = text.partition(":")
        if kind != "halton" or not re.fullmatch("[0-9]{1,9}", length) or not 2 <= int(length) <= _MOST:
            raise GffeError(f"jitter must be off or halton:LENGTH, LENGTH 2 to {_MOST}, got '{text}'")
        return cls(int(length))

    def offset(self, number: int) -> tuple[float, float]:
        """Return the jitter of frame `number`: pixels from the middle of each pixel to where it is sampled, −½ to ½ for
        x and y. Raises GffeError unless `number` is a whole number."""
        number = require_whole(number, "jitter: number")
        if self.length == 1:
            return 0.0, 0.0
        x, y = (_radical_inverse(number % self.length + 1, base) - 0.5 for base in _BASES)
        return x, y

    def camera(self, camera: Camera, number: int) -> Camera:
        """Return the jittered camera of frame `number`; `camera` (render pixels) is the one without jitter."""
        require_kind(camera, Camera, "jitter: camera")
        x, y = self.offset(number)
        return replace(camera, cx=camera.cx - x, cy=camera.cy - y) if x or y else camera


def without_jitter(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return `camera` of an image of `size` (width, height) with the principal point at the center if it is within a
    pixel of it. Other cameras, such as those of windows, are unchanged."""
    middle = size[0] / 2, size[1] / 2
    if max(abs(camera.cx - middle[0]), abs(camera.cy - middle[1])) > 1:
        return camera
    return replace(camera, cx=middle[0], cy=middle[1])


def _radical_inverse(number: int, base: int) -> float:
    value, digit = 0.0, 1.0 / base
    while number:
        number, rest = divmod(number, base)
        value += rest * digit
        digit /= base
    return value


MAX_ENLARGEMENT = 1.5
_MOST_FIXED = 16
MOST = 1e6
NEAR_QUANTILE = 0.05  # of depth: nearer content may leave holes
NEAR_SAMPLES = 8192  # pixels are enough for it
MARGIN = 1.0  # display pixels beyond a predicted edge: taps of resampling, and the error of the prediction
_LEAST = 0.0005  # of the display's side: the uncovered rest of four sides is less than 0.2% of the display
AT_REST = 1e-4  # display pixels: rounding of a camera that does not move
HORIZON = 1e-6  # least z of a direction, relative to its length, that meets the virtual plane


class Window(NamedTuple):
    """Rendered area, which contains the displayed one (−1, −1, 1, 1). `clamped`: a predicted frustum does not fit,
    because of the maximum enlargement or because a corner of it points behind the virtual plane."""

    u0: float
    v0: float
    u1: float
    v1: float
    clamped: bool = False

    @property
    def enlargement(self) -> tuple[float, float]:
        """Width and height of the window as factors of the display's."""
        return (self.u1 - self.u0) / 2, (self.v1 - self.v0) / 2

    def camera(self, display: Camera, size: tuple[int, int], render_size: tuple[int, int] | None = None) -> Camera:
        """Return the off-center pinhole to render through, in pixels of the rendered image.

        `display` is the camera of the displayed image, in pixels of an image of `size` (width, height); `render_size`
        is the rendered image's, the same if None. Raises GffeError if one of them, or the window, is empty.
        """
        require_kind(display, Camera, "window: display")
        u0, v0, u1, v1 = require_vector(self[:4], "window: u0, v0, u1, v1", 4).tolist()
        if not (u0 < u1 and v0 < v1):
            raise GffeError(f"window: expected u0 < u1 and v0 < v1, got {u0:g}, {v0:g}, {u1:g}, {v1:g}")
        shown = require_size(size)
        rendered = shown if render_size is None else require_size(render_size)
        enlargement = Window(u0, v0, u1, v1).enlargement
        scale_x, scale_y = (r / (s * e) for r, s, e in zip(rendered, shown, enlargement, strict=True))
        left, top = (u0 + 1) / 2 * shown[0], (v0 + 1) / 2 * shown[1]
        return replace(
            display,
            fx=display.fx * scale_x,
            fy=display.fy * scale_y,
            cx=(display.cx - left) * scale_x,
            cy=(display.cy - top) * scale_y,
        )


FULL = Window(-1.0, -1.0, 1.0, 1.0)


def fixed_window(factor: float) -> Window:
    """Return the window that enlarges the display by `factor` about its middle. Raises GffeError unless that is a
    number from 1 to 16."""
    factor = require_within(factor, "window: factor of a fixed window", 1, _MOST_FIXED)
    return Window(-factor, -factor, factor, factor)


def adaptive_window(
    current: Camera,
    predicted: Camera | Iterable[Camera],
    max_enlargement: float = MAX_ENLARGEMENT,
    *,
    size: tuple[float, float] | None = None,
    distance: float = math.inf,
    margin: float = MARGIN,
    least: float = 0.0,
) -> Window:
    """Return the window through which to render the frame of `current` so that it covers all of `predicted`.

    The formula is the appendix's, generalized to off-center pinholes: the edges of each predicted frustum are
    intersected with the virtual plane at `distance` before the current camera; the window is the bounding box of the
    intersections and the display. Whatever is farther than the plane is covered too: the edges' vanishing points are in
    the box.

    Parameters
    ----------
    current : Camera
        The camera of the displayed frame, in display pixels.
    predicted : Camera, or several
        `predict_camera` at every α that will be extrapolated, in display pixels.
    max_enlargement : float ≥ 1
        Largest size of the window, as factors of the display's width and height. Where both sides ask for more, the
        side that asks for less has precedence, up to half of the available size. A corner that points behind the
        virtual plane asks for infinitely much.
    size : (width, height) or None
        Size of the displayed image, pixels. None: twice the principal point, right for centered pinholes only.
    distance : float
        Distance of the virtual plane, world units; nearer content may leave holes. A low quantile of the last frame's
        depth is a good choice (`nearest_depth`); infinite: only turning and zooming are covered.
    margin : float
        Display pixels added beyond sides that are enlarged.
    least : float
        Share of the display's side: a side that asks for less stays as it is, because a window costs sharpness.

    Raises
    ------
    GffeError
        For a maximum below 1, a distance that is not positive, an empty display, a negative margin or least.

    Notes
    -----
    Give cameras without jitter, and add it to the camera to render through: then the displayed image has none.
    """
    require_kind(current, Camera, "window: current")
    predicted = [predicted] if isinstance(predicted, Camera) else predicted
    predicted = require_list(predicted, Camera, "window: predicted", "a Camera, or several")
    max_enlargement = require_within(max_enlargement, "window: max_enlargement", 1, MOST)
    distance = require_positive(distance, "window: distance", infinite=True)
    margin = require_within(margin, "window: margin", 0, MOST)
    least = require_within(least, "window: least", 0, 1)
    sides = np.array(require_size((2 * current.cx, 2 * current.cy) if size is None else size))
    low, high, clamped = -np.ones(2), np.ones(2), False
    for camera in predicted:
        points, clipped = _edges_on_plane(current, camera, sides, distance)
        uv = 2 * points / sides - 1
        low, high = np.minimum(low, uv.min(0)), np.maximum(high, uv.max(0))
        clamped |= clipped
    more, rest = 2 * margin / sides, 2 * np.maximum(AT_REST / sides, least)
    low, high = np.where(low < -1 - rest, low - more, -1.0), np.where(high > 1 + rest, high + more, 1.0)
    bounds = [_limited(-1 - low[k], high[k] - 1, 2 * (max_enlargement - 1)) for k in range(2)]
    (left, right, cut_u), (above, below, cut_v) = bounds
    edges = (float(edge) for edge in (-1 - left, -1 - above, 1 + right, 1 + below))
    return Window(*edges, clamped=bool(clamped or cut_u or cut_v))


def nearest_depth(depth: np.ndarray) -> float:
    """Return a `distance` for `adaptive_window`: the lower 5% quantile of depth (H, W), world units, or infinity if no
    depth is finite. Raises GffeError for another shape."""
    depth = require_array(depth, "window: depth", None, None)
    stride = max(1, math.isqrt(depth.size // NEAR_SAMPLES))
    some = depth[::stride, ::stride]
    some = some[np.isfinite(some) & (some > 0)]
    return float(np.partition(some, rank := int(some.size * NEAR_QUANTILE))[rank]) if some.size else math.inf


class WindowChooser:
    """Chooses the window of each rendered frame, one after the other, as an engine would.

    Parameters
    ----------
    mode : "adaptive", "fixed:FACTOR" or "off"
    alphas : times of the frames that will be extrapolated, in intervals
    """

    def __init__(self, mode: str, size: tuple[int, int], alphas: Iterable[float]):
        kind, _, factor = mode.partition(":")
        try:
            self._fixed = fixed_window(float(factor)) if kind == "fixed" else {"off": FULL, "adaptive": None}[mode]
        except (KeyError, ValueError):
            raise GffeError(f"window must be adaptive, fixed:FACTOR (fixed:1.2) or off, got '{mode}'") from None
        self.size, self.alphas = size, sorted(set(alphas))
        self._distance = math.inf

    def choose(self, current: Camera, previous: Camera | None) -> Window:
        """Return the window for the frame shown by `current`, after the one shown by `previous` (None: after a
        reset)."""
        if self._fixed:
            return self._fixed
        if previous is None:
            return FULL
        predicted = [predict_camera(previous, current, alpha) for alpha in self.alphas]
        return adaptive_window(current, predicted, size=self.size, distance=self._distance, least=_LEAST)

    def observe(self, depth: np.ndarray) -> None:
        """Take depth (H, W) of a rendered frame as a guide for the next."""
        if self._fixed is None:
            self._distance = nearest_depth(depth)


def _edges_on_plane(current: Camera, camera: Camera, size, distance: float) -> tuple[np.ndarray, bool]:
    """Return positions (N, 2), in pixels of `current`, where the edges of the frustum of `camera` meet the virtual
    plane, with those of their vanishing points; and whether a corner points behind the plane."""
    px = np.array([(0, 0), (size[0], 0), size, (0, size[1])], np.float64)
    transform = camera.to_view_of(current).tolist()
    rotation, origin = [row[:3] for row in transform[:3]], np.array([row[3] for row in transform[:3]])
    corners = [((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0) for x, y in px.tolist()]
    rays, clipped = _in_front(np.array([vectors.times(rotation, corner) for corner in corners]))
    points = rays / rays[:, 2:]
    if math.isfinite(distance):
        along = np.maximum(distance - origin[2], 0.0)
        met = origin + along * points
        points = np.concatenate([points, met / max(distance, origin[2])])
    return points[:, :2] * (current.fx, current.fy) + (current.cx, current.cy), clipped


def _in_front(rays: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the cone of four edges (4, 3) clipped to directions that meet the virtual plane, and whether anything was
    cut off."""
    rays = rays / np.array([[vectors.length(ray)] for ray in rays.tolist()])
    z = rays[:, 2] - HORIZON
    if (z > 0).all():
        return rays, False
    kept = []
    for k in range(4):
        j = (k + 1) % 4
        if z[k] > 0:
            kept.append(rays[k])
        if (z[k] > 0) != (z[j] > 0):
            kept.append(rays[k] + (rays[j] - rays[k]) * (z[k] / (z[k] - z[j])))
    if not kept:  # nothing of it lies ahead: as far as may be, to the side it has turned to
        kept = [(x, y, HORIZON) for x, y, _ in rays]
    return np.maximum(np.array(kept), (-np.inf, -np.inf, HORIZON)), True


def _limited(low: float, high: float, most: float) -> tuple[float, float, bool]:
    """Return how much to enlarge on two sides that ask for `low` and `high`, and whether that is less than they ask
    for."""
    if low + high <= most:
        return low, high, False
    less = min(low, high, most / 2)
    rest = most - less
    return (less, rest, True) if low <= high else (rest, less, True)
