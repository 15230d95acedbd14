"""Test of motion vectors without the camera's part, or zero: then the colors alone judge cameras and depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gffe_cl.captures.doctor.hypotheses.cameras import CAMERA_AS_GIVEN, CameraReading, camera_readings
from gffe_cl.captures.doctor.hypotheses.depths import ALONG_RAYS, AS_GIVEN, DEVICE, PLANAR, DepthReading
from gffe_cl.captures.doctor.hypotheses.motions import MotionReading, motion_readings
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS
from gffe_cl.captures.doctor.hypotheses.scoring import mostly_nothing, trimmed
from gffe_cl.captures.doctor.hypotheses.search import EDIT, FOCALS, Reading, Search, Verdict

_VISIBLE, _SEEN = 0.1, 0.2  # pixels that static points move, and the share of them that must
_GAIN = 0.012  # gain of color scores that every deviation from the given reading needs
_MOVER = 0.05  # of the largest motion vector: longer ones are of movers
_UNITS = (100.0, 0.01, 1000.0, 0.001)
_PLANES = np.exp(np.linspace(np.log(0.005), np.log(20), 25))  # near planes tried, world units


def without_camera(search: Search) -> Verdict | None:
    """Return the verdict on motion vectors that lack the camera's part; None unless most are zero though the camera
    moves."""
    stored = search.full.motion(MotionReading())
    length = np.linalg.norm(stored, axis=-1)
    solid = search.full.solid & np.isfinite(length)
    if not solid.any():
        return None
    largest = float(np.quantile(length[solid], 0.999))
    if not mostly_nothing(length[solid]):
        return None
    step = search.step if largest > 0 else 1.0  # of vectors that may have been rounded to nothing
    if not np.any(np.nan_to_num(search.full.static(CAMERA_AS_GIVEN, AS_GIVEN)[solid])):
        return None
    camera, depth = _by_colors(search)
    static = search.full.static(camera, depth)
    seen = np.abs(np.nan_to_num(static[solid])).max(-1) > max(_VISIBLE, 0.55 * step)
    if seen.mean() < _SEEN or not mostly_nothing(length[solid][seen]):
        return None
    color = search.camera_color(camera, depth)
    if not color > search.static_color(np.zeros_like(static), PREVIOUS) + _GAIN:
        return None
    motion = _of_movers(search, static, length > _MOVER * largest) if largest > 0 else None
    motion = motion or replace(MotionReading(("zero",)), adds_camera=True)
    return Verdict(Reading(motion, camera, depth), float("nan"), color, color, search.edges)


def _by_colors(search: Search) -> tuple[CameraReading, DepthReading]:
    """Return the camera and the depth that fit colors best, or those given unless others are clearly better."""

    def cost(pair) -> float:
        camera, depth = pair
        edits = len(camera.parts) + (camera.focal != 1) + (depth != AS_GIVEN)
        return _GAIN * edits - np.nan_to_num(search.camera_color(camera, depth))

    depths = [AS_GIVEN, DepthReading(ALONG_RAYS, (1.0,))]
    depths += [DepthReading(PLANAR, (unit,)) for unit in _UNITS]
    for near in _PLANES:
        depths += [DepthReading(DEVICE, (0.0, 1 / near)), DepthReading(DEVICE, (1 / near, -1 / near))]
    cameras = [one for camera in camera_readings() for one in (camera, camera.opposite())]
    cameras = sorted(cameras, key=lambda camera: cost((camera, AS_GIVEN)))[:3]
    cameras = list(dict.fromkeys([CAMERA_AS_GIVEN, *cameras]))
    best = min(((camera, depth) for camera in cameras for depth in depths), key=cost)
    if best[1].model is DEVICE:
        best = min(((best[0], _scaled(best[1], factor)) for factor in _around(1.0, 0.17, 35)), key=cost)
    focal = min(
        (camera.with_focal(f) for camera in {best[0], *cameras} for f in FOCALS), key=lambda c: cost((c, best[1]))
    )
    if cost((focal, best[1])) < cost(best):
        best = min(((focal.with_focal(f), best[1]) for f in _around(focal.focal, 0.06, 25)), key=cost)
    return best


def _around(middle: float, width: float, count: int) -> np.ndarray:
    return middle * np.exp(np.linspace(-width, width, count))


def _scaled(depth: DepthReading, factor: float) -> DepthReading:
    return replace(depth, coefficients=tuple(c * factor for c in depth.coefficients))


def _of_movers(search: Search, static: np.ndarray, movers: np.ndarray) -> MotionReading | None:
    """Return how the vectors of movers are to be read; None if there are too few of them."""
    scores = {}
    for reading in motion_readings():
        if reading.step != PREVIOUS or reading.held_by:
            continue
        score = search.full.color_scores(search.full.motion(reading) + static, PREVIOUS)
        use = movers & np.isfinite(score)
        if use.sum() < 16:
            return None
        scores[reading] = trimmed(search.full.by_frame(score, use)) - EDIT * len(reading.parts)
    best = max(scores, key=lambda r: np.nan_to_num(scores[r]))
    if not scores[best] > scores[MotionReading()] + _GAIN:
        best = MotionReading()
    return replace(best, parts=("without the camera", *best.parts), adds_camera=True)
