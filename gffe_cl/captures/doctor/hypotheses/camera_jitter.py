"""Hypotheses about jitter in the cameras' principal points: whether motion vectors have it, and whether colors do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Look, relinked
from gffe_cl.captures.doctor.hypotheses.scoring import color_gain
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.engine.frame.camera import Camera

Factors = tuple[float, float]
SAME, NONE = (1.0, 1.0), (0.0, 0.0)
OTHERS: dict[Factors, str] = {  # jitter of vectors in units of the cameras', and what is wrong with one of them
    NONE: "absent",
    (-1.0, -1.0): "of the opposite sign",
    (1.0, -1.0): "of the opposite sign in y",
    (-1.0, 1.0): "of the opposite sign in x",
    (2.0, 2.0): "twice as large",
    (0.5, 0.5): "half as large",
}
INVERSE = {difference: difference for difference in OTHERS.values()}  # the same, of the cameras compared with vectors
INVERSE |= {"twice as large": "half as large", "half as large": "twice as large"}
_MOST, _LEAST = 1.25, 0.05  # pixels: largest deviation of a principal point, and least standard deviation
_SAME_FOCAL = 1e-3  # relative difference of focal lengths
_CENTERED = 0.25  # pixels: where the mean is so near to the middle of the image, that is the center
SURE = 4.0  # standard deviations by which colors decide
_BETTER = 0.1  # of agreements, by which another jitter of vectors must fit better


def jitter_center(entries: list[FrameEntry], size: tuple[int, int]) -> np.ndarray | None:
    """Return the center (2,) of the principal points of rendered frames, in pixels, if they are jittered about it; None
    if they are not. `size`: (width, height) of the frames."""
    cameras = [entry.render_camera for entry in entries if entry.render_camera is not None]
    if len(cameras) < 3:
        return None
    points, focal = (np.array([values(c) for c in cameras]) for values in (_point, lambda c: (c.fx, c.fy)))
    if np.ptp(focal, axis=0).max() > _SAME_FOCAL * focal.max():
        return None
    mean, middle = points.mean(0), np.divide(size, 2)
    center = middle if np.abs(mean - middle).max() < _CENTERED else mean
    if np.abs(points - center).max() > _MOST or np.linalg.norm(points.std(0)) < _LEAST:
        return None
    return center


def _point(camera: Camera) -> tuple[float, float]:
    return camera.cx, camera.cy


@dataclass(frozen=True)
class JitterChange:
    """Change of jitter: deviations of principal points from `center` (pixels) are multiplied by `camera`, and `motion`
    times the cameras' jitter is added to motion vectors."""

    center: tuple[float, float]
    camera: Factors = SAME
    motion: Factors = NONE

    def changed(self, camera: Camera) -> Camera:
        x, y = np.add(self.center, np.multiply(self.camera, np.subtract(_point(camera), self.center))).tolist()
        return replace(camera, cx=x, cy=y)

    def added(self, camera: Camera, before: Camera) -> np.ndarray:
        """Return what is added to vectors from a frame of `camera` to that of the camera `before`: (2,) pixels."""
        return np.multiply(self.motion, np.subtract(_point(before), _point(camera)))

    def looks(self, looks: dict[int, Look]) -> dict[int, Look]:
        """Return changed looks."""
        made = {}
        for k, look in looks.items():
            before, motion = look.neighbors.get(PREVIOUS), look.motion
            if before is not None and motion is not None:
                motion = motion + self.added(look.camera, before.camera)
            made[k] = replace(look, neighbors={}, camera=self.changed(look.camera), motion=motion)
        return relinked(made)


def jitter_of_vectors(looks: dict[int, Look], deep: list[int], center: np.ndarray, step: float) -> Factors:
    """Return the jitter that vectors have, in units of the jitter of the cameras: SAME unless another one fits clearly
    better. `deep`: numbers of the looks that are compared; `step`: of quantized vectors, pixels."""

    def agreement(factors: Factors) -> float:
        made = JitterChange((center[0], center[1]), camera=factors).looks(looks)
        search = Search([made[k] for k in deep], step)
        return float(np.nan_to_num(search.agreement(search.full, *search.motions(Reading(), search.full))))

    given = agreement(SAME)
    found = {factors: agreement(factors) for factors in OTHERS}
    best = max(found, key=found.__getitem__)
    return best if found[best] > given + _BETTER else SAME


def jitter_of_colors(looks: dict[int, Look], deep: list[int], center: np.ndarray, vectors: Factors) -> Factors | None:
    """Return the jitter that colors have, in units of the jitter of the cameras: SAME, that of `vectors`, or NONE. None
    if colors do not decide."""
    motions, bench = {}, None
    for factors in {SAME, vectors, NONE}:
        made = JitterChange((center[0], center[1]), camera=factors).looks(looks)
        bench = Search([made[k] for k in deep]).full
        motions[factors] = Search.motions(Reading(), bench)[1]
    assert bench is not None  # there are at least two
    for factors, motion in motions.items():
        gains = [color_gain(bench, motion, other, PREVIOUS) for name, other in motions.items() if name != factors]
        if min(gains) > SURE:
            return factors
    return None
