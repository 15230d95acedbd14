"""Training data: short clips of varied built-in scenes, extrapolated, with ground truth, cached on disk; crops of them
in batches; and augmentation: mirrored and turned, other exposures and hues, noise, and shading that moves."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.lib.stride_tricks import sliding_window_view
from torch import Tensor

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import write_text
from gffe_cl.engine.frame.rendered_frame import HALF_MAX
from gffe_cl.engine.opencl.device import Device, device_of_process
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.shading import TREND_PLANES, spacing_of
from gffe_cl.lab.cluster import Cluster
from gffe_cl.lab.metrics import FOCUS_SMAPE, focus_mask, relative_error, shading_regions
from gffe_cl.lab.training.domain_randomization import vary_scene
from gffe_cl.lab.training.network import decode, encode, halve

# ---- clips ---------------------------------------------------------------------------------------------

TRAINING_SCENES = ("corridor", "plaza", "room", "forest")
CHANNELS = 11  # exposed linear GAE (3), warped previous (3), ground truth (3), inverse depth, input mask
PLANES = {"gae": slice(0, 3), "previous": slice(3, 6), "truth": slice(6, 9), "side": slice(9, 11)}
HALVED_CHANNELS = CHANNELS + TREND_PLANES  # at half resolution the trends of shading come after
CROP = 256
VERSION = 8
_SIZES = ((480, 270), (640, 360), (800, 450), (960, 540))
_SIZE_SHARES = (0.5, 0.35, 0.1, 0.05)
_ALPHAS = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 1.0)
_RENDERED = 4  # rendered frames per clip
_SAMPLES = 5  # of a pixel, across and down
_UNSEEN = 2  # the first ones, without samples: trends need two intervals
_PER_FRAME = 2  # ground truths after each of the others
_MOST_INVERSE_DEPTH = 8.0
_CROPS_PER_FRAME = 6  # times the number that would cover the frame once


@dataclass(frozen=True)
class ClipPlan:
    """Plan of clip number `index` of the data with `seed`; depends on nothing else."""

    seed: int
    index: int
    scene: str
    scene_seed: int
    width: int
    height: int
    fps: float
    start: float
    alphas: tuple

    @classmethod
    def draw(cls, seed: int, index: int) -> ClipPlan:
        rng = np.random.default_rng([seed, index])
        width, height = _SIZES[int(rng.choice(len(_SIZES), p=_SIZE_SHARES))]
        alphas = tuple(
            tuple(sorted(float(a) for a in rng.choice(_ALPHAS, _PER_FRAME, replace=False)))
            for _ in range(_RENDERED - _UNSEEN)
        )
        scene = TRAINING_SCENES[index % len(TRAINING_SCENES)]
        fps = float(2.0 ** rng.uniform(np.log2(15), np.log2(60)))
        return cls(seed, index, scene, int(rng.integers(1, 10**6)), width, height, fps, rng.uniform(0, 20), alphas)

    def make_scene(self):
        rng = np.random.default_rng([self.seed, self.index, 1])
        middle = self.start + 0.5 * _RENDERED / self.fps
        return vary_scene(load_scene(self.scene, self.scene_seed), rng, middle)


def make_clip(device: Device, plan: ClipPlan) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Render and extrapolate a clip, and return samples (S, 11, H, W) float16 (`PLANES`), their trends (S, 8, H/2,
    W/2), of which the pipeline has every second row and column, and α."""
    scene = plan.make_scene()
    scene_frames = SceneFrames(SceneRenderer(device, scene, plan.width, plan.height, _SAMPLES))
    options = Options(shading_inputs=True, shading_correction=False)
    pipeline = Pipeline(device, plan.width, plan.height, options, fps=plan.fps)
    pipeline.exposure = scene.exposure
    samples, trends, alphas = [], [], []
    for k, frame in enumerate(scene_frames.sequence(_RENDERED, plan.fps, plan.start)):
        pipeline.submit(frame)
        for alpha in plan.alphas[k - _UNSEEN] if k >= _UNSEEN else ():
            time = frame.time + alpha / plan.fps
            made = pipeline.extrapolate(scene_frames.display_camera(time), time)
            gae, depth = made.numpy("color"), made.numpy("depth")
            previous = pipeline.stages["shading"].read("warped_previous")[..., :3]
            mask = pipeline.stages["shading"].read("input_mask")
            truth = scene_frames.truth(time).read("color")
            samples.append(_sample(gae, previous, truth, depth, mask, scene.exposure))
            carried = pipeline.stages["shading_trend"].read("trends").repeat(2, -1).repeat(2, -2)
            trends.append(carried[:, : plan.height // 2, : plan.width // 2].astype(np.float16))
            alphas.append(alpha)
    return np.stack(samples), np.stack(trends), alphas


def _sample(gae, previous, truth, depth, mask, exposure) -> np.ndarray:
    colors = np.concatenate((gae, previous, truth), -1).astype(np.float32) * np.float32(exposure)
    side = np.stack((inverse_depth(depth), mask.astype(np.float32)), -1)
    planes = np.concatenate((np.clip(np.nan_to_num(colors), 0, HALF_MAX), side), -1)
    return np.ascontiguousarray(planes.transpose(2, 0, 1).astype(np.float16))


def inverse_depth(depth: np.ndarray) -> np.ndarray:
    """Return median / depth, clamped to [0, 8]; 0 for sky (paper: 'Shading correction network')."""
    finite = depth[np.isfinite(depth)]
    median = np.median(finite) if finite.size else 1.0
    return np.clip(median / np.maximum(depth, 1e-6), 0, _MOST_INVERSE_DEPTH).astype(np.float32)


def crops_of(sample: np.ndarray, rng: np.random.Generator) -> list[tuple[int, int, float]]:
    """Return random crops of a sample: (y, x, share of focus pixels that lie in areas at least three pixels wide). Thin
    lines are outlines, where geometry was wrong: fences have more focus pixels than any shadow."""
    _, height, width = sample.shape
    planes = {name: sample[part].astype(np.float32).transpose(1, 2, 0) for name, part in PLANES.items()}
    focus = _opened(focus_mask(planes["gae"], planes["truth"], planes["side"][..., 1] == 1))
    total = np.zeros((height + 1, width + 1))
    total[1:, 1:] = focus.cumsum(0).cumsum(1)
    crops = []
    for _ in range(round(_CROPS_PER_FRAME * height * width / CROP**2)):
        y, x = int(rng.integers(height - CROP + 1)), int(rng.integers(width - CROP + 1))
        count = total[y + CROP, x + CROP] - total[y, x + CROP] - total[y + CROP, x] + total[y, x]
        crops.append((y, x, float(count) / CROP**2))
    return crops


def _opened(mask: np.ndarray) -> np.ndarray:
    """Return the part of a mask (H, W) that is covered by squares of 3×3 inside it."""
    for within in (np.all, np.any):
        mask = within(sliding_window_view(np.pad(mask, 1), (3, 3)), axis=(2, 3))
    return mask


def halve_samples(samples: np.ndarray) -> np.ndarray:
    """Return samples at half resolution: means over 2×2 pixels, of colors' codes as in the network's input."""
    colors, side = torch.from_numpy(samples.astype(np.float32)).tensor_split((PLANES["side"].start,), 1)
    seen = decode(halve(encode(colors)))
    return torch.cat((seen, halve(side)), 1).half().numpy()


def halved_path(path: Path) -> Path:
    """Return the path of the samples of `path` at half resolution, with their trends."""
    return path.with_name(f"{path.stem}_half.npy")


def clip_path(folder: Path, seed: int, index: int) -> Path:
    """Return the path of the .npy file of a clip; the path of its description ends in .json instead."""
    return Path(folder) / f"clip_{seed}_{index:06d}.npy"


def finished_clips(folder: Path, seed: int, count: int) -> list[Path]:
    """Return the descriptions (`clip_*.json`) of those of the clips 0 … count − 1 that are in `folder`."""
    paths = (clip_path(folder, seed, index).with_suffix(".json") for index in range(count))
    return [path for path in paths if path.exists()]


def make_clips(
    folder: Path,
    device: Device | str | None,
    seed: int,
    count: int,
    on_clip: Callable[[bool], None] = lambda made: None,
    until: float | None = None,
    least: int = 0,
    cluster: Cluster | None = None,
) -> int:
    """Make the missing clips of 0 … count − 1 in `folder`, on the workers of a cluster if there is one, and return the
    number made. `device` may be a name, then.

    Each clip is a `clip_*.npy`, a `clip_*_half.npy` and, written last, a `clip_*.json`. Nothing more is begun when
    `time.monotonic()` has passed `until`, the clips 0 … `least` − 1 apart. `on_clip` is called after each with whether
    it was made; otherwise it was there already. Raises GffeError
    where nothing can be written.
    """
    made = 0
    try:
        folder.mkdir(parents=True, exist_ok=True)
        missing = [k for k in range(count) if not clip_path(folder, seed, k).with_suffix(".json").exists()]
        for _ in range(count - len(missing)):
            on_clip(False)
        calls = ({"device": device, "seed": seed, "index": index} for index in missing)
        results = cluster.map(write_clip, calls) if cluster else None
        for index in missing:
            if index >= least and until is not None and monotonic() > until:
                break
            if results:
                files = next(results)[1]
                for name in sorted(files, key=lambda name: name.endswith(".json")):
                    (folder / name).write_bytes(files[name])
            else:
                write_clip(folder, device, seed, index)
            made += 1
            on_clip(True)
    except OSError as error:
        raise GffeError(f"{folder}: cannot write training data: {error.strerror or error}") from None
    return made


def write_clip(folder: Path, device: Device | str | None, seed: int, index: int) -> None:
    """Write a clip; `device`: its name on a worker of a cluster."""
    name, opened = clip_path(folder, seed, index), device if isinstance(device, Device) else device_of_process(device)
    samples, halved, document = clip_data(opened, ClipPlan.draw(seed, index))
    np.save(name, samples)
    np.save(halved_path(name), halved)
    write_text(name.with_suffix(".json"), json.dumps(document))


def clip_data(device: Device, plan: ClipPlan) -> tuple[np.ndarray, np.ndarray, dict]:
    """Return the stored data of a clip: samples, the same at half resolution with trends (`make_clip`,
    `halve_samples`), and their description."""
    samples, trends, alphas = make_clip(device, plan)
    rng = np.random.default_rng([plan.seed, plan.index, 2])
    crops = [crops_of(sample, rng) for sample in samples]
    halved = np.concatenate((halve_samples(samples), trends), 1)
    return samples, halved, {"version": VERSION, "plan": asdict(plan), "alphas": alphas, "crops": crops}


# ---- crops ---------------------------------------------------------------------------------------------

TOP_SHARE = 0.15  # of all crops: those with the most focus pixels (paper: 'Data Preparation')
RANDOM_SHARE = 0.06  # of all crops: any of the others
_HALF_REACH = 0.75  # of the neighborhood at half resolution, whose pixels are twice as far apart
_DISOCCLUDED = constants("shading.cl")["MASK_DISOCCLUDED"]  # input mask there
DYNAMIC = 0.75  # input mask above which a pixel counts as dynamic; 1 where it is one pixel of the frame


@dataclass(frozen=True)
class Crop:
    """Position of a crop; `focus` is its share of focus pixels (`crops_of`), `height` that of the clip's
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


_CONSTANTS = constants("shading_trend.cl")
_CELL, _LEAST_SHARE = _CONSTANTS["CELL"], _CONSTANTS["LEAST_SHARE"]
_KNOWN = 0.25  # input masks farther than this from that of static, shown pixels are others' or mixed
_UNKNOWN_BEFORE = 0.08  # share of crops that are taken as from the second frame after a reset
_NOISY, _CHANGING = 0.25, 1 / 3  # shares of crops with noise, and of patterns that do not move steadily


class Augmentation:
    """Random variation of batches: mirroring, rotation, exposure, hue, noise, and additional shading.

    The additional shading stands for lights, unseen casters and reflections. On pixels that are not dynamic, a pattern
    multiplies (shadows, pools of light) or is added to (reflections) each frame, as the pattern is at its time. All
    frames of a sample show the geometry at t + α, so shading that moves by v pixels per interval is at x in the GAE
    frame, at x − v in the warped previous frame, at x + α v in the truth, and at x − 2 v in the frame before, of which
    only the trend is known. Trends follow as the stage `ShadingTrend` would find them.

    Batches are on the device of `generator`. `shading`: how often a crop gets any; two fifths of these have lights that
    switch. A third of the patterns (`_CHANGING`) does not move steadily: they jump, are somewhere else in every frame,
    flicker or fade. Of these only fading continues.
    """

    def __init__(self, generator: torch.Generator, shading: float = 0.6):
        self.generator, self.shading = generator, shading

    def __call__(self, batch: Batch) -> Batch:
        with self.generator.device:
            return self._varied(batch)

    def _varied(self, batch: Batch) -> Batch:
        alpha = batch.alpha
        earlier = _earlier(batch)
        colors = torch.stack((batch.gae, batch.previous, batch.truth, earlier))  # (4, N, 3, H, W)
        colors, side, trends = self._turned(colors, batch.side, batch.trends)
        count = colors.shape[1]
        hue = torch.stack([torch.randperm(3, generator=self.generator) for _ in range(count)])
        colors = colors.gather(2, hue.view(1, count, 3, 1, 1).expand_as(colors))
        rest = torch.arange(6, TREND_PLANES).expand(count, -1)
        order = torch.cat((hue, 3 + hue, rest), 1).view(count, TREND_PLANES, 1, 1)
        trends = trends.gather(1, order.expand_as(trends))
        before = _changes(colors, batch.halved)
        colors = colors * torch.exp2(self._uniform((1, count, 3, 1, 1), -0.3, 0.3))
        for change, share in ((self._reflected, 0.4), (self._switched, 0.4), (self._lit, 1.0), (self._lit, 0.4)):
            some = self._some(count, share * self.shading)
            if len(some):
                colors[:, some] = change(colors[:, some], side[some], alpha[some])
        colors = (colors * torch.exp2(self._uniform((1, count, 1, 1, 1), -1.5, 1.0))).clamp_(0, 60000)
        changed = _changes(colors, batch.halved) - before
        static = side[:, 1:] if batch.halved else halve(side[:, 1:])
        known = ((static - 0.5).abs() < _KNOWN).float()
        trends[:, :6] += alpha.view(-1, 1, 1, 1) * low_pass(changed, known, batch.heights)
        trends[:, 7:8] += low_pass(changed[:, 3:].mean(1, keepdim=True), known)
        some = self._some(count, _UNKNOWN_BEFORE)
        trends[some, 3:6] = 0
        trends[some, 7:] = 0
        some = self._some(count, _NOISY)
        if len(some):
            colors[:2, some] = self._grainy(colors[:2, some])
        gae, previous, truth = colors[:3]
        return Batch(gae, previous, truth, side, trends, alpha, batch.heights, batch.halved)

    def _turned(self, colors: Tensor, *others: Tensor) -> list[Tensor]:
        """Return all images mirrored either way, and transposed, at random."""
        images = [colors, *others]
        for change in (lambda x: x.flip(-1), lambda x: x.flip(-2), lambda x: x.transpose(-1, -2)):
            if self._chance() < 0.5:
                images = [change(image) for image in images]
        images[-1] = images[-1].clone()  # is changed in place
        return images

    def _chance(self) -> float:
        return torch.rand((), generator=self.generator).item()

    def _uniform(self, shape, low: float, high: float) -> Tensor:
        return torch.rand(shape, generator=self.generator) * (high - low) + low

    def _some(self, count: int, share: float) -> Tensor:
        """Return indices of samples, each with probability `share`."""
        return (torch.rand(count, generator=self.generator) < share).nonzero()[:, 0]

    def _grainy(self, colors: Tensor) -> Tensor:
        """Return the inputs (not the truth) with a path tracer's noise; less of it in the resampled GAE frame."""
        amount = torch.exp2(self._uniform((1, colors.shape[1], 1, 1, 1), -9, -5.5)) * (colors.shape[-1] / CROP)
        grain = torch.randn(colors.shape, generator=self.generator) * torch.tensor((0.6, 1.0)).view(2, 1, 1, 1, 1)
        return (colors + grain * amount * (0.02 + colors).sqrt()).clamp(min=0)

    def _course(self, count: int, alpha: Tensor) -> tuple[Tensor, Tensor]:
        """Return the course of patterns: where they are along their way, in intervals, and how strong, each (4, N), at
        t, t − 1, t + α and t − 2."""
        times = torch.stack((torch.zeros(count), -torch.ones(count), alpha, torch.full((count,), -2.0)))
        strength = torch.ones(4, count)
        kind = torch.rand(count, generator=self.generator) / _CHANGING  # 1 and more: steady
        elsewhere = self._uniform((4, count), -3.0, 3.0)
        times = torch.where(kind < 0.3, elsewhere, times)
        jumps = (kind >= 0.3) & (kind < 0.4)
        times[2] = torch.where(jumps, elsewhere[2], times[2])
        strength = torch.where((kind >= 0.4) & (kind < 0.7), self._uniform((4, count), 0.0, 1.0), strength)
        fading = self._uniform((count,), 0.2, 0.8) + times * self._uniform((count,), -0.4, 0.4)
        return times, torch.where((kind >= 0.7) & (kind < 1.0), fading.clamp(0, 1), strength)

    def _grids(self, times: Tensor, height: int, width: int) -> Tensor:
        """Return sampling positions (4, N, H, W, 2) of moving patterns at these times (4, N); a pattern is 2 × 2 around
        0."""
        count = times.shape[1]
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
        for time in times:
            gone = time + bend * time * time.abs()
            angle, scale = turned + spin * gone, torch.exp(zoom * gone)
            cos, sin = (angle.cos() * scale).view(-1, 1, 1), (angle.sin() * scale).view(-1, 1, 1)
            moved = plane - (velocity * gone[:, None]).view(-1, 1, 1, 2)
            x, y = moved.unbind(-1)
            grids.append(torch.stack((cos * x - sin * y, sin * x + cos * y), -1) + start)
        return torch.stack(grids)

    def _moved(self, image: Tensor, grids: Tensor) -> Tensor:
        """Return `image` (N, C, h, w) at the four times: (4, N, C, H, W)."""
        return torch.stack(
            [
                functional.grid_sample(image, grid, mode="bilinear", padding_mode="reflection", align_corners=False)
                for grid in grids
            ]
        )

    def _lit(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Return the frames with shadows and pools of light, from one large blob to foliage and bars, of sharp or soft
        edges."""
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
        times, strength = self._course(count, alpha)
        shape = self._moved(field, 0.8 * self._grids(times, height, width))
        shape = torch.sigmoid(3 * shape / softness) * strength.view(4, -1, 1, 1, 1) * (side[:, 1:] <= DYNAMIC)
        dark = self._uniform((count, 1, 1, 1), 0.03, 0.7) * self._uniform((count, 3, 1, 1), 0.8, 1.2)
        factor = 1 - shape * (1 - dark)
        lights = self._some(count, 0.35)
        factor[:, lights] = 1 / factor[:, lights]
        return colors * factor

    def _switched(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Return the frames with lights, screens and windows that switch, each by itself, and stay so for a while: from
        one area to a wall of them, in part of each sample. None of these changes continues."""
        _, count, _, height, width = colors.shape
        cells = 2 ** int(torch.randint(0, 5, (), generator=self.generator))
        levels = self._uniform((4, count, 1, cells, cells), -1.0, 1.0)
        often = self._uniform((count, 1, 1, 1), 0.15, 0.9)  # how often a cell switches in an interval
        for time, since, share in ((1, 3, 1.0), (0, 1, 1.0), (2, 0, alpha.view(-1, 1, 1, 1))):  # in order of time
            stays = torch.rand(levels.shape[1:], generator=self.generator) >= often * share
            levels[time] = torch.where(stays, levels[since], levels[time])
        mode = "nearest" if self._chance() < 0.7 else "bilinear"
        shape = functional.interpolate(levels.flatten(0, 1), (height, width), mode=mode).view(
            4, count, 1, height, width
        )
        where = torch.randn((count, 1, 4, 4), generator=self.generator) + self._uniform((count, 1, 1, 1), -0.5, 2.0)
        where = functional.interpolate(where, (height, width), mode="bicubic", align_corners=False)
        used = torch.sigmoid(8 * where) * (side[:, 1:] <= DYNAMIC)
        return colors * torch.exp2(used * shape * self._uniform((count, 3, 1, 1), 0.2, 2.0))

    def _reflected(self, colors: Tensor, side: Tensor, alpha: Tensor) -> Tensor:
        """Return the frames with another sample as a reflection on part of each."""
        _, count, _, height, width = colors.shape
        strength = self._uniform((count, 1, 1, 1), 0.05, 0.6)
        where = torch.randn((count, 1, 5, 5), generator=self.generator)
        where = functional.interpolate(where, (height, width), mode="bicubic", align_corners=False)
        used = strength * torch.sigmoid(6 * where) * (side[:, 1:] <= DYNAMIC)
        order = torch.randperm(count, generator=self.generator)
        times, strength = self._course(count, alpha)
        used = used * strength.view(4, -1, 1, 1, 1)
        return colors + used * self._moved(colors[2][order], 0.75 * self._grids(times, height, width))


def _earlier(batch: Batch) -> Tensor:
    """Return the frame before the warped previous one, as far as it is known: linear color, at the batch's
    resolution."""
    change = functional.interpolate(batch.trends[:, 7:8], batch.gae.shape[-2:], mode="bilinear", align_corners=False)
    return decode(encode(batch.previous) - change)


def _changes(colors: Tensor, halved: bool) -> Tensor:
    """Return (N, 6, h, w): change of encoded color at half resolution over the last interval, and over the one
    before."""
    now, previous, earlier = (encode(colors[k]) for k in (0, 1, 3))
    changes = torch.cat((now - previous, previous - earlier), 1)
    return changes if halved else halve(changes)


def low_pass(changes: Tensor, known: Tensor, heights: Tensor | None = None) -> Tensor:
    """Return means of `changes` (N, C, h, w; half resolution), where they are `known` (N, 1, h, w), over cells of 8×8
    pixels of the frame, at a quarter of the resolution as in kernels/shading_trend.cl. With `heights` (N,) of the
    frames in pixels, cells around are part of the means."""
    size = [-(-side // 2) for side in changes.shape[-2:]]
    cells = functional.avg_pool2d(torch.cat((changes * known, known), 1), _CELL // 2, ceil_mode=True)
    if heights is not None:
        spacing = torch.tensor([spacing_of(int(height)) for height in heights.tolist()]).view(-1, 1, 1, 1)
        across, along = (torch.arange(side) for side in cells.shape[-2:])
        apart = [(x[:, None] - x[None]).abs() for x in (across, along)]
        weights = [(3 - d / spacing).clamp(min=0) / 9 * (d % spacing == 0) for d in apart]
        cells = weights[0] @ cells @ weights[1]
    mean = cells[:, :-1] / cells[:, -1:].clamp(min=_LEAST_SHARE)
    scaled = functional.interpolate(mean, scale_factor=_CELL // 4, mode="bilinear", align_corners=False)
    return scaled[..., : size[0], : size[1]]
