"""Extrapolation in a few calls of OpenCV or PyTorch: methods that anyone can install, fast enough to run live.

They are runners as in `baselines.py`. Remapping looks the color of t up backward, along the vector that t itself has at
the new frame's pixel. Vectors are not moved there first, so a moving edge takes the vector of the surface that it
covers.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from gffe_cl.lab.table.datasets import Moment, Shot
from gffe_cl.lab.table.image_space import pixel_centers

FLOWS = ("ultrafast", "fast", "medium", "farneback")  # the first three: presets of DIS
_FAR = 1e30  # depth of the sky
_SAME_LAYER = 0.05  # of the depth
_LEAST = 1e-6  # share that is divided by


class Remapped:
    """Continues motion vectors of t by cv2.remap, with cubic or bilinear interpolation."""

    def __init__(self, cubic: bool = False):
        import cv2

        kind = cv2.INTER_CUBIC if cubic else cv2.INTER_LINEAR
        remap: Any = cv2.remap
        self._remap = partial(remap, map2=None, interpolation=kind, borderMode=cv2.BORDER_REPLICATE)
        self._scale_add = cv2.scaleAdd
        self._here = np.zeros((0, 0, 2), np.float32)

    def submit(self, shot: Shot) -> None:
        self._color, self._vectors = _float32(shot.shown), _motion(shot)
        if self._here.shape != self._vectors.shape:
            self._here = pixel_centers(*self._vectors.shape[:2]) - np.float32(0.5)

    def make(self, moment: Moment) -> np.ndarray:
        return self._remap(self._color, self._scale_add(self._vectors, moment.alpha, self._here))


class RemappedFlow(Remapped):
    """Continues the optical flow from t to t−1, one of `FLOWS`, on 8-bit gray (square root of the exposed luma), by a
    bilinear remap. It needs pictures only."""

    def __init__(self, flow: str, exposure: float):
        import cv2

        super().__init__()
        self._cv2, self._exposure, self._gray = cv2, exposure, None
        if flow == "farneback":
            self._find = partial(
                cv2.calcOpticalFlowFarneback, pyr_scale=0.5, levels=3, winsize=15, iterations=3, poly_n=5,
                poly_sigma=1.1, flags=0,
            )  # fmt: skip
        else:
            preset = getattr(cv2, f"DISOPTICAL_FLOW_PRESET_{flow.upper()}")
            self._find: Any = cv2.DISOpticalFlow.create(preset).calc

    def submit(self, shot: Shot) -> None:
        super().submit(shot)
        luma = self._cv2.cvtColor(self._color, self._cv2.COLOR_RGB2GRAY)
        gray = self._cv2.convertScaleAbs(self._cv2.sqrt(luma), alpha=255 * self._exposure**0.5)
        before = gray if self._gray is None or shot.frame.reset else self._gray
        self._vectors, self._gray = self._find(gray, before, None), gray


class TorchSplat:
    """Splats forward by motion vectors. Pixels claim the depth of the pixel nearest to their new place. The nearest
    surface wins, and surfaces within 5% of it are mixed by their share of the pixel. Pixels that nothing reaches keep
    the color of t."""

    def __init__(self):
        import torch

        self._torch = torch

    def submit(self, shot: Shot) -> None:
        torch, height, width = self._torch, *shot.frame.depth.shape
        self._color = torch.from_numpy(_float32(shot.shown)).reshape(-1, 3)
        self._carried = torch.cat([self._color, torch.ones(height * width, 1)], 1)
        self._motion = torch.from_numpy(_motion(shot)).reshape(-1, 2).nan_to_num(0, 0, 0)
        self._depth = torch.from_numpy(_float32(shot.frame.depth)).reshape(-1).nan_to_num(_FAR, _FAR, _FAR)
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        self._size, self._here = (height, width), torch.stack([x, y], -1).reshape(-1, 2)

    def make(self, moment: Moment) -> np.ndarray:
        torch = self._torch
        place = self._here - moment.alpha * self._motion
        index, inside = self._pixels((place + 0.5).floor().long())
        front = torch.full_like(self._depth, _FAR)
        front.scatter_reduce_(0, index[inside], self._depth[inside], "amin")
        low = place.floor()
        part, total = place - low, torch.zeros_like(self._carried)
        for tap in range(4):
            dx, dy = tap & 1, tap >> 1
            share = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
            index, inside = self._pixels(low.long() + torch.tensor((dx, dy)))
            reached = front[index]
            share = share * (inside & ((self._depth - reached).abs() <= _SAME_LAYER * reached))
            total.index_add_(0, index, self._carried * share[:, None])
        weight = total[:, 3:]
        made = torch.where(weight > 0, total[:, :3] / weight.clamp(min=_LEAST), self._color)
        return made.reshape(*self._size, 3).numpy()

    def _pixels(self, place):
        """Return the indices of the pixels at `place` (N, 2), x and y, at the border if outside; and whether they are
        inside."""
        (height, width), (x, y) = self._size, place.unbind(1)
        clamped = y.clamp(0, height - 1) * width + x.clamp(0, width - 1)
        return clamped, (x >= 0) & (x < width) & (y >= 0) & (y < height)


def _float32(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float32)


def _motion(shot: Shot) -> np.ndarray:
    motion = shot.frame.motion
    return np.zeros((*shot.frame.depth.shape, 2), np.float32) if motion is None else _float32(motion)
