"""Computation of motion vectors: from forward flow, over two frames.

Arrays are in our conventions: images (H, W), pixels, y down, depth planar and +inf for sky.
"""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.sequence.engine_form import static_motion
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import is_long

_SAME_SURFACE = 0.05  # relative depth
_STEPS = 6  # of the fixed-point iteration that inverts flow
_CLOSE = 0.75  # pixels between where flow and its inverse lead, at most


def inverted_flow(
    flow: np.ndarray, depth_before: np.ndarray, camera_before: Camera, depth: np.ndarray, camera: Camera
) -> np.ndarray:
    """Return the motion (H, W, 2) float32 of a frame from the flow (H, W, 2) that leads to it from the frame before.

    The flow is splatted, and then V = −flow(x + V) is solved; both keep to pixels whose depth fits the surface at x.
    Pixels to which no flow leads came into view: they move like static surfaces.
    """
    still, expected = static_motion(depth, camera, camera_before)
    flow = without_long(flow)
    motion = _splatted(flow, _depth_seen(depth_before, camera_before, camera, flow), depth)
    known = np.asarray(np.isfinite(motion).all(-1))
    motion = np.where(known[..., None], motion, still)
    for _ in range(_STEPS):
        found, fits = sampled(-flow, depth_before, motion, expected)
        motion = np.where(fits[..., None], found, motion)
    found, fits = sampled(-flow, depth_before, motion, expected)
    agree = fits & (np.linalg.norm(found - motion, axis=-1) <= _CLOSE)
    return np.where((agree | known)[..., None], motion, still).astype(np.float32)


def composed(
    motion: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    between: np.ndarray,
    depth_between: np.ndarray,
    camera_between: Camera,
    before: Camera,
    steps: int = 1,
) -> np.ndarray:
    """Return the motion over one more frame (H, W, 2) float32: m₂(x) = m(x) + m′(x + m(x)).

    `motion`, over so many `steps`, `depth`, `camera` are of the frame itself; `between`, `depth_between`,
    `camera_between` of the frame that `motion` leads to; `before` is the camera of the one that `between` leads to. m′
    is interpolated between pixels of the same surface. Surfaces that were hidden in between move like static ones if
    they did until then, otherwise they continue their motion.
    """
    still, depth_still = static_motion(depth, camera, camera_between)
    motion, between = without_long(motion), without_long(between)
    found, fits = sampled(between, depth_between, motion, depth_still)
    with np.errstate(invalid="ignore"):
        stands = np.linalg.norm(motion - still, axis=-1) <= 1
    whole, _ = static_motion(depth, camera, before)
    hidden = np.where(stands[..., None] & np.isfinite(whole), whole, motion * (steps + 1) / steps)
    return np.where(fits[..., None], motion + found, hidden).astype(np.float32)


def without_long(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (H, W, 2) with NaN in place of those as long as the image's diagonal, which were never written and
    must not be mixed with others."""
    long = is_long(vectors)
    return np.where(long[..., None], vectors.dtype.type(np.nan), vectors) if long.any() else vectors


def sampled(
    values: np.ndarray, depths: np.ndarray, motion: np.ndarray, expected: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return `values` (H, W, 2) at x + `motion` (H, W, 2), bilinear over those of the four pixels whose depth fits
    `expected` (H, W), and whether there are any. Sky fits sky."""
    height, width = depths.shape
    at = centers(*motion.shape[:2]) + motion - 0.5
    at = np.where(np.isfinite(at), at, -1e9)
    corner = np.floor(np.clip(at, -1e9, 1e9)).astype(np.int64)
    part = at - corner
    total, weights = np.zeros(motion.shape), np.zeros(motion.shape[:2])
    for dy in (0, 1):
        for dx in (0, 1):
            x, y = corner[..., 0] + dx, corner[..., 1] + dy
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
            value = values[y, x]
            weight = np.abs(1 - dx - part[..., 0]) * np.abs(1 - dy - part[..., 1])
            fits = inside & same_surface(depths[y, x], expected) & np.isfinite(value).all(-1)
            weight = np.where(fits, np.maximum(weight, 1e-6), 0)
            total += np.where(fits[..., None], value, 0) * weight[..., None]
            weights += weight
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / weights[..., None], weights > 0


def same_surface(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return whether depths are those of one surface, to 5%; sky is one, too."""
    with np.errstate(invalid="ignore"):
        return (np.isinf(a) & np.isinf(b)) | (np.abs(a - b) <= _SAME_SURFACE * np.minimum(a, b))


def centers(height: int, width: int) -> np.ndarray:
    """Return the pixel centers (H, W, 2): x, y."""
    y, x = np.mgrid[:height, :width]
    return np.stack([x + 0.5, y + 0.5], -1)


def _depth_seen(depth: np.ndarray, camera: Camera, other: Camera, flow: np.ndarray) -> np.ndarray:
    """Return the depth (H, W) that pixels have in `other`, if they moved across the view only."""
    _, seen = static_motion(depth, camera, other)
    return np.where(np.isfinite(flow).all(-1), seen, np.nan)


def _splatted(flow: np.ndarray, seen: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return −flow (H, W, 2) at the pixels it leads to, for the surfaces in `depth`; NaN elsewhere.

    Each pixel goes to the four around its goal; those whose depth `seen` fits are averaged.
    """
    height, width = depth.shape
    to = centers(height, width) + flow - 0.5
    to = np.where(np.isfinite(to), to, -1e9)
    corner = np.floor(np.clip(to, -1e9, 1e9)).astype(np.int64)
    part = to - corner
    total, weights = np.zeros((height * width, 2)), np.zeros(height * width)
    for dy in (0, 1):
        for dx in (0, 1):
            x, y = corner[..., 0] + dx, corner[..., 1] + dy
            ok = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            index = np.where(ok, y * width + x, 0)
            ok &= same_surface(depth.ravel()[index], seen)
            weight = (np.abs(1 - dx - part[..., 0]) * np.abs(1 - dy - part[..., 1]) + 1e-6)[ok]
            np.add.at(weights, index[ok], weight)
            np.add.at(total, index[ok], -flow[ok] * weight[:, None])
    with np.errstate(invalid="ignore", divide="ignore"):
        return (total / weights[:, None]).reshape(height, width, 2)
