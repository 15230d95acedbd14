"""Export of a trained network: ONNX, checked against PyTorch, and layers for kernels."""

from __future__ import annotations

import logging
import os
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.inference.layers import (
    HEAD,
    INPUTS,
    MULTIPLE,
    OUTPUT,
    head_text,
    head_weights,
    shapes_at,
)
from gffe_cl.engine.inference.network import open_session
from gffe_cl.lab.training.layers import write_layers
from gffe_cl.lab.training.network import ShadingCorrectionNetwork
from gffe_cl.lab.training.quantization import rounded_weights, store_integers

OPSET = 18
TOLERANCE = 2e-4  # between onnxruntime and PyTorch, of values in about −1 … 1
INTEGER_TOLERANCE = 0.4  # of integers, the root of the mean square of values in about −10 … 10


def export_onnx(network: ShadingCorrectionNetwork, path: Path, integers: bool = False) -> float:
    """Write `network` to `path`: its convolutions, for frames of any height and width, and the head's weights. Return
    the largest difference between onnxruntime and PyTorch on random input of two sizes. `integers`: the network was
    quantized. Then its layers for kernels are written beside it, and the root of the mean squared difference is
    returned, because integers may be off by one.

    Raises GffeError if they disagree, or the file cannot be written; then there is none.
    """
    convert: Any = network.eval().cpu().to  # the stub lacks this form of it
    network = convert(memory_format=torch.contiguous_format)
    convolutions = rounded_weights(network.convolutions) if integers else network.convolutions
    path, part = Path(path), Path(path).with_suffix(".part.onnx")
    example = example_inputs(4 * MULTIPLE, 6 * MULTIPLE)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            logging.getLogger("torch.onnx").setLevel(logging.ERROR)
            torch.onnx.export(
                convolutions,
                tuple(example.values()),
                str(part),
                input_names=list(example),
                output_names=[OUTPUT],
                dynamic_axes={
                    "frames": {2: "height", 3: "width"},
                    "candidates": {2: "half_height", 3: "half_width"},
                    OUTPUT: {2: "half_height", 3: "half_width"},
                },
                opset_version=OPSET,
                dynamo=False,
            )
        if integers:
            store_integers(part)
        model = onnx.load(str(part))
        model.metadata_props.add(key=HEAD, value=head_text(network.head_weights()))
        onnx.save(model, str(part))
        largest, mean = differences(network, part)
        difference, most = (mean, INTEGER_TOLERANCE) if integers else (largest, TOLERANCE)
        if not difference <= most:
            raise GffeError(f"{path}: onnxruntime and PyTorch differ by {difference:.2g} (expected at most {most:g})")
        os.replace(part, path)
        if integers:
            write_layers(path)
    except OSError as error:
        raise GffeError(f"{path}: cannot write the model: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            part.unlink()
    return difference


def example_inputs(height: int, width: int) -> dict[str, torch.Tensor]:
    """Return random input of the model, in the order of its arguments. Equal sizes get equal numbers."""
    generator, shapes = torch.Generator().manual_seed(height), shapes_at(height, width)
    return {name: torch.rand(shapes[name], generator=generator) for name in INPUTS}


def weights_of(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the weights in a network that `export_onnx` wrote: of the convolutions, by the names of their parameters,
    and of the head. Raises GffeError."""
    try:
        model = onnx.load(str(path))
        weights = {item.name: onnx.numpy_helper.to_array(item) for item in model.graph.initializer}
        head = next((item.value for item in model.metadata_props if item.key == HEAD), "")
    except (OSError, ValueError, TypeError, LookupError, DecodeError) as error:
        raise GffeError(
            f"{path}: not an ONNX network ({getattr(error, 'strerror', None) or type(error).__name__})"
        ) from None
    return weights, head_weights(head)


def differences(network: ShadingCorrectionNetwork, path: Path) -> tuple[float, float]:
    """Return two differences between the outputs of onnxruntime and PyTorch: the largest, and the root of the mean
    square."""
    session = open_session(path)
    found = []
    for height, width in ((2 * MULTIPLE, 3 * MULTIPLE), (5 * MULTIPLE, MULTIPLE)):
        inputs = example_inputs(height, width)
        (made,) = session.run(None, {name: value.numpy() for name, value in inputs.items()})
        with torch.no_grad():
            found.append((made - network.convolutions(*inputs.values()).numpy()).ravel())
    difference = np.concatenate(found)
    return float(np.abs(difference).max()), float(np.sqrt((difference**2).mean()))
