"""Small ONNX models with the interface of the shading correction network."""

import itertools
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from gffe_cl.engine.inference.layers import HEAD, HEAD_LAYERS, JUDGEMENT_PLANES, OUTPUT, head_text
from gffe_cl.lab.training.layers import write_layers

FLOAT = TensorProto.FLOAT
FRAMES, CANDIDATES = (1, 8, "height", "width"), (1, 16, "h", "w")
INPUTS = (("frames", FLOAT, FRAMES), ("candidates", FLOAT, CANDIDATES))
OUTPUTS = ((OUTPUT, FLOAT, (1, JUDGEMENT_PLANES, "h", "w")),)
ALPHA_PLANE = 15  # of the candidates
IN_PLACE, NOT_AT_ALL, FOR_GOOD = (0.0, 0.0, -80.0), -1.0, 1.0  # flow that is followed, how long trends last


def head(delta=0.0, keep=1.0, mask=1.0, trend=0.0, of_detail=0.0):
    """Return weights with the same output for every pixel, but for `of_detail` × the first channel of detail in the
    mask."""
    (hidden, seen), (said, _) = HEAD_LAYERS
    first, second = np.zeros((hidden, seen)), np.zeros((said, hidden))
    first[0, 0], second[4, 0] = 1, of_detail / 2
    last = [*np.broadcast_to(delta, 3), 80 if keep else -80, (mask + 0.1) / 2, trend]
    return np.concatenate([first.ravel(), np.zeros(hidden), second.ravel(), last]).astype(np.float32)


def constant_model(path, delta=0.0, keep=1.0, mask=1.0, judgement=(), trend=0.0):
    """Return a model with the same output for every pixel; `delta` may be three numbers, `mask` depends on α where it
    is "alpha"; `judgement`: its first numbers, else no flow is followed and no trend lasts."""
    by_alpha = mask == "alpha"
    planes = np.zeros(JUDGEMENT_PLANES, np.float32)
    planes[:4] = *IN_PLACE, NOT_AT_ALL
    planes[: len(judgement)] = judgement
    choice = np.zeros(JUDGEMENT_PLANES, np.float32)
    choice[4:8] = by_alpha
    nodes = [
        helper.make_node("Gather", ["candidates", "which"], ["alpha"], axis=1),
        helper.make_node("Mul", ["alpha", "choice"], ["chosen"]),
        helper.make_node("Add", ["chosen", "planes"], [OUTPUT]),
    ]
    constants = {
        "which": np.array([ALPHA_PLANE]),
        "choice": choice.reshape(1, -1, 1, 1),
        "planes": planes.reshape(1, -1, 1, 1),
    }
    return save(path, nodes, constants, weights=head(delta, keep, 0 if by_alpha else mask, trend, float(by_alpha)))


def look_model(path):
    """Return a model that gives its candidates back, the first of them twice."""
    nodes = [
        helper.make_node("Gather", ["candidates", "which"], ["again"], axis=1),
        helper.make_node("Concat", ["candidates", "again"], [OUTPUT], axis=1),
    ]
    return save(path, nodes, {"which": np.arange(JUDGEMENT_PLANES - 16)})


def movers_model(path, delta=0.1):
    """Return a model that brightens movers: its focus mask is 1 where the input mask is nearly 1, else 0."""
    nodes = [
        helper.make_node("Gather", ["frames", "last"], ["mask"], axis=1),
        helper.make_node("Greater", ["mask", "limit"], ["moving"]),
        helper.make_node("Cast", ["moving"], ["focus"], to=FLOAT),
        helper.make_node("SpaceToDepth", ["focus"], ["detail"], blocksize=2),
        helper.make_node("Mul", ["detail", "none"], ["nothing"]),
        helper.make_node("Add", ["nothing", "still"], ["judged"]),
        helper.make_node("Concat", ["judged", "detail", "nothing", "nothing", "nothing"], [OUTPUT], axis=1),
    ]
    constants = {
        "last": np.array([7]),
        "limit": np.array([0.9], np.float32),
        "none": np.zeros(1, np.float32),
        "still": np.array([*IN_PLACE, NOT_AT_ALL], np.float32).reshape(1, 4, 1, 1),
    }
    return save(path, nodes, constants, weights=head(delta, mask=0.0, of_detail=1.0))


def pooling_model(path):
    """Return a model that gives a quarter of the pixels that it should."""
    nodes = [
        helper.make_node("Gather", ["candidates", "which"], ["some"], axis=1),
        helper.make_node("MaxPool", ["some"], [OUTPUT], kernel_shape=[2, 2], strides=[2, 2]),
    ]
    outputs = ((OUTPUT, FLOAT, (1, JUDGEMENT_PLANES, "a", "b")),)
    return save(path, nodes, {"which": np.arange(JUDGEMENT_PLANES) % 16}, outputs=outputs)


def save(path, nodes, constants, inputs=INPUTS, outputs=OUTPUTS, weights=None):
    graph = helper.make_graph(
        nodes,
        "test",
        [helper.make_tensor_value_info(*value) for value in inputs],
        [helper.make_tensor_value_info(*value) for value in outputs],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 16)], ir_version=8)
    onnx.checker.check_model(model)
    helper.set_model_props(model, {HEAD: head_text(head() if weights is None else weights)})
    onnx.save(model, path)
    return str(path)


class _Integers:
    """Graph of a network in integers under construction, with random weights; see `integer_model`."""

    def __init__(self, rng, zeros, largest):
        self.rng, self.zeros, self.largest = rng, zeros, largest
        self.nodes, self.constants, self.scales = [], {}, {}

    def add(self, op, inputs, **about):
        """Add a node and return the name of its output."""
        name = f"{op}{len(self.nodes)}"
        self.nodes.append(helper.make_node(op, inputs, [name], **about))
        return name

    def constant(self, name, values, dtype=np.float32):
        self.constants[name] = np.array(values, dtype)
        return name

    def rounded(self, numbers, scale):
        name, zero = f"{numbers}.scale", f"{numbers}.zero"
        parts = self.constant(name, scale), self.constant(zero, next(self.zeros), np.uint8)
        made = self.add("DequantizeLinear", [self.add("QuantizeLinear", [numbers, *parts]), *parts])
        self.scales[made] = float(scale)
        return made

    def convolved(self, image, inputs, outputs, size=3, stride=1):
        """Return a convolution in integers, rounded, with a leaky rectifier, rounded again."""
        rng, most = self.rng, self.largest
        weights = rng.integers(-most, most + 1, (outputs, inputs, size, size), np.int8)
        weights[0, :, 0, 0] = most
        if outputs > 1:
            weights[-1] = most  # all of one sign: the largest sum
        unit = rng.uniform(0.5, 2, outputs) / most
        biases = rng.integers(-3000, 3000, outputs)
        given = []
        for kind, values, dtype, step in (
            ("weights", weights, np.int8, unit),
            ("bias", biases, np.int32, np.float32(self.scales[image]) * unit.astype(np.float32)),
        ):
            name = f"{image}.{kind}.{outputs}.{size}"
            parts = [
                self.constant(name, values, dtype),
                self.constant(f"{name}.unit", step),
                self.constant(f"{name}.no_zero", np.zeros(outputs), dtype),
            ]
            given.append(self.add("DequantizeLinear", parts, axis=0))
        pads = [size // 2] * 4
        made = self.add("Conv", [image, *given], kernel_shape=[size] * 2, pads=pads, strides=[stride] * 2)
        spread = self.scales[image] * np.sqrt(inputs) * size
        rectified = self.add("LeakyRelu", [self.rounded(made, spread)], alpha=0.1)
        return self.rounded(rectified, spread * rng.uniform(0.6, 1.0))

    def joined(self, *images):
        made = self.add("Concat", images, axis=1)
        return self.rounded(made, max(self.scales[image] for image in images) * self.rng.uniform(0.8, 1.2))


def integer_model(path, channels=(16, 24), seen=16, seed=0, zeros=(), largest=63, layers=True):
    """Return a network of integers as `gffe train` makes them, with random weights up to `largest`: `channels` of its
    levels, finest first, `seen` of the first convolution; `zeros`: zero points, in turn, or random ones; `layers`:
    whether its layers for kernels are written, too."""
    rng = np.random.default_rng(seed)
    made = _Integers(rng, itertools.cycle(zeros) if zeros else iter(lambda: rng.integers(64, 192), -1), largest)
    first = rng.normal(0, 0.3, (seen, 8, 3, 3)), rng.normal(0, 0.3, seen)
    given = [made.constant(f"first.{k}", values) for k, values in enumerate(first)]
    frames = made.add("Conv", ["frames", *given], kernel_shape=[3, 3], pads=[1] * 4, strides=[2, 2])
    gain = made.constant("gain", rng.uniform(0.5, 2, (1, 16, 1, 1)))
    parts = (
        made.rounded(made.add("LeakyRelu", [frames], alpha=0.1), 0.02),
        made.rounded(made.add("Mul", ["candidates", gain]), 0.02),
    )
    features = [made.convolved(made.joined(*parts), seen + 16, channels[0])]
    for fine, coarse in itertools.pairwise(channels):
        features.append(made.convolved(made.convolved(features[-1], fine, coarse, stride=2), coarse, coarse))
    result = features.pop()
    twice = made.constant("twice", [1, 1, 2, 2])
    for fine, coarse in reversed(list(itertools.pairwise(channels))):
        narrow = made.convolved(result, coarse, fine, size=1)
        about = {"mode": "linear", "coordinate_transformation_mode": "half_pixel"}
        large = made.rounded(made.add("Resize", [narrow, "", twice], **about), made.scales[narrow] * 0.9)
        result = made.convolved(made.joined(large, features.pop()), 2 * fine, fine)
    last = rng.normal(0, 0.2, (JUDGEMENT_PLANES, channels[0], 1, 1)), rng.normal(0, 0.2, JUDGEMENT_PLANES)
    given = [made.constant(f"last.{k}", values) for k, values in enumerate(last)]
    made.nodes.append(helper.make_node("Conv", [result, *given], [OUTPUT], kernel_shape=[1, 1]))
    save(path, made.nodes, made.constants)
    if layers:
        write_layers(Path(path))
    return str(path)
