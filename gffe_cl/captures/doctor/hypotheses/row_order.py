"""Search for the row order of each buffer, and whether the picture is upright.

Turning all buffers, with y of motion vectors and cameras, makes a mirror image that fits as well. So every reading has
a twin, and where neither is the given one, other evidence decides between them: the sky, the ground, the world's axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.captures.doctor.hypotheses.sampling import BUFFERS
from gffe_cl.captures.doctor.hypotheses.search import GOOD, Reading, Search, Verdict

_ORDERS = ((), ("color",), ("depth",), ("motion",))  # all others are mirror images of these
_BLIND = 0.6  # sum of color scores below which colors may be turned if silhouettes do not decide
_TURNED = 0.1  # of the sum of color scores, by which turned colors must be better
_TWINS = 4  # readings that are compared with their mirror images
_WEIGHT = 0.05  # of the evidence for the upright picture, in units of the scores
_SKY, _AWAY = 0.02, 0.1  # least share of sky, and how far from the middle it is, in image heights
_FAR, _ABOVE = 0.7, 0.04  # quantile of depths that are far, and how far above the middle they are
_VERTICAL = 0.7  # of the cameras' mean up vector, along a world axis
_SILENT = 0.2  # least evidence
_LEFT = 1e-3  # of equals the one that leaves the picture as it is


@dataclass
class WhichWayUp:
    """Verdicts on readings of all row orders, the best first; `twins`: {reading → (verdict on its mirror image,
    evidence from −1 to 1 that the reading's picture is upright)} of those that were compared."""

    verdicts: list[Verdict]
    twins: dict[Reading, tuple[Verdict, float]]

    def doubt(self, reading: Reading) -> Reading | None:
        """Return the mirror image of `reading` if no evidence decides between them and it is about as simple."""
        if reading not in self.twins:
            return None
        twin, upright = self.twins[reading]
        return twin.reading if abs(upright) < _SILENT and twin.reading.edits <= reading.edits + 1 else None


def search_rows(search_of: Callable[[tuple[str, ...]], Search]) -> WhichWayUp:
    """Search all row orders in which a better fit is possible, and return the verdicts; `search_of`: the search with
    such rows."""
    plain = [search_of(rows).verdict(Reading(rows=rows)) for rows in _ORDERS]
    best = max(plain, key=lambda verdict: verdict.total)
    settled = _is_settled(best, search_of)
    orders = [best.reading.rows] if settled else [rows for rows in _ORDERS if search_of(rows).edges >= 0]
    verdicts: list[Verdict] = []
    for rows in orders:
        verdicts += search_of(rows).candidates()
        verdicts.sort(key=lambda verdict: -verdict.total)
        if _is_settled(verdicts[0], search_of):
            break
    if verdicts[0].reading == Reading():
        return WhichWayUp(verdicts, {})
    twins, rank = {}, {}
    for verdict in verdicts[:_TWINS]:
        mirror = verdict.reading.mirrored()
        twin = search_of(mirror.rows).verdict(mirror)
        upright = _upright(search_of(verdict.reading.rows), verdict.reading)
        twins[verdict.reading], twins[mirror] = (twin, upright), (verdict, -upright)
        ahead = verdict.total - twin.total + 2 * _WEIGHT * upright
        ahead += _LEFT * (bool(mirror.rows) - bool(verdict.reading.rows))
        first, second = (verdict, twin) if ahead >= 0 else (twin, verdict)
        rank[first.reading] = first.total  # orientation ranks mirror images only
        rank[second.reading] = min(first.total, second.total) - _LEFT
        verdicts.append(twin)
    unique = {verdict.reading: verdict for verdict in verdicts}
    verdicts = sorted(unique.values(), key=lambda verdict: -rank.get(verdict.reading, verdict.total - 2 * _WEIGHT))
    return WhichWayUp(verdicts, twins)


def _is_settled(best: Verdict, search_of: Callable[[tuple[str, ...]], Search]) -> bool:
    """Return whether other row orders need no search: all agree, and colors would not agree better upside down."""
    if not best.agreement >= GOOD or best.edges < 0 or (best.edges == 0 and best.colors < _BLIND):
        return False
    if "color" in best.reading.rows or best.reading.jitter:
        return True
    search = search_of(tuple(name for name in BUFFERS if name == "color" or name in best.reading.rows))
    turned = search.motion_color(best.reading.motion), search.camera_color(best.reading.camera, best.reading.depth)
    return float(np.nansum([*turned, search.edges])) <= best.colors + _TURNED


def _upright(search: Search, reading: Reading) -> float:
    """Return evidence from −1 to 1 that the picture is upright by `reading`: sky is at the top, far surfaces are
    higher in the picture, and the up vector is a usual world axis."""
    bench = search.full
    w = reading.depth.inverse(bench.stored, bench.reach(reading.camera, reading.motion.step).ray)
    heights = np.repeat([look.size[1] for look in bench.looks], [len(look.px) for look in bench.looks])
    y = bench.px[:, 1] / heights - 0.5  # down
    known = np.isfinite(w)
    sky, evidence = known & (~bench.solid | (w <= 0)), 0.0
    if sky.mean() > _SKY and abs(y[sky].mean()) > _AWAY:
        evidence -= np.sign(y[sky].mean())
    far = known & (w <= np.quantile(w[known], 1 - _FAR)) if known.any() else known
    if far.any() and abs(y[far].mean()) > _ABOVE:
        evidence -= 0.5 * np.sign(y[far].mean())
    return float(np.clip(evidence + _world_is_usual(search, reading), -1, 1))


def _world_is_usual(search: Search, reading: Reading) -> float:
    """Return 1 if world axes are right-handed with y or z up, −1 if left-handed with y or z down, 0 if both are
    usual or cameras look in all directions."""
    rotations = [reading.camera.read(look.camera).world_to_view[:3, :3] for look in search.full.looks]
    up = -np.mean([m[1] for m in rotations], 0)
    axis = 1 + int(np.abs(up[1:]).argmax())
    if abs(up[axis]) < _VERTICAL:
        return 0.0
    handed = np.sign(np.linalg.det(rotations[0]))
    return float(handed) if handed == np.sign(up[axis]) else 0.0
