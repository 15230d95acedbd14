"""The window of the viewer, opened once under Xvfb: picture, numbers, keys, and a panel that is drawn and dragged in.

The long tests of test_viewer_gui.py look at everything; this one is part of every run.
"""

import json
from pathlib import Path

import tiny_sequence
from xvfb import run_window


def test_the_window(tmp_path):
    tiny_sequence.write(tmp_path / "small")
    run_window(Path(__file__).with_name("viewer_gui_case.py"), "smoke", tmp_path, tmp_path, folder=tmp_path)
    seen = json.loads((tmp_path / "smoke.json").read_text())["cases"]["smoke"]
    assert seen["error"] is None, seen["error"]
