"""Networks whose convolutions get channels of zeros, so that every provider computes them rightly."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper
from scn_models import save

from gffe_cl import GffeError
from gffe_cl.engine.inference.model_interface import shapes_at
from gffe_cl.engine.inference.network import load_network
from gffe_cl.lab.training.channels import pad_channels, pad_file

RNG = np.random.default_rng(3)


def convolved(image, weights, stride=1):
    """(C, H, W) by (O, C, 3, 3), zeros around it, in float64."""
    height, width = image.shape[1:]
    around = np.pad(image.astype(np.float64), ((0, 0), (1, 1), (1, 1)))
    parts = (
        np.einsum("oc,chw->ohw", weights[:, :, y, x], around[:, y : y + height, x : x + width])
        for y in range(3)
        for x in range(3)
    )
    return sum(parts)[:, ::stride, ::stride]


def model(path, channels=6, group=1):
    """Convolves the first `channels` planes twice with the same weights, and adds the two."""
    weights = RNG.normal(0, 0.2, (5 * group, channels // group, 3, 3)).astype(np.float32)
    constants = {"weights": weights, "which": np.arange(channels), "first": np.arange(20) % 5}
    constants["quarter"] = np.full(1, 0.25, np.float32)
    nodes = [
        helper.make_node("Gather", ["candidates", "which"], ["some"], axis=1),
        helper.make_node("Neg", ["some"], ["less"]),
        helper.make_node("Conv", ["some", "weights"], ["a"], pads=[1, 1, 1, 1], group=group),
        helper.make_node("Conv", ["less", "weights"], ["b"], pads=[1, 1, 1, 1], group=group),
        helper.make_node("Mul", ["b", "quarter"], ["c"]),
        helper.make_node("Add", ["a", "c"], ["all"]),
        helper.make_node("Gather", ["all", "first"], ["judgement"], axis=1),
    ]
    return Path(save(path, nodes, constants)), weights


def channels_of(path):
    made = onnx.load(path)
    dims = {tensor.name: tuple(tensor.dims) for tensor in made.graph.initializer}
    return [dims[node.input[1]][1] for node in made.graph.node if node.op_type == "Conv"]


@pytest.mark.parametrize("channels", [5, 6, 7])
def test_padded_convolutions_say_the_same(tmp_path, channels):
    path, weights = model(tmp_path / "m.onnx", channels)
    assert pad_file(path, tmp_path / "p.onnx") == 2 and channels_of(tmp_path / "p.onnx") == [8, 8]
    frames, candidates, judgement = (RNG.random(shape[1:], np.float32) for shape in shapes_at(16, 32).values())
    load_network(tmp_path / "p.onnx").run(frames, candidates, judgement)
    expected = 0.75 * convolved(candidates[:channels], weights)
    np.testing.assert_allclose(judgement[:5], expected, atol=1e-5)  # sums of 63 products of about 0.2, in float32
    assert channels_of(path) == [channels, channels]  # as it was


@pytest.mark.parametrize("channels, group", [(3, 1), (4, 1), (8, 1), (6, 2)])
def test_what_needs_nothing_stays(tmp_path, channels, group):
    """Few channels, multiples of four, groups; and what is padded already."""
    path, _ = model(tmp_path / "m.onnx", channels, group)
    before = path.read_bytes()
    assert pad_file(path, path) == 0 and onnx.load_from_string(before) == onnx.load(path)


def test_the_shipped_network_needs_no_more(default_model):
    made = onnx.load(default_model())
    assert pad_channels(made) == 0
    assert all(channels <= 4 or channels % 4 == 0 for channels in channels_of(default_model()))


def test_weights_that_are_something_else_too_stay(tmp_path):
    path, weights = model(tmp_path / "m.onnx")
    made = onnx.load(path)
    made.graph.node.append(helper.make_node("Neg", ["weights"], ["negative"]))
    assert pad_channels(made) == 0
    assert np.array_equal(numpy_helper.to_array(made.graph.initializer[0]), weights)


def test_as_a_program(tmp_path):
    """The faults: one line, exit code 2, nothing written."""

    def call(*arguments):
        start = [sys.executable, "-m", "gffe_cl.lab.training.channels", *map(str, arguments)]
        done = subprocess.run(start, capture_output=True, text=True)
        return done.returncode, done.stdout.strip(), done.stderr.strip()

    path, _ = model(tmp_path / "m.onnx")
    assert call(path, tmp_path / "p.onnx") == (0, "padded convolutions: 2", "")
    (tmp_path / "junk.onnx").write_bytes(b"junk")
    code, _, err = call(tmp_path / "junk.onnx", tmp_path / "q.onnx")
    assert code == 2 and "junk.onnx: not an ONNX network" in err and "Traceback" not in err
    assert not (tmp_path / "q.onnx").exists()
    with pytest.raises(GffeError, match=r"cannot write the model: No such file"):
        pad_file(path, tmp_path / "no" / "q.onnx")
    with pytest.raises(GffeError, match=r"none.onnx: not an ONNX network .No such file"):
        pad_file(tmp_path / "none.onnx", tmp_path / "q.onnx")
