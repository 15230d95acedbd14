"""From a trained network to what is shipped: ONNX, checked against PyTorch, and a model card."""

from __future__ import annotations

import copy
import logging
import os
import subprocess
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch

from gffe_cl.core.errors import GffeError
from gffe_cl.inference.network import INPUT_PLANES, MULTIPLE, TREND_PLANES, load_onnxruntime
from gffe_cl.scn.channels import pad_file
from gffe_cl.scn.network import ShadingCorrectionNetwork

OPSET = 18  # of 20 and later OpenVINO does not know GridSample
TOLERANCE = 2e-4  # between onnxruntime and PyTorch, of values in about −1 … 1


def export_onnx(network: ShadingCorrectionNetwork, path: Path) -> float:
    """Write `network` to `path` (inputs frames, alpha, trends; output correction; any height and width); returns the
    largest difference between onnxruntime and PyTorch on random input of two sizes.

    Raises GffeError if they disagree, or the file cannot be written; then there is none.
    """
    network = network.eval().cpu().to(memory_format=torch.contiguous_format)
    path, part = Path(path), Path(path).with_suffix(".part.onnx")
    example = example_inputs(4 * MULTIPLE, 6 * MULTIPLE)
    free = {2: "height", 3: "width"}
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            logging.getLogger("torch.onnx").setLevel(logging.ERROR)
            torch.onnx.export(
                network,
                tuple(example.values()),
                str(part),
                input_names=list(example),
                output_names=["correction"],
                dynamic_axes={"frames": free, "trends": free, "correction": free},
                opset_version=OPSET,
                dynamo=False,
            )
        pad_file(part, part)
        difference = largest_difference(network, part)
        if not difference <= TOLERANCE:
            raise GffeError(
                f"{path}: onnxruntime and PyTorch differ by {difference:.2g} (expected at most {TOLERANCE:g})"
            )
        os.replace(part, path)
    except OSError as error:
        raise GffeError(f"{path}: cannot write the model: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            part.unlink()
    return difference


def example_inputs(height: int, width: int) -> dict[str, torch.Tensor]:
    """Random input of the network, in the order of its arguments; equal sizes, equal numbers."""
    generator = torch.Generator().manual_seed(height)
    shapes = {"frames": (1, INPUT_PLANES, height, width), "alpha": (1,), "trends": (1, TREND_PLANES, height, width)}
    return {name: torch.rand(shape, generator=generator) for name, shape in shapes.items()}


def weights_of(path: Path) -> dict[str, np.ndarray]:
    """The weights in a network that `export_onnx` wrote, by the names of its parameters. Raises GffeError."""
    import onnx

    try:
        model = onnx.load(str(path))
        return {item.name: onnx.numpy_helper.to_array(item) for item in model.graph.initializer}
    except Exception as error:  # of protobuf, onnx or the system
        raise GffeError(
            f"{path}: not an ONNX network ({getattr(error, 'strerror', None) or type(error).__name__})"
        ) from None


def largest_difference(network: ShadingCorrectionNetwork, path: Path) -> float:
    """Between the outputs of onnxruntime and PyTorch."""
    session = load_onnxruntime().InferenceSession(str(path), providers=["CPUExecutionProvider"])
    worst = 0.0
    for height, width in ((2 * MULTIPLE, 3 * MULTIPLE), (5 * MULTIPLE, MULTIPLE)):
        inputs = example_inputs(height, width)
        (onnx,) = session.run(None, {name: value.numpy() for name, value in inputs.items()})
        with torch.no_grad():
            expected = network(*inputs.values()).numpy()
        worst = max(worst, float(np.abs(onnx - expected).max()))
    return worst


def count_operations(network: ShadingCorrectionNetwork, width: int, height: int) -> tuple[int, float]:
    """Parameters, and GFLOP (two per multiply-add) for one frame of `width` × `height` display pixels."""
    from torch.utils.flop_counter import FlopCounterMode

    sides = [-(-side // (2 * MULTIPLE)) * MULTIPLE for side in (height, width)]
    shape_only = copy.deepcopy(network).to("meta").eval()
    with torch.no_grad(), torch.device("meta"), FlopCounterMode(display=False) as counter:
        shape_only(*(torch.zeros(1, n, *sides) if n else torch.zeros(1) for n in (INPUT_PLANES, 0, TREND_PLANES)))
    return sum(p.numel() for p in network.parameters()), counter.get_total_flops() / 1e9


def commit() -> str:
    """Of the source this runs from; "unknown" outside a git checkout, "…, changed" where it is not committed."""
    folder = Path(__file__).resolve().parent

    def git(*arguments):
        return subprocess.run(
            ["git", *arguments], cwd=folder, capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        name = git("rev-parse", "--short=12", "HEAD")
        return name + (
            ", changed" if git("status", "--porcelain", "--untracked-files=no", "..", "../../kernels") else ""
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def model_card(facts: dict[str, str], figures: dict[str, float], command: str) -> str:
    """Markdown: data, recipe, figures and the command that gives the weights again."""
    rows = "\n".join(f"| {name} | {value} |" for name, value in facts.items())
    numbers = "\n".join(f"| {name} | {value:.4g} |" for name, value in figures.items())
    return f"""# Shading correction network

Corrects the shading of extrapolated frames: shadows, lights and reflections that move over what does not.
Input, output and composition: `gffe_cl/scn/network.py`. Made by

    {command}

| | |
| --- | --- |
{rows}

Validation, on clips that were not trained on (mean absolute error of encoded colour):

| | |
| --- | --- |
{numbers}
"""
