"""Training the shading correction network: resumable, on a CPU, a GPU or several (`gffe train`)."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import torch.distributed as distributed
from torch import Tensor, nn

from gffe_cl.errors import GffeError
from gffe_cl.scn import losses
from gffe_cl.scn.crops import Augmentation, Batch, Crop, keep_crops, load_batch
from gffe_cl.scn.network import ShadingCorrectionNetwork, compose, double, encode

CHECKPOINT = "checkpoint.pt"
_FORMAT = 1
_CHECKPOINT_SECONDS = 120
_VALIDATION_SHARE = 0.04  # of the clips
_VALIDATION_CROPS = 96


@dataclass(frozen=True)
class Recipe:
    """What determines the result, the data apart.

    Defaults are the paper's (appendix, 'Training'), but for the number of steps, each of `batch` crops in all
    processes together. `blend_weight` counts the error of the frame as it is shown, which the paper's reconstruction
    loss, with the ground truth in place of the GAE frame, does not see. Full resolution, where the network's output is
    composed, is needed for its `keep` only, and takes three quarters of a step's time: all but every `full_every`-th
    step do with half.
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

    def __post_init__(self):
        for name in ("steps", "batch", "full_every"):
            if getattr(self, name) < 1:
                raise GffeError(f"training: {name} must be at least 1, got {getattr(self, name)}")
        if not 0 < self.final_learning_rate <= self.learning_rate < 1:
            raise GffeError(
                "training: learning rates must be 0 < final ≤ first < 1,"
                f" got {self.final_learning_rate:g} and {self.learning_rate:g}"
            )

    def learning_rate_at(self, step: int) -> float:
        """From the first to the final one along half a cosine."""
        share = 0.5 + 0.5 * math.cos(math.pi * min(step / self.steps, 1.0))
        return self.final_learning_rate + share * (self.learning_rate - self.final_learning_rate)


@dataclass
class Progress:
    """What a step, or the end of a slice, reports."""

    step: int
    terms: dict[str, float]


class Processes:
    """This process among those that torchrun started; alone without it."""

    def __init__(self):
        self.count, self.rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
        cuda = torch.cuda.is_available()
        self.device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0))) if cuda else torch.device("cpu")
        if self.count > 1 and not distributed.is_initialized():
            distributed.init_process_group("nccl" if cuda else "gloo")

    @property
    def first(self) -> bool:
        return self.rank == 0

    def any(self, flag: bool) -> bool:
        """Whether any process says so."""
        if self.count == 1:
            return flag
        flags = torch.tensor(float(flag), device=self.device)
        distributed.all_reduce(flags)
        return flags.item() > 0

    def wait(self) -> None:
        if self.count > 1:
            distributed.barrier()

    def wrap(self, model: nn.Module) -> nn.Module:
        if self.count == 1:
            return model
        return nn.parallel.DistributedDataParallel(model, [self.device] if self.device.type == "cuda" else None)

    def close(self) -> None:
        if self.count > 1 and distributed.is_initialized():
            distributed.destroy_process_group()


class _Model(nn.Module):
    """The network, and its encoder's features of the truth, in one forward pass (as DDP wants it)."""

    def __init__(self):
        super().__init__()
        self.network = ShadingCorrectionNetwork()

    def forward(self, frames: Tensor, alpha: Tensor, truth: Tensor):
        correction, features, likely = self.network(frames, alpha)
        with torch.no_grad():
            true_features = self.network.encoder(truth, frames[:, :3])
        return correction, likely, features, true_features


def loss_terms(
    correction: Tensor,
    likely: Tensor,
    features: list[Tensor],
    true_features: list[Tensor],
    batch: Batch,
    focus: Tensor,
    perceptual,
) -> dict[str, Tensor]:
    """The terms of the loss, not weighted: see `weights`. `likely`: p of the network's focus mask.

    The frame that is reconstructed is the truth but for the focus mask, where it is the refined image (paper, equation
    of the final prediction): the true mask's pixels too, or else a mask that begins at 0 would teach nothing.
    """
    refined, final, mask = compose(batch.gae, correction)
    truth = encode(batch.truth)
    shown = encode(batch.truth + torch.maximum(mask, focus) * (refined - batch.truth))
    likely = likely.float()
    return {
        "reconstruction": losses.charbonnier(shown, truth),
        "features": sum(losses.census(a.float(), b.float()) for a, b in zip(features, true_features, strict=True)),
        "focus": losses.focus_loss(likely if batch.halved else double(likely), focus),
        "perceptual": perceptual(shown, truth),
        "blend": losses.shown_loss(final, batch.truth),
    }


def weights(recipe: Recipe) -> dict[str, float]:
    return {
        "reconstruction": 1.0,
        "features": losses.FEATURES_WEIGHT,
        "focus": losses.FOCUS_WEIGHT,
        "perceptual": losses.PERCEPTUAL_WEIGHT,
        "blend": recipe.blend_weight,
    }


class Training:
    """One run in `folder`: continues from its checkpoint if there is one.

    Raises GffeError if the checkpoint is of another recipe or cannot be read.
    """

    def __init__(self, folder: Path, recipe: Recipe, crops: list[Crop], processes: Processes, vgg: Path | None = None):
        self.folder, self.recipe, self.processes = Path(folder), recipe, processes
        validation, train = split_crops(crops, recipe.seed)
        self.crops, self.validation = keep_crops(train, recipe.seed), validation
        self.device = processes.device
        torch.manual_seed(recipe.seed)
        self.model = _Model().to(self.device, memory_format=torch.channels_last)
        self.parallel = processes.wrap(self.model)
        self.optimizer = torch.optim.Adam(self.model.parameters(), recipe.learning_rate)
        self.perceptual = losses.perceptual_loss(vgg).to(self.device)
        self.step, self.seconds = 0, 0.0
        self._load()

    @property
    def network(self) -> ShadingCorrectionNetwork:
        return self.model.network

    def run(
        self,
        until: float | None = None,
        on_step: Callable[[Progress], None] = lambda progress: None,
        validate_every: int = 500,
    ) -> bool:
        """Train until all steps are done, or `time.monotonic()` passes `until`; returns whether all are.

        A checkpoint is written every two minutes, at the end, and when interrupted.
        """
        started = saved = time.monotonic()
        spent = self.seconds
        writer = self._writer() if self.processes.first else None
        try:
            while self.step < self.recipe.steps:
                now = time.monotonic()
                self.seconds = spent + now - started
                if now - saved > _CHECKPOINT_SECONDS:
                    self.save()
                    saved = now
                if self.processes.any(until is not None and now > until):
                    break
                terms = self._train_step()
                self.step += 1
                if writer and (self.step % 20 == 0 or self.step == 1):
                    for name, value in terms.items():
                        writer.add_scalar(f"train/{name}", value, self.step)
                if writer and self.validation and (self.step % validate_every == 0 or self.step == self.recipe.steps):
                    for name, value in self.validate().items():
                        writer.add_scalar(f"validation/{name}", value, self.step)
                on_step(Progress(self.step, terms))
        finally:
            self.seconds = spent + time.monotonic() - started
            self.save()
            if writer:
                writer.close()
        return self.step >= self.recipe.steps

    def _train_step(self) -> dict[str, float]:
        recipe, processes = self.recipe, self.processes
        generator = torch.Generator().manual_seed(_mixed(recipe.seed, self.step, processes.rank))
        batch = load_batch(self._chosen())
        if (self.step + 1) % recipe.full_every:
            batch = batch.halve()
        batch = Augmentation(generator, recipe.shading)(batch).to(self.device)
        for group in self.optimizer.param_groups:
            group["lr"] = recipe.learning_rate_at(self.step)
        self.parallel.train()
        with torch.autocast(self.device.type, torch.bfloat16, enabled=recipe.bfloat16):
            correction, likely, features, true_features = self.parallel(
                batch.frames().contiguous(memory_format=torch.channels_last), batch.alpha, batch.target()
            )
        terms = loss_terms(correction.float(), likely, features, true_features, batch, batch.focus(), self.perceptual)
        factors = weights(recipe)
        loss = sum(factors[name] * value for name, value in terms.items())
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self.optimizer.step()
        return {name: float(value.detach()) for name, value in terms.items()} | {"loss": float(loss.detach())}

    def _chosen(self) -> list[Crop]:
        """This process's share of the crops of the present step: every crop once per epoch, in an order of its own."""
        recipe, count = self.recipe, len(self.crops)
        share = max(1, recipe.batch // self.processes.count)
        first = self.step * recipe.batch + self.processes.rank * share
        orders: dict[int, np.ndarray] = {}
        chosen = []
        for k in range(first, first + share):
            epoch = k // count
            if epoch not in orders:
                orders[epoch] = np.random.default_rng([recipe.seed, 4, epoch]).permutation(count)
            chosen.append(self.crops[orders[epoch][k % count]])
        return chosen

    def validate(self) -> dict[str, float]:
        """On crops of clips that are not trained on, not augmented: mean absolute encoded error of the GAE and the
        final frame on focus pixels that are not disoccluded, and on all; recall and precision of the focus mask."""
        self.model.eval()
        sums: dict[str, float] = {}

        def add(name, value):
            sums[name] = sums.get(name, 0.0) + float(value)

        with torch.no_grad():
            for k in range(0, len(self.validation), self.recipe.batch):
                batch = load_batch(self.validation[k : k + self.recipe.batch]).to(self.device)
                correction = self.network(batch.frames().contiguous(memory_format=torch.channels_last), batch.alpha)
                _, final, mask = compose(batch.gae, correction)
                focus = batch.focus() * (batch.side[:, 1:] != 0)
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

    # ---- checkpoints -----------------------------------------------------------------------------------

    def save(self) -> None:
        """Write the checkpoint; whole, or the one before stays."""
        if not self.processes.first:
            return
        state = {
            "format": _FORMAT,
            "recipe": asdict(self.recipe),
            "step": self.step,
            "seconds": self.seconds,
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        path = self.folder / CHECKPOINT
        part = path.with_suffix(".part")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            torch.save(state, part)
            os.replace(part, path)
        except (OSError, RuntimeError) as error:
            with suppress(OSError):
                part.unlink()
            raise GffeError(
                f"{path}: cannot write the checkpoint: {getattr(error, 'strerror', None) or error}"
            ) from None

    def _load(self) -> None:
        path = self.folder / CHECKPOINT
        if not path.exists():
            return
        with _readable(path):
            state = torch.load(path, map_location=self.device, weights_only=True)
            if state["format"] != _FORMAT:
                raise GffeError(f"{path}: checkpoint of format {state['format']}, expected {_FORMAT}")
            differing = [key for key, value in asdict(self.recipe).items() if state["recipe"].get(key) != value]
            if differing:
                was = ", ".join(f"{key} {state['recipe'].get(key)}" for key in differing)
                raise GffeError(f"{path}: was started with {was} (expected the same options, or another folder)")
            self.model.load_state_dict(state["model"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.seconds = int(state["step"]), float(state["seconds"])

    def _writer(self):
        from torch.utils.tensorboard import SummaryWriter

        return SummaryWriter(str(self.folder / "log"), purge_step=self.step)


def split_crops(crops: list[Crop], seed: int) -> tuple[list[Crop], list[Crop]]:
    """Crops of some clips, those with the most focus pixels, to validate with; and those of the others."""
    paths = sorted({crop.path for crop in crops})
    count = math.ceil(_VALIDATION_SHARE * len(paths)) if len(paths) > 1 else 0
    held = {paths[i] for i in np.random.default_rng([seed, 5]).choice(len(paths), count, replace=False)}
    validation = sorted((crop for crop in crops if crop.path in held), key=lambda crop: -crop.focus)
    return validation[:_VALIDATION_CROPS], [crop for crop in crops if crop.path not in held]


@contextmanager
def _readable(path: Path):
    try:
        yield
    except GffeError:
        raise
    except Exception as error:  # torch.load raises many kinds
        raise GffeError(f"{path}: not a checkpoint of this program ({type(error).__name__})") from None


def _mixed(seed: int, step: int, rank: int) -> int:
    return int(np.random.SeedSequence([seed, step, rank]).generate_state(1)[0])
