"""Running the network: who runs it, what onnxruntime writes, and what is said of a network that fails."""

import os
import subprocess
import sys

import numpy as np
import onnx
import pytest
import tiny_sequence
from parameters import few
from scn_models import constant_model, look_model

from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.inference.layers import shapes_at
from gffe_cl.engine.inference.network import NetworkError, load_network

LOADS = "from gffe_cl.engine.inference.network import load_network; load_network({!r}).session.get_inputs()"


def test_onnxruntime_writes_nothing_about_the_device(tmp_path):
    """A process with a home of its own, which loads a network: nothing lies in it afterwards but our own cache."""
    model = constant_model(tmp_path / "m.onnx")
    home = tmp_path / "home"
    home.mkdir()
    environment = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    environment |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "XDG_CONFIG_HOME": str(home / "config")}
    child = subprocess.run(
        [sys.executable, "-c", LOADS.format(model)], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert child.returncode == 0, child.stderr
    written = [path for path in home.rglob("*") if path.is_file()]
    assert all((home / "cache" / "gffe-cl") in path.parents for path in written), written


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_output_that_is_not_finite_is_counted(tmp_path, bad):
    frames, candidates, judgement = (np.zeros(shape[1:], np.float32) for shape in shapes_at(16, 32).values())
    model = load_network(constant_model(tmp_path / "m.onnx", judgement=[0, bad, bad]))
    assert model.run(frames, candidates, judgement) == 8 * 16
    sound = load_network(constant_model(tmp_path / "n.onnx", judgement=[3e38] * 20))
    assert sound.run(frames, candidates, judgement) == 0


def test_there_are_two_providers(tmp_path):
    with pytest.raises(NetworkError, match=r"provider 'cuda' is not available \(there is: auto, opencl, cpu\)"):
        load_network(look_model(tmp_path / "m.onnx"), "cuda")


def test_kernels_run_the_network_where_onnxruntime_is_not_installed(monkeypatch):
    monkeypatch.setattr(inference, "_loaded", {})
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    network = load_network(inference.cpu_model(inference.PACKAGED), None)
    assert network.layers and inference.reason(network, None, on_gpu=False) == "onnxruntime is not installed"
    inference.load_onnxruntime.cache_clear()
    with pytest.raises(NetworkError, match="onnxruntime is not installed"):
        load_network(inference.PACKAGED)


def test_hostile_models_are_one_line(tmp_path):
    """... at once: what would run for ever, or read another file, is not loaded."""
    loop, elsewhere = (onnx.load(constant_model(tmp_path / "m.onnx")) for _ in range(2))
    loop.graph.node[0].op_type = "Loop"
    elsewhere.graph.initializer[0].external_data.add(key="location", value="/etc/passwd")
    numbers, large = b"\x3a" + b"\xff" * 400_000, bytes(1 + (64 << 20))
    for model, said in (
        (loop.SerializeToString(), "operator Loop .expected Add, Cast"),
        (elsewhere.SerializeToString(), "data in another file"),
        (numbers, "no number"),
        (large, "67108865 bytes, expected at most 67108864"),
    ):
        (tmp_path / "m.onnx").write_bytes(model)
        with pytest.raises(NetworkError, match=f"m.onnx: cannot be loaded .*: {said}") as refused:
            load_network(tmp_path / "m.onnx")
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("command", few(["run", "eval", "view"], "view"))
def test_every_command_says_once_that_kernels_cannot(device, gffe, tmp_path, monkeypatch, command):
    """... the viewer in its window, too."""
    inference.load_onnxruntime()
    monkeypatch.setattr(inference, "has_onnxruntime", lambda: False)
    scn, said = ("--scn-provider", "auto", "--scn-model", look_model(tmp_path / "m.onnx")), []
    if command == "run":
        tiny_sequence.write(tmp_path / "in", frames=2)
        arguments = ("run", tmp_path / "in", tmp_path / "out", "--no-check")
    elif command == "eval":
        options = ("--methods", "gffe", "--frames", "4", "--size", "64x36", "--out", tmp_path / "report")
        arguments = ("eval", "corridor", *options)
    else:
        pytest.importorskip("imgui_bundle")
        monkeypatch.setattr("gffe_cl.viewer.window.running.require_display", lambda: None)
        monkeypatch.setattr("gffe_cl.viewer.window.running.run", lambda app, *_: said.extend(app.model.messages))
        arguments = ("view", "--cache", "0")
    code, _, err = gffe(*arguments, "--device", device.info.index, *scn)
    remark = "m.onnx: onnxruntime runs the network, as OpenCL kernels cannot"
    assert code == 0 and err.count(f"warning: {remark}") == 1, err
    assert [each.text.startswith(remark) for each in said] == [True] * (command == "view")
