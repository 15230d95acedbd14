"""All panels in small and large windows on screens of two scales, with small and large letters: nothing is cut, and
no text covers another one or the picture."""

import json
import os
from pathlib import Path

import pytest
from xvfb import run_window

from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.renderer import render_sequence
from gffe_cl.engine.opencl.device import open_device


@pytest.mark.long
@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_panels(tmp_path, scale):
    render_sequence(load_scene("corridor"), tmp_path / "in", open_device(), 96, 54, 5, 30.0, ground_truth=True)
    pictures = Path(os.environ.get("GFFE_ARTIFACTS") or tmp_path).absolute() / "sizes"
    pictures.mkdir(exist_ok=True, parents=True)
    script, report = Path(__file__).with_name("viewer_sizes_case.py"), tmp_path / "report.json"
    arguments = (round(96 * scale), tmp_path / "in", report, pictures)
    run_window(script, *arguments, folder=tmp_path, timeout=500, size="3840x2160")
    seen = json.loads(report.read_text())
    assert seen["scale"] == scale and len(seen["faults"]) > 50
    assert [fault for faults in seen["faults"].values() for fault in faults] == []
