"""Detection of frames in the wrong place, gaps and cuts: pairs of frames that do not fit although most pairs do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.captures.doctor.hypotheses.depths import rays
from gffe_cl.captures.doctor.hypotheses.motions import MOTION_AS_GIVEN
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Clip, Look
from gffe_cl.captures.doctor.hypotheses.scoring import Reach
from gffe_cl.captures.doctor.hypotheses.search import Reading
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_FITTING = 0.5  # share of samples that must agree, of the share in pairs that are right
_AGREES = 0.1  # of the motion's length: residuals that agree
_FINEST = 0.3  # pixels: residuals that always agree
_BETTER = 0.2  # share of samples by which another frame must fit better than the one before
_LEAST = 0.3  # share of samples that agree in correct pairs; below it there is no result
_SURE = 0.5  # share of samples that must agree with another frame than the one before
_WINDOW = 24  # frames before and after, among which the right one is looked for


@dataclass
class Order:
    """Evidence from pairs of frames on their order.

    `fits`: {frame → share of samples that agree with the frame before}; `misfits`: frames that do not follow the one
    before them; `order`: the frames in the order in which they follow each other, or None.
    """

    fits: dict[int, float]
    misfits: list[int]
    order: list[int] | None


class Reordered:
    """Clip with its rendered frames in another order, or some of them, at their times."""

    def __init__(self, clip: Clip, order: list[int]):
        self._clip, entries = clip, clip.rendered
        self.settings = getattr(clip, "settings", None)
        times = sorted(entries[index].time for index in order)
        self.rendered = [
            replace(entries[index], time=time, reset=place == 0 or (entries[index].reset and index != 0))
            for place, (index, time) in enumerate(zip(order, times, strict=True))
        ]
        self._given = {entry.file: entry for entry in entries}

    def read(self, entry: FrameEntry) -> RenderedFrame:
        return replace(self._clip.read(self._given[entry.file]), time=entry.time, reset=entry.reset)


def examine_order(looks: dict[int, Look], reading: Reading, count: int, step: float) -> Order:
    """Return the evidence of `looks` of some of `count` rendered frames, with `reading` right for most. `step`: of
    quantized vectors."""
    if reading.motion.adds_camera:  # such vectors do not depend on the camera
        return Order({}, [], None)
    fits = {}
    for index, look in looks.items():
        if reading.motion.step in look.neighbors:
            fits[index] = _share(look, look.camera, look.camera_of(reading.motion.step), reading, step)
    known = [share for share in fits.values() if np.isfinite(share)]
    usual = float(np.median(known)) if known else 0.0
    if usual < _LEAST:
        return Order(fits, [], None)
    misfits = [index for index, share in fits.items() if share < _FITTING * usual]
    if not misfits or reading.motion.held_by:
        return Order(fits, misfits, None)
    step_to = reading.motion.step
    leads_to = {index: index + step_to for index in fits if index not in misfits}
    for index in fits:  # where little moves, even frames that are no misfits may fit another one much better
        best, share = _best_other(looks, index, reading, step)
        if share >= max(_FITTING * usual, fits[index] + _BETTER):
            leads_to[index] = best
    before = leads_to if step_to == PREVIOUS else {target: index for index, target in leads_to.items()}
    return Order(fits, misfits, _chain(before, count) if len(looks) == count else None)


def shuffled_order(looks: dict[int, Look], count: int, step: float) -> list[int] | None:
    """Return the order of frames if their vectors, as given, fit other frames than the previous ones. None if there
    is no such order, or if it is mostly reversed: then the vectors lead to the next frame."""
    if len(looks) < count:
        return None
    before = {}
    for index, look in looks.items():
        if look.motion is None or not look.motion.any():
            continue
        best, share = _best_other(looks, index, Reading(), step)
        if share >= _SURE:
            before[index] = best
    order = _chain(before, count)
    return order if order is not None and np.median(np.diff(order)) > 0 else None


def _best_other(looks: dict[int, Look], index: int, reading: Reading, step: float) -> tuple[int, float]:
    """Return the frame whose camera fits the vectors of the frame `index` best, and the share of samples that agree."""
    shares = {
        other: np.nan_to_num(_share(looks[index], looks[index].camera, look.camera, reading, step))
        for other, look in looks.items()
        if other != index and abs(other - index) <= _WINDOW
    }
    best = max(shares, key=shares.__getitem__, default=index)
    return best, float(shares.get(best, 0.0))


def _chain(before: dict[int, int], count: int) -> list[int] | None:
    """Return all frames in a row if `before` has the predecessor of all but one, and the row is not the given one."""
    after = {previous: index for index, previous in before.items()}
    starts = set(range(count)) - set(before)
    if len(starts) != 1 or len(after) != len(before):
        return None
    row = [starts.pop()]
    while row[-1] in after and len(row) <= count:
        row.append(after[row[-1]])
    return row if sorted(row) == list(range(count)) and row != list(range(count)) else None


def _share(look: Look, here: Camera, there: Camera, reading: Reading, step: float) -> float:
    """Return the share of samples whose motion agrees with a camera that went from `there` to `here`; NaN without
    motion."""
    stored = look.motion if reading.motion == MOTION_AS_GIVEN else reading.motion.stored(look)
    motion = None if stored is None else stored @ reading.motion.matrix(look.size).T
    if motion is None:
        return float("nan")
    at, target = reading.camera.read(here), reading.camera.read(there)
    ray, m = rays(at, look.px), at.to_view_of(target)
    n = len(ray)
    reach = Reach(
        ray,
        ray @ m[:3, :3].T,
        np.broadcast_to(m[:3, 3], (n, 3)),
        np.broadcast_to((target.fx, target.fy), (n, 2)),
        np.broadcast_to((target.cx, target.cy), (n, 2)),
    )
    off = reach.pixels(reading.depth.inverse(look.depth, ray)) - look.px - motion
    use = look.solid & np.isfinite(motion).all(-1)
    if use.sum() < 16:
        return float("nan")
    if reading.jitter:
        off = off - np.nanmedian(off[use], axis=0)
    scale = np.median(np.linalg.norm(motion[use], axis=-1))
    return float((np.linalg.norm(off[use], axis=-1) <= max(_AGREES * scale, _FINEST, step)).mean())
