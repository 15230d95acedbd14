"""Parts of the picture that fit another law than the rest: views of another camera, vectors of another convention."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.doctor.hypotheses.motions import motion_readings
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Look
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search
from gffe_cl.captures.doctor.hypotheses.world_shift import fitted_motion, residuals

_CELLS = 64, 36  # of the picture, in which samples are counted
_AGREES, _FINEST = 0.02, 0.05  # of the motion, and pixels: samples that are off by less agree
_INSIDE, _OUTSIDE = 0.8, 0.35  # share of samples that do not agree: at least within the part, at most beyond it
_AT_BORDER = 0.06  # of a side: what is nearer to the border ends there
_LEAST, _MOST = 0.04, 0.65  # of the picture: its area
_FITS, _BETTER = 0.75, 0.4  # share of its samples that another law must fit, and by how much better than the given one
_FEWEST = 40  # samples in a frame
_DEEP = 2.0  # ratio of depths in the part: a single mover has less


class Rectangle(NamedTuple):
    """Rectangle of the picture, in shares of its sides: left, top, right, bottom."""

    left: float
    top: float
    right: float
    bottom: float

    def holds(self, at: np.ndarray) -> np.ndarray:
        """Return which of the positions `at` (N, 2), in shares of the sides, lie within."""
        return np.all((at >= (self.left, self.top)) & (at < (self.right, self.bottom)), axis=-1)

    def in_words(self, size: tuple[int, int]) -> str:
        sides = [
            f"{name} {sign} {round(share * side)}"
            for name, side, low, high in (("x", size[0], self.left, self.right), ("y", size[1], self.top, self.bottom))
            for sign, share in (("≥", low), ("<", high))
            if 0 < share < 1
        ]
        return f"the part of the picture with {' and '.join(sides)}"


def region_findings(search: Search, reading: Reading) -> list[Finding]:
    """Return a finding if a rectangle of the picture does not fit `reading`, the rest does, and another camera or
    another convention of vectors explains it. Several surfaces must be in it, for a mover is no such part."""
    bench = search.full
    if reading.motion.step != PREVIOUS or reading.motion.adds_camera or reading.jitter:
        return []
    motion, static = search.motions(reading, bench)
    use = bench.solid & np.isfinite(motion).all(-1) & np.isfinite(static).all(-1)
    if use.sum() < _FEWEST:
        return []
    near = max(_AGREES * float(np.median(np.linalg.norm(motion[use], axis=-1))), _FINEST, search.step)
    off = np.linalg.norm(motion - static, axis=-1) > near
    at = bench.px / np.concatenate([np.broadcast_to(look.size, look.px.shape) for look in bench.looks])
    part = _part(at[use], off[use])
    if part is None:
        return []
    inside = part.holds(at) & use
    if not _is_apart(off, inside, use & ~inside, bench) or not _is_deep(bench.stored[inside]):
        return []
    where = part.in_words(bench.looks[0].size)
    named = _convention(search, reading, inside, near)
    if named:
        return [finding("motion: partly another convention", part._asdict(), part=where, convention=named)]
    if not _fits_another_camera(search, reading, part, inside, near):
        return []
    return [finding("frames: several views", part._asdict(), part=where)]


def _part(at: np.ndarray, off: np.ndarray) -> Rectangle | None:
    """Return the rectangle with the most samples that do not agree (`off` (N,)) beyond those that do; None if it is too
    small or large."""
    columns, rows = _CELLS
    x, y = np.minimum((at * _CELLS).astype(int), (columns - 1, rows - 1)).T
    counts = np.zeros((rows, columns))
    np.add.at(counts, (y, x), np.where(off, 1.0, -1.0))
    above = np.concatenate([np.zeros((1, columns)), counts.cumsum(0)])
    best, found = 0.0, None
    for top in range(rows):
        sums = np.concatenate([np.zeros((rows - top, 1)), (above[top + 1 :] - above[top]).cumsum(1)], 1)
        lowest = np.minimum.accumulate(sums, 1)
        gain = sums - lowest
        height, right = np.unravel_index(int(gain.argmax()), gain.shape)
        if gain[height, right] > best:
            best = gain[height, right]
            left = int(sums[height, : right + 1].argmin())
            found = Rectangle(left / columns, top / rows, int(right) / columns, (top + 1 + int(height)) / rows)
    if found is None:
        return None
    found = Rectangle(*(float(np.round(side)) if abs(side - np.round(side)) < _AT_BORDER else side for side in found))
    area = (found.right - found.left) * (found.bottom - found.top)
    return found if _LEAST <= area <= _MOST else None


def _is_apart(off: np.ndarray, inside: np.ndarray, outside: np.ndarray, bench) -> bool:
    """Return whether most samples within the part do not agree, and most others do, in every frame."""
    for frame in range(len(bench.looks)):
        one, other = inside & (bench.frame == frame), outside & (bench.frame == frame)
        if min(one.sum(), other.sum()) < _FEWEST or off[one].mean() < _INSIDE or off[other].mean() > _OUTSIDE:
            return False
    return True


def _is_deep(depth: np.ndarray) -> bool:
    near, far = np.quantile(np.abs(depth), (0.1, 0.9))
    return bool(far > _DEEP * near)


def _convention(search: Search, reading: Reading, inside: np.ndarray, near: float) -> str:
    """Return in words how vectors are to be read within the part; "" if no known convention explains them."""
    bench = search.full
    static = bench.static(reading.camera, reading.depth)
    share = {}
    for motion in motion_readings():
        if motion.step == PREVIOUS and not motion.held_by:
            share[motion] = np.mean(np.linalg.norm(bench.motion(motion) - static, axis=-1)[inside] <= near)
    best = max(share, key=lambda motion: share[motion] - 0.01 * len(motion.parts))
    if not share[best] > max(_FITS, share[reading.motion] + _BETTER):
        return ""
    return "; ".join(finding(f"motion: {part}").sentence for part in best.parts)


def _fits_another_camera(search: Search, reading: Reading, part: Rectangle, inside: np.ndarray, near: float) -> bool:
    """Return whether in most frames another motion of the camera explains the vectors within the part, of several
    surfaces: with the same projection, or with that of a view of its own."""
    bench, fits = search.full, 0
    vectors = bench.motion(reading.motion)
    for number, look in enumerate(bench.looks):
        chosen = inside & (bench.frame == number)
        shares = []
        for fx, fy, cx, cy in _projections(look, reading, part):
            ray = np.ones((int(chosen.sum()), 3))
            ray[:, :2] = (bench.px[chosen] - (cx, cy)) / (fx, fy)
            w = reading.depth.inverse(bench.stored[chosen], ray)
            target = (bench.px + vectors)[chosen] - (cx, cy)
            moved = fitted_motion(np.eye(4), True, ray, w, target / (fx, fy), fx)
            explained = residuals(moved, ray, w, target / (fx, fy), fx) <= near
            if explained.any() and _is_deep(bench.stored[chosen][explained]):
                shares.append(explained.mean())
        fits += max(shares, default=0.0) > _FITS
    return 2 * fits > len(bench.looks)


def _projections(look: Look, reading: Reading, part: Rectangle) -> list[tuple[float, float, float, float]]:
    """Return intrinsics that a view in the part may have: those of the whole picture, or of one that was cut off and
    begins here, and its own."""
    camera, (width, height) = reading.camera.read(look.camera), look.size
    cx, cy = (part.left + part.right) / 2 * width, (part.top + part.bottom) / 2 * height
    scales = {1.0, part.right - part.left, part.bottom - part.top}
    own = [(camera.fx * scale, camera.fy * scale, cx, cy) for scale in scales]
    cut = (camera.fx, camera.fy, camera.cx + part.left * width, camera.cy + part.top * height)
    return [(camera.fx, camera.fy, camera.cx, camera.cy), cut, *own]
