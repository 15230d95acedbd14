"""Depth and motion as an engine stores them: the inverse of the conversion that a `FrameFormat` describes, without its
code."""

from dataclasses import replace

import numpy as np

from gffe_cl.captures.sequence.encoding import nearest_motion

FAR = 1e9  # stands for sky, which only turns


def static_motion(frame, before):
    """Return where points at rest were in `before`, less where they are: (H, W, 2) float64, pixels."""
    height, width = frame.depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    px, z = np.stack([x, y], -1), np.where(np.isinf(frame.depth), FAR, frame.depth.astype(np.float64))
    return before.camera.project(frame.camera.unproject(px, z))[0] - px


def sampled(n, m):
    """Return which of `n` pixels are the samples of `m`, and by how much of these the samples are shifted."""
    ratio = n // m
    first = (ratio - 1) // 2
    return np.arange(m) * ratio + first, 0.5 - (first + 0.5) / ratio


def stored(frame, before, format, size=None, jitter=(0.0, 0.0), jitter_before=(0.0, 0.0)):
    """Return `frame`, in our conventions and after `before`, as `format` describes it, of `size` (width, height): every
    pixel or every second or third one. `jitter`: of this frame and the one before, pixels of color, which motion
    includes if `format` says so; samples that are no pixels' centers are jitter, too."""
    height, width = frame.depth.shape
    columns, rows = size or format.geometry_size or (width, height)
    (x, shift_x), (y, shift_y) = sampled(width, columns), sampled(height, rows)
    ratio = np.array((width / columns, height / rows))
    shift = np.array((shift_x, shift_y)) * ratio  # of all frames alike
    own = tuple(((shift + jitter) / ratio).tolist())
    motion = None if frame.motion is None else _motion(frame, before, format, ratio, jitter, jitter_before)
    depth = frame.depth if format.depth != "distance" else frame.depth * _stretch(frame)
    color = srgb_of_linear(frame.color) if format.color_encoding == "srgb" else frame.color
    motion = None if motion is None else motion[np.ix_(y, x)].astype(np.float32)
    up = slice(None, None, -1 if format.rows == "up" else 1)
    depth = _depth(depth, format)[np.ix_(y, x)][up]
    return replace(
        frame, color=color[up], depth=depth, motion=None if motion is None else motion[up], geometry_jitter=own
    )


def _stretch(frame):
    """Return distance along the ray per planar depth (H, W)."""
    height, width = frame.depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    return np.linalg.norm(
        frame.camera.unproject(np.stack([x, y], -1), np.ones((height, width))) - frame.camera.position, axis=-1
    )


def srgb_of_linear(color):
    """Return sRGB of linear color, as halves for color in halves."""
    color, dtype = np.maximum(color.astype(np.float64), 0), color.dtype
    return np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055).astype(dtype)


def _depth(depth, format):
    """Return stored depth (H, W) float32 of planar depth; depth buffers hold nothing beyond their range."""
    (low, high), z, near, far = format.depth_range, depth.astype(np.float64), format.near_z, format.far_z
    added = 0 if near else 1  # of logarithms
    laws = {"device": lambda z: 1 / z, "logarithmic": lambda z: np.log(z + added)}
    law, is_planes = laws.get(format.depth, lambda z: z), format.depth in laws
    z = z / format.depth_scale
    with np.errstate(divide="ignore"):
        z, near, far = (law(np.float64(value)) for value in (z, near, far))
    made = low + (z - near) / (far - near) * (high - low)
    return (np.clip(made, min(low, high), max(low, high)) if is_planes else made).astype(np.float32)


def _motion(frame, before, format, ratio, jitter, jitter_before):
    """Return stored motion (H, W, 2) of motion in pixels of color."""
    moved = frame.motion.astype(np.float64)
    height, width = moved.shape[:2]
    static = static_motion(frame, before) if before else np.zeros_like(moved)
    rests = np.abs(moved - static).max(-1) < 1e-2
    if format.camera_motion == "excluded":
        moved = np.where(np.isinf(frame.depth)[..., None], 0, moved - static)
    if format.motion_dilated:
        moved = nearest_motion(moved, frame.depth)
    if format.motion_jittered:
        moved = moved - jitter + np.array(jitter_before)
    unit = {"pixels": ratio, "color_pixels": 1, "uv": (width, height), "ndc": (width / 2, height / 2)}
    vectors = moved / np.array(unit[format.motion_unit])
    vectors = vectors * {"to_previous": 1, "from_previous": -1}[format.motion_direction]
    vectors = vectors * (1, {"down": 1, "up": -1}[format.motion_y])
    vectors = (vectors - format.motion_offset) / format.motion_scale
    unwritten = {"included": np.arange(height)[:, None] < 2 * ratio[1], "movers_only": rests, "excluded": False}
    if format.motion_invalid is not None:
        vectors[np.broadcast_to(unwritten[format.camera_motion], rests.shape)] = format.motion_invalid
    return vectors
