"""The recipe for Godot 3, in the engine: what it records is sound, and frames between are found."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import gffe_cl as gffe
from gffe_cl.cli.commands import invoke

RECIPE = Path(__file__).parents[3] / "docs" / "godot3"
GODOT = ["godot3", "--path", str(RECIPE), "--video-driver", "GLES3", "--audio-driver", "Dummy", "--fixed-fps", "30"]
EXAMPLE = ["-s", "example.gd"]


@pytest.mark.long
@pytest.mark.skipif(shutil.which("godot3") is None or shutil.which("xvfb-run") is None, reason="no Godot 3 or no Xvfb")
def test_godot3_records_what_gffe_reads(tmp_path, capsys):
    recorded, half = tmp_path / "recorded", tmp_path / "half"
    command = ["xvfb-run", "-a", *GODOT, *EXAMPLE, str(recorded)]
    home = os.environ | {"XDG_DATA_HOME": str(tmp_path)}
    found = subprocess.run(command, env=home, capture_output=True, text=True, timeout=300)
    assert (recorded / "sequence.json").exists(), found.stdout + found.stderr
    assert invoke(["check", str(recorded)]) in (None, 0)
    assert "fault" not in capsys.readouterr().out

    sequence = gffe.open_capture(recorded)
    first, second = sequence.rendered[4:6]
    assert len(sequence.rendered) == 10 and second.time - first.time == pytest.approx(1 / 30)
    frame = sequence.read(first)
    assert frame.color.shape == (180, 320, 3) and frame.color.min() >= 0
    assert np.isinf(frame.depth[0]).all()  # nothing is drawn above the wall
    floor = frame.camera.unproject((160.5, 179.5), frame.depth[179, 160])
    assert floor[1] == pytest.approx(0, abs=0.005) and -3 < floor[2] < -1  # meters, y up

    assert invoke(["import", str(recorded), str(half), "--every", "2"]) in (None, 0)
    halved = gffe.open_sequence(half)
    pipeline = gffe.Pipeline(gffe.open_device(), 320, 180)
    gained = []
    for entry, between in zip(halved.rendered, halved.ground_truth, strict=True):
        frame = halved.read(entry)
        pipeline.submit(frame)
        made = pipeline.extrapolate(between.display_camera, between.time).numpy("color")
        truth = gffe.to_display(halved.read_color(between))
        quality = [gffe.psnr(gffe.to_display(image), truth) for image in (frame.color, made)]
        gained.append(quality[1] - quality[0])
    assert np.mean(gained[2:]) > 3
