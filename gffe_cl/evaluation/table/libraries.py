"""Extrapolation in a few calls of OpenCV or PyTorch: methods that anyone can install, fast enough to run live.

Runners as in `baselines.py`. What remaps looks the color of t up backward, along the vector that t itself has at the
new frame's pixel: nothing is moved there first, so a moving edge takes the vector of what it covers.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from gffe_cl.evaluation.table.datasets import Moment, Shot
from gffe_cl.evaluation.table.image_space import pixel_centres

FLOWS = ("ultrafast", "fast", "medium", "farneback")  # the first three: presets of DIS
_NEARER = 8  # power of the inverse depth by which a surface outweighs one behind it
_COVERED = 1e-20  # sum of weights from which a pixel is covered


class Remapped:
    """Motion vectors of t, by cv2.remap, with cubic or bilinear interpolation."""

    def __init__(self, cubic: bool = True):
        import cv2

        kind = cv2.INTER_CUBIC if cubic else cv2.INTER_LINEAR
        self._remap = partial(cv2.remap, map2=None, interpolation=kind, borderMode=cv2.BORDER_REPLICATE)
        self._scale_add = cv2.scaleAdd
        self._here = np.zeros((0, 0, 2), np.float32)

    def submit(self, shot: Shot) -> None:
        self._color, self._vectors = _float32(shot.shown), _motion(shot)
        if self._here.shape != self._vectors.shape:
            self._here = pixel_centres(*self._vectors.shape[:2]) - np.float32(0.5)

    def make(self, moment: Moment) -> np.ndarray:
        return self._remap(self._color, self._scale_add(self._vectors, moment.alpha, self._here))


class RemappedFlow(Remapped):
    """Optical flow from t to t−1, one of `FLOWS`, on 8-bit gray (square root of the exposed luma), then a cubic remap.
    It needs pictures only."""

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
            self._find = cv2.DISOpticalFlow_create(preset).calc

    def submit(self, shot: Shot) -> None:
        super().submit(shot)
        luma = self._cv2.cvtColor(self._color, self._cv2.COLOR_RGB2GRAY)
        gray = self._cv2.convertScaleAbs(self._cv2.sqrt(luma), alpha=255 * self._exposure**0.5)
        before = gray if self._gray is None or shot.frame.reset else self._gray
        self._vectors, self._gray = self._find(gray, before, None), gray


class TorchSplat:
    """Forward splat by motion vectors, in the manner of softmax splatting (Niklaus and Liu, CVPR 2020): each pixel adds
    to the four around its new place, weighted by its share and by the 8th power of its inverse depth. Pixels that
    nothing reaches keep the color of t."""

    def __init__(self):
        import torch

        self._torch = torch

    def submit(self, shot: Shot) -> None:
        torch, height, width = self._torch, *shot.frame.depth.shape
        self._color = torch.from_numpy(_float32(shot.shown)).reshape(-1, 3)
        self._motion = torch.from_numpy(_motion(shot)).reshape(-1, 2).nan_to_num(0, 0, 0)
        nearness = (1 / torch.from_numpy(_float32(shot.frame.depth)).reshape(-1, 1)).nan_to_num(0, 0, 0).clamp(min=0)
        weight = (nearness / nearness.max().clamp(min=1e-30)).clamp(min=1e-2) ** _NEARER
        self._carried = torch.cat([self._color * weight, weight], 1)
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        self._size, self._here = (height, width), torch.stack([x, y], -1).reshape(-1, 2)

    def make(self, moment: Moment) -> np.ndarray:
        height, width = self._size
        place = self._here - moment.alpha * self._motion
        low = place.floor()
        part, low = place - low, low.long()
        total = self._torch.zeros_like(self._carried)
        for tap in range(4):
            dx, dy = tap & 1, tap >> 1
            x, y = low[:, 0] + dx, low[:, 1] + dy
            share = (part[:, 0] if dx else 1 - part[:, 0]) * (part[:, 1] if dy else 1 - part[:, 1])
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            index = y.clamp(0, height - 1) * width + x.clamp(0, width - 1)
            total.index_add_(0, index, self._carried * (share * inside)[:, None])
        weight = total[:, 3:]
        made = self._torch.where(weight > _COVERED, total[:, :3] / weight.clamp(min=_COVERED), self._color)
        return made.reshape(height, width, 3).numpy()


def _float32(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float32)


def _motion(shot: Shot) -> np.ndarray:
    motion = shot.frame.motion
    return np.zeros((*shot.frame.depth.shape, 2), np.float32) if motion is None else _float32(motion)
