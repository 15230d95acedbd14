"""Padding of convolutions to input channels that are a multiple of four, for providers that compute others wrongly.

onnxruntime's WebGPU provider (plug-in 0.4.0) gives wrong results for a convolution of more than 4 input channels where
they are no multiple of 4. Such a convolution gets channels of zeros, and weights of zeros for them: the result stays
the same but for the order of sums. `python -m gffe_cl.lab.training.channels IN.onnx OUT.onnx` pads an older network;
`gffe train` pads all networks that it writes.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import onnx
from onnx import helper, numpy_helper

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import replacing

_LANES = 4
_CHANNELS = 1  # the axis, of images and of weights


def pad_channels(model: onnx.ModelProto) -> int:
    """Pad the channels of `model`, in place, as its convolutions require. Return the number of padded convolutions."""
    graph = model.graph
    narrow = {tensor.name: tensor for tensor in graph.initializer if _is_narrow(graph, tensor)}
    more = {name: -tensor.dims[_CHANNELS] % _LANES for name, tensor in narrow.items()}
    nodes = []
    for node in graph.node:
        if node.op_type == "Conv" and node.input[1] in narrow:
            nodes.append(_wider_input(graph, node, more[node.input[1]]))
        nodes.append(node)
    padded = len(nodes) - len(graph.node)
    for name, tensor in narrow.items():
        widths = [(0, more[name] if axis == _CHANNELS else 0) for axis in range(len(tensor.dims))]
        tensor.CopyFrom(numpy_helper.from_array(np.pad(numpy_helper.to_array(tensor), widths), name))
    nodes = [onnx.NodeProto.FromString(node.SerializeToString()) for node in nodes]
    del graph.node[:]
    graph.node.extend(nodes)
    return padded


def pad_file(source: Path, target: Path, metadata: Mapping[str, str] = MappingProxyType({})) -> int:
    """Write the network of the ONNX file `source` to `target`, padded, with `metadata`, and return the number of padded
    convolutions. Raises GffeError."""
    try:
        model = onnx.load(str(source))
        padded = pad_channels(model)
        for key, value in metadata.items():
            model.metadata_props.add(key=key, value=value)
        onnx.checker.check_model(model)
    except Exception as error:  # of protobuf, onnx or the system
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise GffeError(f"{source}: not an ONNX network ({reason})") from None
    try:
        with replacing(Path(target)) as part:
            onnx.save(model, str(part))
    except OSError as error:
        raise GffeError(f"{target}: cannot write the model: {error.strerror or error}") from None
    return padded


def _is_narrow(graph: onnx.GraphProto, tensor: onnx.TensorProto) -> bool:
    """Return whether `tensor` holds the weights of convolutions, and of nothing else, that need more input channels."""
    users = [node for node in graph.node if tensor.name in node.input]
    channels = tensor.dims[_CHANNELS] if len(tensor.dims) > _CHANNELS else 0
    return bool(users and channels > _LANES and channels % _LANES) and all(
        node.op_type == "Conv" and list(node.input).index(tensor.name) == 1 and _groups(node) == 1 for node in users
    )


def _wider_input(graph: onnx.GraphProto, node: onnx.NodeProto, more: int) -> onnx.NodeProto:
    """Give a convolution `more` channels of zeros, and return the node that adds them to its input."""
    axes = len(next(tensor for tensor in graph.initializer if tensor.name == node.input[1]).dims)
    pads = np.zeros((2, axes), np.int64)
    pads[1, _CHANNELS] = more
    wider = f"{node.output[0]}.input"
    graph.initializer.append(numpy_helper.from_array(pads.ravel(), f"{wider}.pads"))
    made = helper.make_node("Pad", [node.input[0], f"{wider}.pads"], [wider], name=wider)
    node.input[0] = wider
    return made


def _groups(node: onnx.NodeProto) -> int:
    return next((attribute.i for attribute in node.attribute if attribute.name == "group"), 1)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m gffe_cl.lab.training.channels IN.onnx OUT.onnx")
    try:
        print(f"padded convolutions: {pad_file(Path(sys.argv[1]), Path(sys.argv[2]))}")
    except GffeError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
