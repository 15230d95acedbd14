"""The whole viewer, driven by Dear ImGui's test engine under Xvfb: it is clicked, dragged and typed into.

viewer_gui_case.py runs all cases in one process and writes down what it saw; here that is judged. Pictures of each case
are kept in the folder GFFE_ARTIFACTS, if that is set.
"""

import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from xvfb import require_screen, run_window

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """What the cases saw, by their names; of "leave first" and "leave second" also "exit", seconds from closing to the
    end of the process."""
    require_screen()
    from gffe_cl.engine.opencl.program import kernel_folder

    folder = tmp_path_factory.mktemp("gui")
    artifacts = Path(os.environ.get("GFFE_ARTIFACTS") or folder / "pictures").absolute() / "viewer"
    for made in (artifacts, folder / "working", folder / "config"):
        made.mkdir(parents=True, exist_ok=True)
    for old in artifacts.glob("*.png"):
        old.unlink()
    shutil.copytree(kernel_folder(), folder / "kernels")
    script = Path(__file__).with_name("viewer_gui_case.py")
    environment = {"GFFE_KERNELS": str(folder / "kernels"), "XDG_CONFIG_HOME": str(folder / "config")}
    found = {}
    for phase in ("make", "first", "second"):
        run_window(script, phase, folder, artifacts, folder=folder / "working", timeout=900, **environment)
        ended = time.time()
        if phase != "make":
            report = json.loads((folder / f"{phase}.json").read_text())
            shutil.copy(folder / f"{phase}.json", artifacts)
            found[f"leave {phase}"] = report["cases"].pop("leave") | {"exit": ended - report["closed"]}
            found |= report["cases"]
    found["pictures"] = {path.stem for path in artifacts.glob("*.png")}
    return found


@pytest.fixture
def values(request, seen):
    """Of the case that the test is named after; its picture is there."""
    name = request.node.name.removeprefix("test_")
    assert seen[name]["error"] is None, seen[name]["error"]
    assert name in seen["pictures"]
    return seen[name]["values"]


def test_overview(values, seen):
    assert values["tiles"] == values["layers"]
    assert values["opened"] == ["frame.depth", False]


def test_story(values):
    assert values["picked"] == values["pixel"]
    assert values["dynamic"] is True and len(values["sentences"]) >= 2
    assert len(values["trajectory"]) >= 3
    x, y = values["pixel"]
    assert values["trajectory"][-1] == pytest.approx([x + 0.5, y + 0.5], abs=1.0)
    warm, accent = (255, 178, 64), (89, 217, 255)
    assert np.abs(np.subtract(values["marked"][0], warm)).max() < 12
    assert np.abs(np.subtract(values["marked"][-1], accent)).max() < 12
    assert values["window changed"] and not values["canvas changed"]
    assert values["forgotten"]


def test_doctor(values):
    assert values["said"] == [] and values["marked"] > 0.5


def test_kernels(values):
    assert values["error is shown"] and values["recovered"]
    first, *others = values["copied"].splitlines()
    assert "does not build" in first and "warp.cl:" in others[0]


def test_dropping(values):
    assert "no such folder" in values["told"] and values["shown"] and values["picture stays"]
    assert values["goes on"] == 12 and values["target"] == "small"
    assert values["opened"] == ["large", 960]
    assert values["recent"] == ["large", "small"]
    assert values["by its file"] == "small"


def test_palette_and_help(values):
    assert values["palette"] and values["overview"] and values["palette closed"]
    assert values["chosen by Down"] == 1 and values["closed by Escape"]
    assert values["help"]
    assert values["covered"] and values["help closed"], "no shortcut reaches what lies behind"


def test_open_by_path(values):
    assert values["window"] and values["closed"]
    assert values["opened"] == ["room", True]


def test_flying(values):
    assert values["window"] == "adaptive" and values["flying"]
    assert values["windowed while turning"]
    assert values["compare is not toggled by W"] == "off"
    assert values["moved by"] > 0.1 and values["turned"] > 0.05
    assert values["picture changed"] > 0.3
    assert values["home"] == 0.0 and not values["still flying"]


def test_appearance(values):
    assert values["room"] > 0 and min(values["contrast"]) > 4.5
    width, height = values["exposure"]
    assert width > 2.5 * height  # of one line: "+0.00 EV" has room
    dark, light = values["bright"]
    assert dark < 80 and light > 180 and values["theme"] == "light"
    before, larger, after = values["letters"]
    assert larger > before == after
    first, hidden, back = values["widths"]
    assert hidden > 1.3 * first and back == pytest.approx(first, abs=3)
    assert not values["layers when hidden"] and values["kernels stay closed"]
    assert values["default arrangement"]["width"] == pytest.approx(first, abs=8)
    assert values["default arrangement"]["closed"] == ["Doctor", "Differences", "Ablation", "Plot", "Over time"]


def test_saving(values):
    assert values["png"]["size"] == [108, 192, 3]
    assert values["png"]["fault"] < 1.5  # levels
    assert values["exr"]["files"] == values["exr"]["layers"] and values["exr"]["depth is right"]
    assert all(name in values["told"] for name in (".png", "layers"))


def test_every_action(values):
    assert values == {"failed": [], "told": []}


def test_closing_while_work_runs(seen):
    left = seen["leave first"]
    assert left["error"] is None, left["error"]
    assert left["exit"] < 3.0


def test_restart(values):
    assert values["display"] == [2.0, 9.0, "viridis"]
    assert values["theme"] == "light" and values["bright"] > 180
    assert values["recent"][0] == "small" and "large" in values["recent"]
    assert values["options"] == [False, 1.5, True]
    assert values["playback"] == {"mode": "every frame", "speed": 0.5, "loop": False}
    assert values["compare"] == ["split", "frame.motion", 0.25]
    assert [name for name, shown in values["panels"].items() if not shown] == [
        *("Timings", "Doctor", "Differences", "Ablation", "Plot", "Over time")
    ]
    assert values["window"] == [1100, 700]


def test_finding_frames(values):
    assert values["empty"] == [False, True]
    assert values["slots"] == [list(range(1, 16, 2))] * 2
    assert values["worst"][0] == values["worst"][1]
    assert values["worst pixel"][0] and "largest: " in values["worst pixel"][1]
    assert values["clicked"] == 9


def test_walking_along_a_story(values):
    assert ["frame 6", "final"] in values["links"] and ["dynamic mask", "history.dynamic_mask"] in values["links"]
    way = np.array(values["way"])
    assert way[:, 0].tolist() == [6, 5, 4, 3, 2, 1, 0]
    steps = np.diff(way[:, 1:], axis=0)  # back in time, a walker who comes nearer from the left
    assert (steps[:, 0] < -2).all() and (np.abs(steps) < 8).all()
    slot, pixel, told = values["at the rendered frame"]
    assert slot == 12 and told == "Rendered frame 6 as it is."
    assert np.abs(np.add(pixel, 0.5) - way[0, 1:]).max() <= 0.5
    assert values["layer"] == "history.dynamic_mask"
    slot, pixel = values["two before"]
    assert slot == 8 and np.abs(np.add(pixel, 0.5) - way[2, 1:]).max() <= 1.5
    assert values["back"] and values["back is disabled"] == "no link was followed"


def test_color_bars(values):
    assert values["colors"]["final"] == 0
    assert min(values["colors"][name] for name in ("rendered.depth", "rendered.motion")) > 50, "a ramp, and a wheel"
