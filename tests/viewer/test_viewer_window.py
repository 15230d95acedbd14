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


_AT_REST = """
import json, sys, time
from pathlib import Path
from gffe_cl.viewer.state.model import Model
from gffe_cl.viewer.state.settings import Settings
from gffe_cl.viewer.window.running import new_app, run

model, stamps = Model(Settings(), save_settings=False), []

def look(app):
    stamps.append(time.perf_counter())
    if len(stamps) > 1 and stamps[-1] - stamps[-2] > 3.0:  # nothing was drawn for so long
        rest = model.settled and not model.document.scan.busy and len(model.document.ahead.cached)
        Path(sys.argv[2]).write_text(json.dumps([rest, model.playback.slots]))
        app.close()

model.open(sys.argv[1])
run(new_app(model, on_frame=look), (900, 620))
"""


def test_nothing_is_drawn_at_rest(tmp_path):
    """Frames of the interface end when all is made, and not before: what is made asks for one."""
    tiny_sequence.write(tmp_path / "small")
    case, report = tmp_path / "case.py", tmp_path / "report.json"
    case.write_text(_AT_REST)
    run_window(case, tmp_path / "small", report, folder=tmp_path)
    cached, slots = json.loads(report.read_text())
    assert cached == slots
