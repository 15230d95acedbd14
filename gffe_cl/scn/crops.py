"""Training crops: which ones are kept, and how batches of them are varied."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from gffe_cl.errors import GffeError
from gffe_cl.metrics import FOCUS_SMAPE, relative_error, shading_regions
from gffe_cl.opencl.program import constants
from gffe_cl.scn.clips import CHANNELS, CROP, PLANES, VERSION, finished_clips, halved_path
from gffe_cl.scn.network import encode, halve

TOP_SHARE = 0.15  # of all crops: those with the most focus pixels (paper: 'Data Preparation')
RANDOM_SHARE = 0.03  # of all crops: any of the others
_HALF_REACH = 0.75  # of the neighbourhood at half resolution, whose pixels are twice as far apart
_DISOCCLUDED = constants("shading.cl")["MASK_DISOCCLUDED"]  # input mask there
_DYNAMIC = 0.75  # input mask above which a pixel counts as dynamic; 1 where it is one pixel of the frame


@dataclass(frozen=True)
class Crop:
    """Where a crop is; `focus` is its share of focus pixels (`clips.crops_of`)."""

    path: Path
    sample: int
    y: int
    x: int
    alpha: float
    focus: float


@dataclass
class Batch:
    """Exposed linear colour (N, 3, H, W) of the GAE frame, the warped previous frame and the truth;
    `side` (N, 2, H, W): inverse depth and input mask; alpha (N,). `halved`: all at half resolution."""

    gae: Tensor
    previous: Tensor
    truth: Tensor
    side: Tensor
    alpha: Tensor
    halved: bool = False

    def images(self) -> list[Tensor]:
        return [self.gae, self.previous, self.truth, self.side]

    def to(self, device) -> Batch:
        return Batch(*(image.to(device) for image in self.images()), self.alpha.to(device), self.halved)

    def frames(self) -> Tensor:
        """The network's input."""
        planes = torch.cat((encode(self.gae), encode(self.previous), self.side), 1)
        return planes if self.halved else halve(planes)

    def target(self) -> Tensor:
        """The truth as the network would see it."""
        truth = encode(self.truth)
        return truth if self.halved else halve(truth)

    def focus(self) -> Tensor:
        """(N, 1, H, W) bool: the focus mask that the truth gives."""
        dynamic = self.side[:, 1:] > _DYNAMIC
        return focus_truth(self.gae, self.truth, dynamic, _HALF_REACH if self.halved else 1.0)

    def regions(self) -> dict[str, Tensor]:
        """`gffe_cl.metrics.shading_regions`, (N, 1, H, W) bool: where results are measured. Of whole samples only."""
        return shading_regions(self.focus(), self.side[:, 1:] == _DISOCCLUDED)


def focus_truth(gae: Tensor, truth: Tensor, dynamic: Tensor, reach: float = 1.0) -> Tensor:
    """M^focus, (N, 1, H, W) bool: as `gffe_cl.metrics.focus_mask`; neighbours are `reach` pixels away."""
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
    return (least > 3 * FOCUS_SMAPE) & ~dynamic


def list_crops(folder: Path, seed: int, clips: int) -> list[Crop]:
    """All crops of the clips 0 … `clips` − 1 of `seed` that are finished in `folder`.

    Raises GffeError if there are none or they are of another version.
    """
    crops = []
    for path in finished_clips(folder, seed, clips):
        try:
            document = json.loads(path.read_text())
            version = document["version"]
            for k, (alpha, places) in enumerate(zip(document["alphas"], document["crops"], strict=True)):
                crops += [Crop(path.with_suffix(".npy"), k, y, x, alpha, focus) for y, x, focus in places]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise GffeError(f"{path}: not a description of a training clip ({error})") from None
        if version != VERSION:
            raise GffeError(f"{path}: training data of version {version}, expected {VERSION} (use another folder)")
    if not crops:
        raise GffeError(f"{folder}: no training clips (expected clip_*.npy and clip_*.json)")
    return crops


def keep_crops(crops: list[Crop], seed: int) -> list[Crop]:
    """The top 15% by focus pixels, and 3% of all from the rest, at random."""
    ranked = sorted(crops, key=lambda crop: -crop.focus)
    top = max(1, round(TOP_SHARE * len(ranked)))
    rest = ranked[top:]
    count = min(len(rest), round(RANDOM_SHARE * len(ranked)))
    chosen = np.random.default_rng([seed, 3]).choice(len(rest), count, replace=False) if count else []
    return ranked[:top] + [rest[i] for i in chosen]


def load_batch(crops: list[Crop], halved: bool = False) -> Batch:
    """Read crops from disk. Raises GffeError for a file that is missing, truncated or of another shape."""
    arrays, scale = [], 2 if halved else 1
    shape = (CHANNELS, CROP // scale, CROP // scale)
    for crop in crops:
        path = halved_path(crop.path) if halved else crop.path
        y, x = crop.y // scale, crop.x // scale
        try:
            part = np.load(path, mmap_mode="r")[crop.sample, :, y : y + shape[1], x : x + shape[2]]
        except (OSError, EOFError, ValueError, IndexError) as error:
            raise GffeError(f"{path}: not a training clip ({error})") from None
        if part.shape != shape:
            raise GffeError(f"{path}: expected crops of {shape}, got {part.shape}")
        arrays.append(np.array(part))
    planes = torch.from_numpy(np.stack(arrays)).float()
    alpha = torch.tensor([crop.alpha for crop in crops])
    return Batch(*(planes[:, part] for part in PLANES.values()), alpha, halved)


class Augmentation:
    """Varies batches: mirrored and turned, other exposures and hues, noise, and shading of its own that moves.

    The moving shading stands for lights, unseen casters and reflections: a pattern multiplies (shadows, pools of light)
    or is added to (reflections) the three frames, each where it has got to by then, on what is not dynamic. All frames
    of a sample show the geometry at t + α, so shading that moves by v pixels per interval is at x in the GAE frame, at
    x − v in the warped previous frame and at x + α v in the truth.
    """

    def __init__(self, generator: torch.Generator, shading: float = 0.6, noise: float = 0.25):
        self.generator, self.shading, self.noise = generator, shading, noise

    def __call__(self, batch: Batch) -> Batch:
        colors = torch.stack((batch.gae, batch.previous, batch.truth))  # (3, N, 3, H, W)
        side = batch.side
        if self._chance() < 0.5:
            colors, side = colors.flip(-1), side.flip(-1)
        if self._chance() < 0.5:
            colors, side = colors.flip(-2), side.flip(-2)
        if self._chance() < 0.5:
            colors, side = colors.transpose(-1, -2), side.transpose(-1, -2)
        count = colors.shape[1]
        hue = torch.stack([torch.randperm(3, generator=self.generator) for _ in range(count)])
        colors = colors.gather(2, hue.view(1, count, 3, 1, 1).expand_as(colors))
        colors = colors * torch.exp2(self._uniform((1, count, 3, 1, 1), -0.3, 0.3))
        for change, share in ((self._reflected, 0.4), (self._lit, 1.0), (self._lit, 0.4)):
            some = self._some(count, share * self.shading)
            if len(some):
                colors[:, some] = change(colors[:, some], side[some], batch.alpha[some])
        colors *= torch.exp2(self._uniform((1, count, 1, 1, 1), -1.5, 1.0))
        some = self._some(count, self.noise)
        if len(some):
            colors[:2, some] = self._grainy(colors[:2, some])
        return Batch(*colors.clamp_(0, 60000), side, batch.alpha, batch.halved)

    def _chance(self) -> float:
        return torch.rand((), generator=self.generator).item()

    def _uniform(self, shape, low: float, high: float) -> Tensor:
        return torch.rand(shape, generator=self.generator) * (high - low) + low

    def _some(self, count: int, share: float) -> Tensor:
        """Indices of samples, each with probability `share`."""
        return (torch.rand(count, generator=self.generator) < share).nonzero()[:, 0]

    def _grainy(self, colors: Tensor) -> Tensor:
        """Noise of a path tracer: what is seen, not the truth, has it; less in the resampled GAE frame."""
        amount = torch.exp2(self._uniform((1, colors.shape[1], 1, 1, 1), -9, -5.5)) * (colors.shape[-1] / CROP)
        grain = torch.randn(colors.shape, generator=self.generator) * torch.tensor((0.6, 1.0)).view(2, 1, 1, 1, 1)
        return (colors + grain * amount * (0.02 + colors).sqrt()).clamp(min=0)

    def _grids(self, count: int, height: int, width: int, alpha: Tensor) -> Tensor:
        """(3, N, H, W, 2) sampling positions of a moving pattern at t, t − 1 and t + α; a pattern is 2 × 2 around 0."""
        speed = torch.exp2(self._uniform((count,), -1.0, 6.3))  # pixels of the whole frame per interval
        heading, turned = self._uniform((2, count), -torch.pi, torch.pi)
        velocity = torch.stack((heading.cos(), heading.sin()), -1) * speed[:, None] * (2.0 / CROP)
        spin = self._uniform((count,), -0.03, 0.03)
        zoom = self._uniform((count,), -0.03, 0.03)
        bend = self._uniform((count,), -0.12, 0.12)  # speeds change a little
        ys, xs = torch.linspace(-1, 1, height), torch.linspace(-1, 1, width)
        plane = torch.stack(torch.meshgrid(xs, ys, indexing="xy"), -1)
        start = self._uniform((count, 1, 1, 2), -0.3, 0.3)
        grids = []
        for times in (torch.zeros(count), -torch.ones(count), alpha):
            gone = times + bend * times.abs()
            angle, scale = turned + spin * gone, torch.exp(zoom * gone)
            cos, sin = (angle.cos() * scale).view(-1, 1, 1), (angle.sin() * scale).view(-1, 1, 1)
            moved = plane - (velocity * gone[:, None]).view(-1, 1, 1, 2)
            x, y = moved.unbind(-1)
            grids.append(torch.stack((cos * x - sin * y, sin * x + cos * y), -1) + start)
        return torch.stack(grids)

    def _moved(self, image: Tensor, grids: Tensor) -> Tensor:
        """`image` (N, C, h, w) at the three times: (3, N, C, H, W)."""
        return torch.stack(
            [
                functional.grid_sample(image, grid, mode="bilinear", padding_mode="reflection", align_corners=False)
                for grid in grids
            ]
        )

    def _lit(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Shadows and pools of light, from one large blob to foliage and bars, of sharp or soft edges."""
        _, count, _, height, width = colors.shape
        size = height * 5 // 4  # of the pattern
        cells = 2 ** int(torch.randint(1, 6, (), generator=self.generator))
        coarse = torch.randn((count, 1, 2 + cells, 2 + cells), generator=self.generator)
        field = functional.interpolate(coarse, (size, size), mode="bicubic", align_corners=False)
        bars = self._some(count, 0.3)
        waves = torch.linspace(-1, 1, size) * torch.exp2(self._uniform((len(bars), 1, 1, 1), 2.0, 5.5))
        field[bars] = torch.sin(waves).expand(-1, -1, size, -1)
        field += self._uniform((count, 1, 1, 1), -0.5, 0.7)
        slope = (field[..., 1:] - field[..., :-1]).abs().mean((1, 2, 3), keepdim=True) * (size / CROP)
        softness = torch.exp2(self._uniform((count, 1, 1, 1), 0.0, 4.5)) * slope  # edges of 1 to 20 pixels
        shape = self._moved(field, 0.8 * self._grids(count, height, width, alpha))
        shape = torch.sigmoid(3 * shape / softness) * (side[:, 1:] <= _DYNAMIC)
        dark = self._uniform((count, 1, 1, 1), 0.03, 0.7) * self._uniform((count, 3, 1, 1), 0.8, 1.2)
        factor = 1 - shape * (1 - dark)
        lights = self._some(count, 0.35)
        factor[:, lights] = 1 / factor[:, lights]
        return colors * factor

    def _reflected(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Another sample as a reflection on part of each."""
        _, count, _, height, width = colors.shape
        strength = self._uniform((count, 1, 1, 1), 0.05, 0.6)
        where = torch.randn((count, 1, 5, 5), generator=self.generator)
        where = functional.interpolate(where, (height, width), mode="bicubic", align_corners=False)
        used = strength * torch.sigmoid(6 * where) * (side[:, 1:] <= _DYNAMIC)
        order = torch.randperm(count, generator=self.generator)
        return colors + used * self._moved(colors[2][order], 0.75 * self._grids(count, height, width, alpha))
