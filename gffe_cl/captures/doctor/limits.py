"""Values that stop at the end of their range: depths and vectors that many pixels share, where the others say that they
are larger. They are no evidence of anything else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Look
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search

_LEAST = 0.02  # share of the samples that have the last number
_MOST_OTHERS = 0.25  # of that share: of samples with the next numbers, as many as these is a usual surface's
_BEYOND = 0.6  # share of them that must lie beyond
_BY = 0.05  # of a depth, or of a vector's length: by so much
_PIXELS = 0.02  # of motion: less tells nothing of depth
_FEWEST = 32
_AGREES, _FINEST, _MOST_FIT = 0.1, 0.3, 0.35  # of the motion, pixels, share: the other samples must agree


def set_aside_cut_off(search: Search, looks: list[Look]) -> list[Finding]:
    """Make depths infinite and vectors NaN in `looks` that end at one number, and return notes on them: depths, if
    vectors say that they are farther or nearer, and vectors, if depth and cameras say that they are longer. `search`:
    of some of the looks. Most other samples must fit."""
    found = _of_depth(search)
    for one in found:
        limit = one.figures["limit"]
        for look in looks:
            for depth in (look.depth, look.mirrored["depth"]):
                depth[depth == limit] = np.inf
    if found:
        search = Search(search.full.looks, search.step)
    of_motion = _of_motion(search)
    for one in of_motion:
        for axis, limit in one.figures["limits"].items():
            for motion in (m for look in looks for m in (look.motion, look.mirrored["motion"]) if m is not None):
                motion[np.abs(motion[:, "xy".index(axis)]) == limit] = np.nan
    return found + of_motion


def _fits(search: Search, others: np.ndarray) -> bool:
    """Return whether vectors agree with depth and cameras at most of the samples `others` (N,)."""
    motion, static = search.motions(Reading(), search.full)
    use = others & search.full.solid & np.isfinite(motion).all(-1)
    if use.sum() < _FEWEST:
        return False
    off = np.nan_to_num(np.linalg.norm(motion - static, axis=-1)[use], nan=np.inf)
    near = max(_AGREES * float(np.median(np.linalg.norm(motion[use], axis=-1))), _FINEST, search.step)
    return bool((off <= near).mean() > _MOST_FIT)


def _of_depth(search: Search) -> list[Finding]:
    bench = search.full
    reach = bench.reach(Reading().camera, PREVIOUS)
    a, b = reach.equations(bench.px + bench.motion(Reading().motion))
    with np.errstate(all="ignore"):
        power = np.linalg.norm(a, axis=-1)
        w = (a * b).sum(-1) / power**2  # 1 / depth, by the vectors
    known = bench.solid & np.isfinite(w)
    found = []
    for end, is_beyond in (
        (np.max, lambda limit: w < (1 - _BY) / limit),
        (np.min, lambda limit: w > (1 + _BY) / limit),
    ):
        limit = _limit(bench.stored[bench.solid], end)
        if limit is None or limit <= 0:
            continue
        there = known & (bench.stored == limit) & (power / limit > _PIXELS)
        if there.sum() < _FEWEST or not np.mean(is_beyond(limit)[there]) > _BEYOND:
            continue
        if not _fits(search, bench.stored != limit):
            continue
        share = float(np.mean(bench.stored == limit))
        figures = {"share": share, "limit": float(limit)}
        found.append(finding("depth: cut off" if end is np.max else "depth: cut off/near", figures, **figures))
    return found


def _of_motion(search: Search) -> list[Finding]:
    motion, static = search.motions(Reading(), search.full)
    use = search.full.solid & np.isfinite(motion).all(-1) & np.isfinite(static).all(-1)
    told, limits, shares = [], {}, {}
    for axis, name in enumerate("xy"):
        limit = _limit(np.abs(motion[use, axis]), np.max)
        if limit is None:
            continue
        there = use & (np.abs(motion[:, axis]) == limit)
        longer = (static[:, axis] * np.sign(motion[:, axis]) > (1 + _BY) * limit + search.step)[there]
        if there.sum() >= _FEWEST and longer.mean() > _BEYOND:
            limits[name], shares[name] = limit, float(there.sum() / use.sum())
            told.append(f"{shares[name]:.0%} of the vectors are ±{limit:.4g} px in {name}")
    ends = [np.abs(motion[:, "xy".index(name)]) == limit for name, limit in limits.items()]
    if not told or not _fits(search, ~np.any(ends, 0)):
        return []
    return [finding("motion: cut off", {"share": shares, "limits": limits}, axes=" and ".join(told))]


def _limit(values: np.ndarray, end: Callable) -> float | None:
    """Return the number at the `end` of `values` (N,) if many more have it than have other numbers near it."""
    if not len(values):
        return None
    limit = float(end(values))
    share = float(np.mean(values == limit))
    if not limit or share < _LEAST:
        return None
    near = np.abs(values - limit) <= _BY * abs(limit)
    return limit if near.mean() - share < max(_MOST_OTHERS * share, share) and len(np.unique(values)) > 2 else None
