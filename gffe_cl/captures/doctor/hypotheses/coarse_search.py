"""Coarse part of the search: all cameras and depths at once, on few samples.

With the pixel position that motion leads to, the depth of a sample is one linear equation, a · w = b with w = 1 / depth
(see `depths.py`): so the parameters of each depth model are found directly, and nothing is projected.
"""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.hypotheses.cameras import CameraReading
from gffe_cl.captures.doctor.hypotheses.depths import AS_GIVEN, MODELS, DepthReading
from gffe_cl.captures.doctor.hypotheses.scoring import Bench, log_score

_DRAWS = 24  # lines through two samples, of which the best one is kept
_JUDGES = 120  # samples that decide between them


class WideField:
    """Test of all cameras with all depth models, against motion vectors that lead in the direction `step`."""

    def __init__(self, bench: Bench, cameras: list[CameraReading], step: int):
        self._bench, self._cameras = bench, cameras
        reaches = [bench.reach(camera, step) for camera in cameras]
        self._turned, self._shift, self._focal, self._ray = (
            np.stack([getattr(reach, name) for reach in reaches]) for name in ("turned", "shift", "focal", "ray")
        )
        self._center = reaches[0].center

    def scores(self, motion: np.ndarray, scale: tuple[float, float], jitter: bool) -> list[tuple]:
        """Return (agreement, CameraReading, DepthReading) for all hypotheses that `motion` (N, 2) pixels can decide.
        `scale`: the coarsest and finest residuals that count (`log_score`). With `jitter` each frame may have a
        constant offset."""
        bench = self._bench
        use = bench.solid & np.isfinite(motion).all(-1)
        if use.sum() < 16:
            return []
        u = (bench.px + motion - self._center)[use] / self._focal[:, use]
        turned, shift, focal = self._turned[:, use], self._shift[:, use], self._focal[:, use]
        a = (u * shift[..., 2:] - shift[..., :2]) * focal
        b = (turned[..., :2] - u * turned[..., 2:]) * focal
        power, cross, rest = (a * a).sum(-1), (a * b).sum(-1), (b * b).sum(-1)
        with np.errstate(all="ignore"):
            w = np.where(power > 0, cross / power, np.nan)
        stored, frame, found = bench.stored[use], bench.frame[use], []
        for model in (None, *MODELS):
            basis = (model or AS_GIVEN.model).basis(stored, self._ray[:, use])
            basis = np.broadcast_to(basis, (*w.shape, basis.shape[-1]))
            if model is None:
                fit = np.ones((len(w), 1))
            elif model.terms == 2:
                fit = _lines(basis, w, power, cross, rest)
            else:
                fit = _medians(basis[..., 0], w, power)[:, None]
            if jitter and model is not None:
                fit = _with_constants(fit, basis, a, b, frame)
            tried = np.einsum("cnk,ck->cn", basis, fit)
            off = _pixels_off(a, b, tried, turned, shift)
            score = _agreement(off, frame, scale, jitter)
            for camera, agrees, values in zip(self._cameras, score, fit, strict=True):
                depth = AS_GIVEN if model is None else DepthReading(model, tuple(values.tolist()))
                if np.isfinite(values).all() and depth.is_possible:
                    found.append((float(agrees), camera, depth))
        return found


def _pixels_off(a, b, w, turned, shift) -> np.ndarray:
    """Return residuals (C, N, 2) in pixels; large behind the camera."""
    with np.errstate(all="ignore"):
        depth = turned[..., 2] + w * shift[..., 2]
        off = (a * w[..., None] - b) / depth[..., None]
    off[~(depth > 1e-6)] = 1e9
    return np.nan_to_num(off, nan=1e9)


def _agreement(off, frame, scale, jitter) -> np.ndarray:
    if jitter:
        off = off.copy()
        for k in np.unique(frame):
            at = frame == k
            off[:, at] -= np.median(off[:, at], axis=1, keepdims=True)
    return log_score(np.sqrt((off * off).sum(-1)), *scale).mean(-1)


def _medians(basis, w, power) -> np.ndarray:
    """Return the factors (C,) in w = factor · basis: weighted medians, where samples count as far as translation moves
    them."""
    with np.errstate(all="ignore"):
        ratio, weight = w / basis, np.sqrt(power) * np.abs(basis)
    known = np.isfinite(ratio) & np.isfinite(weight)
    ratio, weight = np.where(known, ratio, 0), np.where(known, weight, 0)
    order = np.argsort(ratio, -1)
    total = np.cumsum(np.take_along_axis(weight, order, -1), -1)
    at = (total < total[:, -1:] / 2).sum(-1).clip(max=total.shape[-1] - 1)
    found = np.take_along_axis(ratio, order[np.arange(len(at)), at][:, None], -1)[:, 0]
    return np.where(total[:, -1] > 0, found, np.nan)


def _lines(basis, w, power, cross, rest) -> np.ndarray:
    """Return the lines (C, 2) in w = c₀ + c₁ · basis₁: of some through two samples, the one with the least logarithms
    of residuals."""
    one, two = np.random.default_rng(7).integers(w.shape[-1], size=(2, _DRAWS))
    some = slice(None, None, max(1, w.shape[-1] // _JUDGES))
    x = basis[..., 1]
    with np.errstate(all="ignore"):
        slope = (w[:, two] - w[:, one]) / (x[:, two] - x[:, one])
        offset = w[:, one] - slope * x[:, one]
        trial = offset[:, None] + slope[:, None] * x[:, some, None]  # (C, judges, draws)
        off = power[:, some, None] * trial**2 - 2 * cross[:, some, None] * trial + rest[:, some, None]
        badness = np.log(np.maximum(off, 0) + 1e-4).mean(1)
    badness = np.where(np.isfinite(badness), badness, np.inf)
    best = badness.argmin(-1)
    rows = np.arange(len(best))
    fit = np.stack([offset[rows, best], slope[rows, best]], -1)
    return np.where(np.isfinite(badness[rows, best])[:, None], fit, np.nan)


def _with_constants(fit, basis, a, b, frame, rounds: int = 5) -> np.ndarray:
    """Return parameters (C, terms) refined from `fit` by reweighted least squares; every frame may be off by a
    constant."""
    left = np.nan_to_num(basis[:, :, None, :] * a[..., None])
    fit = np.nan_to_num(fit)
    starts = np.flatnonzero(np.diff(frame, prepend=-1))
    counts = np.diff(starts, append=len(frame))
    off, middle = _residual(left, b, fit), int(0.4 * len(frame))
    for _ in range(rounds):
        square = (off**2).sum(-1)
        weight = 1 / (1 + square / np.maximum(np.partition(square, middle, -1)[:, middle, None], 1e-8)) ** 2
        total = np.add.reduceat(weight, starts, axis=1) + 1e-300

        def centered(values, weight=weight, total=total):
            extra = (slice(None), slice(None), *[None] * (values.ndim - 2))
            means = np.add.reduceat(weight[extra] * values, starts, axis=1) / total[extra]
            return values - np.repeat(means, counts, axis=1)

        x, y = centered(left), centered(b)
        weighted = weight[..., None, None] * x
        flat = (len(x), -1, x.shape[-1])
        normal = weighted.reshape(flat).swapaxes(1, 2) @ x.reshape(flat)
        right = (weighted * y[..., None]).sum((1, 2))
        size = np.sqrt(np.einsum("ckk->ck", normal)) + 1e-150
        normal = normal / (size[:, :, None] * size[:, None]) + 1e-12 * np.eye(normal.shape[-1])
        fit = np.linalg.solve(normal, (right / size)[..., None])[..., 0] / size
        off = centered(_residual(left, b, fit))
    return fit


def _residual(left, b, fit) -> np.ndarray:
    return (left @ fit[:, None, :, None])[..., 0] - b
