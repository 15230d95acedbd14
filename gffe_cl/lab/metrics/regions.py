"""Regions in which errors are counted: every pixel of a new frame belongs to one.

Disocclusions are the paper's three ('Disocclusions'): surfaces that a new frame shows and the rendered frame does not
lie *out of screen*, or behind something that stands still (*static*) or moves (*dynamic*). On built-in scenes that is
exact, from the renderer. On sequences without G-buffers of the new frame it comes from the pipeline's own masks: no
better than these, but the same for all methods.
"""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.frame.camera import Camera

# By label; where several would hold, the first does.
REGIONS = {
    "out of screen": "it shows something outside of the rendered frame",
    "static disocclusion": "hidden in the rendered frame behind something that stands still",
    "dynamic disocclusion": "hidden in the rendered frame behind something that moves",
    "silhouettes": "beside a step in depth",
    "dynamic": "surfaces that move by themselves",
    "focus": "shading is wrong although geometry is not (the paper's focus pixels)",
    "rest": "everything else",
}
_LABEL = {name: number for number, name in enumerate(REGIONS)}
_SAME_SURFACE = 0.02  # of the depth
_STEP = 0.1  # of the depth, from which two neighbors are two surfaces
_SKY = 1e7  # world units


def masks(labels: np.ndarray) -> dict[str, np.ndarray]:
    """Return masks (H, W) bool by name of the region, and "whole"."""
    found = {name: labels == number for name, number in _LABEL.items()}
    return found | {"whole": np.ones(labels.shape, bool)}


def labels_of(parts: dict[str, np.ndarray]) -> np.ndarray:
    """Return labels (H, W) uint8 of masks by name; the first of `REGIONS` wins."""
    labels = np.full(parts["dynamic"].shape, _LABEL["rest"], np.uint8)
    for name in reversed(REGIONS):
        if name in parts:
            labels[parts[name]] = _LABEL[name]
    return labels


def same_surface(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return whether depths are one surface's, to 2%; both infinite, or neither."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(b), np.isinf(a), np.abs(a - b) <= _SAME_SURFACE * np.abs(b))


def steps(depth: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: pixels with a neighbor, of four, at another depth."""
    found = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        a, b = (np.take(depth, range(k, depth.shape[axis] - 1 + k), axis) for k in (0, 1))
        with np.errstate(invalid="ignore"):
            step = np.where(np.isfinite(a) & np.isfinite(b), np.abs(a - b) > _STEP * np.minimum(a, b), a != b)
        step &= ~(np.isinf(a) & np.isinf(b))
        first = [slice(None)] * 2
        second = [slice(None)] * 2
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        found[tuple(first)] |= step
        found[tuple(second)] |= step
    return found


def shows(camera: Camera, width: int, height: int, world_pos: np.ndarray) -> np.ndarray:
    """Return (N,) bool: whether world positions (N, 3) lie before `camera` and within its image, hidden or not."""
    px, depth = camera.project(world_pos)
    with np.errstate(invalid="ignore"):
        return (depth > 0) & (px >= 0).all(-1) & (px < (width, height)).all(-1)


def world_positions(camera: Camera, depth: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return the world positions (N, 3) of the pixels of `mask`; sky is put very far away."""
    y, x = np.nonzero(mask)
    z = depth[mask].astype(np.float64)
    return camera.unproject(np.stack([x + 0.5, y + 0.5], -1), np.where(np.isinf(z), _SKY, z))
