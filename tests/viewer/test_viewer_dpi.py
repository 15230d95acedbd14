"""The viewer's sizes on a screen with 144 dpi."""

import json
from pathlib import Path

import pytest
from xvfb import run_window


@pytest.mark.long
def test_sizes_are_in_proportion_to_letters_in_every_frame(tmp_path):
    report = tmp_path / "report.json"
    run_window(Path(__file__).with_name("viewer_dpi_case.py"), report, folder=tmp_path)
    seen = json.loads(report.read_text())
    usual_scrollbar, usual_padding = 14, 8  # of ImGui at 96 dpi
    assert all(sizes == [1.5 * usual_scrollbar, 1.5 * usual_padding] for sizes in seen["frames"]), seen["frames"]
    assert len(seen["frames"]) > 8, "also after a change of the theme"
    assert seen["remembered"] == [600, 400], "a size at 96 dpi, as it is given"
