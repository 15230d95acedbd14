"""Conversion of matrices, depth buffers and motion vectors from the conventions of graphics APIs and engines to ours.

Ours: column vectors, view axes x right, y down, z forward, pixels from the top left corner, planar depth in world
units, motion = (position in the previous rendered frame) − (position here) in pixels, y down.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, NoReturn

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    QUIETLY,
    as_float32,
    as_float64,
    require_array,
    require_bool,
    require_choice,
    require_number,
    require_size,
    shown,
)

LAYOUTS = ("auto", "row-major", "column-major")
DIRECTIONS = {"to_previous": 1.0, "from_previous": -1.0}
_ZERO = 1e-6  # of the largest entry
_SAME = 1e-9
_RIGID = 1e-2  # by which lengths may differ
MOST_PLANES = 1e30  # times the near plane: beyond, a plane is infinitely far
_SLACK = 1e-3  # by which infinitely far planes are moved against rounding errors


class Pinhole(NamedTuple):
    """Pinhole camera of a view and a projection matrix: (4, 4) from world space to view axes x right, y down, z
    forward; intrinsics in pixels."""

    world_to_view: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float


@QUIETLY
def pinhole(view: Any, projection: Any, size: Any, layout: str, ndc_up: bool, view_up: bool = False) -> Pinhole:
    """Return the camera of an API whose normalized device coordinates go up (`ndc_up`) or down, on an image of `size`
    pixels. Raises GffeError for matrices that are no rigid view and pinhole.

    Which way the view axes point follows from the projection P (column vectors): w = P₃₂ z, so z is forward where P₃₂
    is positive, and x, y agree with those of the device where P₀₀, P₁₁ are positive. With `view_up` the view's y is
    known to be up, and a projection turned upside down is taken for one into a texture. Then, with P divided by P₃₂:
    fx = |P₀₀| W/2, cx = (1 + P₀₂) W/2; fy = |P₁₁| H/2, cy = (1 ± P₁₂) H/2.
    """
    width, height = require_size(size)
    v, p = matrices(view, projection, layout)
    v = rigid(v, "view")
    p = _perspective(p)
    if max(abs(p[0, 1]), abs(p[1, 0]), abs(p[0, 3]), abs(p[1, 3])) > _ZERO * np.abs(p[:2]).max():
        raise GffeError("camera: projection is sheared (expected an off-center pinhole)")
    if not (p[0, 0] and p[1, 1]):
        raise GffeError("camera: singular projection, its first two diagonal entries must not be 0")
    forward = np.sign(p[3, 2])
    if view_up and p[1, 1] < 0:
        p[1] *= -1
    down = -1.0 if ndc_up else 1.0
    axes = np.diag([np.sign(p[0, 0]), down * np.sign(p[1, 1]), forward, 1.0])
    focal = np.abs(p[[0, 1], [0, 1]]) * (width / 2, height / 2)
    middle = (1 + p[:2, 2] * (forward, down * forward)) * (width / 2, height / 2)
    return Pinhole(axes @ v, *focal.tolist(), *middle.tolist())  # `Camera` refuses non-finite values


def matrices(view: Any, projection: Any, layout: str = "auto") -> tuple[np.ndarray, np.ndarray]:
    """Return both matrices as (4, 4) float64 for column vectors; `layout` is that of `Camera.from_opengl`. Raises
    GffeError if they are no such matrices, or contradict the layout."""
    v, p = square(view, "view"), square(projection, "projection")
    turned = (v, p), (v.T, p.T)
    fits = [is_one and _is_view(a) for is_one, (a, _) in zip(_are_projections(p), turned, strict=True)]
    symmetric = np.array_equal(v, v.T) and np.array_equal(p, p.T)
    chosen = _chosen_layout(layout, fits, symmetric, "view and projection")
    if chosen is None and not (_is_view(v) or _is_view(v.T)):
        raise GffeError("camera: view is no view matrix (expected a row or column 0 0 0 1)")
    if chosen is None:
        _refuse_projection([b for a, b in turned if _is_view(a)])
    first, second = turned[chosen]
    return first.copy(), second.copy()


def _chosen_layout(layout: str, fits: list[bool], symmetric: bool, what: str) -> int | None:
    """Return 0 for row-major, 1 for column-major, None if "auto" fits neither. `fits`: whether `what` can have
    either layout."""
    require_choice(layout, LAYOUTS, "camera: layout")
    if layout != "auto":
        asked = LAYOUTS.index(layout) - 1
        if fits[1 - asked] and not fits[asked]:
            raise GffeError(f"camera: {what} do not fit layout '{layout}' (expected '{LAYOUTS[2 - asked]}')")
        return asked
    if all(fits) and not symmetric:
        raise GffeError(f"camera: {what} fit both layouts (expected layout='row-major' or 'column-major')")
    return fits.index(True) if any(fits) else None


def _perspective(p: np.ndarray) -> np.ndarray:
    """Return the projection `p`, for column vectors, scaled so that w = ±z. Raises GffeError if it is no perspective
    projection along z."""
    if np.abs(p[3, [0, 1, 3]]).max() > _ZERO * abs(p[3, 2]) or p[3, 2] == 0:
        _refuse_projection([p])
    return p / abs(p[3, 2])


def _refuse_projection(candidates: list[np.ndarray]) -> NoReturn:
    """Raise a GffeError that names the value of w in place of ±z and, for another axis, the conversion.
    `candidates`: the projection for column vectors, in each possible layout."""
    for p in candidates:
        for k in np.flatnonzero(np.abs(np.abs(p[3]) - 1) <= _ZERO):
            if np.delete(np.abs(p[3]), k).max() > _ZERO:
                continue
            if k == 3:
                raise GffeError("camera: projection is no perspective one but orthographic, w = 1 (expected w = ±z)")
            if k < 2:
                _refuse_axes(p, int(k))
    raise GffeError("camera: projection is no perspective one (expected w = ±z: a row or column 0 0 ±1 0)")


def _refuse_axes(p: np.ndarray, forward: int) -> NoReturn:
    """Raise the GffeError for a projection along the x or y axis."""
    others = [axis for axis in range(3) if axis != forward]
    up = max(others, key=lambda axis: abs(p[1, axis]))
    (right,) = (axis for axis in others if axis != up)
    turn = np.eye(4, dtype=int)[[right, up, forward, 3]]
    turn[2] *= round(np.linalg.det(turn))
    along = ("-" if p[3, forward] < 0 else "") + "xyz"[forward]
    raise GffeError(
        f"camera: projection has w = {along}, so it looks along {along} with {'xyz'[up]} vertical (expected w = z or"
        f" -z); convert, for column vectors, with T = {turn.tolist()}: projection @ T.T, and T @ view"
    )


def square(given: Any, name: str) -> np.ndarray:
    """Return the matrix (4, 4) float64 of rows or of 16 numbers. Raises a GffeError with `name` unless it is that, and
    finite."""
    array = require_array(given, f"camera: {name}", ...)
    if array.shape not in ((4, 4), (16,)):
        raise GffeError(f"camera: {name} must have shape (4, 4), or be 16 numbers, got shape {array.shape}")
    array = as_float64(array)
    if not np.isfinite(array).all():
        raise GffeError(f"camera: {name} must be finite")
    return array.reshape(4, 4)


def rigid(matrix: np.ndarray, name: str) -> np.ndarray:
    """Return (4, 4) `matrix` without rounding errors and uniform scale of its rotation. The camera's position stays.

    Raises GffeError unless it is a rotation (mirrored or not), a scale and a translation, to 1%.
    """
    made = np.eye(4)
    try:
        with np.errstate(all="ignore"):
            left, scale, right = np.linalg.svd(matrix[:3, :3])
            fits = scale[2] > 0 and scale[0] / scale[2] - 1 <= _RIGID
            made[:3, :3] = left @ right
            made[:3, 3] = made[:3, :3] @ np.linalg.solve(matrix[:3, :3], matrix[:3, 3])
    except np.linalg.LinAlgError:
        fits = False
    if not fits:
        raise GffeError(f"camera: {name} is singular or not rigid (expected a rotation and a translation)")
    return made


def unreal_view(location: Any, pitch: float, yaw: float, roll: float) -> np.ndarray:
    """Return the matrix (4, 4) from the world to x right, y down, z forward of a camera of Unreal at `location` (world
    units); angles are in degrees.

    Unreal's world is left-handed: x forward, y right, z up; a positive pitch looks up, yaw turns to the right, roll
    leans to the right. The result is mirrored accordingly.
    """
    p, y, r = np.radians([pitch, yaw, roll])
    (sp, sy, sr), (cp, cy, cr) = np.sin([p, y, r]), np.cos([p, y, r])
    forward = (cp * cy, cp * sy, sp)
    right = (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, -sr * cp)
    up = (-(cr * sp * cy + sr * sy), cy * sr - cr * sp * sy, cr * cp)
    matrix = np.eye(4)
    matrix[:3, :3] = (right, np.negative(up), forward)
    matrix[:3, 3] = -matrix[:3, :3] @ np.asarray(location, np.float64)
    return matrix


def refuse_oblique(projection: np.ndarray) -> None:
    """Raise GffeError if the near plane of a perspective projection (4, 4), for column vectors, is oblique: planar
    depth then depends on more than the value in the buffer."""
    row = projection[2]
    if np.abs(row[:2]).max() > _ZERO * np.abs(projection).max():
        raise GffeError(
            f"camera: projection has an oblique near plane (third row {' '.join(f'{value:.4g}' for value in row)}): its"
            " depth buffer is not made linear (expected the matrix without it, or linear depth)"
        )


@QUIETLY
def depth_from_device(
    z: Any, projection: Any, *, layout: str = "auto", opengl_buffer: bool = False, sky: bool = True
) -> np.ndarray:
    """Return planar depth in world units from the values of a depth buffer.

    Parameters
    ----------
    z : (…) float
        Depth after division by w, as `projection` makes it: 0 … 1 in Direct3D, Vulkan, Unity and Unreal, 1 … 0 where
        depth is reversed, −1 … 1 in OpenGL.
    projection : (4, 4)
        The projection matrix used for rendering, of any API; reversed and infinitely far planes follow from it.
    layout : "auto", "row-major" or "column-major"
        Layout of the matrix, as in `Camera.from_opengl`.
    opengl_buffer : bool
        Whether `z` is the result of `glReadPixels` without `glClipControl`: 0 … 1 for −1 … 1. It is not used where
        `projection` gives reversed depth from 1 to 0, which OpenGL has with `glClipControl` only.
    sky : bool
        Whether pixels with exactly the far plane's depth, as in a cleared buffer, become infinite.

    Returns
    -------
    (…) float32
        With P for column vectors, P₂₃ / (z − s P₂₂), s = P₃₂ = ±1; +inf beyond the range of the projection.

    Raises
    ------
    GffeError
        If `projection` is no perspective projection or its near plane is oblique, or `z` is no array of numbers.
    """
    p = square(projection, "projection")
    chosen = _chosen_layout(layout, _are_projections(p), np.array_equal(p, p.T), "entries of projection")
    p = _perspective(p.T if chosen == 1 else p) if chosen is not None else _refuse_projection([p, p.T])
    refuse_oblique(p)
    device = as_float64(require_array(z, "depth: z", ...))
    opengl_buffer, sky = require_bool(opengl_buffer, "depth: opengl_buffer"), require_bool(sky, "depth: sky")
    a, b = _depth_terms(p)
    if b == 0:
        raise GffeError("camera: projection gives every depth the same value (expected two planes)")
    opengl_buffer &= not _reversed_to_zero(a, b)
    if opengl_buffer:
        device = 2 * device - 1
    far = 1.0 if b < 0 else -1.0 if opengl_buffer or a <= -1 + _SLACK else 0.0
    depth = b / (device - a)
    depth = np.where(np.isnan(device), np.nan, np.where((depth > 0) & np.isfinite(depth), depth, np.inf))
    if sky:
        depth = np.where(device == far, np.inf, depth)
    return as_float32(depth)


def decides_depth_range(projection: np.ndarray) -> bool:
    """Return whether a perspective projection (4, 4), for column vectors, determines the range of the values in its
    depth buffer. Planes that are not reversed can be meant for 0 … 1 and for −1 … 1."""
    return _reversed_to_zero(*_depth_terms(_perspective(projection)))


def planes_of(projection: np.ndarray, opengl_buffer: bool) -> tuple[float, float]:
    """Return planar depth where a depth buffer of a perspective projection (4, 4), for column vectors, holds 0 and 1;
    infinity for a plane that far. `opengl_buffer` as in `depth_from_device`. Raises GffeError for other projections."""
    p = _perspective(projection)
    a, b = _depth_terms(p)
    if b == 0:
        raise GffeError("camera: projection gives every depth the same value (expected two planes)")
    in_device = (-1.0, 1.0) if opengl_buffer and not _reversed_to_zero(a, b) else (0.0, 1.0)
    ends = [math.inf if value == a else b / (value - a) for value in in_device]
    first, second = (math.inf if end < 0 or end > MOST_PLANES * min(map(abs, ends)) else end for end in ends)
    return first, second


def depth_planes(projection: np.ndarray, inverted: bool) -> tuple[float, float]:
    """Return the distances of the near and the far plane of a perspective projection (4, 4) to depth 0 … 1, of row or
    of column vectors, infinity included; `inverted`: depth is 1 at the near plane. Raises GffeError if it is no such
    projection."""
    chosen = _are_projections(projection)
    if not any(chosen):
        _refuse_projection([projection, projection.T])
    perspective = _perspective(projection if chosen[0] else projection.T)
    refuse_oblique(perspective)
    a, b = _depth_terms(perspective)
    ends = [math.inf if abs(value - a) < _ZERO else b / (value - a) for value in (0.0, 1.0)]
    near, far = reversed(ends) if inverted else ends
    if not 0 < near < far:
        expected = "1 at the near plane, 0 far away" if inverted else "0 at the near plane, 1 far away"
        raise GffeError(f"camera: projectionMatrix has its planes at {near:g} and {far:g} (expected depth {expected})")
    return near, far


def _depth_terms(p: np.ndarray) -> tuple[float, float]:
    """Return a and b of device depth = a + b / depth, of a perspective projection whose w is ±z."""
    return float(p[2, 2] * np.sign(p[3, 2])), float(p[2, 3])


def _reversed_to_zero(a: float, b: float) -> bool:
    """Return whether device depth a + b / depth is 1 at the near plane and about 0 far away: a = −near / (far − near).
    From 1 to −1 it would be −1 or less."""
    return b > 0 and -1 + _SLACK < a < _SLACK


@QUIETLY
def depth_from_distance(distance: Any, camera: Any) -> np.ndarray:
    """Return planar depth (H, W) float32 from distances along the rays, as ray tracers write them, in the same unit.

    depth = distance / √(1 + ((x − cx)/fx)² + ((y − cy)/fy)²), x and y at pixel centers; `camera` is the `Camera` of
    these pixels. Infinite distances stay. Raises GffeError for another shape.
    """
    distance = require_array(distance, "distance", None, None)
    if not all(hasattr(camera, name) for name in ("fx", "fy", "cx", "cy")):
        raise GffeError(f"distance: camera must be a Camera, got {shown(camera)}")
    y, x = (np.arange(n) + 0.5 for n in distance.shape)
    across = 1 + ((x - camera.cx) / camera.fx) ** 2
    return as_float32(as_float64(distance) / np.sqrt(across + ((y - camera.cy) / camera.fy)[:, None] ** 2))


def motion_from_ndc(motion: Any, size: Any, direction: str = "to_previous", y: str = "up") -> np.ndarray:
    """Return motion in pixels (H, W, 2) float32 from motion in normalized device coordinates, −1 … 1 across the image.

    (x, y) becomes (x · W/2, −y · H/2); with `y` "down", as in Vulkan, (x · W/2, y · H/2). `size` is (W, H) in pixels.
    `direction` "to_previous": the given vectors are (previous − here); "from_previous": (here − previous).
    """
    return _scaled(motion, size, 0.5, direction, y)


def motion_from_uv(motion: Any, size: Any, direction: str = "to_previous", y: str = "down") -> np.ndarray:
    """Return motion in pixels (H, W, 2) float32 from motion in texture coordinates, 0 … 1 across the image.

    (x, y) becomes (x · W, y · H); with `y` "up", as in OpenGL, (x · W, −y · H). `size` is (W, H) in pixels.
    `direction` "to_previous": the given vectors are (previous − here); "from_previous", as of Unity: (here − previous).
    """
    return _scaled(motion, size, 1.0, direction, y)


@QUIETLY
def motion_from_unreal(rg: Any, size: Any, scale: float = 2.0) -> np.ndarray:
    """Return motion in pixels (H, W, 2) float32 from the red and green channels (H, W, 2) of Movie Render Queue's
    motion vectors, around ½.

    (R, G) becomes (−s W (R − ½), s H (G − ½)); s is 2 by default, and 1 in Epic's own example. Reproject static objects
    to see which one it is. `size` is (W, H) in pixels.
    """
    rg = _vectors(rg)
    width, height = require_size(size)
    scale = require_number(scale, "motion: scale")
    return as_float32((rg - 0.5) * (-scale * width, scale * height))


@QUIETLY
def _scaled(motion, size, factor, direction, y) -> np.ndarray:
    sign = DIRECTIONS[require_choice(direction, DIRECTIONS, "motion: direction")]
    down = require_choice(y, ("up", "down"), "motion: y") == "down"
    width, height = require_size(size)
    return as_float32(_vectors(motion) * (sign * factor * width, sign * factor * height * (1 if down else -1)))


def _vectors(motion) -> np.ndarray:
    return as_float64(require_array(motion, "motion", ..., 2))


def _is_view(m: np.ndarray) -> bool:
    return bool(np.abs(m[3] - (0, 0, 0, 1)).max() <= _SAME * (1 + np.abs(m).max()))


def _are_projections(m: np.ndarray) -> list[bool]:
    """Return whether `m`, and whether its transpose, is a perspective projection for column vectors. One with an
    oblique near plane, whose third row may hold anything, counts only if neither is an ordinary one."""
    ordinary = [_is_projection(p) and _is_zero(p[2, :2], p) for p in (m, m.T)]
    return ordinary if any(ordinary) else [_is_projection(p) for p in (m, m.T)]


def _is_projection(m: np.ndarray) -> bool:
    return bool(abs(abs(m[3, 2]) - 1) <= _ZERO and _is_zero(np.array([*m[3, [0, 1, 3]], *m[:2, 3]]), m))


def _is_zero(entries: np.ndarray, m: np.ndarray) -> bool:
    return bool(np.abs(entries).max() <= _ZERO * np.abs(m).max())
