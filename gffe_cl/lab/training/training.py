"""Training of the shading correction network: resumable, on a CPU or a GPU (`gffe train`). Its losses are in the
encoded space (paper: appendix, 'Loss Functions')."""

from __future__ import annotations

import atexit
import copy
import hashlib
import math
import os
import pickle
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor, distributed, nn
from torch.nn.parallel import DistributedDataParallel

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import replacing
from gffe_cl.engine.core.validation import require_seed
from gffe_cl.engine.frame.transfer_function import SRGB_TOE
from gffe_cl.lab.metrics import FOCUS
from gffe_cl.lab.training.data import VERSION, Augmentation, Batch, Crop, CropReader, keep_crops
from gffe_cl.lab.training.export import quantize, weights_of
from gffe_cl.lab.training.network import ShadingCorrectionNetwork, compose, double, encode

LOSSES_VERSION = 5  # of the terms' definition: a run continues only with its own
FOCUS_WEIGHT = 0.05  # λ_focus; the paper's is 1, and its mask covers large errors only
PERCEPTUAL_WEIGHT = 0.01  # λ_vgg of the paper
TEACHER_WEIGHT = 16.0  # of the frame of the network in floats, for one in integers
TAUGHT = 0.2  # how much the refined image is taught where the focus mask is 0
_CHARBONNIER = 1e-3
_DISPLAY_WEIGHT = 10.0
_STRUCTURE_WEIGHT = 0.05
_WINDOW = 7  # pixels: that of `gffe_cl.lab.metrics.ssim`
_TOE = float(SRGB_TOE)
# Errors of `torch.load`, and of content that is not as expected.
UNREADABLE = (
    OSError,
    EOFError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ImportError,
    pickle.UnpicklingError,
)


def charbonnier(a: Tensor, b: Tensor) -> Tensor:
    """Return the mean of √((a − b)² + ε²) − ε."""
    return (torch.sqrt((a - b) ** 2 + _CHARBONNIER**2) - _CHARBONNIER).mean()


def shown_loss(a: Tensor, b: Tensor) -> Tensor:
    """Return the loss of exposed linear frames as they are displayed.

    The terms are Charbonnier of encoded color; the squared error of display values (sRGB), which PSNR counts; and 1 −
    SSIM of them, which penalizes texture that is carried along with moving light.
    """
    shown, truth = display(a), display(b)
    squared = ((shown - truth) ** 2).mean()
    return charbonnier(encode(a), encode(b)) + _DISPLAY_WEIGHT * squared + _STRUCTURE_WEIGHT * (1 - ssim(shown, truth))


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Return the mean structural similarity of display values (N, 3, H, W), as `gffe_cl.lab.metrics.ssim` does."""

    def mean(x: Tensor) -> Tensor:
        return functional.avg_pool2d(x, _WINDOW, stride=1)

    unbiased = _WINDOW**2 / (_WINDOW**2 - 1)
    mean_a, mean_b = mean(a), mean(b)
    variance_a, variance_b = unbiased * (mean(a * a) - mean_a**2), unbiased * (mean(b * b) - mean_b**2)
    covariance = unbiased * (mean(a * b) - mean_a * mean_b)
    brightness = (2 * mean_a * mean_b + 0.01**2) / (mean_a**2 + mean_b**2 + 0.01**2)
    return (brightness * (2 * covariance + 0.03**2) / (variance_a + variance_b + 0.03**2)).mean()


def display(color: Tensor) -> Tensor:
    """Return sRGB of exposed linear color, clipped to 0 … 1, as `gffe_cl.lab.metrics.to_display` does."""
    linear = color.clamp(0, 1)
    curve = 1.055 * linear.clamp(min=_TOE) ** (1 / 2.4) - 0.055
    return torch.where(linear <= _TOE, 12.92 * linear, curve)


def focus_loss(likely: Tensor, truth: Tensor) -> Tensor:
    """Return the mean squared error of the focus mask. The paper writes ‖M̄ − M‖₂; the difference is on purpose.

    With a root, per crop or batch, crops with larger errors would count less, and the mask would be too small where it
    is needed. A sum would grow with the crop and outweigh all other terms.
    """
    return ((likely - truth) ** 2).mean()


class PyramidLoss(nn.Module):
    """Replaces the perceptual loss where VGG's weights are not on disk: mean |difference| of the bands of a Laplacian
    pyramid, which counts edges at every scale."""

    name = "Laplacian pyramid"

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        difference = a - b
        total = difference.new_zeros(())
        for _ in range(4):
            lower = functional.avg_pool2d(difference, 2)
            band = difference - functional.interpolate(lower, scale_factor=2, mode="bilinear", align_corners=False)
            total = total + band.abs().mean()
            difference = lower
        return total + difference.abs().mean()


class VggLoss(nn.Module):
    """Mean |difference| of VGG-19's features after relu1_2, 2_2, 3_2, 4_2 (Johnson et al. 2016).

    `path`: torchvision's `vgg19-*.pth`. Raises GffeError if it cannot be read or holds something else.
    """

    name = "VGG-19"
    _LAYOUT = (64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", 512, 512)
    _TAPS = (3, 8, 13, 22)

    def __init__(self, path: Path):
        super().__init__()
        layers, channels = [], 3
        for width in self._LAYOUT:
            if width == "M":
                layers.append(nn.MaxPool2d(2))
            else:
                layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU()]
                channels = width
        self.layers = nn.Sequential(*layers)
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            state = {
                key.removeprefix("features."): value for key, value in state.items() if key.startswith("features.")
            }
            self.layers.load_state_dict({key: state[key] for key in self.layers.state_dict()})
        except UNREADABLE as error:
            raise GffeError(f"{path}: not VGG-19 as torchvision saves it ({type(error).__name__})") from None
        self.requires_grad_(False)
        self.register_buffer("mean", torch.tensor((0.485, 0.456, 0.406)).view(1, 3, 1, 1))
        self.register_buffer("deviation", torch.tensor((0.229, 0.224, 0.225)).view(1, 3, 1, 1))

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        both = (torch.cat((a, b), 0).clamp(0, 1) - self.get_buffer("mean")) / self.get_buffer("deviation")
        total = both.new_zeros(())
        for index, layer in enumerate(self.layers):
            both = layer(both)
            if index in self._TAPS:
                first, second = both.chunk(2)
                total = total + (first - second).abs().mean()
        return total


def perceptual_loss(vgg: Path | None) -> nn.Module:
    """Return the VGG loss where its weights are: at `vgg`, else in torch's cache; its substitute otherwise."""
    if vgg is None:
        found = sorted(Path(torch.hub.get_dir(), "checkpoints").glob("vgg19-*.pth"))
        vgg = found[0] if found else None
    return PyramidLoss() if vgg is None else VggLoss(vgg)


CHECKPOINT = "checkpoint.pt"
_FORMAT = 4
_CHECKPOINT_SECONDS = 30
_VALIDATION_SHARE = 0.06  # of the clips
_VALIDATION_CROPS = 96
_CALIBRATION_STEPS = 24
_LONGEST_WAIT = timedelta(days=30)  # of processes for the first one, which may render clips


@dataclass(frozen=True)
class Recipe:
    """Recipe of a training: everything that determines the result, except the data.

    Learning rates are the paper's (appendix, 'Training'); a step takes `batch` crops.
    `shading` is how often crops get moving shading (`Augmentation`). `blend_weight` weights the error of the frame as
    it is shown, which the paper's reconstruction loss, with the ground truth in place of the GAE frame, does not
    contain. Full resolution, where the network's output is composed, is needed for its `keep` only, and takes more than
    half of a step's time: all but every `full_every`-th step use half resolution. `integers`: for convolutions in 8-bit
    integers (`quantization`).
    """

    seed: int = 0
    steps: int = 20000
    batch: int = 16
    learning_rate: float = 1e-4
    final_learning_rate: float = 1e-5
    shading: float = 0.6
    blend_weight: float = 1.0
    full_every: int = 4
    bfloat16: bool = False
    integers: bool = False

    def __post_init__(self):
        if self.bfloat16 and self.integers:
            raise GffeError("training: expected bfloat16 or integers, got both")
        for name in ("steps", "batch", "full_every"):
            if getattr(self, name) < 1:
                raise GffeError(f"training: {name} must be at least 1, got {getattr(self, name)}")
        require_seed(self.seed, "training: seed")
        if not 0 <= self.shading <= 1 or not 0 <= self.blend_weight < math.inf:
            raise GffeError(
                "training: expected shading from 0 to 1 and blend weight ≥ 0,"
                f" got {self.shading:g} and {self.blend_weight:g}"
            )
        if not 0 < self.final_learning_rate <= self.learning_rate < 1:
            raise GffeError(
                "training: learning rates must be 0 < final ≤ first < 1,"
                f" got {self.final_learning_rate:g} and {self.learning_rate:g}"
            )

    def learning_rate_at(self, step: int) -> float:
        """Return the learning rate at `step`: from the first to the final one along half a cosine."""
        share = 0.5 + 0.5 * math.cos(math.pi * min(step / self.steps, 1.0))
        return self.final_learning_rate + share * (self.learning_rate - self.final_learning_rate)


def loss_terms(
    correction: Tensor,
    likely: Tensor,
    batch: Batch,
    focus: Tensor,
    perceptual,
    taught_by: Tensor | None = None,
) -> dict[str, Tensor]:
    """Return the terms of the loss, not weighted: see `weights`. `likely`: p of the network's focus mask.

    The frame that is reconstructed is the truth but for the focus mask, where it is the refined image (paper, equation
    of the final prediction): the true mask's pixels too, or else a mask that begins at 0 would teach nothing, and, a
    little, all others. The error of the final frame decides how much of it is worth showing, and so the mask: small
    changes of shading are many, and no focus pixels. `taught_by`: the correction of a network to stay close to.
    """
    refined, final, mask = compose(batch.gae, correction)
    truth = encode(batch.truth)
    taught = torch.maximum(mask.detach(), focus.float()).clamp(min=TAUGHT)
    shown = encode(batch.truth + taught * (refined - batch.truth))
    likely = likely.float()
    terms = {
        "reconstruction": charbonnier(shown, truth),
        "focus": focus_loss(likely if batch.halved else double(likely), focus),
        "perceptual": perceptual(shown, truth),
        "blend": shown_loss(final, batch.truth),
    }
    if taught_by is not None:
        terms["teacher"] = shown_loss(final, compose(batch.gae, taught_by)[1])
    return terms


def weights(recipe: Recipe) -> dict[str, float]:
    return {
        "reconstruction": 1.0,
        "focus": FOCUS_WEIGHT,
        "perceptual": PERCEPTUAL_WEIGHT,
        "blend": recipe.blend_weight,
        "teacher": TEACHER_WEIGHT,
    }


class Processes:
    """Processes of one training, as `torchrun` starts them, with a GPU each where there are GPUs: their `count`, the
    own `rank` and `device`. They see the same files. Without torchrun there is one."""

    def __init__(self):
        self.count, self.rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
        self.device = torch.device("cpu")
        if torch.cuda.is_available():
            self.device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0)))
            torch.cuda.set_device(self.device)
        if self.count > 1:
            kind = "gloo" if self.device.type == "cpu" else "nccl"
            distributed.init_process_group(kind, timeout=_LONGEST_WAIT)
            atexit.register(distributed.destroy_process_group)

    def share(self, network: nn.Module) -> nn.Module:
        """Return the network with gradients that are means over all processes."""
        return DistributedDataParallel(network, broadcast_buffers=False) if self.count > 1 else network

    def agree(self, value: Any) -> Any:
        """Return the `value` of the first process in all of them, once they all are here."""
        values = [value]
        if self.count > 1:
            distributed.broadcast_object_list(values, device=self.device)
        return values[0]


class Training:
    """One run in `folder` on the crops of `clips` clips. It continues from its checkpoint if there is one, unless it is
    to begin `anew`, and else starts with the weights of the network `start`, if given.

    Of several `processes` each trains on its part of every step's crops, and the first one writes checkpoints.

    Raises GffeError if the checkpoint is of another recipe or other data, or cannot be read.
    """

    def __init__(
        self,
        folder: Path,
        recipe: Recipe,
        crops: list[Crop],
        vgg: Path | None = None,
        clips: int = 0,
        start: Path | None = None,
        anew: bool = False,
        processes: Processes | None = None,
    ):
        self.folder, self.recipe = Path(folder), recipe
        validation, train = split_crops(crops, recipe.seed)
        self.crops, self.validation = keep_crops(train, recipe.seed), validation
        self.processes = processes or Processes()
        if recipe.batch % self.processes.count:
            raise GffeError(
                f"training: batch {recipe.batch} for {self.processes.count} processes (expected a multiple)"
            )
        self.device = self.processes.device
        self.reader = CropReader(self.device)
        torch.manual_seed(recipe.seed)
        self.network = ShadingCorrectionNetwork()
        if start:
            self._begin_with(start)
        self.teacher: ShadingCorrectionNetwork | None = None
        if recipe.integers:
            self.teacher = copy.deepcopy(self.network).eval().requires_grad_(False).to(self.device)
            quantize(self.network.convolutions, self._seen_by_convolutions(self.teacher))
        convert: Any = self.network.to  # the stub lacks this form of it
        self.network = convert(self.device, memory_format=torch.channels_last)
        self.optimizer = torch.optim.Adam(self.network.parameters(), recipe.learning_rate)
        self.perceptual = perceptual_loss(vgg).to(self.device)
        self.step, self.seconds = 0, 0.0
        self.conditions = asdict(recipe) | {
            "clips": clips,
            "crops": len(self.crops),
            "data version": VERSION,
            "losses": LOSSES_VERSION,
            "perceptual loss": self.perceptual.name,
            "start": hashlib.sha256(start.read_bytes()).hexdigest()[:12] if start else "nothing",
        }
        if not anew:
            self._load()
        self.parallel = self.processes.share(self.network)

    def run(self, until: float | None = None, on_step: Callable[[int], None] = lambda step: None) -> bool:
        """Train until all steps are done, or `time.monotonic()` passes `until`, but a step at least, and return whether
        all are done. `on_step` is called with the number of steps after each.

        A checkpoint is written every half minute and at the end, also when interrupted between two steps. Raises
        GffeError, and leaves the last checkpoint, if the loss is not finite.
        """
        started = saved = time.monotonic()
        spent, first = self.seconds, self.step
        whole = True  # between two steps
        try:
            while self.step < self.recipe.steps:
                now = time.monotonic()
                self.seconds = spent + now - started
                if now - saved > _CHECKPOINT_SECONDS:
                    self.save()
                    saved = now
                if until is not None and self.step > first and self.processes.agree(now > until):
                    break
                whole = False
                self._train_step()
                self.step += 1
                whole = True
                on_step(self.step)
        except KeyboardInterrupt as interrupt:
            if whole or (self.folder / CHECKPOINT).exists():
                interrupt.add_note(f"the last checkpoint is in {self.folder}")
            raise
        finally:
            if whole:
                self.seconds = spent + time.monotonic() - started
                self.save()
        return self.step >= self.recipe.steps

    def _train_step(self) -> dict[str, float]:
        """Train one step, and return the terms of its loss."""
        recipe = self.recipe
        halved = (self.step + 1) % recipe.full_every != 0
        batch = self._batch(self.step, halved)
        for group in self.optimizer.param_groups:
            group["lr"] = recipe.learning_rate_at(self.step)
        self.network.train()
        with torch.autocast(self.device.type, torch.bfloat16, enabled=recipe.bfloat16):
            correction, likely = self.parallel(*self._inputs(batch))
        taught_by = self.teacher(*self._inputs(batch)) if self.teacher else None
        terms = loss_terms(correction.float(), likely, batch, batch.focus().float(), self.perceptual, taught_by)
        factors = weights(recipe)
        loss: Any = sum(factors[name] * value for name, value in terms.items())
        self.optimizer.zero_grad()
        loss.backward()
        length = nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        if not math.isfinite(length):
            raise GffeError(
                f"training: the loss is not finite at step {self.step} (expected a lower learning rate; the last"
                " checkpoint is kept)"
            )
        self.optimizer.step()
        return {name: float(value.detach()) for name, value in (terms | {"loss": loss}).items()}

    def _batch(self, step: int, halved: bool) -> Batch:
        """Return the augmented crops of a step."""
        rank, count = self.processes.rank, self.processes.count
        generator = torch.Generator(self.device).manual_seed(_mixed(self.recipe.seed, step, rank))
        crops = self._chosen(step)[rank::count]
        return Augmentation(generator, self.recipe.shading)(self.reader.batch(crops, halved))

    def _inputs(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        """Return the network's arguments."""
        frames, trends = (x.contiguous(memory_format=torch.channels_last) for x in (batch.frames(), batch.trends))
        return frames, batch.alpha, trends

    def _chosen(self, step: int) -> list[Crop]:
        """Return the crops of a step: every crop once per epoch."""
        recipe, count = self.recipe, len(self.crops)
        first = step * recipe.batch
        orders: dict[int, np.ndarray] = {}
        chosen = []
        for k in range(first, first + recipe.batch):
            epoch = k // count
            if epoch not in orders:
                orders[epoch] = np.random.default_rng([recipe.seed, 4, epoch]).permutation(count)
            chosen.append(self.crops[orders[epoch][k % count]])
        return chosen

    def validate(self) -> dict[str, float]:
        """Return the figures on crops of clips that are not trained on, not augmented: mean absolute encoded error of
        the GAE and the final frame on focus pixels that are not disoccluded, and on all; recall and precision of the
        focus mask."""
        self.network.eval()
        sums: dict[str, float] = {}

        def add(name, value):
            sums[name] = sums.get(name, 0.0) + float(value)

        with torch.no_grad():
            for k in range(0, len(self.validation), self.recipe.batch):
                batch = self.reader.batch(self.validation[k : k + self.recipe.batch])
                correction = self.network(*self._inputs(batch))
                _, final, mask = compose(batch.gae, correction)
                regions = batch.regions()
                focus, mask = regions[FOCUS], mask * ~regions["disoccluded"]
                truth = encode(batch.truth)
                for name, image in (("gae", batch.gae), ("final", final)):
                    error = (encode(image) - truth).abs().mean(1, keepdim=True)
                    add(f"{name}, focus", (error * focus).sum())
                    add(f"{name}, all", error.sum())
                add("focus", focus.sum())
                add("pixels", focus.numel())
                add("mask", mask.sum())
                add("hit", (mask * focus).sum())
        focus, pixels = max(sums["focus"], 1.0), sums["pixels"]
        return {
            "gae error, focus": sums["gae, focus"] / focus,
            "final error, focus": sums["final, focus"] / focus,
            "gae error": sums["gae, all"] / pixels,
            "final error": sums["final, all"] / pixels,
            "recall": sums["hit"] / focus,
            "precision": sums["hit"] / max(sums["mask"], 1e-6),
        }

    @torch.no_grad()
    def _seen_by_convolutions(self, network: ShadingCorrectionNetwork) -> list[tuple[Tensor, Tensor]]:
        """Return the inputs of the convolutions of `network`, on the training's device, in some steps, for their
        ranges."""
        seen: list[tuple[Tensor, Tensor]] = []
        hook = network.convolutions.register_forward_pre_hook(
            lambda _, inputs: seen.append(tuple(x.cpu() for x in inputs))
        )
        for step in range(_CALIBRATION_STEPS):
            network(*self._inputs(self._batch(step, halved=True)))
        hook.remove()
        return seen

    def _begin_with(self, start: Path) -> None:
        try:
            self.network.take(*weights_of(start))
        except ValueError as error:
            raise GffeError(f"{start}: not a network of this kind, {error} (expected one that gffe trained)") from None

    # ---- checkpoints -----------------------------------------------------------------------------------

    def save(self) -> None:
        """Write the checkpoint, in the first process. If that fails, the one before stays."""
        if self.processes.rank:
            return
        state = {
            "format": _FORMAT,
            "conditions": self.conditions,
            "step": self.step,
            "seconds": self.seconds,
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        path = self.folder / CHECKPOINT
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing(path) as part:
                torch.save(state, part)
        except (OSError, RuntimeError) as error:
            raise GffeError(
                f"{path}: cannot write the checkpoint: {getattr(error, 'strerror', None) or error}"
            ) from None

    def _load(self) -> None:
        path = self.folder / CHECKPOINT
        if not path.exists():
            return
        with _readable(path):
            state = _read(path, self.device)
            was = state["conditions"]
            differing = [f"{key} {was.get(key)}" for key, value in self.conditions.items() if was.get(key) != value]
            if differing:
                raise GffeError(
                    f"{path}: was started with {', '.join(differing)} (expected the same options, or another folder)"
                )
            self.network.load_state_dict(state["network"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.seconds = int(state["step"]), float(state["seconds"])


def clips_of_run(folder: Path) -> int | None:
    """Return how many clips the run in `folder` was started with; None if none was. Raises GffeError as `Training`."""
    path = Path(folder) / CHECKPOINT
    if not path.exists():
        return None
    with _readable(path):
        return int(_read(path, torch.device("cpu"))["conditions"]["clips"])


def _read(path: Path, device: torch.device) -> dict:
    state = torch.load(path, map_location=device, weights_only=True)
    if state["format"] != _FORMAT:
        raise GffeError(f"{path}: checkpoint of format {state['format']}, expected {_FORMAT} (use another folder)")
    return state


def split_crops(crops: list[Crop], seed: int) -> tuple[list[Crop], list[Crop]]:
    """Return the crops to validate with, of some clips those with the most focus pixels, and the crops of the other
    clips."""
    paths = sorted({crop.path for crop in crops})
    count = math.ceil(_VALIDATION_SHARE * len(paths)) if len(paths) > 1 else 0
    held = {paths[i] for i in np.random.default_rng([seed, 5]).choice(len(paths), count, replace=False)}
    validation = []
    for path in sorted(held):
        ranked = sorted((crop for crop in crops if crop.path == path), key=lambda crop: -crop.focus)
        validation += ranked[: math.ceil(_VALIDATION_CROPS / count)]
    return validation, [crop for crop in crops if crop.path not in held]


@contextmanager
def _readable(path: Path):
    try:
        yield
    except UNREADABLE as error:
        raise GffeError(f"{path}: not a checkpoint of this program ({type(error).__name__})") from None


def _mixed(seed: int, step: int, rank: int) -> int:
    return int(np.random.SeedSequence([seed, step, rank]).generate_state(1)[0])
