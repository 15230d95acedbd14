"""NumPy twin of kernels/scene_cuts.h; `twins/__init__.py` describes all twins."""

from types import SimpleNamespace

import numpy as np

from gffe_cl.engine.opencl.program import constants
from twins.common import F, invalid, load_color, reproject

CUTS = SimpleNamespace(**{n: F(v) if isinstance(v, float) else v for n, v in constants("scene_cuts.h").items()})


def _brightness(color, x, y):
    c = np.maximum(load_color(color)[y, x], F(0))
    return (c[..., 0] + c[..., 1]) + c[..., 2]


def _contrast(color, x, y, dx, dy):
    a, b = _brightness(color, x - dx, y - dy), _brightness(color, x + dx, y + dy)
    return (b - a) / ((a + b) + CUTS.TOO_DARK)


def _depth_before(px, px_prev, mv, z, to_previous):
    static = reproject(px, z, to_previous)
    off = static[..., :2] - px_prev
    most = CUTS.STATIC_PX + CUTS.STATIC_SHARE * (np.abs(mv[..., 0]) + np.abs(mv[..., 1]))
    is_static = (static[..., 2] > 0) & (off[..., 0] * off[..., 0] + off[..., 1] * off[..., 1] <= most * most)
    return np.where(is_static & ~np.isinf(z), static[..., 2], z)


def _depth_is_right(px_prev, expected, depth_prev):
    """Return (compared, right) of samples that land inside."""
    height, width = depth_prev.shape
    first = np.floor(px_prev - F(0.5)).astype(int)
    taps = np.stack(
        [
            depth_prev[np.clip(first[:, 1] + j, 0, height - 1), np.clip(first[:, 0] + i, 0, width - 1)]
            for j in (0, 1)
            for i in (0, 1)
        ]
    )
    sky = np.isposinf(taps)
    nearest = np.where(invalid(taps), np.inf, taps).min(0)
    farthest = np.where(invalid(taps), 0, taps).max(0)
    tolerance = CUTS.DEPTH_AGREES
    near_enough = nearest <= expected * (F(1) + tolerance)
    right = np.where(np.isinf(expected), sky.any(0), near_enough & (farthest >= expected * (F(1) - tolerance)))
    return ~(np.isinf(expected) & sky.all(0)), right


def counts(color, depth, motion, color_prev, depth_prev, to_previous, camera_step):
    """Return the counts of the samples, (7,) in the order of the kernel's enum."""
    height, width = depth.shape
    columns, rows = min(width, CUTS.SAMPLES_X), min(height, CUTS.SAMPLES_Y)
    x = (2 * np.arange(columns) + 1) * width // (2 * columns)
    y = (2 * np.arange(rows) + 1) * height // (2 * rows)
    x, y = (a.ravel() for a in np.meshgrid(x, y))
    x, y = (a[~invalid(depth[y, x])] for a in (x, y))
    z, mv = depth[y, x], motion[y, x]
    found = dict.fromkeys(("valid", "passed"), 0)
    found["valid"], found["passed"] = len(z), int((z < F(camera_step)).sum())
    px = np.stack([x, y], -1).astype(F) + F(0.5)
    px_prev = px + mv
    inside = ((px_prev >= 0) & (px_prev < np.array([width, height], F))).all(-1)
    x, y, z, mv, px, px_prev = (a[inside] for a in (x, y, z, mv, px, px_prev))
    found["inside"] = len(z)
    compared, right = _depth_is_right(px_prev, _depth_before(px, px_prev, mv, z, to_previous), depth_prev)
    found["compared"], found["depth_right"] = int(compared.sum()), int((compared & right).sum())

    x_prev, y_prev = px_prev.astype(int).T
    arm = CUTS.ARM
    use = compared & right
    for u, v in ((x, y), (x_prev, y_prev)):
        use &= (u >= arm) & (v >= arm) & (u < width - arm) & (v < height - arm)
    x, y, x_prev, y_prev = (a[use] for a in (x, y, x_prev, y_prev))
    found["with_contrast"] = found["contrast_right"] = 0
    for dx, dy in ((arm, 0), (0, arm)):
        now, before = _contrast(color, x, y, dx, dy), _contrast(color_prev, x_prev, y_prev, dx, dy)
        most = np.maximum(np.abs(now), np.abs(before))
        some = most > CUTS.CONTRAST_LEAST
        found["with_contrast"] += int(some.sum())
        found["contrast_right"] += int((some & (np.abs(now - before) <= CUTS.CONTRAST_AGREES * most)).sum())
    return found
