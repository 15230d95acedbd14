"""A network of 8-bit integers as a list of layers that kernels can run (kernels/convolutions.cl).

The network is read from its ONNX file, whatever its width and depth: a chain of convolutions of images of bytes, with
images that are doubled or joined in between. Where the file rounds, the layers round, to the same integers as
onnxruntime: a byte q stands for (q − zero) · scale. Leaky rectifiers and changes of scale work on single bytes, and are
factors that are checked for all bytes here. Sums of products of bytes stay below 2^24, so that floats hold them, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.engine.inference.model_interface import (
    CANDIDATE_PLANES,
    HEAD,
    INPUT_PLANES,
    INPUTS,
    JUDGEMENT_PLANES,
    OUTPUT,
)
from gffe_cl.engine.inference.onnx_file import Graph, Node, NotRead, read_graph

FRAMES, CANDIDATES = INPUTS
BLOCK = 4  # channels that lie side by side
FIRST_CHANNELS = 16  # that a work-item of the first convolution makes: a divisor of its channels
FEWEST_LAST_CHANNELS = 16  # that the last convolution reads
MOST_LEVEL = 4  # of the images: frames are a multiple of 2^4 pixels wide and high
MOST_IMAGES = 2  # that a convolution joins, and that a layer makes
EXACT = 1 << 24  # floats hold all whole numbers up to here
_F = np.float32
_BYTES = np.arange(256)
_NEIGHBORS = 64  # floats tried on either side of a factor


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
    sources: list[Any] = field(default_factory=list)
    targets: list[Image] = field(default_factory=list)
    roundings: tuple[Rounding, ...] = ()
    factors: tuple[tuple[np.float32, np.float32], ...] = ()
    weights: np.ndarray = field(default_factory=lambda: np.zeros(0, _F))
    bias: np.ndarray = field(default_factory=lambda: np.zeros(0, _F))
    unit: np.ndarray = field(default_factory=lambda: np.zeros(0, _F))
    stride: int = 1


@dataclass
class IntegerNetwork:
    """The layers of a network, in order, and its metadata `head` (see `model_interface`)."""

    layers: list[Layer]
    head: str

    @property
    def images(self) -> list[Image]:
        """All images of bytes, in the order in which they are made."""
        return [image for layer in self.layers for image in layer.targets]


def read_layers(path: Path) -> IntegerNetwork:
    """Return the layers of the network in an ONNX file. Raises NotInKernels where kernels cannot run it."""
    try:
        graph = read_graph(path)
        return IntegerNetwork(_Reader(graph).layers(), graph.metadata.get(HEAD, ""))
    except (NotRead, OSError) as error:
        raise NotInKernels(str(error)) from None
    except (IndexError, TypeError, AttributeError) as error:  # of constants and attributes in unusual forms
        raise NotInKernels(f"it has a node in an unusual form ({error})") from None


def _require(holds: Any, problem: str) -> None:
    if not holds:
        raise NotInKernels(problem)


# ---- values of a graph ---------------------------------------------------------------------------------


@dataclass(eq=False)
class _Made:
    """Results of a `layer`, before they are rounded, and the roundings of the images that others read of it."""

    layer: Layer
    wanted: list[tuple[Rounding, ...]] = field(default_factory=list)


@dataclass
class _Given:
    """An input of the graph, multiplied by `gain`."""

    name: str
    gain: np.ndarray | None = None


@dataclass
class _Numbers:
    """Results of a layer, rounded by `roundings`: as bytes or as the numbers that these stand for. Numbers may have a
    leaky rectifier's `slope` since the last rounding."""

    made: _Made
    roundings: tuple[Rounding, ...] = ()
    slope: float = 1.0
    are_bytes: bool = False


@dataclass
class _Integers:
    """Integers of the file, and the step of each output channel."""

    values: np.ndarray
    unit: np.ndarray


class _Reader:
    """Reader of a graph's nodes, one after the other. A method for an operator returns the value of its output."""

    def __init__(self, graph: Graph):
        self._graph = graph
        self._made: list[_Made] = []
        inputs = [name for name in graph.inputs if name not in graph.constants]
        _require(sorted(inputs) == sorted(INPUTS) and graph.outputs == [OUTPUT], "its inputs or outputs are others")
        # By name: arrays, and the classes above; joined images are lists.
        self._known: dict[str, Any] = dict(graph.constants) | {name: _Given(name) for name in INPUTS}
        self._read = {
            "Constant": self._constant,
            "Identity": lambda node: self._value(node, 0),
            "Mul": self._product,
            "LeakyRelu": self._rectified,
            "Concat": self._joined,
            "QuantizeLinear": self._as_bytes,
            "DequantizeLinear": self._as_numbers,
            "Resize": self._doubled,
            "Conv": self._convolved,
        }

    def layers(self) -> list[Layer]:
        for node in self._graph.nodes:
            _require(node.op in self._read and len(node.outputs) == 1, f"it has a node '{node.op}'")
            self._known[node.outputs[0]] = self._read[node.op](node)
        result = self._known.get(OUTPUT)
        _require(isinstance(result, _Numbers) and result.made.layer.kind == "last", "it ends otherwise")
        for number, made in enumerate(self._made):
            _settle(made, number)
        self._name_sources()
        return [made.layer for made in self._made]

    def _name_sources(self) -> None:
        """Put images in place of the roundings that layers read."""
        for made in self._made:
            made.layer.sources = [
                source.made.layer.targets[source.made.wanted.index(source.roundings)] for source in made.layer.sources
            ]

    def _value(self, node: Node, number: int) -> Any:
        _require(node.inputs[number : number + 1] != [] and node.inputs[number] in self._known, f"'{node.op}' lacks")
        return self._known[node.inputs[number]]

    def _array(self, node: Node, number: int) -> np.ndarray:
        value = self._value(node, number)
        _require(isinstance(value, np.ndarray), f"'{node.op}' has no constants")
        return value

    def _add(self, layer: Layer) -> _Numbers:
        made = _Made(layer)
        self._made.append(made)
        return _Numbers(made)

    def _constant(self, node: Node) -> np.ndarray:
        value = node.attributes.get("value")
        _require(isinstance(value, np.ndarray), "a constant is no tensor")
        return np.asarray(value)

    def _product(self, node: Node) -> _Given:
        value, gain = self._value(node, 0), self._array(node, 1)
        fits = isinstance(value, _Given) and value.gain is None and gain.shape in ((1, CANDIDATE_PLANES, 1, 1), ())
        _require(fits and gain.dtype == _F, "it multiplies otherwise than candidates by a factor for each channel")
        return _Given(value.name, np.broadcast_to(gain.ravel(), CANDIDATE_PLANES).copy())

    def _rectified(self, node: Node) -> _Numbers:
        value = self._value(node, 0)
        slope = float(node.attributes.get("alpha", 0.01))
        _require(isinstance(value, _Numbers) and not value.are_bytes and value.slope == 1.0, "a rectifier is elsewhere")
        _require(0 < slope <= 1, "a rectifier has another slope than between 0 and 1")
        return _Numbers(value.made, value.roundings, slope)

    def _joined(self, node: Node) -> list[_Numbers]:
        parts = [self._value(node, k) for k in range(len(node.inputs))]
        fits = node.attributes.get("axis") == 1 and len(parts) == MOST_IMAGES
        fits &= all(isinstance(part, _Numbers) and part.roundings and not part.are_bytes for part in parts)
        _require(fits, f"it joins otherwise than {MOST_IMAGES} rounded images")
        return parts

    def _as_bytes(self, node: Node) -> Any:
        value = self._value(node, 0)
        scale, zero = self._array(node, 1), self._array(node, 2)
        _require(scale.size == 1 and zero.dtype == np.uint8, "an image is not rounded to unsigned bytes of one scale")
        scale, zero = _F(scale.reshape(())), int(zero.reshape(()))
        _require(bool(np.isfinite(scale)) and scale > 0, "a scale is not positive")
        if isinstance(value, _Given):
            _require(value.name == CANDIDATES, "frames are rounded")
            gain = np.ones(CANDIDATE_PLANES, _F) if value.gain is None else value.gain
            value = self._add(Layer("taken", 1, CANDIDATE_PLANES, weights=gain))
        if isinstance(value, list):
            return [self._rounded(part, scale, zero) for part in value]
        return self._rounded(value, scale, zero)

    def _rounded(self, value: Any, scale: np.float32, zero: int) -> _Numbers:
        _require(isinstance(value, _Numbers) and not value.are_bytes, "something else than an image is rounded")
        return _Numbers(value.made, (*value.roundings, Rounding(scale, zero, value.slope)), are_bytes=True)

    def _as_numbers(self, node: Node) -> Any:
        value = self._value(node, 0)
        scale, zero = self._array(node, 1), self._array(node, 2)
        if isinstance(value, np.ndarray):
            fits = value.dtype in (np.int8, np.int32) and not zero.any() and scale.shape in ((), value.shape[:1])
            _require(fits and node.attributes.get("axis", 0) == 0, "weights are stored otherwise")
            return _Integers(value, np.broadcast_to(scale, value.shape[:1]).astype(_F))
        numbers = value if isinstance(value, list) else [value]
        for each in numbers:
            fits = isinstance(each, _Numbers) and each.are_bytes
            last = each.roundings[-1] if fits else None
            _require(last and (last.scale, last.zero) == (scale, zero), "an image is read in other steps than stored")
        numbers = [_Numbers(each.made, each.roundings) for each in numbers]
        return numbers if isinstance(value, list) else numbers[0]

    def _doubled(self, node: Node) -> _Numbers:
        told = node.attributes
        image = self._read_images(self._value(node, 0))
        fits = told.get("mode") == "linear" and told.get("coordinate_transformation_mode") == "half_pixel"
        fits &= not told.get("antialias") and not told.get("exclude_outside") and len(image) == 1
        _require(fits and self._array(node, 2).tolist() == [1, 1, 2, 2], "an image is resized otherwise than doubled")
        (source,) = image
        layer = source.made.layer
        _require(layer.level > 1, "an image is larger than a quarter of the display")
        return self._add(Layer("doubled", layer.level - 1, layer.channels, image))

    def _convolved(self, node: Node) -> _Numbers:
        value, weights = self._value(node, 0), self._value(node, 1)
        bias = self._value(node, 2) if len(node.inputs) > 2 else None
        told, shape = node.attributes, np.shape(weights.values if isinstance(weights, _Integers) else weights)
        _require(len(shape) == 4 and shape[2] == shape[3], "a convolution's weights are not square")
        size, stride = shape[2], told.get("strides", [1, 1])
        plain = told.get("group", 1) == 1 and told.get("dilations", [1, 1]) == [1, 1] and told.get("auto_pad") is None
        plain &= told.get("pads", [0] * 4) == [size // 2] * 4 and stride[0] == stride[1]
        _require(plain, "a convolution has groups, dilations, or another border")
        kind = size, stride[0]
        if isinstance(value, _Given):
            return self._first(value, weights, bias, kind)
        if isinstance(weights, _Integers):
            return self._convolution(value, weights, bias, kind)
        return self._last(value, weights, bias, kind)

    def _first(self, value: _Given, weights: Any, bias: Any, kind: tuple[int, int]) -> _Numbers:
        fits = value.name == FRAMES and value.gain is None and kind == (3, 2) and _are_floats(weights, bias)
        fits = fits and weights.shape[1] == INPUT_PLANES and len(weights) % FIRST_CHANNELS == 0
        _require(fits, f"its first convolution is not 3×3 of frames, in floats, to n · {FIRST_CHANNELS} channels")
        return self._add(Layer("first", 1, len(weights), weights=weights, bias=bias, stride=2))

    def _last(self, value: Any, weights: Any, bias: Any, kind: tuple[int, int]) -> _Numbers:
        images = self._read_images(value)
        fits = len(images) == 1 and kind == (1, 1) and _are_floats(weights, bias) and len(weights) == JUDGEMENT_PLANES
        fits = fits and images[0].made.layer.level == 1 and weights.shape[1] == images[0].made.layer.channels
        # onnxruntime sums fewer channels in another order.
        fits = fits and images[0].made.layer.channels >= FEWEST_LAST_CHANNELS
        _require(fits, f"its last convolution is not 1×1, in floats, of {FEWEST_LAST_CHANNELS} channels or more")
        return self._add(Layer("last", 1, JUDGEMENT_PLANES, images, weights=weights, bias=bias))

    def _convolution(self, value: Any, weights: _Integers, bias: Any, kind: tuple[int, int]) -> _Numbers:
        images, integers = self._read_images(value), weights.values
        _require(kind in ((1, 1), (3, 1), (3, 2)), "a convolution is not 1×1 or 3×3, or has another stride")
        _require(isinstance(bias, _Integers) and integers.dtype == np.int8, "a convolution is not in integers")
        last, levels = images[0].roundings[-1], {image.made.layer.level for image in images}
        inputs = sum(image.made.layer.channels for image in images)
        _require(len(levels) == 1 and integers.shape[1] == inputs, "a convolution joins images of several sizes")
        same = all((image.roundings[-1].scale, image.roundings[-1].zero) == (last.scale, last.zero) for image in images)
        unit = (last.scale * weights.unit).astype(_F)
        _require(same and np.allclose(bias.unit, unit, rtol=1e-5, atol=0), "a convolution's bias has other steps")
        level = levels.pop() + (kind[1] == 2)
        _require(level <= MOST_LEVEL, f"it has images of level {level} (expected up to {MOST_LEVEL})")
        whole = integers.astype(np.int64)
        added = bias.values.astype(np.int64) - last.zero * whole.sum((1, 2, 3))
        products, own = 255 * np.abs(whole).sum((1, 2, 3)), np.abs(bias.values.astype(np.int64))
        largest = int(np.max([products + own, np.abs(added)]))
        _require(largest < EXACT, f"sums reach {largest} (expected less than 2^24)")
        return self._add(
            Layer("convolution", level, len(integers), images, weights=integers, bias=added.astype(_F), unit=unit,
                  stride=kind[1])
        )  # fmt: skip

    def _read_images(self, value: Any) -> list[_Numbers]:
        """Note that a layer reads these images, and return them: one or several that are joined."""
        images = value if isinstance(value, list) else [value]
        for image in images:
            fits = isinstance(image, _Numbers) and image.roundings and not image.are_bytes and image.slope == 1.0
            _require(bool(fits), "a layer reads something else than rounded images")
            if image.roundings not in image.made.wanted:
                image.made.wanted.append(image.roundings)
        return images


def _are_floats(*arrays: Any) -> bool:
    return all(isinstance(a, np.ndarray) and a.dtype == _F and np.isfinite(a).all() for a in arrays)


def _settle(made: _Made, number: int) -> None:
    """Fill in what a layer rounds to, once all that read it are known."""
    layer = made.layer
    _require(layer.channels % BLOCK == 0, f"an image has {layer.channels} channels (expected a multiple of {BLOCK})")
    if layer.kind == "last":
        _require(not made.wanted, "its result is read again")
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
