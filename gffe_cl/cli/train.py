"""Command `gffe train`, which trains the network."""

from __future__ import annotations

import time
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from gffe_cl.cli.common import (
    DeviceOption,
    JsonOption,
    OverwriteOption,
    app,
    input_file,
    out,
    progress_bars,
    takes_scheduler,
    write_json,
)
from gffe_cl.engine.core.errors import GffeError, require_packages
from gffe_cl.engine.core.files import only_process


@app.command()
@takes_scheduler
def train(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder for checkpoint and model; training continues from its content."),
    ],
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of cached training clips; missing ones are made [dim](default: FOLDER/data)[/]."),
    ] = None,
    clips: Annotated[
        int, typer.Option(help="Number of training clips of four samples each; fewer where --minutes does not suffice.")
    ] = 400,
    steps: Annotated[int, typer.Option(help="Number of optimizer steps.")] = 20000,
    batch: Annotated[int, typer.Option(help="Batch size: crops of 256×256 pixels per step.")] = 16,
    learning_rate: Annotated[float, typer.Option(help="Learning rate of Adam at the beginning.")] = 1e-4,
    final_learning_rate: Annotated[float, typer.Option(help="Final learning rate.")] = 1e-5,
    shading: Annotated[float, typer.Option(help="Share of crops that get additional moving shading, 0 to 1.")] = 0.6,
    blend_weight: Annotated[float, typer.Option(help="Weight of the loss of the displayed frame.")] = 1.0,
    full_every: Annotated[
        int,
        typer.Option(help="Interval of steps at full resolution; the others are at half resolution, which is quicker."),
    ] = 4,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Mixed precision with bfloat16: quicker on CPUs with AMX and on GPUs.")
    ] = False,
    integers: Annotated[
        bool,
        typer.Option(
            "--integers",
            help="Quantization-aware training with 8-bit integers, as CPUs run them, close to the network of --start.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Random seed of data, order, augmentation and initial weights.")] = 0,
    minutes: Annotated[
        float | None,
        typer.Option(help="Time limit, minutes, a third of it for clips; the same command continues from there."),
    ] = None,
    start: Annotated[
        Path | None,
        typer.Option(
            help="Network to begin with, an ONNX file of an earlier training.", callback=input_file("--start")
        ),
    ] = None,
    vgg: Annotated[
        Path | None,
        typer.Option(
            help="Weights of VGG-19 for the perceptual loss: torchvision's vgg19-*.pth.", callback=input_file("--vgg")
        ),
    ] = None,
    device: DeviceOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    *,
    cluster: Any,
) -> None:
    """Train the shading correction network on varied built-in scenes, and export it as ONNX."""
    require_packages("training", "train", "torch", "onnx")
    import torch

    from gffe_cl.engine.opencl.device import open_device
    from gffe_cl.lab.training.data import finished_clips, list_crops, make_clips
    from gffe_cl.lab.training.training import Processes, Recipe, Training, clips_of_run

    if minutes is not None and not minutes > 0:
        raise GffeError(f"--minutes must be positive, got {minutes:g}")
    if integers and start is None:
        raise GffeError("--integers: expected --start, too: the network in floats to stay close to")
    if clips < 2:
        raise GffeError(f"--clips must be at least 2, got {clips}")
    recipe = Recipe(
        seed, steps, batch, learning_rate, final_learning_rate, shading, blend_weight, full_every, bfloat16, integers
    )
    data = data or folder / "data"
    begun = None if overwrite else clips_of_run(folder)
    for path in [folder / name for name in _MADE] if begun is None and not overwrite else ():
        if path.exists():
            raise GffeError(f"{path}: is there without a checkpoint (expected another folder, or --overwrite)")
    if begun is not None and clips < begun:
        raise GffeError(f"--clips {clips}: {folder} was started with {begun} (expected at least as many)")
    wanted, processes = begun or clips, Processes()
    is_first = processes.rank == 0
    with progress_bars(is_first) as bars, only_process(folder) if is_first else nullcontext():
        if begun and is_first:
            bars.console.print(f"going on with the {begun} clips that this run was started with")
        started, limit = time.monotonic(), None if minutes is None else 60 * minutes
        clips_until = None if limit is None or begun else started + limit / 3
        task = bars.add_task("clips", total=wanted)
        on_clip = lambda made: bars.advance(task)  # noqa: E731
        if is_first:
            with cluster as workers:
                opened = device if workers else open_device(device)
                make_clips(data, opened, seed, wanted, on_clip, clips_until, _LEAST_CLIPS, workers)
        count = processes.agree(len(finished_clips(data, seed, wanted)) if is_first else 0)
        crops = list_crops(data, seed, count)
        training = Training(folder, recipe, crops, vgg, count, start, overwrite, processes)
        bars.reset(task, description="steps", total=steps, completed=training.step)
        steps_until = None if limit is None else max(started + limit, time.monotonic() + limit / 3)
        done = training.run(steps_until, lambda step: bars.update(task, completed=step))
    if is_first:
        _export(training, folder, data, count, done, torch.__version__, json_path)


_LEAST_CLIPS = 2  # to train on and to validate with
_MADE = ("scn.onnx", "scn-int8.onnx", "scn-int8.npz")  # at the end of a training


def _export(training, folder: Path, data: Path, clips: int, done: bool, torch_version: str, json_path) -> None:
    from gffe_cl.lab.training.export import export_onnx
    from gffe_cl.lab.training.training import LOSSES_VERSION

    figures = training.validate()
    recipe, network = training.recipe, training.network
    if recipe.integers:
        rounded = export_onnx(network, folder / "scn-int8.onnx", integers=True)
        network = training.teacher
    difference = export_onnx(network, folder / "scn.onnx")
    facts = {
        "steps": f"{training.step:,} of {recipe.steps:,}, {recipe.batch} crops each",
        "training": f"{training.seconds / 3600:.2f} h on {training.device.type}, PyTorch {torch_version}",
        "data": f"{clips} clips, seed {recipe.seed}; {len(training.crops):,} crops of 256×256",
        "losses": f"version {LOSSES_VERSION}, perceptual: {training.perceptual.name}",
        "onnxruntime against PyTorch": f"largest difference {difference:.1g}",
    }
    if recipe.integers:
        facts["the same, integers"] = f"root of the mean square {rounded:.1g}"
    for name, value in (facts | {name: f"{value:.4g}" for name, value in figures.items()}).items():
        out.print(f"{name}: {value}")
    if not done:
        out.print("not finished: run the same command again to continue")
    write_json(json_path, {"step": training.step, "done": done, "validation": figures, **facts})
