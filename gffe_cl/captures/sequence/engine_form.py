"""Conversion of rendered frames that a `FrameFormat` describes to our conventions, on the host: of sequences on disk,
and for the doctor. The pipeline converts on the device."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import DEPTHS, SCALED_DEPTHS, FrameFormat, conversion, jitter_in_color
from gffe_cl.engine.frame.rendered_frame import HALF_MAX, RenderedFrame, type_of
from gffe_cl.engine.frame.transfer_function import linear_of_srgb
from gffe_cl.engine.opencl.program import constants


def described_frame(
    frame: RenderedFrame, format: FrameFormat, previous: Camera | None, previous_jitter: tuple[float, float]
) -> RenderedFrame:
    """Return `frame` of NumPy arrays in our conventions: depth and motion in float32, of the size of color, color in
    floats. `previous`: the render camera of the frame before; None if there is none. `previous_jitter`: of its
    geometry, pixels of color.

    Raises GffeError where vectors lack the camera's motion and a frame has no camera.
    """
    (height, width), (rows, columns) = np.shape(frame.color)[:2], np.shape(frame.depth)
    size, geometry = (width, height), (columns, rows)
    motion_type = None if frame.motion is None else _type_of(frame.motion)
    types = {"color": None, "depth": _type_of(frame.depth), "motion": motion_type}
    jitter = jitter_in_color(frame.geometry_jitter, size, geometry)
    jitters = jitter, previous_jitter if previous else jitter
    given = conversion(format, size, types, {"color": 3, "motion": 2}, *jitters, geometry)
    made = _converted(frame, format, previous, given)
    if format.motion_dilated and made.motion is not None:
        static = None
        if previous and frame.camera:
            static = _camera_motion(made.depth.astype(np.float64), frame.camera, previous, given["from_geometry"])
        made = replace(made, motion=undilated(made.motion, made.depth, static))
    if geometry == size:
        return made
    motion = np.zeros((rows, columns, 2), np.float32) if made.motion is None else made.motion
    depth, motion = spread_geometry(made.color, made.depth, motion, given)
    jitter = (0.0, 0.0)
    return replace(
        made, depth=depth, motion=None if made.motion is None else motion, geometry_size=None, geometry_jitter=jitter
    )


def undilated(motion: np.ndarray, depth: np.ndarray, static: np.ndarray | None) -> np.ndarray:
    """Return motion (H, W, 2) float32 without dilation, as `undo_dilation` of kernels/upload.cl does, with its bits.
    `depth`: (H, W); `static`: motion of static points, None if it is not known."""
    numbers, f = constants("upload.cl"), np.float32
    around, reach = int(numbers["SQUARE"]), int(numbers["SQUARE"]) // 2
    height, width = depth.shape
    padded = np.pad(depth.astype(f), reach)
    z = np.stack([padded[k // around :, k % around :][:height, :width] for k in range(around * around)])
    middle, steps = len(z) // 2, [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)]
    own, distance = z[middle], np.full(depth.shape, np.iinfo(np.int32).max)
    chosen = np.arange(depth.size).reshape(depth.shape)
    here = chosen.copy()
    with np.errstate(invalid="ignore"):
        for step_y, step_x in steps:
            center = z[middle + step_y * around + step_x]
            least, source = center, np.full(depth.shape, step_x * step_x + step_y * step_y)
            for tap_y, tap_x in steps:
                from_y, from_x = step_y + tap_y, step_x + tap_x
                other = z[middle + from_y * around + from_x]
                nearer = (other > 0) & (other < least)
                least = np.where(nearer, other, least)
                source = np.where(nearer, from_x * from_x + from_y * from_y, source)
            same = np.where(np.isinf(own), np.isinf(center), np.abs(center - own) <= f(numbers["SAME_SURFACE"]) * own)
            better = same & (own > 0) & (center > 0) & (least >= f(numbers["NEARER"]) * center) & (source < distance)
            distance = np.where(better, source, distance)
            chosen = np.where(better, here + step_y * width + step_x, chosen)
        made = motion.astype(f).reshape(-1, 2)[chosen]
        lost = (distance == np.iinfo(np.int32).max) & (own > 0)
    return made if static is None else np.where(lost[..., None], static.astype(f), made)


def spread_geometry(
    color: np.ndarray, depth: np.ndarray, motion: np.ndarray, given: Mapping[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return depth (H, W) and motion (H, W, 2) float32 for every pixel of `color` (H, W, 3) from smaller ones, as
    `spread_geometry` of kernels/upload.cl does, with its bits. `given`: of `conversion`."""
    numbers, f = constants("upload.cl"), np.float32
    rgb = np.clip(np.nan_to_num(color[..., :3], posinf=HALF_MAX, neginf=-HALF_MAX), -HALF_MAX, HALF_MAX).astype(f)
    height, width = rgb.shape[:2]
    rows, columns = depth.shape
    depth, motion = depth.astype(f), motion.astype(f)
    to, back = (np.array(given[name], f) for name in ("to_geometry", "from_geometry"))
    x, y = np.arange(width, dtype=f) + f(0.5), np.arange(height, dtype=f)[:, None] + f(0.5)
    taps, weights, offsets = _taps(x * to[0] + to[2] - f(0.5), y * to[1] + to[3] - f(0.5), columns, rows)
    x, y = np.arange(columns, dtype=f) + f(0.5), np.arange(rows, dtype=f)[:, None] + f(0.5)
    in_color, color_weights, _ = _taps(x * back[0] + back[2] - f(0.5), y * back[1] + back[3] - f(0.5), width, height)
    at_samples = np.zeros((rows, columns, 3), f)
    for indices, weight in zip(in_color, color_weights, strict=True):
        at_samples += rgb.reshape(-1, 3)[indices] * weight[..., None]
    z, moved, colors = depth.reshape(-1)[taps], motion.reshape(-1, 2)[taps], at_samples.reshape(-1, 3)[taps]

    def of(tap: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return depth and motion of a sample for each pixel, and which samples show its surface, (4, H, W)."""
        own_z, own = (np.take_along_axis(a, tap.reshape(1, *tap.shape, *[1] * (a.ndim - 3)), 0)[0] for a in (z, moved))
        with np.errstate(invalid="ignore"):
            near = np.where(np.isinf(own_z), np.isinf(z), np.abs(z - own_z) <= f(numbers["SAME_SURFACE"]) * own_z)
            return own_z, own, near & (np.abs(moved - own) <= f(numbers["ALIKE_MOTION"])).all(-1)

    *_, alike = of((offsets[0] >= 0.5) + 2 * (offsets[1] >= 0.5))
    smooth, light = alike.all(0), rgb[..., 0] + rgb[..., 1] + rgb[..., 2]
    far, least = f(numbers["NEARNESS"]) * (light * light + f(1e-6)), np.float32(np.inf)
    chosen = np.zeros((height, width), np.intp)
    for tap in range(4):
        off, dx, dy = colors[tap] - rgb, offsets[0] - f(tap & 1), offsets[1] - f(tap >> 1)
        squared = off * off
        cost = squared[..., 0] + squared[..., 1] + squared[..., 2] + far * (dx * dx + dy * dy)
        chosen, least = np.where(cost < least, tap, chosen), np.where(cost < least, cost, least)
    own_z, own, alike = of(chosen)
    added = alike | smooth
    sums = [np.zeros((height, width), f) for _ in range(4)]
    with np.errstate(all="ignore"):
        for tap in range(4):
            for total, value in zip(sums, (f(1), z[tap], moved[tap, ..., 0], moved[tap, ..., 1]), strict=True):
                total += np.where(added[tap], weights[tap] * value, f(0))
        spread_z, *spread = (np.where(smooth, part, part / sums[0]) for part in sums[1:])
    kept = ~smooth & ~(sums[0] > 0)
    spread_z = np.where(kept, own_z, np.where(np.isinf(own_z), own_z, spread_z))
    return spread_z, np.where(kept[..., None], own, np.stack(spread, -1))


def _taps(x: np.ndarray, y: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray, tuple]:
    """Return indices (4, H, W) of the pixels around positions, x (W,) and y (H, 1) with whole numbers at pixel centers,
    in an image of a size; their bilinear weights; and the offsets (H, W) of x and y from the first."""
    x, y = np.clip(x, np.float32(0), np.float32(width - 1)), np.clip(y, np.float32(0), np.float32(height - 1))
    left, top = x.astype(np.intp), y.astype(np.intp)
    columns, rows = (left, np.minimum(left + 1, width - 1)), (top, np.minimum(top + 1, height - 1))
    u, v = np.broadcast_arrays(x - left.astype(np.float32), y - top.astype(np.float32))
    taps = np.stack([rows[tap >> 1] * width + columns[tap & 1] for tap in range(4)])
    weights = np.stack([(u if tap & 1 else 1 - u) * (v if tap >> 1 else 1 - v) for tap in range(4)])
    return taps, weights, (u, v)


def _converted(
    frame: RenderedFrame, format: FrameFormat, previous: Camera | None, given: Mapping[str, Any]
) -> RenderedFrame:
    """Return `frame` in our conventions, but for the size of depth and motion."""
    motion_type = None if frame.motion is None else _type_of(frame.motion)
    down = slice(None, None, -1 if format.rows == "up" else 1)
    depth = _depth(_values(frame.depth[down]), given)
    if format.depth == "distance":
        if frame.camera is None:
            raise GffeError("frame: distances need a camera to become planar depth")
        depth = _planar(depth, frame.camera, given["from_geometry"])
    color = color_of(frame.color, format)
    if frame.motion is None:
        return replace(frame, color=color, depth=depth.astype(np.float32))
    stored, (*factors, x, y) = frame.motion[down].astype(np.float64), given["given_motion"]
    # Halves may have become floats on their way to disk.
    invalid = [given["motion_invalid"]]
    if format.motion_invalid is not None and motion_type == "float32":
        invalid.append(float(np.float16(format.motion_invalid)))
    unwritten = np.isin(stored, invalid).all(-1, keepdims=True)
    vectors = np.where(unwritten, 0.0, stored * factors + (x, y))
    if format.camera_motion == "included":
        vectors = np.where(unwritten, np.nan, vectors)
    elif previous:
        if frame.camera is None:
            raise GffeError("frame: motion without the camera's part needs a camera")
        added = unwritten | (format.camera_motion == "excluded")
        static = _camera_motion(depth, frame.camera, previous, given["from_geometry"])
        vectors = np.where(added, vectors + static, vectors)
    with np.errstate(over="ignore"):
        return replace(frame, color=color, depth=depth.astype(np.float32), motion=vectors.astype(np.float32))


def color_of(color: np.ndarray, format: FrameFormat) -> np.ndarray:
    """Return linear color (H, W, 3 or 4) of stored one, from the top row down: floats as they are, integers as
    float32."""
    color = color[::-1] if format.rows == "up" else color
    if color.dtype.kind != "f":
        color = color / np.float64(np.iinfo(color.dtype).max)
    if format.color_encoding == "srgb":
        color = linear_of_srgb(color)
    return color.astype(np.float32) if color.dtype == np.float64 else color


def _planar(distance: np.ndarray, camera: Camera, mapping: Sequence[float]) -> np.ndarray:
    """Return planar depth (H, W) of distances along the rays. `mapping`: from pixels of depth to those of color."""
    y, x = (np.arange(n) + 0.5 for n in distance.shape)
    across = ((x * mapping[0] + mapping[2] - camera.cx) / camera.fx) ** 2
    down = ((y * mapping[1] + mapping[3] - camera.cy) / camera.fy) ** 2
    return distance / np.sqrt(1 + across + down[:, None])


def _type_of(array: np.ndarray) -> str:
    return type_of(array) or "float32"  # float64, too


def _values(depth: np.ndarray) -> np.ndarray:
    """Return stored depth (H, W) in float64: of 32-bit integers the low 24 bits."""
    return (depth & 0xFFFFFF if depth.dtype == np.uint32 else depth).astype(np.float64)


def _depth(stored: np.ndarray, given: Mapping[str, Any]) -> np.ndarray:
    """Return planar depth or distance (H, W), of the values of a depth buffer sky beyond its range or at the far
    end."""
    (factor, origin, addend, sky), law = given["given_depth"], DEPTHS[given["depth_law"]]
    with np.errstate(all="ignore"):
        if law == "logarithmic":
            depth = addend + (addend or 1.0) * np.expm1(factor * (stored - origin))
            return np.where(stored == np.float32(sky), math.inf, depth)
        value = factor * (stored - origin) + addend
        if law in SCALED_DEPTHS:
            return value
        return np.where((stored == np.float32(sky)) | (value <= 0), math.inf, 1 / value)


def _camera_motion(depth: np.ndarray, camera: Camera, previous: Camera, mapping: Sequence[float]) -> np.ndarray:
    """Return `static_motion` as kernels/upload.cl has it: 0 where depth is invalid."""
    return np.where((depth > 0)[..., None], static_motion(depth, camera, previous, mapping)[0], 0.0)


def static_motion(
    depth: np.ndarray, camera: Camera, before: Camera, mapping: Sequence[float] = (1.0, 1.0, 0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Return motion (H, W, 2) float64 of static surfaces, pixels of color, from `camera` to `before`, and their depth
    (H, W) there. Sky, and pixels of invalid depth, move with the rotation; motion is NaN behind the camera before,
    depth where it is invalid. `mapping`: from pixels of depth to those of color."""
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]] + 0.5
    here = np.stack([x * mapping[0] + mapping[2], y * mapping[1] + mapping[3]], -1)
    finite = np.isfinite(depth) & (depth > 0)
    across = (here - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    along = np.concatenate([across, np.ones((*depth.shape, 1))], -1)
    turn = camera.to_view_of(before)
    with np.errstate(all="ignore"):
        seen = along @ turn[:3, :3].T  # at infinite depth
        near = seen * np.where(finite, depth, 1.0)[..., None] + turn[:3, 3]
        seen = np.where(finite[..., None], near, seen)
        px = seen[..., :2] / seen[..., 2:] * (before.fx, before.fy) + (before.cx, before.cy)
        depth_before = np.where(finite, seen[..., 2], np.where(depth > 0, np.inf, np.nan))
    px[~(seen[..., 2] > 0)] = np.nan
    return px - here, depth_before
