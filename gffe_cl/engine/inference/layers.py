"""The shading correction network as files hold it: the interface of its ONNX model, and its layers for OpenCL kernels.

Kernels (kernels/convolutions.cl) run networks of 8-bit integers, of any width and depth up to four levels: a chain of
convolutions of images of bytes, with images that are doubled or joined in between. Such a network's layers lie beside
its ONNX file, in a file of NumPy (.npz); `gffe_cl.lab.training.layers` writes it. They round where the ONNX file
rounds, to the same integers as onnxruntime: a byte q stands for (q − zero) · scale.
"""

from __future__ import annotations

import base64
import hashlib
import json
import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.engine.core.files import read_bounded

# ---- ONNX files of others ------------------------------------------------------------------------------

MOST_BYTES = 64 << 20  # of a model, and of its layers
_MOST_FIELDS = 200_000
# What networks of this family consist of. None of them repeats anything or contains another graph.
_OPERATORS = {
    *("Add", "Cast", "Clip", "Concat", "Constant", "Conv", "DequantizeLinear", "Gather", "Greater", "Identity"),
    *("LeakyRelu", "MaxPool", "Mul", "QuantizeLinear", "Relu", "Resize", "SpaceToDepth", "Sub"),
}
# Numbers of fields in onnx.proto: messages that are looked into, and fields that no such network has.
_GRAPH, _NODE, _ATTRIBUTE, _TENSOR, _INITIALIZER, _OPERATOR, _DOMAIN = 7, 1, 5, 5, 5, 4, 7
_UNKNOWN = {"model": {20: "training", 25: "functions"}, "attribute": {6: "a graph", 11: "graphs"}, "graph": {}}
_UNKNOWN |= {"tensor": {13: "data in another file"}, "node": {}}


def require_operators(model: bytes) -> None:
    """Raise ValueError unless the ONNX file `model` consists of operators of this family of networks, whose work is
    bounded by the size of the image: another one may run for ever."""
    stack, count = [("model", memoryview(model))], 0
    while stack:
        kind, message = stack.pop()
        for number, value in _fields(message):
            count += 1
            if count > _MOST_FIELDS:
                raise ValueError(f"more than {_MOST_FIELDS} fields")
            if number in _UNKNOWN[kind]:
                raise ValueError(f"{_UNKNOWN[kind][number]} (expected operators alone)")
            inner = {
                ("model", _GRAPH): "graph",
                ("graph", _NODE): "node",
                ("graph", _INITIALIZER): "tensor",
                ("node", _ATTRIBUTE): "attribute",
                ("attribute", _TENSOR): "tensor",
            }.get((kind, number))
            if inner and isinstance(value, memoryview):
                stack.append((inner, value))
            if kind == "node" and number in (_OPERATOR, _DOMAIN) and isinstance(value, memoryview):
                name = bytes(value[:40]).decode("ascii", "replace")
                if name not in (_OPERATORS if number == _OPERATOR else ("", "ai.onnx")):
                    raise ValueError(f"operator {name} (expected {', '.join(sorted(_OPERATORS))})")


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview | None]]:
    """Yield number and value of the fields of a message of Protocol Buffers. Raises ValueError where it is none."""
    at = 0
    while at < len(message):
        key, at = _number(message, at)
        value, size = None, {1: 8, 5: 4}.get(key & 7, 0)
        if key & 7 == 0:
            value, at = _number(message, at)
        elif key & 7 == 2:
            size, at = _number(message, at)
            value = message[at : at + size]
        elif not size:
            raise ValueError("no message")
        at += size
        if at > len(message):
            raise ValueError("cut off")
        yield key >> 3, value


def _number(message: memoryview, at: int) -> tuple[int, int]:
    """Return a number of up to ten bytes, and where it ends."""
    found = 0
    for place, byte in enumerate(message[at : at + 10]):
        found |= (byte & 127) << 7 * place
        if byte < 128:
            return found, at + place + 1
    raise ValueError("no number")


# ---- interface of the model ----------------------------------------------------------------------------

MULTIPLE = 16  # of the width and height of its frames
INPUT_PLANES, CANDIDATE_PLANES, JUDGEMENT_PLANES = 8, 16, 20
HEAD = "head"  # key of the metadata
HEAD_LAYERS = ((16, 16), (6, 16))  # outputs and inputs of each
HEAD_WEIGHTS = sum(outputs * (inputs + 1) for outputs, inputs in HEAD_LAYERS)
INPUTS, OUTPUT = ("frames", "candidates"), "judgement"


def shapes_at(height: int, width: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of inputs and output by name, for frames of this size."""
    quarter = height // 2, width // 2
    return {
        "frames": (1, INPUT_PLANES, height, width),
        "candidates": (1, CANDIDATE_PLANES, *quarter),
        "judgement": (1, JUDGEMENT_PLANES, *quarter),
    }


def head_text(weights: np.ndarray) -> str:
    """Return the metadata for a head of these weights: of each layer rows, then biases."""
    return base64.b64encode(weights.astype("<f4").tobytes()).decode()


def head_weights(text: str) -> np.ndarray:
    """Return the head's weights (n,) float32: the inverse of `head_text`. The array is empty for a text that holds
    none."""
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(np.float32)
    except ValueError:
        return np.empty(0, np.float32)


# ---- layers for kernels --------------------------------------------------------------------------------

BLOCK = 4  # channels that lie side by side
FIRST_CHANNELS = 16  # that a work-item of the first convolution makes: a divisor of its channels
ABOUT = "about"  # key of a text in the file: JSON of everything that is no array
ARRAYS = ("weights", "bias", "unit")  # of each layer; their keys are "NUMBER.NAME"
_F = np.float32
_DAMAGED = (OSError, zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, EOFError)  # of the file itself
_DAMAGED += (LookupError, ValueError, TypeError)  # of its content


class NotInKernels(ValueError):
    """Error of a network that the kernels cannot run; the message says why."""


@dataclass(frozen=True)
class Rounding:
    """Rounding to bytes, after a leaky rectifier of this slope (1: none): in real numbers what `onnxruntime` does."""

    scale: np.float32
    zero: int
    slope: float = 1.0

    @property
    def limits(self) -> tuple[float, float]:
        """Least and largest number of steps from the zero point."""
        return float(-self.zero), float(255 - self.zero)


@dataclass(frozen=True)
class Image:
    """Image of bytes: `zero` stands for 0 in it, and so around it, and a step for `scale`. It has half the pixels each
    way of level − 1; level 1 is a quarter of the display."""

    name: str
    channels: int
    level: int
    zero: int
    scale: np.float32


@dataclass
class Layer:
    """Layer of a network.

    Attributes
    ----------
    kind : "first" (convolution of frames, in floats), "taken" (candidates as bytes), "convolution", "doubled", "last"
        (convolution of bytes to the judgement, in floats)
    level, channels : of its result
    sources : images that it reads; two are joined
    targets : images that it makes: the first one is rounded twice, the second one, for being joined, once more
    roundings : two, or three with a second target
    factors : by which steps of one rounding are multiplied before the next, from 0 on and below
    weights : (outputs, inputs, size, size), float32, or int8 for "convolution"; for "taken" (channels,) float32 factors
    bias : (outputs,) float32; of convolutions in integers whole numbers, in which zero points are contained
    unit : (outputs,) float32: the step of sums of integers in units of the first rounding
    stride : of a convolution
    """

    kind: str
    level: int
    channels: int
    sources: list[Image] = field(default_factory=list)
    targets: list[Image] = field(default_factory=list)
    roundings: tuple[Rounding, ...] = ()
    factors: tuple[tuple[np.float32, np.float32], ...] = ()
    weights: np.ndarray = field(default_factory=lambda: np.zeros(0, _F))
    bias: np.ndarray = field(default_factory=lambda: np.zeros(0, _F))
    unit: np.ndarray = field(default_factory=lambda: np.zeros(0, _F))
    stride: int = 1


@dataclass
class IntegerNetwork:
    """The layers of a network, in order, and its metadata `head` (see `head_text`)."""

    layers: list[Layer]
    head: str

    @property
    def images(self) -> list[Image]:
        """All images of bytes, in the order in which they are made."""
        return [image for layer in self.layers for image in layer.targets]


def layers_file(path: Path) -> Path:
    """Return where the layers of the ONNX file `path` are."""
    return path.with_suffix(".npz")


def digest_of(path: Path) -> str:
    """Return the hash of an ONNX file, by which its layers name it."""
    return hashlib.sha256(read_bounded(path, MOST_BYTES)).hexdigest()


def read_layers(path: Path) -> IntegerNetwork:
    """Return the layers of the network in the ONNX file `path`. Raises NotInKernels if there are none beside it, or
    those of another file."""
    beside = layers_file(path)
    try:
        with zipfile.ZipFile(beside) as archive:
            if sum(part.file_size for part in archive.infolist()) > MOST_BYTES or archive.testzip():
                raise zipfile.BadZipFile
        with np.load(beside, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(str(arrays[ABOUT]))
        if about["model"] != digest_of(path):
            raise NotInKernels(f"the layers beside it, {beside.name}, are those of another file")
        return _network(about, arrays)
    except FileNotFoundError:
        raise NotInKernels(f"its layers, {beside.name}, are not beside it") from None
    except NotInKernels:
        raise
    except _DAMAGED as error:
        raise NotInKernels(f"its layers, {beside.name}, cannot be read ({type(error).__name__})") from None


def _network(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> IntegerNetwork:
    images: dict[str, Image] = {}
    layers = []
    for number, row in enumerate(about["layers"]):
        images |= {own["name"]: Image(**own | {"scale": _F(own["scale"])}) for own in row["targets"]}
        layer = Layer(
            row["kind"],
            row["level"],
            row["channels"],
            [images[name] for name in row["sources"]],
            [images[own["name"]] for own in row["targets"]],
            tuple(Rounding(_F(scale), zero, slope) for scale, zero, slope in row["roundings"]),
            tuple((_F(above), _F(below)) for above, below in row["factors"]),
            stride=row["stride"],
            **{name: arrays[f"{number}.{name}"] for name in ARRAYS},
        )
        _require_shapes(layer)
        layers.append(layer)
    return IntegerNetwork(layers, about["head"])


def _require_shapes(layer: Layer) -> None:
    """Raise ValueError if the arrays of a layer are not as large as its kernel reads them."""
    inputs = sum(image.channels for image in layer.sources) or INPUT_PLANES
    size = layer.weights.shape[-1] if layer.weights.ndim == 4 else 0
    weights = {"taken": (layer.channels,), "doubled": (0,)}.get(layer.kind, (layer.channels, inputs, size, size))
    outputs = layer.channels if layer.kind not in ("taken", "doubled") else 0
    units = layer.channels if layer.kind == "convolution" else 0
    if (layer.weights.shape, layer.bias.shape, layer.unit.shape) != (weights, (outputs,), (units,)):
        raise ValueError(f"a layer of kind '{layer.kind}' has arrays of other shapes")
