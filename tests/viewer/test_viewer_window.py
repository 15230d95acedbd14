"""The window of the viewer, opened once under Xvfb: picture, numbers, keys, and a panel that is drawn and dragged in.

The long tests of test_viewer_gui.py look at everything; this one is part of every run.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import tiny_sequence
from xvfb import run_window


def test_the_window(tmp_path):
    tiny_sequence.write(tmp_path / "small")
    run_window(Path(__file__).with_name("viewer_gui_case.py"), "smoke", tmp_path, tmp_path, folder=tmp_path)
    seen = json.loads((tmp_path / "smoke.json").read_text())["cases"]["smoke"]
    assert seen["error"] is None, seen["error"]
    values = seen["values"]
    np.testing.assert_allclose(values["shown"], values["expected"], atol=2)
    assert values["slots after keys"] == [1, 2, 1]
    assert values["pointed at"] == [[3, 4], [9, 7]]
    assert values["zoomed at the pointer"] and values["wipe"] == pytest.approx(0.25, abs=0.01)
    assert values["scrubbed to"] == [0, 5] and values["told"] == [3, 4]
    assert values["switched"] is False
    assert values["shown by a new panel"] == "final", "the panel that docs/map.md has as an example"
