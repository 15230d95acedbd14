"""Networks of integers as layers for kernels: what is read of an ONNX file, and what kernels cannot run."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper
from scn_models import constant_model, integer_model, look_model

from gffe_cl import GffeError
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.inference.integer_layers import NotInKernels, read_layers
from gffe_cl.engine.inference.network import OPENCL, load_network, reason, take_remarks
from gffe_cl.engine.inference.onnx_file import NotRead, read_graph
from gffe_cl.engine.inference.sessions import PACKAGED, cpu_model


@pytest.mark.parametrize("path", [PACKAGED, cpu_model(PACKAGED)], ids=["floats", "integers"])
def test_files_are_read_as_the_package_onnx_reads_them(path):
    read, graph = read_graph(path), onnx.load(path).graph
    assert [(n.op, n.inputs, n.outputs) for n in read.nodes] == [
        (n.op_type, list(n.input), list(n.output)) for n in graph.node
    ]
    for node, other in zip(read.nodes, graph.node, strict=True):
        assert set(node.attributes) == {attribute.name for attribute in other.attribute}
        for attribute in other.attribute:
            value = onnx.helper.get_attribute_value(attribute)
            value = numpy_helper.to_array(value) if isinstance(value, onnx.TensorProto) else value
            value = value.decode() if isinstance(value, bytes) else value
            assert np.array_equal(node.attributes[attribute.name], value)
    assert list(read.constants) == [tensor.name for tensor in graph.initializer]
    for tensor in graph.initializer:
        expected = numpy_helper.to_array(tensor)
        assert read.constants[tensor.name].dtype == expected.dtype
        assert np.array_equal(read.constants[tensor.name], expected)
    assert (read.inputs, read.outputs) == (["frames", "candidates"], ["judgement"])
    assert read.metadata == {entry.key: entry.value for entry in onnx.load(path).metadata_props}


def test_the_packages_network_is_read():
    layers = read_layers(cpu_model(PACKAGED)).layers
    kinds = [layer.kind for layer in layers]
    assert len(kinds) == 19 and kinds.count("convolution") == 13 and kinds.count("doubled") == 3
    assert [layer.level for layer in layers if layer.stride == 2] == [1, 2, 3, 4]
    assert [len(layer.sources) for layer in layers].count(2) == 4


def changed(path, change):
    """The ONNX file after `change` of its model."""
    model = onnx.load(path)
    change(model.graph)
    onnx.save(model, path)
    return Path(path)


def node_of(graph, op, number=0):
    return [node for node in graph.node if node.op_type == op][number]


def set_numbers(name, change):
    def apply(graph):
        for tensor in graph.initializer:
            if name in tensor.name:
                values = change(numpy_helper.to_array(tensor))
                tensor.CopyFrom(numpy_helper.from_array(np.asarray(values), tensor.name))

    return apply


def set_attribute(op, number, name, value):
    def apply(graph):
        node = node_of(graph, op, number)
        kept = [attribute for attribute in node.attribute if attribute.name != name]
        del node.attribute[:]
        node.attribute.extend([*kept, onnx.helper.make_attribute(name, value)])

    return apply


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (set_attribute("Conv", 1, "dilations", [2, 2]), "groups, dilations, or another border"),
        (set_attribute("Conv", 1, "pads", [0] * 4), "groups, dilations, or another border"),
        (set_attribute("Conv", 1, "strides", [1, 2]), "groups, dilations, or another border"),
        (set_attribute("Conv", 0, "strides", [1, 1]), "first convolution"),
        (set_attribute("LeakyRelu", 1, "alpha", 1.5), "another slope"),
        (set_attribute("Concat", 0, "axis", 2), "joins otherwise"),
        (set_attribute("Resize", 0, "mode", "nearest"), "resized otherwise"),
        (set_attribute("Resize", 0, "coordinate_transformation_mode", "asymmetric"), "resized otherwise"),
        (set_numbers("twice", lambda _: np.float32([1, 1, 3, 3])), "resized otherwise"),
        (set_numbers("first.0", lambda w: w * np.float32(np.nan)), "first convolution"),
        (set_numbers(".bias.16.3.unit", lambda u: u * np.float32(3)), "bias has other steps"),
        (set_numbers(".scale", lambda s: s * np.float32(-1)), "not positive"),
        (set_numbers(".no_zero", lambda z: z + z.dtype.type(1)), "weights are stored otherwise"),
        (lambda graph: node_of(graph, "LeakyRelu").__setattr__("op_type", "Relu"), "a node 'Relu'"),
        (lambda graph: graph.output[0].__setattr__("name", "other"), "inputs or outputs"),
        (lambda graph: node_of(graph, "Conv", 2).input.pop(), "not in integers"),
        (lambda graph: graph.node.pop(), "ends otherwise"),
    ],
)
def test_what_kernels_cannot_run_is_said(tmp_path, change, why):
    path = changed(integer_model(tmp_path / "m.onnx"), change)
    with pytest.raises(NotInKernels, match=why):
        read_layers(path)


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda path: integer_model(path, (12, 8)), "of 16 channels or more"),
        (lambda path: integer_model(path, (16, 8, 8, 8, 8)), "level 5 .expected up to 4"),
        (lambda path: integer_model(path, (18, 16)), "18 channels .expected a multiple of 4"),
        (lambda path: integer_model(path, (128,), 48, largest=127), r"sums reach \d+ .expected less than 2.24"),
        (constant_model, "a node 'Gather'"),
        (look_model, "a node 'Gather'"),
    ],
)
def test_networks_that_go_to_onnxruntime(tmp_path, make, why):
    """... with a note on a GPU, and an error for those who ask for kernels."""
    path = make(tmp_path / "m.onnx")
    with pytest.raises(GffeError, match=rf"m.onnx: OpenCL kernels cannot run it: .*{why}") as caught:
        load_network(path, OPENCL)
    assert "\n" not in str(caught.value)
    take_remarks()
    for provider in (None, "auto"):
        network = load_network(path, provider, on_gpu=True)
        assert network.layers is None
        (remark,) = take_remarks()
        assert why.split(" .")[0].split("\\")[0] in remark and "onnxruntime runs the network" in remark
    assert reason(network, None, on_gpu=True) == "kernels cannot run it"


def test_floats_go_to_onnxruntime():
    with pytest.raises(NotInKernels, match="joins otherwise than 2 rounded images"):
        read_layers(PACKAGED)


def test_who_runs_a_network(tmp_path):
    path = integer_model(tmp_path / "m.onnx")
    by_kernels_where = [(None, True), ("auto", True), (OPENCL, True), (OPENCL, False)]
    for provider, on_gpu in [*by_kernels_where, (None, False), ("auto", False), ("cpu", True)]:
        by_kernels = (provider, on_gpu) in by_kernels_where
        network = load_network(path, provider, on_gpu)
        assert (network.layers is not None, network.provider == OPENCL) == (by_kernels, by_kernels)
        assert not network.remark and reason(network, provider, on_gpu)
    assert load_network(path, None, True) is load_network(path, None, True)
    assert take_remarks() == []


def test_kernels_need_no_onnxruntime(tmp_path, monkeypatch):
    def fails():
        raise AssertionError("onnxruntime was loaded")

    monkeypatch.setattr(inference, "load_onnxruntime", fails)
    monkeypatch.setattr("gffe_cl.engine.inference.sessions.load_onnxruntime", fails)
    assert load_network(integer_model(tmp_path / "m.onnx"), OPENCL).layers


def test_files_that_are_broken(tmp_path):
    """Bytes that are cut off or changed: never anything but a reason."""
    content, rng = Path(integer_model(tmp_path / "m.onnx")).read_bytes(), np.random.default_rng(0)
    path, refused = tmp_path / "broken.onnx", 0
    for number in range(300):
        broken = bytearray(content)
        if number % 3 == 0:
            del broken[rng.integers(len(broken)) :]
        else:
            for at in rng.integers(len(broken), size=1 + number % 7):
                broken[at] = rng.integers(256)
        path.write_bytes(broken)
        try:
            read_layers(path)
        except NotInKernels as error:
            refused += 1
            assert str(error) and "\n" not in str(error)
    assert refused > 50
    for content in (b"", b"no model at all", b"\xff" * 40):
        path.write_bytes(content)
        with pytest.raises((NotRead, NotInKernels)):
            read_layers(path)
