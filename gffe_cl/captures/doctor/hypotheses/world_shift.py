"""Shifts of the world's origin between two frames: cameras jump, while vectors and colors go on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search
from gffe_cl.engine.frame.camera import Camera

_DRAWS, _DRAWN, _ROUNDS = 32, 6, 6  # tries, samples of each, and steps
_CORE, _FINEST = 0.4, 1e-6  # quantile of residuals that sets their scale, and pixels: smaller ones are equal
_ALIKE, _ALIKE_PX = 1.2, 1e-3  # times the residual, and pixels: a shift in fewer digits may leave more
_DIGITS = 7  # after the point


@dataclass(frozen=True)
class Shift:
    """Change of the world's space. `matrix` (4, 4): from the coordinates before the frame to those from it on."""

    matrix: np.ndarray

    def is_undone_by(self, other: Shift) -> bool:
        """Return whether another shift leads back, up to a tenth."""
        rest, own = other.matrix @ self.matrix - np.eye(4), self.matrix - np.eye(4)
        parts = slice(None, 3), slice(3, None)  # of rotation, and of translation
        return all(np.linalg.norm(rest[:3, part]) <= 0.1 * np.linalg.norm(own[:3, part]) for part in parts)

    def __str__(self) -> str:
        moved = "moved by (" + ", ".join(f"{value + 0.0:.8g}" for value in self.matrix[:3, 3].round(6)) + ")"
        if (self.matrix[:3, :3] == np.eye(3)).all():
            return moved
        angle = np.degrees(np.arccos(np.clip((np.trace(self.matrix[:3, :3]) - 1) / 2, -1, 1)))
        return f"turned by {angle:.4g}° and {moved}"


def world_shift(search: Search, reading: Reading, earlier: Camera | None, most: float, share: float) -> Shift | None:
    """Return the shift of the world that makes vectors of the only look of `search` fit depth and cameras: a
    translation or, if that does not do, with a rotation; None unless `share` of the samples then agree to `most`
    pixels. `earlier`: camera two frames before, None if it is not known: the camera probably goes on as it went."""
    look = search.full.looks[0]
    here, before = (reading.camera.read(camera) for camera in (look.camera, look.camera_of(PREVIOUS)))
    vectors = search.full.motion(reading.motion)
    ray = search.full.reach(reading.camera, PREVIOUS).ray
    w = reading.depth.inverse(search.full.stored, ray)
    use = search.full.solid & np.isfinite(vectors).all(-1) & np.isfinite(w)
    if not use.any():
        return None
    target = ((search.full.px + vectors)[use] - (before.cx, before.cy)) / (before.fx, before.fy)
    given = here.to_view_of(before)
    for turns in (False, True):
        start = np.eye(4) if earlier is None else before.to_view_of(reading.camera.read(earlier))
        if not turns:
            start[:3, :3] = given[:3, :3]
        moved = fitted_motion(start, turns, ray[use], w[use], target, before.fx)
        off = residuals(moved, ray[use], w[use], target, before.fx)
        if (off <= most).mean() >= share:
            matrix = np.linalg.inv(here.world_to_view) @ np.linalg.inv(moved) @ before.world_to_view
            if not turns:
                matrix[:3, :3] = np.eye(3)
                matrix = _in_few_digits(matrix, here, before, (ray[use], w[use], target, before.fx))
            return Shift(matrix)
    return None


def _seen(moved: np.ndarray, ray: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return view positions (N, 3), times 1 / depth, after the motion (4, 4)."""
    return ray @ moved[:3, :3].T + w[:, None] * moved[:3, 3]


def residuals(moved: np.ndarray, ray: np.ndarray, w: np.ndarray, target: np.ndarray, focal: float) -> np.ndarray:
    """Return residuals (N,) in pixels; large behind the camera."""
    v = _seen(moved, ray, w)
    with np.errstate(all="ignore"):
        off = focal * np.linalg.norm(v[:, :2] / v[:, 2:] - target, axis=-1)
    return np.where(v[:, 2] > 1e-6, off, 1e9)


def fitted_motion(start: np.ndarray, turns: bool, ray: np.ndarray, w: np.ndarray, target: np.ndarray, focal: float):
    """Return the motion (4, 4) from view to view that fits most targets (N, 2): the best one of some samples, refined
    with all. Without `turns` the rotation is that of `start`."""
    rng, found, least = np.random.default_rng(7), start, np.inf
    for _ in range(_DRAWS):
        few = rng.integers(len(w), size=_DRAWN)
        moved = start
        for _ in range(_ROUNDS):
            moved = _step(moved, turns, ray[few], w[few], target[few], np.ones(_DRAWN))
        badness = float(np.log(residuals(moved, ray, w, target, focal) + _FINEST).mean())
        found, least = (moved, badness) if badness < least else (found, least)
    for _ in range(2 * _ROUNDS):
        off = residuals(found, ray, w, target, focal)
        weight = 1 / (1 + (off / max(float(np.quantile(off, _CORE)), _FINEST)) ** 2) ** 2
        found = _step(found, turns, ray, w, target, weight)
    return found


def _step(moved: np.ndarray, turns: bool, ray: np.ndarray, w: np.ndarray, target: np.ndarray, weight: np.ndarray):
    """Return the motion (4, 4) after a step of weighted least squares."""
    v = _seen(moved, ray, w)
    z = np.maximum(v[:, 2], 1e-6)
    u = v[:, :2] / z[:, None]
    by_translation = np.broadcast_to(np.eye(3), (len(v), 3, 3)) * w[:, None, None]
    by = np.concatenate([by_translation, -_crosses(v)], -1) if turns else by_translation
    slopes = (by[:, :2] - u[..., None] * by[:, 2:]) / z[:, None, None]
    normal = np.einsum("n,nij,nik->jk", weight, slopes, slopes)
    right = np.einsum("n,nij,ni->j", weight, slopes, target - u)
    step = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
    change = np.eye(4)
    change[:3, 3] = step[:3]
    if turns:
        left, _, back = np.linalg.svd(np.eye(3) + _crosses(step[None, 3:])[0])
        change[:3, :3] = left @ back
    return change @ moved


def _crosses(v: np.ndarray) -> np.ndarray:
    """Return the matrices (N, 3, 3) that multiply by v (N, 3) ×."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)


def _in_few_digits(matrix: np.ndarray, here, before, evidence: tuple) -> np.ndarray:
    """Return the translation `matrix` with as few digits after the point as fit about as well."""

    def residual(tried: np.ndarray) -> float:
        moved = before.world_to_view @ np.linalg.inv(tried) @ np.linalg.inv(here.world_to_view)
        return float(np.median(np.nan_to_num(residuals(moved, *evidence), nan=np.inf)))

    for digits in range(_DIGITS):
        tried = np.round(matrix, digits)
        if residual(tried) <= _ALIKE * residual(matrix) + _ALIKE_PX:
            return tried
    return matrix
