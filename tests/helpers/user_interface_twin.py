"""The twin of kernels/user_interface.cl."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.frame.rendered_frame import HALF_MAX
from gffe_cl.engine.opencl.program import constants

_C = {name: np.float32(value) for name, value in constants("user_interface.cl").items()}
PAIRS, LEAST, AROUND = (int(_C[name]) for name in ("PAIRS", "LEAST_MARKED", "MARKED_AROUND"))


def count_evidence(
    evidence: np.ndarray,
    color: np.ndarray,
    color_prev: np.ndarray,
    depth: np.ndarray,
    depth_prev: np.ndarray,
    motion: np.ndarray,
    exposure: float,
) -> np.ndarray:
    """Return the evidence (H, W) uint8 of user interface after a frame, from that before it. Colors (H, W, 3 or 4),
    depths (H, W) and motion (H, W, 2) as of `RenderedFrame`; `…_prev`: of the frame before."""
    here, before = (_exposed(image, exposure) for image in (color, color_prev))
    counted = np.where(_is_within(here, before, "SAME"), evidence, 0).astype(np.uint8)
    with np.errstate(invalid="ignore"):
        length = np.fmax(np.abs(motion[..., 0]), np.abs(motion[..., 1]))
        y, x = np.nonzero(_is_within(here, before, "SAME") & (length >= _C["MOVES"]) & (evidence < PAIRS))
        c, z, mv = here[y, x], depth[y, x], motion[y, x]
        center = np.stack([x, y], -1).astype(np.float32) + np.float32(0.5)
        there, holds = _pixels(center + mv, depth.shape)
        stays = holds & _is_one_surface(z, depth_prev[there]) & ~_is_within(before[there], c, "CLEAR")
        there, holds = _pixels(center - mv, depth.shape)
        apart = np.abs(motion[there] - mv)
        holds &= np.fmax(apart[:, 0], apart[:, 1]) <= _C["STAYING_MOTION"] * length[y, x]
        stays |= holds & _is_one_surface(z, depth[there]) & ~_is_within(here[there], c, "CLEAR")
    counted[y, x] += stays
    return counted


def user_interface_mask(evidence: np.ndarray) -> np.ndarray:
    """Return the mask (H, W) bool of a user interface by its evidence (H, W)."""
    sure = evidence == PAIRS
    sure &= window_sums(sure, AROUND) >= LEAST
    return window_sums(sure, 1) > 0


def window_sums(mask: np.ndarray, reach: int) -> np.ndarray:
    """Return (H, W) int: for each pixel how many of those up to `reach` away in x and y are set in `mask` (H, W)."""
    height, width = mask.shape
    padded = np.pad(mask.astype(np.int16), reach)
    steps = range(2 * reach + 1)
    rows = np.sum([padded[y : y + height] for y in steps], 0)
    return np.sum([rows[:, x : x + width] for x in steps], 0)


def _exposed(color: np.ndarray, exposure: float) -> np.ndarray:
    linear = np.nan_to_num(np.asarray(color)[..., :3].astype(np.float32), nan=0.0, posinf=HALF_MAX, neginf=-HALF_MAX)
    return np.maximum(np.clip(linear, -HALF_MAX, HALF_MAX) * np.float32(exposure), np.float32(0))


def _is_within(a: np.ndarray, b: np.ndarray, most: str) -> np.ndarray:
    apart = a - b
    return np.all(apart * apart <= _C[most] * (np.maximum(a, b) + _C["LINEAR_BELOW"]), -1)


def _pixels(places: np.ndarray, shape: tuple[int, ...]) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Return the indices (N,) of the pixels at `places` (N, 2), 0 where they are beyond the image, and whether they are
    within."""
    holds = np.all((places >= 0) & (places < np.array(shape[::-1], np.float32)), -1)
    found = np.where(holds[:, None], places, np.float32(0)).astype(int)
    return (found[:, 1], found[:, 0]), holds


def _is_one_surface(z: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.where(np.isinf(z), np.isinf(other), np.abs(other - z) <= _C["STAYING_DEPTH"] * z)
