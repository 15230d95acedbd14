"""Small ONNX models with the interface of the shading correction network."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

FLOAT = TensorProto.FLOAT
FRAMES, ALPHA = (1, 8, "h", "w"), (1,)


def constant_model(path, delta=0.0, keep=1.0, mask=1.0):
    """Says the same for every pixel; `delta` may be three numbers, `mask` too depends on α where it is "alpha"."""
    by_alpha = mask == "alpha"
    planes = np.array([*np.broadcast_to(delta, 3), keep, 0 if by_alpha else mask], np.float32).reshape(1, 5, 1, 1)
    nodes = [
        helper.make_node("Slice", ["frames", "zero", "one", "channel"], ["plane"]),
        helper.make_node("Sub", ["plane", "plane"], ["nothing"]),
        helper.make_node("Mul", ["alpha", "choice"], ["by_alpha"]),
        helper.make_node("Add", ["planes", "by_alpha"], ["all"]),
        helper.make_node("Add", ["nothing", "all"], ["correction"]),
    ]
    choice = np.array([0, 0, 0, 0, by_alpha], np.float32).reshape(1, 5, 1, 1)
    constants = {
        "planes": planes,
        "choice": choice,
        "zero": np.array([0]),
        "one": np.array([1]),
        "channel": np.array([1]),
    }
    return save(path, nodes, constants)


def look_model(path, channels=(0, 1, 2, 3, 4)):
    """Gives planes of its input back."""
    return save(
        path, [helper.make_node("Gather", ["frames", "which"], ["correction"], axis=1)], {"which": np.array(channels)}
    )


def trend_model(path, which=0):
    """Says what a plane of its trends is, in the first of its own; the focus mask is 1."""
    nodes = [
        helper.make_node("Gather", ["trends", "which"], ["plane"], axis=1),
        helper.make_node("Sub", ["plane", "plane"], ["nothing"]),
        helper.make_node("Add", ["nothing", "alpha"], ["something"]),
        helper.make_node("Mul", ["something", "zero"], ["none"]),
        helper.make_node("Slice", ["frames", "first", "second", "channel"], ["unused"]),
        helper.make_node("Sub", ["unused", "unused"], ["empty"]),
        helper.make_node("Add", ["none", "one"], ["full"]),
        helper.make_node("Concat", ["plane", "empty", "empty", "full", "full"], ["correction"], axis=1),
    ]
    constants = {
        "which": np.array([which]),
        "zero": np.zeros(1, np.float32),
        "one": np.ones(1, np.float32),
        "first": np.array([0]),
        "second": np.array([1]),
        "channel": np.array([1]),
    }
    inputs = (("frames", FLOAT, FRAMES), ("alpha", FLOAT, ALPHA), ("trends", FLOAT, (1, 7, "h", "w")))
    return save(path, nodes, constants, inputs)


def movers_model(path, delta=0.1):
    """Brightens what moves: its focus mask is 1 where the input mask is nearly 1, else 0."""
    nodes = [
        helper.make_node("Gather", ["frames", "last"], ["mask"], axis=1),
        helper.make_node("Greater", ["mask", "limit"], ["moving"]),
        helper.make_node("Cast", ["moving"], ["focus"], to=FLOAT),
        helper.make_node("Mul", ["focus", "choice"], ["chosen"]),
        helper.make_node("Add", ["chosen", "constant"], ["correction"]),
    ]
    constants = {
        "last": np.array([7]),
        "limit": np.array([0.9], np.float32),
        "choice": np.array([0, 0, 0, 0, 1], np.float32).reshape(1, 5, 1, 1),
        "constant": np.array([delta, delta, delta, 1, 0], np.float32).reshape(1, 5, 1, 1),
    }
    return save(path, nodes, constants)


def save(
    path,
    nodes,
    constants,
    inputs=(("frames", FLOAT, FRAMES), ("alpha", FLOAT, ALPHA)),
    outputs=(("correction", FLOAT, (1, 5, "h", "w")),),
):
    graph = helper.make_graph(
        nodes, "test",
        [helper.make_tensor_value_info(*value) for value in inputs],
        [helper.make_tensor_value_info(*value) for value in outputs],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 16)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return str(path)
