"""NumPy forms of kernels whose arithmetic is a short formula: oracles of tests. recorded_bits.py holds the bits of all
kernels. Float32, in the kernels' order; constants are read from the kernels' sources."""

import numpy as np

from gffe_cl.engine.opencl.program import constants

F = np.float32
COLOR_MAX, KNEE = F(constants("common.h")["COLOR_MAX"]), F(constants("color_code.h")["KNEE"])
_TREND = constants("shading_trend.cl")
CODE_OFFSET = F(0.5)  # of color_code.h, at exposure 1; tests set it to 0 for linear light


def encode_color(c):
    """Return codes of colors."""
    c = np.asarray(c, F)
    if not CODE_OFFSET:
        return c
    size, white_root = np.abs(c), F(2) * CODE_OFFSET
    root = np.sqrt(size)
    dark = F(0.5) * size + CODE_OFFSET * root
    bright = KNEE * white_root * np.sqrt(white_root * root) - (KNEE - F(1)) * white_root * white_root
    return np.copysign(np.where(root > white_root, bright, dark), c)


def load_color(color):
    c = np.nan_to_num(color[..., :3].astype(F), nan=0.0, posinf=COLOR_MAX, neginf=-COLOR_MAX)
    return np.clip(c, -COLOR_MAX, COLOR_MAX)


def codes_of(color):
    """Return codes of an image's colors in half storage."""
    return encode_color(load_color(color)).astype(np.float16)


def centers(height, width):
    """Return (H, W, 2) float32 pixel centers."""
    y, x = np.mgrid[:height, :width].astype(F)
    return np.stack([x + F(0.5), y + F(0.5)], -1)


def doubled(plane):
    """Return an image interpolated to twice the size, pixel centers on one plane, borders repeated."""
    height, width = plane.shape
    y, x = np.mgrid[: 2 * height, : 2 * width]
    left, top = np.clip((x - 1) >> 1, 0, width - 1), np.clip((y - 1) >> 1, 0, height - 1)
    right, bottom = np.clip(((x - 1) >> 1) + 1, 0, width - 1), np.clip(((y - 1) >> 1) + 1, 0, height - 1)
    u, v = np.where(x & 1, F(0.25), F(0.75)), np.where(y & 1, F(0.25), F(0.75))
    a, b, c, d = plane[top, left], plane[top, right], plane[bottom, left], plane[bottom, right]
    return (F(1) - u) * (F(1) - v) * a + u * (F(1) - v) * b + (F(1) - u) * v * c + u * v * d


def find_trend(changes, spacing):
    """Return (4, h, w) as the blur of shading_trend.cl: means over the neighborhood of what is known, and the share
    that is."""
    around = _TREND["TREND_CELLS"]
    _, height, width = changes.shape
    padded = np.pad(changes, ((0, 0), *[(around * spacing,) * 2] * 2))
    changes = np.zeros_like(changes)
    for j, i in np.ndindex(2 * around + 1, 2 * around + 1):
        share = F((around + 1 - abs(j - around)) * (around + 1 - abs(i - around))) * F(1 / 81)
        changes += share * padded[:, j * spacing : j * spacing + height, i * spacing : i * spacing + width]
    share = np.maximum(changes[3], F(_TREND["LEAST_SHARE"]))
    return np.concatenate([changes[:3] / share, changes[3:]])
