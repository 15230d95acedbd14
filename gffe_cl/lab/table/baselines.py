"""Baselines: other kinds of methods, in their plainest form, each a runner of the table.

They stand for a kind of method, not for a product. Published methods add further parts, above all networks. Runners
take rendered frames by `submit(shot)` and make pictures of moments by `make(moment)`: linear (H, W, 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.metrics import to_display
from gffe_cl.lab.metrics.flicker import LUMA
from gffe_cl.lab.metrics.regions import same_surface
from gffe_cl.lab.table.datasets import Moment, Shot
from gffe_cl.lab.table.image_space import filled, pixel_centers, sample, sample_sharp, splat, taps

_SAME_AS_BEFORE = 0.1  # of the depth, between two frames of a moving camera
_GUIDED_REACHES = (1, 2, 4, 8, 16, 32)  # pixels
_SHOWS = 0.1  # of a pixel: so much of a surface, and it shows there
_GUIDED_DEPTH = 0.05  # of the depth: how alike guides must be


class Repeat:
    """Shows the last rendered frame again."""

    def submit(self, shot: Shot) -> None:
        self._shown = shot.shown

    def make(self, moment: Moment) -> np.ndarray:
        return self._shown


class MotionVectors:
    """Continues motion vectors in image space, in the manner of Mob-FGSR (Yang et al., SIGGRAPH 2024): splat to t + α
    with the depth test, holes take the nearest vector, and the color of t is looked up backward.

    `order` 1: at constant speed; 2: with the change of the vectors since the frame before, found where they point to.
    """

    def __init__(self, order: int):
        self._order, self._before = order, None

    def submit(self, shot: Shot) -> None:
        frame = shot.frame
        self._color, self._depth = shot.shown.astype(np.float32), frame.depth
        speed = np.zeros((*frame.depth.shape, 2), np.float32) if frame.motion is None else -frame.motion
        self._speed, self._change = speed, np.zeros_like(speed)
        if self._order == 2 and self._before is not None and not frame.reset:
            place = pixel_centers(*frame.depth.shape) - speed
            self._change = speed - sample(self._before, place)[0]
        self._before = np.nan_to_num(speed)

    def make(self, moment: Moment) -> np.ndarray:
        alpha = np.float32(moment.alpha)
        moved = alpha * self._speed + alpha * (alpha + 1) / 2 * self._change
        here = pixel_centers(*self._depth.shape)
        field, known = splat(here + moved, self._depth, moved)
        return sample(self._color, here - filled(field, known))[0]


class OpticalFlow:
    """Continues the flow from t to t−1 by OpenCV's DIS (Kroeger et al., ECCV 2016) on displayed pictures at constant
    speed, and warps forward. Holes take the nearest vector. It needs pictures only."""

    def __init__(self, exposure: float):
        import cv2

        self._find: Any = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self._exposure = exposure
        self._gray: np.ndarray | None = None

    def submit(self, shot: Shot) -> None:
        self._color = shot.shown.astype(np.float32)
        gray = (255 * (to_display(shot.shown, self._exposure) @ LUMA)).astype(np.uint8)
        before = gray if self._gray is None or shot.frame.reset else self._gray
        self._flow, self._gray = self._find.calc(gray, before, None), gray

    def make(self, moment: Moment) -> np.ndarray:
        moved = -np.float32(moment.alpha) * self._flow
        height, width = moved.shape[:2]
        here = pixel_centers(height, width)
        field, known = splat(here + moved, np.ones((height, width), np.float32), moved)
        return sample(self._color, here - filled(field, known))[0]


class GuidedExtrapolation:
    """Warps frame t backward, guided by G-buffers of the new frame, in the manner of ExtraSS-E (Wu et al., SIGGRAPH
    Asia 2023): where any of its surface shows in t, the color is looked up there, antialiased as it is; else it is a
    mean of pixels around with similar depth. The G-buffers are exact, and their cost is not counted."""

    def submit(self, shot: Shot) -> None:
        self._color, self._depth = shot.shown.astype(np.float32), shot.frame.depth

    def make(self, moment: Moment) -> np.ndarray:
        guide = moment.guide
        assert guide is not None  # see Method.needs
        place = pixel_centers(*guide.depth.shape) + guide.motion
        seen = same_surface(taps(self._depth, place), guide.source_depth)
        height, width = guide.depth.shape
        with np.errstate(invalid="ignore"):
            seen &= (place >= 0).all(-1) & (place < (width, height)).all(-1)
        _, shows = sample(self._color, place, seen)
        return guided_fill(sample_sharp(self._color, place), shows >= _SHOWS, guide.depth)


class Interpolation:
    """Interpolates between t and the next rendered frame along the latter's motion vectors. It is a reference with the
    latency that extrapolation avoids. Where both frames show one surface they are mixed by time. Surfaces that only t
    shows follow t's own vectors."""

    def submit(self, shot: Shot) -> None:
        self._shot = shot

    def make(self, moment: Moment) -> np.ndarray:
        now, after = self._shot.frame, self._shot.following
        alpha, height = np.float32(moment.alpha), now.depth.shape[0]
        here = pixel_centers(height, now.depth.shape[1])
        if after is None:
            raise GffeError("interpolation: the rendered frame after this one is missing")
        back = after.motion
        own = np.zeros_like(back) if now.motion is None else now.motion
        field, known = splat(here + (1 - alpha) * back, after.depth, np.concatenate([back, after.depth[..., None]], -1))
        old, old_known = splat(here - alpha * own, now.depth, own)
        vectors, depth = field[..., :2], field[..., 2]
        before_place = here + alpha * vectors
        met = taps(now.depth, before_place)
        with np.errstate(invalid="ignore"):
            both = (np.abs(met - depth) <= _SAME_AS_BEFORE * depth).any(0) | (np.isinf(met).any(0) & (depth >= 1e29))
        later = sample(after.color[..., :3].astype(np.float32), here - (1 - alpha) * vectors)[0]
        earlier = sample(now.color[..., :3].astype(np.float32), before_place)[0]
        mixed = np.where(both[..., None], (1 - alpha) * earlier + alpha * later, later)
        only_old = sample(now.color[..., :3].astype(np.float32), here + alpha * filled(old, old_known))[0]
        return np.where(known[..., None], mixed, only_old)


def guided_fill(color: np.ndarray, known: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return `color` (H, W, 3), filled where it is not `known`: with means of known pixels of similar `depth` (H,
    W), from increasing distances, or else with the nearest pixel."""
    color, known = color.copy(), known.copy()
    nearness = np.where(np.isfinite(depth), 1 / np.maximum(depth, 1e-6), 0).astype(np.float32)
    height, width = depth.shape
    for reach in _GUIDED_REACHES:
        y, x = np.nonzero(~known)
        if not len(y):
            return color
        total, weights = np.zeros((len(y), 3), np.float32), np.zeros(len(y), np.float32)
        for dy in (-2, -1, 0, 1, 2):
            for dx in (-2, -1, 0, 1, 2):
                ny, nx = y + dy * reach, x + dx * reach
                inside = (ny >= 0) & (ny < height) & (nx >= 0) & (nx < width)
                ny, nx = np.clip(ny, 0, height - 1), np.clip(nx, 0, width - 1)
                apart = np.abs(nearness[ny, nx] - nearness[y, x]) / np.maximum(nearness[y, x], 1e-6)
                weight = inside * known[ny, nx] * np.exp(-((apart / _GUIDED_DEPTH) ** 2) - 0.2 * (dx * dx + dy * dy))
                total += weight[:, None] * color[ny, nx]
                weights += weight
        found = weights > 1e-3
        color[y[found], x[found]] = total[found] / weights[found, None]
        known[y[found], x[found]] = True
    return filled(color, known)
