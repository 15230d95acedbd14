"""Twin of upload.cl."""

import numpy as np

from twins.common import COLOR_MAX, F


def convert_color(color):
    """(H, W, 4) float16 from (H, W, 3 or 4) half or float, with 0 in the fourth channel; how many pixels hold NaN or
    infinity; and how many were clamped."""
    rgb = color[..., :3].astype(F)
    finite = np.isfinite(rgb)
    over = finite & (np.abs(rgb) > COLOR_MAX)
    out = np.zeros((*color.shape[:2], 4), np.float16)
    out[..., :3] = np.where(np.isnan(rgb), F(0), np.minimum(np.maximum(rgb, -COLOR_MAX), COLOR_MAX))
    return out, (~finite).any(-1).sum(), over.any(-1).sum()


def convert_geometry(depth, motion):
    """Depth without denormal numbers and with sky beyond 1e37, motion without vectors as long as the diagonal, and how
    many depths are invalid, how many vectors not finite, how many depths too far, and how many vectors too long."""
    invalid, far = ~(depth >= np.finfo(F).tiny), np.isfinite(depth) & (depth > 1e37)
    finite = np.isfinite(motion).all(-1)
    with np.errstate(over="ignore", invalid="ignore"):
        short = np.square(motion).sum(-1, dtype=F) < np.square(depth.shape, dtype=F).sum(dtype=F)
    converted = np.where(far, F(np.inf), np.where(invalid & (depth >= 0), F(0), depth))
    unwritten = finite & ~short
    vectors = np.where(unwritten[..., None], F(np.nan), motion)
    return converted, vectors, (invalid.sum(), (~finite).sum(), far.sum(), unwritten.sum())
