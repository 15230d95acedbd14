"""Warping of pictures by motion in pixels, without geometry, for baselines. NumPy, whole images at a time."""

from __future__ import annotations

from typing import Any

import numpy as np

_SAME_LAYER = 0.05  # of the depth: surfaces within one pixel that are mixed


def pixel_centers(height: int, width: int) -> np.ndarray:
    """Return the pixel centers (H, W, 2) float32: x, y."""
    y, x = np.mgrid[:height, :width].astype(np.float32) + np.float32(0.5)
    return np.stack([x, y], -1)


def sample(image: np.ndarray, place: np.ndarray, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Sample `image` (H, W, C) at `place` (h, w, 2) pixels, bilinear, the border repeated. Only taps where `mask` (4,
    h, w), in reading order, is set count. Return (h, w, C) float32, and the weight (h, w) of the taps that counted."""
    height, width = image.shape[:2]
    finite = np.where(np.isfinite(place), place, -1e6) - np.float32(0.5)
    low = np.floor(finite).astype(np.int64)
    part = (finite - low).astype(np.float32)
    total = np.zeros((*place.shape[:2], image.shape[2]), np.float32)
    weights = np.zeros(place.shape[:2], np.float32)
    for tap in range(4):
        dx, dy = tap & 1, tap >> 1
        weight = (part[..., 0] if dx else 1 - part[..., 0]) * (part[..., 1] if dy else 1 - part[..., 1])
        if mask is not None:
            weight = weight * mask[tap]
        y, x = np.clip(low[..., 1] + dy, 0, height - 1), np.clip(low[..., 0] + dx, 0, width - 1)
        total += weight[..., None] * image[y, x]
        weights += weight
    return total / np.maximum(weights, 1e-6)[..., None], weights


def sample_sharp(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return cubic samples (Catmull-Rom), within the range of the four nearest taps, the border repeated: (h, w, C)
    float32."""
    height, width = image.shape[:2]
    finite = np.where(np.isfinite(place), place, -1e6) - np.float32(0.5)
    low = np.floor(finite).astype(np.int64)
    t = (finite - low).astype(np.float32)
    one = np.stack([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2]) / 2
    total = np.zeros((*place.shape[:2], image.shape[2]), np.float32)
    least, most = np.full_like(total, np.inf), np.full_like(total, -np.inf)
    for k in range(16):
        dx, dy = k & 3, k >> 2
        y, x = np.clip(low[..., 1] + dy - 1, 0, height - 1), np.clip(low[..., 0] + dx - 1, 0, width - 1)
        value = image[y, x]
        total += (one[dx, ..., 0] * one[dy, ..., 1])[..., None] * value
        if dx in (1, 2) and dy in (1, 2):
            least, most = np.minimum(least, value), np.maximum(most, value)
    return np.clip(total, least, most)


def taps(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the four neighbors (4, h, w) of `place` in `image` (H, W), in reading order, the border repeated."""
    height, width = image.shape
    low = np.floor(np.where(np.isfinite(place), place, -1e6) - 0.5).astype(np.int64)
    return np.stack(
        [
            image[np.clip(low[..., 1] + (t >> 1), 0, height - 1), np.clip(low[..., 0] + (t & 1), 0, width - 1)]
            for t in range(4)
        ]
    )


def splat(place: np.ndarray, depth: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Carry `values` (H, W, C) of every pixel to `place` (H, W, 2), onto the four pixels around. The nearest `depth`
    (H, W) wins; surfaces within 5% of it are mixed by their share of the pixel. Return (H, W, C) float32, and (H, W)
    bool of the pixels reached."""
    height, width = depth.shape
    finite = np.isfinite(place).all(-1) & ~np.isnan(depth)
    at, z, carried = place[finite] - np.float32(0.5), depth[finite].astype(np.float32), values[finite]
    z = np.minimum(z, np.float32(1e30))
    low = np.floor(np.clip(at, -2, (width + 1, height + 1))).astype(np.int64)
    part = at - low
    where, share, source = [], [], []
    for tap in range(4):
        dx, dy = tap & 1, tap >> 1
        x, y = low[:, 0] + dx, low[:, 1] + dy
        weight = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (weight > 0.02)
        where.append((y * width + x)[inside])
        share.append(weight[inside])
        source.append(np.nonzero(inside)[0])
    where, share, source = (np.concatenate(parts) for parts in (where, share, source))
    nearest = np.full(height * width, np.inf, np.float32)
    np.minimum.at(nearest, where, z[source])
    front = z[source] <= nearest[where] * np.float32(1 + _SAME_LAYER)
    where, share, source = where[front], share[front], source[front]
    weights = np.bincount(where, share, height * width)
    sums = [np.bincount(where, share * carried[source, c], height * width) for c in range(values.shape[2])]
    mixed = np.stack(sums, -1) / np.maximum(weights, 1e-9)[:, None]
    return mixed.reshape(height, width, -1).astype(np.float32), (weights > 0).reshape(height, width)


def filled(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return `values` (H, W, C) with those of the nearest known pixel where `known` (H, W) is not set."""
    if known.all() or not known.any():
        return values
    from scipy.ndimage import distance_transform_edt

    nearest: Any = distance_transform_edt(~known, return_distances=False, return_indices=True)
    y, x = nearest
    return values[y, x]
