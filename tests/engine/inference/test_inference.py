"""Running the network: what onnxruntime writes, and what is said of a network that fails."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scn_models import constant_model

from gffe_cl.engine.inference.model_interface import shapes_at
from gffe_cl.engine.inference.network import load_network

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
