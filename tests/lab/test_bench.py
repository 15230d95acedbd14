"""What frames cost: footage and times."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scn_models import constant_model

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.timing import bench as bench_module
from gffe_cl.engine.timing import footage as timed_footage
from gffe_cl.lab import bench as inputs

ROOT = Path(__file__).parents[2]
DEFAULT = ("--device", open_device().info.index)  # where no device is named, all are timed


def test_bench(gffe, tmp_path):
    model = constant_model(tmp_path / "m.onnx")
    words = ("--sizes", "64x48,33x20", "--repeats", 1, "--scn-model", model, "--json", tmp_path / "b.json")
    code, text, _ = gffe("bench", *words, *DEFAULT)
    assert code == 0 and "bytes per pixel" in text and "preset performance, ms" in text and "SCN, network" in text
    for one in json.loads((tmp_path / "b.json").read_text())["devices"]:
        for size in one["sizes"]:
            parts = size["milliseconds"]
            assert set(size["presets"]) == {"quality", "balanced", "performance"} and min(size["presets"].values()) > 0
            assert {"history", "warp", "background, collection", "holes", "misc", "GAE"} <= set(parts)
            assert size["bandwidth"] > 0 and size["memory"] > 0
            others = sum(ms for name, ms in parts.items() if name not in ("GAE", "misc") and name[:3] != "SCN")
            assert parts["GAE"] == pytest.approx(others)
            per_pixel = size["bytes_per_pixel"]["warp"] * size["width"] * size["height"]
            assert per_pixel == pytest.approx(parts["warp"] * 1e6 * size["bandwidth"])
        parts = one["sizes"][0]["milliseconds"]
        scn = [parts[f"SCN, {name}"] for name in ("trend", "inputs", "flow", "kernels", "network", "copies")]
        assert min(scn[:5]) > 0 and scn[5] >= 0 and parts["SCN"] == pytest.approx(sum(scn))


@pytest.mark.long
def test_bench_of_upscaling(gffe, tmp_path):
    """A row of its own, beside GAE of the smaller frames."""
    options = ("--sizes", "64x48", "--repeats", 1, "--json", tmp_path / "b.json", "--kernels")
    code, text, _ = gffe("bench", *options, "--upscale", 2, *DEFAULT)
    assert code == 0 and "upscaling.accumulate" in text
    for one in json.loads((tmp_path / "b.json").read_text())["devices"]:
        (size,) = one["sizes"]
        parts = size["milliseconds"]
        assert (size["width"], size["height"]) == (64, 48) and parts["upscaling"] > 0
        assert parts["GAE"] == pytest.approx(sum(ms for name, ms in parts.items() if name not in ("GAE", "upscaling")))


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("nosuch",), "unknown scene 'nosuch'"),
        (("--frame", 0), "--frame must be at least 1"),
        (("--repeats", 0), "--repeats must be at least 1"),
    ],
)
def test_bench_refuses(gffe, options, complaint):
    code, _, err = gffe("bench", *options)
    assert code == 2 and complaint in err and len(err.splitlines()) == 1


@pytest.fixture(autouse=True)
def _small_copies(monkeypatch):
    monkeypatch.setattr(bench_module, "_COPY_BYTES", 1 << 22)


# ---- footage ---------------------------------------------------------------------------------------------------


def test_turns_follow_the_frame_that_motion_refers_to():
    camera = Camera(np.eye(4), 10, 10, 5, 5)
    frames = tuple(RenderedFrame(k, k, k, camera, 0.0) for k in range(2))
    turns = list(timed_footage.FrameLoop("x", 10, 10, 1.0, 0.1, frames, (None,) * 2).turns(3))
    assert [turn.index for turn in turns] == [0, 1, 0, 1, 0, 1] and sum(turn.counts for turn in turns) == 3
    assert [turn.frame.reset for turn in turns] == [True] + [False] * 5 and turns[0].before is None
    assert all(turn.before.color == 1 - turn.frame.color for turn in turns[1:])
    assert np.allclose(np.diff([turn.frame.time for turn in turns]), 0.1)


def test_a_part_sees_what_the_whole_does():
    shown = inputs.scene_loop(open_device(), "room", 64, 48)
    part = shown.part(20, 16, (0.25, 0.5))
    assert (part.width, part.height) == (20, 16) == part.frames[0].depth.shape[::-1]
    assert np.array_equal(part.frames[1].motion, shown.frames[1].motion[16:32, 6:26])
    pixel = np.array([3.5, 4.5])
    one = part.frames[0].camera.unproject(pixel, 2.0)
    assert np.allclose(one, shown.frames[0].camera.unproject(pixel + (6, 16), 2.0))
    assert part.cameras[0].cx == shown.cameras[0].cx - 6
    assert shown.part(100, 100, (0.5, 0.5)).frames[0].color.shape == (48, 64, 3)
    reset = replace(shown, frames=tuple(replace(frame, motion=None) for frame in shown.frames))
    assert reset.part(20, 16, (0.5, 0.5)).frames[0].motion is None


# ---- scripts of the documentation ------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.slow
def test_the_calling_thread_is_timed_in_each_way(tmp_path):
    """NumPy frames, rings of two and three sets of device buffers, and new buffers every time, in two processes."""
    script = [sys.executable, str(ROOT / "docs" / "tools" / "compare_speed.py"), "--old", str(ROOT), "--size", "64x48"]
    options = ["--host", "--repeats", "2", "--json", str(tmp_path / "c.json")]
    child = subprocess.run([*script, *options], capture_output=True, text=True, timeout=300)
    assert child.returncode == 0, child.stderr[-2000:]
    found = json.loads((tmp_path / "c.json").read_text())["of"]
    ways = ("arrays", "ring of 2", "ring of 3", "new buffers")
    assert [one["of"] for one in found] == [f"plaza, {way}" for way in ways]
    assert all(one["new"]["host"] > 0 and one["ratio"]["host"] > 0 for one in found)
