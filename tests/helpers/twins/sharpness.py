"""Twin of sharpness.cl."""

import numpy as np

from twins.common import F, cubic_of, invalid, kernel_constants, reproject, white

SHARPNESS = kernel_constants("sharpness.cl")


def _luma(color):
    """Return the luminance (…, 1) of colors in its code."""
    r, g, b = (color[..., k].astype(F) for k in range(3))
    with np.errstate(invalid="ignore"):
        light = (F(0.25) * r + F(0.5) * g + F(0.25) * b) / white()
    dark = F(1) - np.fmin(np.fmax(light, F(0)), F(1))
    return (F(1) - dark**4)[..., None]


def compare(color, depth, motion, dynamic, color_prev, depth_prev, to_previous):
    """Return the sums (explained, changed) over the samples of a rendered frame."""
    height, width = depth.shape
    columns, rows = min(width, SHARPNESS.SAMPLES_X), min(height, SHARPNESS.SAMPLES_Y)
    y, x = (
        n.ravel()
        for n in np.meshgrid(
            (2 * np.arange(rows) + 1) * height // (2 * rows),
            (2 * np.arange(columns) + 1) * width // (2 * columns),
            indexing="ij",
        )
    )
    z = depth[y, x]
    use = ~invalid(z) & ~np.isinf(z)
    center = np.stack([x, y], -1).astype(F) + F(0.5)
    static = reproject(center, np.where(use, z, F(1)), to_previous)
    moved = np.concatenate([center + motion[y, x], z[:, None]], -1)
    px = np.where((dynamic[y, x] == SHARPNESS.STATIC)[:, None], static, moved)
    with np.errstate(invalid="ignore"):
        use &= (px[:, 2] > 0) & ((px[:, :2] >= 0) & (px[:, :2] < (width, height))).all(-1)
    px = np.where(use[:, None], px, F(0))
    first = np.floor(px[:, :2] - F(0.5))
    u, v = np.moveaxis(px[:, :2] - F(0.5) - first, -1, 0)
    left, top = np.moveaxis(first.astype(int), -1, 0)
    use &= (left >= 1) & (top >= 1) & (left < width - 2) & (top < height - 2)
    x, y, left, top, u, v, met = (a[use] for a in (x, y, left, top, u, v, px[:, 2]))
    same = np.ones(len(x), bool)
    with np.errstate(invalid="ignore"):
        for k in range(4):
            there = depth_prev[top + (k >> 1), left + (k & 1)]
            same &= np.abs(there - met) <= SHARPNESS.SAME_SHAPE * met
    x, y, left, top, u, v = (a[same] for a in (x, y, left, top, u, v))
    before = _luma(color_prev)
    taps = {(ty, tx): before[top + ty - 1, left + tx - 1] for ty in range(4) for tx in range(4)}
    plain, sharp = (cubic_of(taps, u, v, F(k), F(1)) for k in (0, 1))
    off, change = _luma(color)[y, x] - plain, sharp - plain
    return float((off * change).sum()), float((change * change).sum())
