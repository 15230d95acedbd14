"""Estimation of the focal length of a capture. Only rotation determines it: translation looks the same through any
lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gffe_cl.captures.calibration.correspondences import Correspondences
from gffe_cl.captures.calibration.pose import (
    Lens,
    Movement,
    advanced,
    cost,
    fit,
    moved,
    reach_of,
    refine,
    residuals,
    slopes,
    weights,
)

FIRST_VIEW = 60.0  # degrees, horizontally: with it the pairs that turn most are looked for
LEAST_TURN = 5.0  # degrees in all
MOST_DEVIATION = 0.003  # relative
_VIEWS = (14.0, 20.0, 28.0, 38.0, 49.0, 60.0, 73.0, 88.0, 104.0, 120.0, 136.0)
_SPREAD = 24  # pairs at most, evenly over the capture
_SEARCHED, _SEARCH_SAMPLES = 6, 400  # pairs that turn most, and samples of each, for the search
_SAMPLES = 1000  # of a pair, for the refinement
_SAME = 0.02  # relative change of the lens that does not affect the static samples


def lens_of_view(degrees: float, size: tuple[int, int], center: np.ndarray, aspect: float) -> Lens:
    """Return the lens that shows so many degrees across an image of `size` (width, height)."""
    return Lens(size[0] / (2 * np.tan(np.radians(degrees) / 2)) / aspect, center, aspect)


def view_of_lens(lens: Lens, size: tuple[int, int]) -> float:
    """Return the field of view of `lens` in degrees across an image of `size` (width, height)."""
    return float(np.degrees(2 * np.arctan(size[0] / (2 * lens.focals[0]))))


def find_focal(
    pairs: Sequence[Correspondences], size: tuple[int, int], center: np.ndarray, aspect: float
) -> tuple[Lens, float]:
    """Return the lens that explains all pairs best, each pair with a camera movement of its own; and the relative
    standard deviation of its focal length as estimated from noise, infinite if it is undetermined."""
    rng = np.random.default_rng(0)
    evenly = np.unique(np.linspace(0, len(pairs) - 1, _SPREAD).astype(int))
    chosen = [pairs[k].some(_SAMPLES, rng) for k in evenly]
    first = lens_of_view(FIRST_VIEW, size, center, aspect)
    turned = [fit(seen, first).degrees for seen in chosen]
    most = [chosen[k].some(_SEARCH_SAMPLES, rng) for k in np.argsort(turned)[::-1][:_SEARCHED]]
    lenses = [lens_of_view(view, size, center, aspect) for view in _VIEWS]
    lens = min(lenses, key=lambda lens: sum(float(cost(seen, lens, fit(seen, lens))) for seen in most))
    for _ in range(3):  # movers are recognizable only with a nearly correct lens
        before = lens
        lens, deviation = _refined(chosen, lens, [fit(seen, lens) for seen in chosen])
        if abs(lens.focal / before.focal - 1) < _SAME:
            break
    return lens, deviation


def _refined(
    pairs: Sequence[Correspondences], lens: Lens, movements: list[Movement], rounds: int = 15
) -> tuple[Lens, float]:
    """Return the lens and the relative deviation of its focal length, refined together with the movements by
    Gauss-Newton."""
    total = 0.0
    for _ in range(rounds):
        total, slope_total, eliminated = 0.0, 0.0, []
        for seen, movement in zip(pairs, movements, strict=True):
            normal, right, weight = _normal_equations(seen, lens, movement)
            inverse = np.linalg.inv(normal[:6, :6] + 1e-9 * np.trace(normal[:6, :6]) * np.eye(6))
            carried = normal[6, :6] @ inverse
            total += (normal[6, 6] - carried @ normal[:6, 6]) * weight
            slope_total += (right[6] - carried @ right[:6]) * weight
            eliminated.append((inverse, normal[:6, 6], right[:6]))
        step = float(np.clip(-slope_total / max(total, 1e-300), -0.1, 0.1))
        lens = replace(lens, focal=lens.focal * np.exp(step))
        movements = [
            advanced(movement, -inverse @ (right + coupling * step))
            for movement, (inverse, coupling, right) in zip(movements, eliminated, strict=True)
        ]
        movements = [refine(seen, lens, m, rounds=2) for seen, m in zip(pairs, movements, strict=True)]
        if abs(step) < 1e-5:
            break
    return lens, float(1 / np.sqrt(max(total, 1e-300)))


def _normal_equations(seen: Correspondences, lens: Lens, movement: Movement) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the normal equations of the movement and the logarithm of the focal length, (7, 7) and (7,), and the
    weight of one squared pixel."""
    off = residuals(seen, lens, movement)
    weight = weights(off, reach_of(movement))
    at = moved(seen, lens, movement)
    slope = np.concatenate([slopes(at, seen.sky, lens), _focal_slopes(seen, lens, movement, at)[..., None]], -1)
    use = weight > 0
    slope, off, weight = slope[use].reshape(-1, 7), off[use].ravel(), np.repeat(weight[use], 2)
    weighted = slope.T * weight
    return weighted @ slope, weighted @ off, 1 / movement.noise**2


def _focal_slopes(seen: Correspondences, lens: Lens, movement: Movement, at: np.ndarray) -> np.ndarray:
    """Return the derivatives (N, 2) of the residuals by the logarithm of the focal length."""
    points = lens.rays(seen.px, seen.depth)
    points[:, 2] = 0
    change = -points @ movement.rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        near = 1 / at[:, 2:]
    return lens.focals * near * (at[:, :2] + change[:, :2] - at[:, :2] * near * change[:, 2:])
