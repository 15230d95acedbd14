"""Layers of networks of integers for kernels: what training writes beside an ONNX file, and what kernels cannot run."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from scn_models import constant_model, integer_model

from gffe_cl import GffeError
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.inference.layers import NotInKernels, layers_file, read_layers
from gffe_cl.engine.inference.network import OPENCL, PACKAGED, cpu_model, load_network, reason, take_remarks
from gffe_cl.lab.training.layers import layers_of, write_layers


def test_the_packages_layers_are_those_of_its_network():
    """`python -m gffe_cl.lab.training.layers gffe_cl/engine/inference/weights/scn-int8.onnx` writes them."""
    read, made = read_layers(cpu_model(PACKAGED)), layers_of(cpu_model(PACKAGED))
    assert len(read.layers) == 19 and read.head == made.head
    for layer, expected in zip(read.layers, made.layers, strict=True):
        np.testing.assert_equal(asdict(layer), asdict(expected))
        assert layer.weights.dtype == expected.weights.dtype


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda path: integer_model(path, (12, 8), layers=False), "of 16 channels or more"),
        (lambda path: integer_model(path, (16, 8, 8, 8, 8), layers=False), "level 5 .expected up to 4"),
        (lambda path: integer_model(path, (18, 16), layers=False), "18 channels .expected a multiple of 4"),
        (lambda path: integer_model(path, (128,), 48, largest=127, layers=False), r"sums reach \d+ .expected less"),
        (constant_model, "a node 'Gather'"),
    ],
)
def test_networks_without_layers_go_to_onnxruntime(tmp_path, make, why):
    """... with a note on a GPU, and an error for those who ask for kernels."""
    path = Path(make(tmp_path / "m.onnx"))
    with pytest.raises(NotInKernels, match=why):
        write_layers(path)
    with pytest.raises(GffeError, match=r"m.onnx: OpenCL kernels cannot run it: its layers, m.npz, are not beside it"):
        load_network(path, OPENCL)
    take_remarks()
    for provider in (None, "auto"):
        network = load_network(path, provider, on_gpu=True)
        assert network.layers is None
        (remark,) = take_remarks()
        assert "m.npz" in remark and "onnxruntime runs the network" in remark
    assert reason(network, None, on_gpu=True) == "kernels cannot run it"


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
    assert load_network(integer_model(tmp_path / "m.onnx"), OPENCL).layers


def test_layers_belong_to_their_network(tmp_path):
    """Another file of the same name, as of a training that went on, is not run by the layers of the one before."""
    path = Path(integer_model(tmp_path / "m.onnx"))
    assert load_network(path, OPENCL).layers
    integer_model(path, seed=1, layers=False)
    with pytest.raises(GffeError, match=r"the layers beside it, m.npz, are those of another file"):
        load_network(path, OPENCL)
    write_layers(path)
    assert load_network(path, OPENCL).layers


def test_files_that_are_broken(tmp_path):
    """Bytes that are cut off or changed, and arrays of other shapes: a reason, or the layers."""
    path = Path(integer_model(tmp_path / "m.onnx"))
    content, rng, refused = layers_file(path).read_bytes(), np.random.default_rng(0), 0
    for number in range(300):
        broken = bytearray(content)
        if number % 3 == 0:
            del broken[rng.integers(len(broken)) :]
        else:
            for at in rng.integers(len(broken), size=1 + number % 7):
                broken[at] = rng.integers(256)
        layers_file(path).write_bytes(broken)
        try:
            read_layers(path)
        except NotInKernels as error:
            refused += 1
            assert str(error) and "\n" not in str(error)
    assert refused > 200
    layers_file(path).write_bytes(content)
    with np.load(layers_file(path)) as file:
        arrays = dict(file)
    for name in ("2.weights", "2.bias", "2.unit", "0.weights", "0.bias"):
        np.savez(layers_file(path), **arrays | {name: np.repeat(arrays[name], 2, 0)[1:]})
        with pytest.raises(NotInKernels, match="cannot be read"):
            read_layers(path)
    np.savez(layers_file(path), **{name: array for name, array in arrays.items() if name != "0.bias"})
    with pytest.raises(NotInKernels, match="cannot be read"):
        read_layers(path)
