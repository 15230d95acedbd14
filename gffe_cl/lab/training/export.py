"""Export of a trained network: quantization of its convolutions to 8-bit integers, for CPUs and kernels; ONNX, checked
against PyTorch; and layers for kernels.

Activations have 8 bits per tensor, weights 7 bits per output channel: sums of two products of an unsigned and a signed
byte then fit 16 bits, and CPUs with and without VNNI give the same results. The first convolution, on colors, and the
last one stay in floats.
"""

from __future__ import annotations

import copy
import logging
import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from onnx import helper, numpy_helper
from torch import Tensor, nn

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
from gffe_cl.lab.training.network import ConvolutionLayers, ShadingCorrectionNetwork

_LEVELS = 255  # steps of an activation's range
_LARGEST_WEIGHT = 63
_KEPT = 1e-4  # share of an activation's values beyond its range, at either end
_BALANCE = 0.5  # how far scales go by activations rather than by weights, as exponent
_MOST_VALUES = 1 << 20  # of an activation that its range is found from

Inputs = tuple[Tensor, Tensor]  # of `ConvolutionLayers.forward`


class RoundedActivation(nn.Module):
    """Forward hook that rounds a module's output to steps of a fixed range."""

    def __init__(self, least: float, most: float):
        super().__init__()
        least, most = min(least, 0.0), max(most, 0.0)
        scale = max(most - least, 1e-6) / _LEVELS
        self.register_buffer("scale", torch.tensor(scale))
        self.register_buffer("zero", torch.tensor(round(-least / scale), dtype=torch.int32))

    def forward(self, x: Tensor) -> Tensor:
        return torch.fake_quantize_per_tensor_affine(x, self.get_buffer("scale"), self.get_buffer("zero"), 0, _LEVELS)


def unit_of(weight: Tensor) -> Tensor:
    """Return the steps (outputs,) to which weights of each output channel are rounded."""
    return (weight.abs().amax((1, 2, 3)) / _LARGEST_WEIGHT).clamp(min=1e-8)


def rounded(weight: Tensor) -> Tensor:
    """Return the weights rounded to values that integers hold."""
    unit = unit_of(weight.detach())
    zero = torch.zeros_like(unit, dtype=torch.int32)
    return torch.fake_quantize_per_channel_affine(weight, unit, zero, 0, -_LARGEST_WEIGHT, _LARGEST_WEIGHT)


class ChannelGain(nn.Module):
    """Gain layer that scales the candidates, so that all channels share one range."""

    def __init__(self, gain: Tensor):
        super().__init__()
        self.register_buffer("gain", gain.view(1, -1, 1, 1))

    def forward(self, candidates: Tensor) -> Tensor:
        return candidates * self.get_buffer("gain")


def quantize(network: ConvolutionLayers, inputs: Iterable[Inputs]) -> None:
    """Make `network` compute as its integers will, with channels equalized and ranges found on `inputs`."""
    inputs = list(inputs)
    equalize(network, inputs)
    for name, values in _activations(network, inputs, _rounded(network)).items():
        module: Any = network.get_submodule(name)
        module.rounding = RoundedActivation(*map(float, np.quantile(values, (_KEPT, 1 - _KEPT))))
        module.register_forward_hook(_round)
    for convolution in _in_integers(network):
        convolution.weight_rounding = rounded


def rounded_weights(network: ConvolutionLayers) -> ConvolutionLayers:
    """Return a copy of a network that was quantized, with the rounded weights in place of those that are trained."""
    network = copy.deepcopy(network)
    for convolution in _in_integers(network):
        convolution.weight.data = rounded(convolution.weight.data)
        convolution.weight_rounding = None
    return network


@torch.no_grad()
def equalize(network: Any, inputs: list[Inputs]) -> None:
    """Scale channels to use the range of their tensor, and scale the weights that read them inversely. The output is
    unchanged."""
    readers = _readers(network)
    rows = _activations(network, inputs, list(readers), by_channel=True)
    for name, convolutions in readers.items():
        size = np.quantile(np.abs(rows[name]), 1 - _KEPT, axis=1)
        size = np.maximum(size, 1e-3 * size.max())
        weights = [convolution.weight[:, first : first + len(size)] for convolution, first in convolutions]
        largest = np.max([weight.abs().amax((0, 2, 3)).numpy() for weight in weights], axis=0)
        scale = size**_BALANCE / np.maximum(largest, 1e-6) ** (1 - _BALANCE)
        scale = torch.from_numpy((scale / np.exp(np.log(scale).mean())).astype(np.float32))
        for weight in weights:
            weight *= scale.view(1, -1, 1, 1)
        if name == "given":
            network.given = ChannelGain(1 / scale)
        else:
            block: Any = network.get_submodule(name)
            convolution = block[0]
            convolution.weight /= scale.view(-1, 1, 1, 1)
            convolution.bias /= scale


def _readers(network: Any) -> dict[str, list[tuple[nn.Conv2d, int]]]:
    """Return by the modules that make channels the convolutions that read these, and from which input channel on."""
    encoder, narrow, decoder = network.encoder, network.narrow, network.decoder
    last = len(decoder)
    seen = network.seen[0].out_channels
    readers = {"seen": [(encoder[0][0], 0)], "given": [(encoder[0][0], seen)]}
    for k, level in enumerate(encoder):
        made = "encoder.0"
        if k:
            readers[f"encoder.{k}.0"] = [(level[1][0], 0)]
            made = f"encoder.{k}.1"
        if k == last:
            readers[made] = [(narrow[-1][0], 0)]
        else:
            readers[made] = [(encoder[k + 1][0][0], 0), (decoder[k][0], narrow[k][0].out_channels)]
    for k in range(last):
        readers[f"narrow.{k}"] = [(decoder[k][0], 0)]
        readers[f"decoder.{k}"] = [(narrow[k - 1][0] if k else network.out, 0)]
    return readers


def _in_integers(network: Any) -> Iterator[Any]:
    for module in network.modules():
        if isinstance(module, nn.Conv2d) and module not in (network.seen[0], network.out):
            yield module


def _rounded(network: ConvolutionLayers) -> list[str]:
    """Return the names of the modules whose outputs are integers."""
    names = ["seen.1", "given"]
    for name in _readers(network):
        if name not in ("seen", "given"):
            names += [f"{name}.0", f"{name}.1"]
    return names + [f"{kind}.{k}" for kind in ("doubled", "joined") for k in range(len(getattr(network, kind)))]


def _round(module: Any, _, x: Tensor) -> Tensor:
    return module.rounding(x)


@torch.no_grad()
def _activations(
    network: ConvolutionLayers, inputs: list[Inputs], names: list[str], by_channel: bool = False
) -> dict[str, np.ndarray]:
    """Return some of the output values of the modules `names`, by name: (n,), or (channels, n)."""
    found: dict[str, list[Tensor]] = {name: [] for name in names}
    generator = torch.Generator().manual_seed(0)

    def keep(parts: list[Tensor], x: Any) -> None:
        rows = x.float().movedim(1, 0).flatten(1)
        some = torch.randint(rows.shape[1], (_MOST_VALUES // len(inputs) // len(rows) + 1,), generator=generator)
        parts.append(rows[:, some])

    hooks = [
        network.get_submodule(name).register_forward_hook(lambda _, __, x, parts=parts: keep(parts, x))
        for name, parts in found.items()
    ]
    for each in inputs:
        network(*each)
    for hook in hooks:
        hook.remove()
    rows = {name: torch.cat(parts, 1).numpy() for name, parts in found.items()}
    return rows if by_channel else {name: values.ravel() for name, values in rows.items()}


def store_integers(path: Path) -> None:
    """Store weights and biases in the ONNX file of a network of `rounded_weights` as the integers that they are."""
    model = onnx.load(str(path))
    graph = model.graph
    numbers = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    numbers |= {n.output[0]: numpy_helper.to_array(n.attribute[0].t) for n in graph.node if n.op_type == "Constant"}
    for node in graph.node:
        if node.op_type == "Identity" and node.input[0] in numbers:  # of equal tensors the exporter stores one
            numbers[node.output[0]] = numbers[node.input[0]]
    makers = {output: node for node in graph.node for output in node.output}
    nodes = []

    def stored(name: str, integers: np.ndarray, unit: np.ndarray) -> str:
        zero = np.zeros(len(unit), integers.dtype)
        parts = {f"{name}.integers": integers, f"{name}.unit": unit, f"{name}.zero": zero}
        graph.initializer.extend(numpy_helper.from_array(array, part) for part, array in parts.items())
        nodes.append(helper.make_node("DequantizeLinear", list(parts), [f"{name}.rounded"], f"{name}.rounded", axis=0))
        return f"{name}.rounded"

    for node in graph.node:
        maker = makers.get(node.input[0]) if node.op_type == "Conv" else None
        if maker is not None and maker.op_type == "DequantizeLinear" and node.output[0] != OUTPUT:
            weight, bias = (numbers[name].copy() for name in node.input[1:])
            unit = unit_of(torch.from_numpy(weight)).numpy()
            integers = np.rint(weight / unit.reshape(-1, 1, 1, 1)).astype(np.int8)
            node.input[1] = stored(node.input[1], integers, unit)
            unit = numbers[maker.input[1]] * unit
            node.input[2] = stored(node.input[2], np.rint(bias / unit).astype(np.int32), unit)
        nodes.append(node)
    used = {name for node in nodes for name in node.input}
    tensors = [tensor for tensor in graph.initializer if tensor.name in used]
    nodes = [onnx.NodeProto.FromString(node.SerializeToString()) for node in nodes]
    tensors = [onnx.TensorProto.FromString(tensor.SerializeToString()) for tensor in tensors]
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(tensors)
    onnx.save(model, str(path))


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
