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


def count_geometry(depth, motion):
    """How many depths are NaN or not positive, and how many motion vectors are not finite."""
    return (~(depth > 0)).sum(), (~np.isfinite(motion).all(-1)).sum()
