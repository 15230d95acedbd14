"""The viewer's sizes on a screen with 144 dpi."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.long
def test_sizes_are_in_proportion_to_letters_in_every_frame(tmp_path):
    if shutil.which("xvfb-run") is None:
        assert not os.environ.get("CI"), "CI must have xvfb-run"
        pytest.skip("xvfb-run is not installed")
    script, report = Path(__file__).with_name("viewer_dpi_case.py"), tmp_path / "report.json"
    subprocess.run(
        ["xvfb-run", "-a", "-s", "-noreset -screen 0 1920x1200x24", sys.executable, str(script), str(report)],
        env=os.environ | {"LIBGL_ALWAYS_SOFTWARE": "1", "XDG_CONFIG_HOME": str(tmp_path)},
        check=True,
        timeout=120,
    )
    seen = json.loads(report.read_text())
    usual_scrollbar, usual_padding = 14, 8  # of ImGui at 96 dpi
    assert all(sizes == [1.5 * usual_scrollbar, 1.5 * usual_padding] for sizes in seen["frames"]), seen["frames"]
    assert len(seen["frames"]) > 8, "also after a change of the theme"
    assert seen["remembered"] == [600, 400], "a size at 96 dpi, as it is given"
