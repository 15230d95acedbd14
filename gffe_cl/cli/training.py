"""The command that trains: train."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from gffe_cl.cli.common import DeviceOption, JsonOption, app, out, progress_bars, write_json
from gffe_cl.errors import GffeError


@app.command()
def train(
    folder: Annotated[Path, typer.Argument(help="Checkpoint, logs, model and its card; continues what it holds.")],
    data: Annotated[
        Path | None,
        typer.Option(help="Cache of training clips, made as far as missing [dim](default: FOLDER/data)[/]."),
    ] = None,
    clips: Annotated[int, typer.Option(help="Clips to train on; each gives four samples.")] = 400,
    steps: Annotated[int, typer.Option(help="Optimiser steps.")] = 20000,
    batch: Annotated[int, typer.Option(help="Crops of 256×256 per step.")] = 16,
    learning_rate: Annotated[float, typer.Option(help="Of Adam, at the beginning.")] = 1e-4,
    final_learning_rate: Annotated[float, typer.Option(help="And at the end.")] = 1e-5,
    shading: Annotated[float, typer.Option(help="How often crops get moving shading of their own, 0 to 1.")] = 0.6,
    blend_weight: Annotated[float, typer.Option(help="Of the loss of the frame as it is shown.")] = 1.0,
    full_every: Annotated[
        int, typer.Option(help="Steps from one at full resolution to the next; half, quicker, between.")
    ] = 4,
    bfloat16: Annotated[
        bool, typer.Option("--bfloat16", help="Mixed precision: quicker where there is AMX or a GPU.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Of data, order, augmentation and first weights.")] = 0,
    minutes: Annotated[
        float | None, typer.Option(help="Stop after so long; the same command goes on from there.")
    ] = None,
    data_only: Annotated[bool, typer.Option("--data-only", help="Only make the clips.")] = False,
    vgg: Annotated[Path | None, typer.Option(help="torchvision's vgg19-*.pth, for the perceptual loss.")] = None,
    device: DeviceOption = None,
    json_path: JsonOption = None,
) -> None:
    """Train the shading correction network on varied built-in scenes, and export it as ONNX.

    Several GPUs: torchrun --nproc-per-node N -m gffe_cl train …
    """
    try:
        import tensorboard  # noqa: F401
        import torch
    except ImportError:
        raise GffeError("training needs PyTorch and TensorBoard (expected: pip install 'gffe-cl[train]')") from None
    from gffe_cl.opencl.device import open_device
    from gffe_cl.scn.clips import finished_clips, make_clips
    from gffe_cl.scn.crops import list_crops
    from gffe_cl.scn.training import Processes, Recipe, Training

    if minutes is not None and not minutes > 0:
        raise GffeError(f"--minutes must be positive, got {minutes:g}")
    if clips < 2:
        raise GffeError(f"--clips must be at least 2, got {clips}")
    until = None if minutes is None else time.monotonic() + 60 * minutes
    recipe = Recipe(seed, steps, batch, learning_rate, final_learning_rate, shading, blend_weight, full_every, bfloat16)
    data = data or folder / "data"
    processes = Processes()
    try:
        with progress_bars() as bars:
            task = bars.add_task("clips", total=-(-clips // processes.count), visible=processes.first)
            part = processes.rank, processes.count
            make_clips(data, open_device(device), seed, clips, lambda: bars.advance(task), part, until)
            late = processes.any(until is not None and time.monotonic() > until)
            if data_only or late:
                if processes.first:
                    made = len(finished_clips(data, seed, clips))
                    out.print(f"clips: {made} of {clips}" + ("; the same command goes on from here" if late else ""))
                    write_json(json_path, {"clips": made, "done": False})
                return
            training = Training(folder, recipe, list_crops(data, seed, clips), processes, vgg)
            bars.update(task, description="steps", total=steps, completed=training.step)
            done = training.run(until, lambda progress: bars.update(task, completed=progress.step))
        if processes.first:
            _export(training, folder, data, clips, done, torch.__version__, json_path)
    finally:
        processes.close()


def _export(training, folder: Path, data: Path, clips: int, done: bool, torch_version: str, json_path) -> None:
    from gffe_cl.scn.export import count_operations, export_onnx, model_card

    figures = training.validate()
    difference = export_onnx(training.network, folder / "scn.onnx")
    parameters, operations = count_operations(training.network, 1920, 1080)
    recipe = training.recipe
    facts = {
        "parameters": f"{parameters:,}",
        "operations at 1920×1080": f"{operations:.1f} GFLOP",
        "steps": f"{training.step:,} of {recipe.steps:,}, {recipe.batch} crops each",
        "training": f"{training.seconds / 3600:.2f} h on {training.device.type}, PyTorch {torch_version}",
        "data": f"{clips} clips, seed {recipe.seed}; {len(training.crops):,} crops of 256×256",
        "perceptual loss": training.perceptual.name,
        "onnxruntime against PyTorch": f"largest difference {difference:.1g}",
        "source": f"commit {', then '.join(training.sources)}",
    }
    if training.processes.count > 1:
        facts["processes"] = str(training.processes.count)
    command = shlex.join(("gffe", *sys.argv[1:]))
    try:
        (folder / "MODEL_CARD.md").write_text(model_card(facts, figures, command))
    except OSError as error:
        raise GffeError(f"{folder}: cannot write the model card: {error.strerror}") from None
    for name, value in (facts | {name: f"{value:.4g}" for name, value in figures.items()}).items():
        out.print(f"{name}: {value}")
    if not done:
        out.print("not finished: the same command goes on from here")
    write_json(json_path, {"step": training.step, "done": done, "validation": figures, **facts})
