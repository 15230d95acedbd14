"""Estimation of a camera's movement between two frames, by robust perspective-n-point: moving objects are outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.captures.calibration.correspondences import Correspondences

NEAR = 1.0  # px: residuals from here on are all equally bad while hypotheses are compared
_HYPOTHESES, _OF = 96, 4  # candidates, and samples that each of them follows from
_JUDGES = 256  # samples that compare candidates
_BEST = 2  # candidates that are refined
_FEW = 800  # samples that candidates are refined on
_ENOUGH = 3e-6  # radians, and median depths: smaller steps end the iteration
_ROUNDS, _FIRST_ROUNDS = 15, 6  # of refinement, and of that of candidates
_LEAST_NOISE = 0.004  # px
_MOST_SIGMA = 6.0  # residuals beyond have no weight


@dataclass(frozen=True)
class Lens:
    """Pinhole lens with its principal point: `focal` in pixels along y, `aspect` times that along x; `center` (2,)."""

    focal: float
    center: np.ndarray
    aspect: float = 1.0

    @property
    def focals(self) -> np.ndarray:
        """Focal lengths fx and fy, (2,) pixels."""
        return self.focal * np.array([self.aspect, 1.0])

    def rays(self, px: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return view space positions (…, 3) of pixels (…, 2) at view depth (…)."""
        flat = (px - self.center) / self.focals * depth[..., None]
        return np.concatenate([flat, depth[..., None]], -1)


@dataclass(frozen=True)
class Movement:
    """Transform from the view space of a frame to that of the one before: `rotation` (3, 3), `translation` (3,) world
    units. Leading axes are candidates. `noise`: standard deviation of static residuals along an axis, pixels."""

    rotation: np.ndarray
    translation: np.ndarray
    noise: float = NEAR

    @property
    def matrix(self) -> np.ndarray:
        """The transform as a matrix (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.translation
        return matrix

    @property
    def degrees(self) -> float:
        """Angle in degrees by which the camera turned."""
        off = self.rotation - self.rotation.T
        sine = np.linalg.norm([off[2, 1], off[0, 2], off[1, 0]]) / 2
        return float(np.degrees(np.arctan2(sine, (np.trace(self.rotation) - 1) / 2)))


def still(candidates: int = 1) -> Movement:
    """Return so many candidates without movement."""
    return Movement(np.tile(np.eye(3), (candidates, 1, 1)), np.zeros((candidates, 3)))


def moved(seen: Correspondences, lens: Lens, movement: Movement) -> np.ndarray:
    """Return the samples (…, N, 3) in view space of the frame before, for all candidates."""
    points = lens.rays(seen.px, seen.depth) @ np.swapaxes(movement.rotation, -1, -2)
    return points + movement.translation[..., None, :] * ~seen.sky[..., None]


def residuals(seen: Correspondences, lens: Lens, movement: Movement) -> np.ndarray:
    """Return residuals (…, N, 2): predicted minus actual positions of samples in the frame before, pixels; infinite
    behind the camera."""
    return _off(moved(seen, lens, movement), seen, lens)


def _off(at: np.ndarray, seen: Correspondences, lens: Lens) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        off = at[..., :2] * (1 / at[..., 2:]) * lens.focals + (lens.center - seen.px_prev)
    off[at[..., 2] <= 0] = np.inf
    return off


def slopes(at: np.ndarray, sky: np.ndarray, lens: Lens) -> np.ndarray:
    """Return the derivatives (…, N, 2, 6) of `residuals` by a small further rotation (3) and translation (3), where
    samples are `moved` to `at`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.where(at[..., 2] > 0, 1 / at[..., 2], 1.0)
    u, v = at[..., 0] * near, at[..., 1] * near
    near = np.where(sky, 0.0, near)
    slope = np.zeros((*u.shape, 2, 6))
    for k, along_x in enumerate((-u * v, 1 + u * u, -v, near, 0, -u * near)):
        slope[..., 0, k] = along_x
    for k, along_y in enumerate((-1 - v * v, u * v, u, 0, near, -v * near)):
        slope[..., 1, k] = along_y
    slope *= lens.focals[:, None]
    return slope


def advanced(movement: Movement, change: np.ndarray) -> Movement:
    """Return the movement after a further rotation and translation (…, 6)."""
    turn = rotation_of(change[..., :3])
    along = (turn @ movement.translation[..., None])[..., 0] + change[..., 3:]
    return replace(movement, rotation=turn @ movement.rotation, translation=along)


def rotation_of(vector: np.ndarray) -> np.ndarray:
    """Return the rotations (…, 3, 3) about vectors (…, 3) by their lengths in radians."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vector, -1, 0)
    none = np.zeros_like(x)
    cross = np.stack([np.stack(row, -1) for row in ((none, -z, y), (z, none, -x), (-y, x, none))], -2)
    safe = np.where(angle > 1e-12, angle, 1.0)
    first = np.where(angle > 1e-12, np.sin(safe) / safe, 1.0)
    second = np.where(angle > 1e-12, (1 - np.cos(safe)) / safe**2, 0.5)
    return np.eye(3) + first * cross + second * (cross @ cross)


def fit(seen: Correspondences, lens: Lens, guesses: tuple[Movement, ...] = (), seed: int = 0) -> Movement:
    """Return the movement that explains most samples, refined on all of them.

    `guesses` are tried beside candidates drawn at random. Depths may be in any unit: `translation` is in it.
    """
    rng = np.random.default_rng(seed)
    unit = float(np.median(seen.depth[~seen.sky])) if not seen.sky.all() else 1.0
    seen = replace(seen, depth=np.where(seen.sky, 1.0, seen.depth / unit))
    guesses = tuple(replace(guess, translation=guess.translation / unit) for guess in guesses)
    judges = seen.some(_JUDGES, rng)
    candidates = _joined(_candidates(seen, lens, rng), still(), *(_alone(guess) for guess in guesses))
    order = np.argsort(cost(judges, lens, candidates))[:_BEST]
    few = seen.some(_FEW, rng)
    refined = [
        refine(few, lens, Movement(candidates.rotation[k], candidates.translation[k]), _FIRST_ROUNDS) for k in order
    ]
    best = refine(seen, lens, min(refined, key=lambda movement: float(cost(few, lens, movement))))
    return replace(best, translation=best.translation * unit)


def cost(seen: Correspondences, lens: Lens, movement: Movement) -> np.ndarray:
    """Return the mean squared residual (…), of which none counts for more than `NEAR`, pixels squared."""
    squared = (residuals(seen, lens, movement) ** 2).sum(-1)
    return np.minimum(squared, NEAR**2).mean(-1)


def _candidates(seen: Correspondences, lens: Lens, rng: np.random.Generator) -> Movement:
    """Return candidate movements, each from a few samples, by Gauss-Newton from no movement on."""
    chosen = rng.integers(len(seen), size=(_HYPOTHESES, _OF))
    few = Correspondences(seen.px[chosen], seen.px_prev[chosen], seen.depth[chosen], seen.sky[chosen])
    movement = still(_HYPOTHESES)
    for _ in range(6):
        at = moved(few, lens, movement)
        movement = advanced(movement, _step(slopes(at, few.sky, lens), _off(at, few, lens), np.ones(chosen.shape)))
    return movement


def refine(seen: Correspondences, lens: Lens, movement: Movement, rounds: int = _ROUNDS) -> Movement:
    """Return `movement` refined by Gauss-Newton with weights that fall to 0 at six times the noise, which is estimated
    meanwhile. It starts from the noise of `movement`."""
    reach = max(reach_of(movement), 2 * NEAR)
    for _ in range(rounds):
        at = moved(seen, lens, movement)
        off = _off(at, seen, lens)
        noise = noise_of(off, reach)
        settled, reach = reach <= 1.01 * _MOST_SIGMA * noise, min(reach, max(_MOST_SIGMA * noise, reach / 3))
        step = _step(slopes(at, seen.sky, lens), off, weights(off, reach))
        movement = replace(advanced(movement, step), noise=noise)
        if settled and np.abs(step).max() < _ENOUGH:
            break
    return movement


def weights(off: np.ndarray, reach: float) -> np.ndarray:
    """Return Tukey's weights (…, N) of residuals: from 1 where they are 0 to 0 where they are `reach` pixels long and
    beyond."""
    squared = (off**2).sum(-1)
    return (1 - np.minimum(squared, reach**2) / reach**2) ** 2


def reach_of(movement: Movement) -> float:
    """Return the length of residuals from which on a sample has no weight, pixels."""
    return _MOST_SIGMA * movement.noise


def noise_of(off: np.ndarray, reach: float) -> float:
    """Return the standard deviation along an axis of the residuals (N, 2) that are shorter than `reach`, by their
    median."""
    length = np.linalg.norm(off, axis=-1)
    near = length[length < reach]
    return max(float(np.median(near)) / 1.1774 if len(near) else reach, _LEAST_NOISE)


def _step(slope: np.ndarray, off: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the step (…, 6) of weighted Gauss-Newton. Components that the samples do not determine stay unchanged."""
    weight = np.where(np.isfinite(off).all(-1), weight, 0.0)
    off = np.where(np.isfinite(off), off, 0.0)
    flat = slope.reshape(*slope.shape[:-3], -1, 6)  # both axes of all samples
    turned = np.swapaxes(flat * np.repeat(weight, 2, -1)[..., None], -1, -2)
    normal, right = turned @ flat, (turned @ off.reshape(*off.shape[:-2], -1, 1))[..., 0]
    damping = 1e-9 * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] + 1e-12
    step = -np.linalg.solve(normal + damping * np.eye(6), right[..., None])[..., 0]
    length = np.linalg.norm(step, axis=-1, keepdims=True)
    return step * np.minimum(1.0, 0.5 / np.maximum(length, 1e-12))


def _alone(movement: Movement) -> Movement:
    return Movement(movement.rotation[None], movement.translation[None])


def _joined(*movements: Movement) -> Movement:
    return Movement(
        np.concatenate([movement.rotation for movement in movements]),
        np.concatenate([movement.translation for movement in movements]),
    )
