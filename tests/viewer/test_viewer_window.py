"""The window of the viewer, opened once under Xvfb: picture, numbers, keys, and a panel that is drawn and dragged in.

The long tests of test_viewer_gui.py look at everything; this one is part of every run. And its sizes on a screen with
144 dpi.
"""

import json
from pathlib import Path

import pytest
import tiny_sequence
from xvfb import run_window


def test_the_window(tmp_path):
    tiny_sequence.write(tmp_path / "small")
    run_window(Path(__file__).with_name("viewer_gui_case.py"), "smoke", tmp_path, tmp_path, folder=tmp_path)
    seen = json.loads((tmp_path / "smoke.json").read_text())["cases"]["smoke"]
    assert seen["error"] is None, seen["error"]


@pytest.mark.long
def test_sizes_are_in_proportion_to_letters_in_every_frame(tmp_path):
    report = tmp_path / "report.json"
    run_window(Path(__file__).with_name("viewer_dpi_case.py"), report, folder=tmp_path)
    seen = json.loads(report.read_text())
    usual_scrollbar, usual_padding = 14, 8  # of ImGui at 96 dpi
    assert all(sizes == [1.5 * usual_scrollbar, 1.5 * usual_padding] for sizes in seen["frames"]), seen["frames"]
    assert len(seen["frames"]) > 8, "also after a change of the theme"
    assert seen["remembered"] == [600, 400], "a size at 96 dpi, as it is given"
