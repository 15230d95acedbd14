"""The layers of a network of integers for OpenCL kernels, read from its ONNX file.

`gffe train --integers` writes them beside the network. For an ONNX file that it wrote before:

    python -m gffe_cl.lab.training.layers out/scn-int8.onnx

Leaky rectifiers and changes of scale work on single bytes, and are factors that are checked for all bytes here. Sums of
products of bytes stay below 2^24, so that floats hold them, too.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from gffe_cl.engine.core.files import replacing
from gffe_cl.engine.inference.layers import (
    ABOUT,
    ARRAYS,
    BLOCK,
    CANDIDATE_PLANES,
    FIRST_CHANNELS,
    HEAD,
    INPUTS,
    JUDGEMENT_PLANES,
    OUTPUT,
    Image,
    IntegerNetwork,
    Layer,
    NotInKernels,
    Rounding,
    digest_of,
    layers_file,
)

FRAMES, CANDIDATES = INPUTS
FEWEST_LAST_CHANNELS = 16  # that the last convolution reads: onnxruntime sums fewer in another order
MOST_LEVEL = 4  # of the images: frames are a multiple of 2^4 pixels wide and high
MOST_IMAGES = 2  # that a convolution joins, and that a layer makes
EXACT = 1 << 24  # floats hold all whole numbers up to here
_F = np.float32
_BYTES = np.arange(256)
_NEIGHBORS = 64  # floats tried on either side of a factor


def write_layers(path: Path) -> Path:
    """Write the layers of the network of integers in the ONNX file `path` beside it, and return where. Raises OSError,
    and NotInKernels where kernels cannot run it."""
    network, rows, arrays = layers_of(path), [], {}
    for number, layer in enumerate(network.layers):
        arrays |= {f"{number}.{name}": getattr(layer, name) for name in ARRAYS}
        rows.append(
            {
                "kind": layer.kind,
                "level": layer.level,
                "channels": layer.channels,
                "stride": layer.stride,
                "sources": [image.name for image in layer.sources],
                "targets": [asdict(image) | {"scale": float(image.scale)} for image in layer.targets],
                "roundings": [(float(each.scale), each.zero, each.slope) for each in layer.roundings],
                "factors": [(float(above), float(below)) for above, below in layer.factors],
            }
        )
    about = json.dumps({"model": digest_of(path), "head": network.head, "layers": rows})
    made = layers_file(path)
    with replacing(made) as part, part.open("wb") as file:
        np.savez(file, **{ABOUT: np.array(about)}, **arrays)
    return made


def layers_of(path: Path) -> IntegerNetwork:
    """Return the layers of the network of integers in the ONNX file `path`. Raises NotInKernels where kernels cannot
    run it."""
    model = onnx.load(str(path))
    head = next((entry.value for entry in model.metadata_props if entry.key == HEAD), "")
    return IntegerNetwork(_Reader(model.graph).layers(), head)


def _require(holds: Any, problem: str) -> None:
    if not holds:
        raise NotInKernels(problem)


# ---- values of a graph ---------------------------------------------------------------------------------


@dataclass(eq=False)
class _Made:
    """Results of a `layer`, before they are rounded, the results that it reads, and the roundings of the images that
    others read of it."""

    layer: Layer
    sources: list[_Numbers] = field(default_factory=list)
    wanted: list[tuple[Rounding, ...]] = field(default_factory=list)


@dataclass
class _Numbers:
    """Results of a layer, rounded by `roundings`. They may have a leaky rectifier's `slope` since the last one."""

    made: _Made
    roundings: tuple[Rounding, ...] = ()
    slope: float = 1.0


@dataclass
class _Integers:
    """Integers of the file, and the step of each output channel."""

    values: np.ndarray
    unit: np.ndarray


class _Reader:
    """Reader of a graph's nodes, one after the other. A method for an operator returns the value of its output: an
    array, the classes above, or a list of joined images. The candidates are the array of their gains."""

    def __init__(self, graph: onnx.GraphProto):
        self._nodes, self._made = graph.node, []
        self._known: dict[str, Any] = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
        self._known |= {FRAMES: FRAMES, CANDIDATES: np.ones(CANDIDATE_PLANES, _F)}
        self._read = {
            "Constant": lambda about: numpy_helper.to_array(about["value"]),
            "Identity": lambda about, value: value,
            "Mul": lambda about, candidates, gain: candidates * np.broadcast_to(gain.ravel(), CANDIDATE_PLANES),
            "LeakyRelu": lambda about, value: replace(value, slope=float(about["alpha"])),
            "Concat": lambda about, *images: list(images),
            "QuantizeLinear": self._rounded,
            "DequantizeLinear": self._as_numbers,
            "Resize": self._doubled,
            "Conv": self._convolved,
        }

    def layers(self) -> list[Layer]:
        for node in self._nodes:
            _require(node.op_type in self._read, f"it has a node '{node.op_type}'")
            about = {attribute.name: onnx.helper.get_attribute_value(attribute) for attribute in node.attribute}
            inputs = [self._known[name] if name else None for name in node.input]
            self._known[node.output[0]] = self._read[node.op_type](about, *inputs)
        _require(isinstance(self._known.get(OUTPUT), _Numbers), "it ends otherwise")
        for number, made in enumerate(self._made):
            _settle(made, number)
        for made in self._made:
            made.layer.sources = [
                source.made.layer.targets[source.made.wanted.index(source.roundings)] for source in made.sources
            ]
        return [made.layer for made in self._made]

    def _add(self, layer: Layer, sources: list[_Numbers]) -> _Numbers:
        """Add a layer, note the images that it reads, and return its numbers."""
        channels = layer.channels
        _require(channels % BLOCK == 0, f"an image has {channels} channels (expected a multiple of {BLOCK})")
        for source in sources:
            _require(source.slope == 1.0, "a rectifier is elsewhere")
            if source.roundings not in source.made.wanted:
                source.made.wanted.append(source.roundings)
        self._made.append(_Made(layer, sources))
        return _Numbers(self._made[-1])

    def _rounded(self, about: dict[str, Any], value: Any, scale: np.ndarray, zero: np.ndarray) -> Any:
        if isinstance(value, list):
            return [self._rounded(about, part, scale, zero) for part in value]
        if isinstance(value, np.ndarray):
            value = self._add(Layer("taken", 1, CANDIDATE_PLANES, weights=value), [])
        rounding = Rounding(_F(scale.reshape(())), int(zero.reshape(())), value.slope)
        return _Numbers(value.made, (*value.roundings, rounding))

    def _as_numbers(self, about: dict[str, Any], value: Any, scale: np.ndarray, zero: np.ndarray) -> Any:
        if isinstance(value, np.ndarray):
            return _Integers(value, np.broadcast_to(scale, value.shape[:1]).astype(_F))
        return value

    def _doubled(self, about: dict[str, Any], image: _Numbers, _: Any, scales: np.ndarray) -> _Numbers:
        told = about["mode"], about["coordinate_transformation_mode"], scales.tolist()
        _require(told == (b"linear", b"half_pixel", [1, 1, 2, 2]), "an image is resized otherwise than doubled")
        layer = image.made.layer
        return self._add(Layer("doubled", layer.level - 1, layer.channels), [image])

    def _convolved(self, about: dict[str, Any], value: Any, weights: Any, bias: Any) -> _Numbers:
        size, stride = about["kernel_shape"][0], about.get("strides", [1])[0]
        plain = about.get("group", 1) == 1 and set(about.get("dilations", [1])) == {1}
        _require(
            plain and about.get("pads", [0]) in ([0], [size // 2] * 4), "a convolution has groups or another border"
        )
        if isinstance(weights, _Integers):
            return self._convolution(value if isinstance(value, list) else [value], weights, bias, size, stride)
        outputs = len(weights)
        if isinstance(value, str):
            fits = (size, stride) == (3, 2) and outputs % FIRST_CHANNELS == 0
            _require(fits, f"its first convolution is not 3×3 of frames, in floats, to n · {FIRST_CHANNELS} channels")
            return self._add(Layer("first", 1, outputs, weights=weights, bias=bias, stride=2), [])
        fits = isinstance(value, _Numbers) and size == 1 and outputs == JUDGEMENT_PLANES
        fits = fits and value.made.layer.channels >= FEWEST_LAST_CHANNELS
        _require(fits, f"its last convolution is not 1×1, in floats, of {FEWEST_LAST_CHANNELS} channels or more")
        return self._add(Layer("last", 1, JUDGEMENT_PLANES, weights=weights, bias=bias), [value])

    def _convolution(
        self, images: list[_Numbers], weights: _Integers, bias: _Integers, size: int, stride: int
    ) -> _Numbers:
        _require((size, stride) in ((1, 1), (3, 1), (3, 2)), "a convolution is not 1×1 or 3×3, or has another stride")
        _require(len(images) <= MOST_IMAGES, f"it joins more than {MOST_IMAGES} images")
        last, integers = images[0].roundings[-1], weights.values.astype(np.int64)
        unit = (last.scale * weights.unit).astype(_F)
        _require(np.allclose(bias.unit, unit, rtol=1e-5, atol=0), "a convolution's bias has other steps")
        level = images[0].made.layer.level + (stride == 2)
        _require(level <= MOST_LEVEL, f"it has images of level {level} (expected up to {MOST_LEVEL})")
        own = bias.values.astype(np.int64)
        added = own - last.zero * integers.sum((1, 2, 3))
        largest = int(np.max([255 * np.abs(integers).sum((1, 2, 3)) + np.abs(own), np.abs(added)]))
        _require(largest < EXACT, f"sums reach {largest} (expected less than 2^24)")
        layer = Layer("convolution", level, len(integers), weights=weights.values, stride=stride)
        layer.bias, layer.unit = added.astype(_F), unit
        return self._add(layer, images)


def _settle(made: _Made, number: int) -> None:
    """Fill in what a layer rounds to, once all that read it are known."""
    layer = made.layer
    if layer.kind == "last":
        return
    made.wanted.sort(key=len)
    _require(0 < len(made.wanted) <= MOST_IMAGES, "an image is read in no or in too many forms")
    short, whole = made.wanted[0], made.wanted[-1]
    fits = len(short) == 2 and len(whole) == 1 + len(made.wanted) and whole[:2] == short
    _require(fits, "an image is not rounded twice, or three times where it is joined")
    _require(whole[0].slope == 1.0 or layer.kind == "first", "a rectifier is elsewhere")
    layer.roundings = whole
    layer.factors = tuple(_factors(*pair) for pair in pairwise(whole))
    if layer.kind == "convolution":
        layer.unit = (layer.unit / whole[0].scale).astype(_F)
    layer.targets = [
        Image(f"image{number}{suffix}", layer.channels, layer.level, roundings[-1].zero, roundings[-1].scale)
        for suffix, roundings in zip(("", "_joined"), made.wanted, strict=False)
    ]


def _factors(before: Rounding, after: Rounding) -> tuple[np.float32, np.float32]:
    """Return the floats by which steps of one rounding, from 0 on and below, are multiplied to be those of the next
    before they are rounded. They give the integers of onnxruntime's table for all 256 bytes."""
    steps = _BYTES - before.zero
    numbers = (before.scale * steps.astype(_F)).astype(_F)
    found = []
    for side, slope in ((steps >= 0, 1.0), (steps < 0, after.slope)):
        expected = _clipped(((numbers[side] * _F(slope)).astype(_F) / after.scale).astype(_F), after)
        middle = _F(before.scale / after.scale * _F(slope))
        candidates = [middle]
        for direction in (np.inf, -np.inf):
            factor = middle
            for _ in range(_NEIGHBORS):
                factor = np.nextafter(factor, _F(direction))
                candidates.append(factor)
        fitting = (f for f in candidates if np.array_equal(_clipped(steps[side].astype(_F) * f, after), expected))
        factor = next(fitting, None)
        _require(factor is not None, "a change of scale is no factor")
        found.append(factor)
    return found[0], found[1]


def _clipped(numbers: np.ndarray, rounding: Rounding) -> np.ndarray:
    return np.clip(np.rint(numbers), *rounding.limits)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(write_layers(Path(name)))
