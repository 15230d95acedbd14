"""Choice of the law by which a reading turns stored numbers into depths, and whether it explains the motion of all
surfaces, near and far."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gffe_cl.captures.doctor.hypotheses.depths import AS_GIVEN, MODELS, RARE
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search

_CLEARER, _EXACT = 0.5, 2e-4  # of the residual by which another law must be better; and pixels that say nothing
_RANGES = 8  # of depths, with equal numbers of samples
_FEWEST, _MOST_OFF = 24, 2  # samples in such a range; and ranges that may be off, as those of movers are
_OFF, _OFF_PX = 0.01, 0.01  # of depth, and of motion in pixels: what is off by less counts as right
_RARE = 0.05  # times that: rare laws must fit better, as they would describe many others roughly
_SYSTEMATIC = 1.5  # times their scatter: by so much the depths of a range are off together


class Misfit(NamedTuple):
    """Error that a law leaves over: in parts of depth, and in pixels of motion."""

    share: float
    pixels: float


def settled(search: Search, reading: Reading) -> tuple[Reading, Misfit | None]:
    """Return `reading` with the depth law that fits vectors clearly best for its cameras, rare laws among them, and
    what that leaves over. Depths as given, and laws without parameters but a unit that explain everything, stay."""
    left = None if reading.depth == AS_GIVEN else misfit(search, reading)
    if reading.depth == AS_GIVEN or reading.motion.adds_camera or (left is None and reading.depth.model.terms == 1):
        return reading, left
    others = [one for one in search.fitted(search.full, reading, (*MODELS, *RARE)) if one.depth.has_meaning]
    others = [one for one in others if one.camera == reading.camera]
    best = min([reading, *others], key=lambda one: _residual(search, one))
    if _residual(search, best) + _EXACT < _CLEARER * _residual(search, reading):
        reading = best
    return reading, misfit(search, reading)


def _residual(search: Search, reading: Reading) -> float:
    """Return the median difference of vectors from static motion, pixels."""
    motion, static = search.motions(reading, search.full)
    use = search.full.solid & np.isfinite(motion).all(-1)
    return float(np.median(np.nan_to_num(np.linalg.norm(motion - static, axis=-1)[use], nan=np.inf)))


def misfit(search: Search, reading: Reading) -> Misfit | None:
    """Return what the depth law of `reading` leaves over in most ranges of depth; None if it explains them, or if the
    vectors do not decide."""
    bench, motion = search.full, reading.motion
    if motion.adds_camera:
        return None
    reach = bench.reach(reading.camera, motion.step)
    vectors, static = search.motions(reading, bench)
    vectors += bench.static(reading.camera, reading.depth, motion.step) - static  # jitter is none of depth
    a, b = reach.equations(bench.px + vectors)
    w = reading.depth.inverse(bench.stored, reach.ray)
    with np.errstate(all="ignore"):
        parallax = np.linalg.norm(a, axis=-1) * w
        share = (a * b).sum(-1) / (a * a).sum(-1) / w - 1  # by which vectors have another depth
    use = bench.solid & np.isfinite(share) & (w > 0)
    if use.sum() < _RANGES * _FEWEST:
        return None
    parallax, share, w = parallax[use], share[use], w[use]
    of_range = np.searchsorted(np.quantile(w, np.arange(1, _RANGES) / _RANGES), w)
    found, strictness = [], _RARE if reading.depth.model in RARE else 1.0
    for part in (of_range == k for k in range(_RANGES)):
        if part.sum() >= _FEWEST:
            off = float(np.median(share[part]))
            scatter, pixels = np.median(np.abs(share[part] - off)), abs(off) * float(np.median(parallax[part]))
            least = max(strictness * _OFF_PX, 0.5 * search.step)
            if abs(off) > max(strictness * _OFF, _SYSTEMATIC * scatter) and pixels > least:
                found.append((abs(off), pixels))
    return Misfit(*np.median(found, 0).tolist()) if len(found) > _MOST_OFF else None
