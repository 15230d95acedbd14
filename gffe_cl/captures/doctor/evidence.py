"""Evidence for readings: residuals of motion vectors against depth and cameras, and colors along both.

Samples of several frames lie one after the other: `Bench`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gffe_cl.captures.doctor.readings import Cameras, Depth, Motion, rays
from gffe_cl.captures.doctor.samples import NEXT, PREVIOUS, Look, sampled

_STILL = 0.05  # share of the usual motion: samples with less are no evidence on motion vectors
_CHANCE = 0.2  # color score where nothing is known
_FEWEST = 16  # samples
_SMALLEST = 0.02  # pixels: the unit of visible errors


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
        self._counts = [len(look.px[::thin]) for look in looks]
        self.frame = np.repeat(np.arange(len(looks)), self._counts)
        self.px, self.stored, self.solid, self.color, self.contrast, self.textured = (
            np.concatenate([getattr(look, name)[::thin] for look in looks])
            for name in ("px", "depth", "solid", "color", "contrast", "textured")
        )
        self._reaches: dict = {}
        self._motions: dict = {}
        self._scales: dict = {}

    @cached_property
    def has(self) -> dict[int, np.ndarray]:
        """Masks {step → (N,) bool} of samples that have a frame in that direction."""
        return {s: np.repeat([s in look.neighbors for look in self.looks], self._counts) for s in (PREVIOUS, NEXT)}

    def motion(self, reading: Motion) -> np.ndarray:
        """Return motion (N, 2) in pixels; NaN where the file has none."""
        if reading not in self._motions:
            found = []
            for look, count in zip(self.looks, self._counts, strict=True):
                v = reading.pixels(look)
                found.append(np.full((count, 2), np.nan) if v is None else v[:: self._thin])
            self._motions[reading] = np.concatenate(found)
        return self._motions[reading]

    def reach(self, reading: Cameras, step: int) -> Reach:
        key = reading, step
        if key not in self._reaches:
            self._reaches[key] = self._new_reach(reading, step)
        return self._reaches[key]

    def _new_reach(self, reading: Cameras, step: int) -> Reach:
        parts: tuple = ([], [], [], [], [])
        for look in self.looks:
            px = look.px[:: self._thin]
            here = reading.read(look.camera)
            there = reading.read(look.neighbors[step].camera) if step in look.neighbors else here
            m, ray = here.to_view_of(there), rays(here, px)
            values = (ray, ray @ m[:3, :3].T, m[:3, 3], (there.fx, there.fy), (there.cx, there.cy))
            for part, value in zip(parts, values, strict=True):
                part.append(np.broadcast_to(value, (len(px), np.shape(value)[-1])))
        return Reach(*(np.concatenate(part) for part in parts))

    def static(self, cameras: Cameras, depth: Depth, step: int = PREVIOUS) -> np.ndarray:
        """Return the motion (N, 2), in pixels, of every sample if nothing but the camera moves; NaN where that is
        unknown."""
        reach = self.reach(cameras, step)
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
        """Return (N,) the agreement of colors along `motion` (N, 2): 1 for equal ones, NaN without evidence."""
        score = np.full(len(motion), np.nan)
        for k, look in enumerate(self.looks):
            other = look.neighbors.get(step)
            use = (self.frame == k) & self.textured
            if other is None or other.image is None or not use.any():
                continue
            met, inside = sampled(other, self.px[use] + np.nan_to_num(motion[use], nan=1e9))
            off = np.abs(met - self.color[use]).mean(-1) / self.contrast[use]
            score[use] = np.where(inside, 1 / (1 + (off / 0.25) ** 2), _CHANCE)
        return score

    def colors_along(self, motion: np.ndarray, step: int) -> float:
        """Return the agreement of colors along `motion` (N, 2), where it moves; NaN without evidence."""
        score = self.color_scores(motion, step)
        return trimmed(self.by_frame(score, np.isfinite(score) & _moving(motion)))

    def scale(self, reading: Motion, step: float) -> tuple[float, float]:
        """Return the coarsest and the finest residuals that are evidence, in pixels. Frames in which nearly nothing
        moves do not count. `step`: of quantized vectors."""
        if (reading, step) not in self._scales:
            self._scales[reading, step] = self._new_scale(reading, step)
        return self._scales[reading, step]

    def _new_scale(self, reading: Motion, step: float) -> tuple[float, float]:
        length = np.linalg.norm(self.motion(reading), axis=-1)
        known = np.isfinite(length)
        usual = np.array([np.median(length[part]) if part.any() else 0.0 for part in self.parts(known)])
        known &= (usual >= _STILL * usual.max())[self.frame]
        scale = max(float(np.median(length[known])) if known.any() else 0.0, _SMALLEST)
        return max(0.5 * scale, 2 * step), max(0.005 * scale, 0.5 * step)

    def offsets(self, off: np.ndarray, use: np.ndarray) -> np.ndarray:
        """Return the common offset (looks, 2) of most of `off` (N, 2) in each frame: the center of the densest
        region."""
        found = np.zeros((len(self.looks), 2))
        for k, part in enumerate(self.parts(use & np.isfinite(off).all(-1))):
            values = off[part]
            if len(values) < _FEWEST:
                continue
            center = np.median(values, 0)
            for _ in range(8):
                apart = ((values - center) ** 2).sum(-1)
                weight = 1 / (1 + apart / max(float(np.quantile(apart, 0.4)), 1e-8)) ** 2
                center = weight @ values / weight.sum()
            found[k] = center
        return found


def trimmed(by_frame: np.ndarray) -> float:
    """Return the mean over frames without the worst third, because a few frames may have other faults; NaN without
    frames."""
    values = np.sort(by_frame[np.isfinite(by_frame)])
    return float(values[len(values) // 3 :].mean()) if len(values) else float("nan")


def _moving(motion: np.ndarray) -> np.ndarray:
    """Return the mask (N,) bool of samples whose motion is not zero."""
    length = np.linalg.norm(np.nan_to_num(motion), axis=-1)
    return length > _STILL * np.quantile(length, 0.95) if length.any() else np.zeros(len(length), bool)


def log_score(residual: np.ndarray, coarsest: float, finest: float) -> np.ndarray:
    """Return the score of residuals (pixels): 1 up to `finest`, 0 from `coarsest` on, logarithmic between; 0 for
    NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.log(coarsest / np.maximum(residual, finest)) / np.log(coarsest / finest)
    return np.nan_to_num(np.clip(score, 0, 1))
