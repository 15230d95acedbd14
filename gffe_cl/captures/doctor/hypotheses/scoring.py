"""Scores of hypotheses from two kinds of evidence: motion vectors against depth and cameras, and colors against both.

Samples of several frames lie one after the other: `Bench`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gffe_cl.captures.doctor.hypotheses.cameras import CameraReading
from gffe_cl.captures.doctor.hypotheses.depths import DepthReading, rays
from gffe_cl.captures.doctor.hypotheses.motions import MotionReading
from gffe_cl.captures.doctor.hypotheses.sampling import NEXT, PREVIOUS, Look, sampled

_STILL = 0.05  # share of the usual motion: samples with less are no evidence on motion vectors
_NOTHING = 2e-3  # of the largest motion vector: shorter ones are none
_CHANCE = 0.2  # color score where nothing is known
_VISIBLE = 0.3  # pixels that the camera moves static points, at least, where they tell anything
_LOW = 0.25  # quantile of residuals that is compared: movers may be most of the rest
_BETTER, _WORSE, _LEAST = 0.8, 1.25, 0.1  # of the residual as given, and pixels more than that
_FEWEST = 16  # samples


@dataclass
class Reach:
    """Samples seen from the frame that motion leads to, after the camera's rotation and its translation.

    `turned` (N, 3): rays after the rotation; `shift` (N, 3): translation in view space of the other frame; `focal`,
    `center` (N, 2): of its camera, pixels; `ray` (N, 3): before the rotation.
    """

    ray: np.ndarray
    turned: np.ndarray
    shift: np.ndarray
    focal: np.ndarray
    center: np.ndarray

    def pixels(self, w: np.ndarray) -> np.ndarray:
        """Return pixel positions (N, 2) of static points at 1 / depth `w` (N,); NaN behind the camera."""
        v = self.turned + w[:, None] * self.shift
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            at = v[:, :2] / v[:, 2:] * self.focal + self.center
        at[~(v[:, 2] > 1e-6)] = np.nan
        return at

    def equations(self, px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a, b (N, 2) with a · w = b for points that are seen at `px`: their differences are in pixels at depth
        1."""
        u = (px - self.center) / self.focal
        a = u * self.shift[:, 2:] - self.shift[:, :2]
        b = self.turned[:, :2] - u * self.turned[:, 2:]
        return a * self.focal, b * self.focal


class Bench:
    """Samples of several looks, one after the other, every `thin`-th of each."""

    def __init__(self, looks: list[Look], thin: int = 1):
        self.looks, self._thin = looks, thin
        self._part = [slice(None, None, thin)] * len(looks)
        self._counts = [len(look.px[::thin]) for look in looks]
        self.frame = np.repeat(np.arange(len(looks)), self._counts)
        self.px = np.concatenate([look.px[::thin] for look in looks])
        self.stored = np.concatenate([look.depth[::thin] for look in looks])
        self.solid = np.concatenate([look.solid[::thin] for look in looks])
        self.color = np.concatenate([look.color[::thin] for look in looks])
        self.contrast = np.concatenate([look.contrast[::thin] for look in looks])
        self.textured = np.concatenate([look.textured[::thin] for look in looks])
        self._reaches: dict = {}

    @cached_property
    def has(self) -> dict[int, np.ndarray]:
        """Masks {step → (N,) bool} of samples that have a frame in that direction."""
        return {s: np.repeat([s in look.neighbors for look in self.looks], self._counts) for s in (PREVIOUS, NEXT)}

    def motion(self, reading: MotionReading) -> np.ndarray:
        """Return motion (N, 2) in pixels; NaN where the file has none."""
        found = []
        for look, count in zip(self.looks, self._counts, strict=True):
            v = reading.pixels(look)
            found.append(np.full((count, 2), np.nan) if v is None else v[:: self._thin])
        return np.concatenate(found)

    def reach(self, reading: CameraReading, step: int) -> Reach:
        key = reading, step
        if key not in self._reaches:
            self._reaches[key] = self._new_reach(reading, step)
        return self._reaches[key]

    def _new_reach(self, reading: CameraReading, step: int) -> Reach:
        parts: tuple = ([], [], [], [], [])
        for look in self.looks:
            px = look.px[:: self._thin]
            here = reading.read(look.camera)
            there = reading.read(look.camera_of(step)) if step in look.neighbors else here
            m, ray = here.to_view_of(there), rays(here, px)
            values = (ray, ray @ m[:3, :3].T, m[:3, 3], (there.fx, there.fy), (there.cx, there.cy))
            for part, value in zip(parts, values, strict=True):
                part.append(np.broadcast_to(value, (len(px), np.shape(value)[-1])))
        return Reach(*(np.concatenate(part) for part in parts))

    def static(self, camera: CameraReading, depth: DepthReading, step: int = PREVIOUS) -> np.ndarray:
        """Return the motion (N, 2), in pixels, of every sample if nothing but the camera moves; NaN where that is
        unknown."""
        reach = self.reach(camera, step)
        moved = reach.pixels(depth.inverse(self.stored, reach.ray)) - self.px
        return np.where(self.has[step][:, None], moved, np.nan)

    def parts(self, chosen: np.ndarray) -> list[np.ndarray]:
        """Return the `chosen` samples (N,) of each look, as masks of all samples."""
        return [chosen & (self.frame == k) for k in range(len(self.looks))]

    def by_frame(self, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return the mean (looks,) of the chosen `values` (N,); NaN where there are few."""
        count = np.bincount(self.frame[chosen], minlength=len(self.looks))
        total = np.bincount(self.frame[chosen], values[chosen], minlength=len(self.looks))
        return np.where(count >= 8, total / np.maximum(count, 1), np.nan)

    def color_scores(self, motion: np.ndarray, step: int) -> np.ndarray:
        """Return (…, N) the agreement of colors along `motion` (…, N, 2): 1 for equal ones, NaN without evidence."""
        score = np.full(motion.shape[:-1], np.nan)
        for k, look in enumerate(self.looks):
            other = look.neighbors.get(step)
            use = (self.frame == k) & self.textured
            if other is None or other.image is None or not use.any():
                continue
            target = self.px[use] + motion[..., use, :]
            met, inside = sampled(other, target)
            off = np.abs(met - self.color[use]).mean(-1) / self.contrast[use]
            score[..., use] = np.where(inside, 1 / (1 + (off / 0.25) ** 2), _CHANCE)
        return score


def color_gain(bench: Bench, motion: np.ndarray, other: np.ndarray, step: int) -> float:
    """Return how sure it is that colors agree better along `motion` than along `other` (N, 2), in standard deviations
    of the mean difference; 0 without evidence."""
    scores = bench.color_scores(np.stack([motion, other]), step)
    gains = scores[0] - scores[1]
    gains = gains[np.isfinite(gains) & bench.solid & (np.abs(motion - other).max(-1) > 0)]
    if len(gains) < _FEWEST:
        return 0.0
    return float(gains.mean() / (gains.std() / np.sqrt(len(gains)) + 1e-9))


Vectors = tuple[np.ndarray, np.ndarray]  # motion vectors and static motion, (N, 2) pixels each


@dataclass(frozen=True)
class ResidualChange:
    """Residuals of static points in one frame, in pixels: as `given` and as `read`. `step`: of quantized vectors."""

    given: float
    read: float
    step: float = 0.0

    @classmethod
    def of(cls, given: Vectors, read: Vectors, solid: np.ndarray, step: float = 0.0) -> ResidualChange | None:
        """Compare the vectors at the samples `solid` (N,), and return the residuals; None if the camera moves so few of
        them visibly that the frame is no evidence."""
        moved = [np.linalg.norm(np.nan_to_num(static), axis=-1) for _, static in (given, read)]
        telling = solid & (np.maximum(moved[0], moved[1]) > _VISIBLE)
        low = []
        for motion, static in (given, read):
            off = np.linalg.norm(motion - static, axis=-1)[telling & np.isfinite(motion).all(-1)]
            if len(off) < _FEWEST:
                return None
            low.append(float(np.quantile(np.nan_to_num(off, nan=np.inf), _LOW, method="lower")))
        return cls(low[0], low[1], step)

    @property
    def is_better(self) -> bool:
        return self.read < _BETTER * self.given

    @property
    def is_worse(self) -> bool:
        return self.read > _WORSE * self.given + max(_LEAST, 0.5 * self.step)


def mostly_nothing(length: np.ndarray) -> bool:
    """Return whether most of these motion vectors, by their lengths (N,), are none."""
    return not len(length) or bool(np.median(length) <= _NOTHING * np.quantile(length, 0.999))


def trimmed(by_frame: np.ndarray) -> float:
    """Return the mean over frames without the worst third, because a few frames may have other faults; NaN without
    frames."""
    values = np.sort(by_frame[np.isfinite(by_frame)])
    return float(values[len(values) // 3 :].mean()) if len(values) else float("nan")


def frame_offsets(bench: Bench, off: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Return the common offset (looks, 2) of most of `off` (N, 2) in each frame: the center of the densest region."""
    found = np.zeros((len(bench.looks), 2))
    for k in range(len(found)):
        values = off[use & (bench.frame == k)]
        values = values[np.isfinite(values).all(-1)]
        if len(values) < 8:
            continue
        center = np.median(values, 0)
        for _ in range(8):
            apart = ((values - center) ** 2).sum(-1)
            weight = 1 / (1 + apart / max(float(np.quantile(apart, 0.4)), 1e-8)) ** 2
            center = weight @ values / weight.sum()
        found[k] = center
    return found


def moving(motion: np.ndarray) -> np.ndarray:
    """Return the mask (N,) bool of samples whose motion, in whatever unit, is not zero."""
    length = np.linalg.norm(np.nan_to_num(motion), axis=-1)
    return length > _STILL * np.quantile(length, 0.95) if length.any() else np.zeros(len(length), bool)


def log_score(residual: np.ndarray, coarsest, finest) -> np.ndarray:
    """Return the score of residuals (pixels): 1 up to `finest`, 0 from `coarsest` on, logarithmic between; 0 for
    NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.log(coarsest / np.maximum(residual, finest)) / np.log(coarsest / finest)
    return np.nan_to_num(np.clip(score, 0, 1))
