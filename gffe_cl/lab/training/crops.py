"""Selection of training crops, and batches of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.program import constants
from gffe_cl.lab.metrics import FOCUS_SMAPE, relative_error, shading_regions
from gffe_cl.lab.training.clips import CHANNELS, CROP, HALVED_CHANNELS, PLANES, VERSION, finished_clips, halved_path
from gffe_cl.lab.training.images import halve
from gffe_cl.lab.training.network import encode

TOP_SHARE = 0.15  # of all crops: those with the most focus pixels (paper: 'Data Preparation')
RANDOM_SHARE = 0.06  # of all crops: any of the others
_HALF_REACH = 0.75  # of the neighborhood at half resolution, whose pixels are twice as far apart
_DISOCCLUDED = constants("shading.cl")["MASK_DISOCCLUDED"]  # input mask there
DYNAMIC = 0.75  # input mask above which a pixel counts as dynamic; 1 where it is one pixel of the frame


@dataclass(frozen=True)
class Crop:
    """Position of a crop; `focus` is its share of focus pixels (`clips.crops_of`), `height` that of the clip's
    frames."""

    path: Path
    sample: int
    y: int
    x: int
    alpha: float
    focus: float
    height: int = CROP


@dataclass
class Batch:
    """Batch of crops: exposed linear color (N, 3, H, W) of the GAE frame, the warped previous frame and the truth;
    `side` (N, 2, H, W): inverse depth and input mask; `trends` (N, 8, h, w) of shading, always at a quarter of the
    frames' resolution; alpha (N,); `heights` (N,) of the frames that the crops are of, in pixels. `halved`: all at half
    resolution."""

    gae: Tensor
    previous: Tensor
    truth: Tensor
    side: Tensor
    trends: Tensor
    alpha: Tensor
    heights: Tensor
    halved: bool = False

    def images(self) -> list[Tensor]:
        return [self.gae, self.previous, self.truth, self.side]

    def frames(self) -> Tensor:
        """Return the network's input without trends."""
        planes = torch.cat((encode(self.gae), encode(self.previous), self.side), 1)
        return planes if self.halved else halve(planes)

    def focus(self) -> Tensor:
        """Return the focus mask by the truth, (N, 1, H, W) bool."""
        dynamic = self.side[:, 1:] > DYNAMIC
        return focus_truth(self.gae, self.truth, dynamic, _HALF_REACH if self.halved else 1.0)

    def regions(self) -> dict[str, Tensor]:
        """Return the regions in which results are measured, (N, 1, H, W) bool: `gffe_cl.lab.metrics.shading_regions`.
        They are defined for whole samples only."""
        return shading_regions(self.focus(), self.side[:, 1:] == _DISOCCLUDED)


def focus_truth(gae: Tensor, truth: Tensor, dynamic: Tensor, reach: float = 1.0) -> Tensor:
    """Return M^focus, (N, 1, H, W) bool, as `gffe_cl.lab.metrics.focus_mask` does; neighbors are `reach` pixels
    away."""
    height, width = gae.shape[-2:]
    padded = functional.pad(truth, (1, 1, 1, 1), value=1e9)
    least = None
    for dy in range(3):
        for dx in range(3):
            other = padded[..., dy : dy + height, dx : dx + width]
            if reach != 1:
                other = torch.lerp(truth, other, reach)
            error = relative_error(gae, other).sum(1, keepdim=True)
            least = error if least is None else torch.minimum(least, error)
    assert least is not None
    return (least > 3 * FOCUS_SMAPE) & ~dynamic


def list_crops(folder: Path, seed: int, clips: int) -> list[Crop]:
    """Return all crops of the clips 0 … `clips` − 1 of `seed` that are finished in `folder`.

    Raises GffeError if there are none or they are of another version.
    """
    crops = []
    for path in finished_clips(folder, seed, clips):
        try:
            document = json.loads(path.read_text())
            version = document["version"]
            for k, (alpha, places) in enumerate(zip(document["alphas"], document["crops"], strict=True)):
                height, name = document["plan"]["height"], path.with_suffix(".npy")
                crops += [Crop(name, k, y, x, alpha, focus, height) for y, x, focus in places]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise GffeError(f"{path}: not a description of a training clip ({error})") from None
        if version != VERSION:
            raise GffeError(f"{path}: training data of version {version}, expected {VERSION} (use another folder)")
    if not crops:
        raise GffeError(f"{folder}: no training clips (expected clip_*.npy and clip_*.json)")
    return crops


def keep_crops(crops: list[Crop], seed: int) -> list[Crop]:
    """Return the top 15% by focus pixels, and 6% of all from the rest, at random."""
    ranked = sorted(crops, key=lambda crop: -crop.focus)
    top = max(1, round(TOP_SHARE * len(ranked)))
    rest = ranked[top:]
    count = min(len(rest), round(RANDOM_SHARE * len(ranked)))
    chosen = np.random.default_rng([seed, 3]).choice(len(rest), count, replace=False) if count else []
    return ranked[:top] + [rest[i] for i in chosen]


class CropReader:
    """Reader of crops from disk into the memory of `device`. A GPU keeps those that fit into half of its free memory;
    for a CPU the system caches files."""

    def __init__(self, device: torch.device):
        self.device = device
        self._kept: dict[tuple[Crop, bool], Tensor] = {}
        self._left = torch.cuda.mem_get_info(device)[0] // 2 if device.type == "cuda" else 0

    def batch(self, crops: list[Crop], halved: bool = False) -> Batch:
        """Return a batch of crops. Raises GffeError for a file that is missing, truncated or of another shape."""
        half = torch.stack([self._read(crop, True) for crop in crops]).float()
        planes = half if halved else torch.stack([self._read(crop, False) for crop in crops]).float()
        alpha = torch.tensor([crop.alpha for crop in crops], device=self.device)
        heights = torch.tensor([float(crop.height) for crop in crops], device=self.device)
        images = (planes[:, part] for part in PLANES.values())
        return Batch(*images, trends=half[:, CHANNELS:, ::2, ::2], alpha=alpha, heights=heights, halved=halved)

    def _read(self, crop: Crop, halved: bool) -> Tensor:
        """Return the planes of a crop, of `Crop.path` or of its half resolution."""
        if (kept := self._kept.get((crop, halved))) is not None:
            return kept
        path, channels, scale = (halved_path(crop.path), HALVED_CHANNELS, 2) if halved else (crop.path, CHANNELS, 1)
        shape, y, x = (channels, CROP // scale, CROP // scale), crop.y // scale, crop.x // scale
        try:
            part = np.load(path, mmap_mode="r")[crop.sample, :, y : y + shape[1], x : x + shape[2]]
        except (OSError, EOFError, ValueError, IndexError) as error:
            raise GffeError(f"{path}: not a training clip ({error})") from None
        if part.shape != shape:
            raise GffeError(f"{path}: expected crops of {shape}, got {part.shape}")
        read = torch.from_numpy(np.array(part)).to(self.device)
        if read.nbytes <= self._left:
            self._left -= read.nbytes
            self._kept[crop, halved] = read
        return read
