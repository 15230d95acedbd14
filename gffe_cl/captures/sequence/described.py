"""Conversion of rendered frames that a `FrameFormat` describes to our conventions, on the host: of sequences on disk,
and for the doctor. The pipeline converts on the device."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat, conversion
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, type_of


def described_frame(
    frame: RenderedFrame, format: FrameFormat, previous: Camera | None, previous_jitter: tuple[float, float]
) -> RenderedFrame:
    """Return `frame` of NumPy arrays in our conventions: depth and motion in float32, color in floats. `previous`: the
    render camera of the frame before; None if there is none. `previous_jitter`: of its geometry, pixels.

    Raises GffeError where vectors lack the camera's motion and a frame has no camera.
    """
    height, width = np.shape(frame.depth)
    motion_type = None if frame.motion is None else type_of(frame.motion)
    types = {"color": None, "depth": type_of(frame.depth), "motion": motion_type}
    jitters = frame.geometry_jitter, previous_jitter if previous else frame.geometry_jitter
    given = conversion(format, (width, height), types, {"color": 3, "motion": 2}, *jitters)
    depth = _depth(_values(frame.depth), given)
    color = frame.color
    if color.dtype.kind != "f":
        color = (color / np.float64(np.iinfo(color.dtype).max)).astype(np.float32)
    if frame.motion is None:
        return replace(frame, color=color, depth=depth.astype(np.float32))
    stored, (*factors, x, y) = frame.motion.astype(np.float64), given["given_motion"]
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
        vectors = np.where(added, vectors + _camera_motion(depth, frame.camera, previous), vectors)
    with np.errstate(over="ignore"):
        return replace(frame, color=color, depth=depth.astype(np.float32), motion=vectors.astype(np.float32))


def _values(depth: np.ndarray) -> np.ndarray:
    """Return stored depth (H, W) in float64: of 32-bit integers the low 24 bits."""
    return (depth & 0xFFFFFF if depth.dtype == np.uint32 else depth).astype(np.float64)


def _depth(stored: np.ndarray, given: dict) -> np.ndarray:
    """Return planar depth (H, W), of device depth sky beyond its range or at the far end."""
    factor, origin, addend, sky = given["given_depth"]
    with np.errstate(all="ignore"):
        value = factor * (stored - origin) + addend
        if not given["depth_is_device"]:
            return value
        return np.where((stored == np.float32(sky)) | (value <= 0), math.inf, 1 / value)


def _camera_motion(depth: np.ndarray, camera: Camera, previous: Camera) -> np.ndarray:
    """Return the motion (H, W, 2) of static points, pixels: 0 where depth is invalid, NaN behind the camera before."""
    height, width = depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    here, sky = np.stack([x, y], -1), np.isinf(depth)
    known = depth > 0
    turned = np.linalg.norm(camera.position - previous.position)
    far = 1e12 * (1 + turned)  # sky turns and does not move
    points = camera.unproject(here, np.where(known, np.where(sky, far, depth), 1.0))
    before, front = previous.project(points)
    moved = np.where((front > 0)[..., None], before - here, np.nan)
    return np.where(known[..., None], moved, 0.0)
