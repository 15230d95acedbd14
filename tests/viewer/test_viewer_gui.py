"""The whole viewer, driven by Dear ImGui's test engine under Xvfb: it is clicked, dragged and typed into.

viewer_gui_case.py runs all cases in one process and writes down which failed. Pictures of each case are kept in the
folder GFFE_ARTIFACTS, if that is set.
"""

import json
import os
import shutil
import time
from pathlib import Path

import pytest
from xvfb import require_screen, run_window

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Outcomes of the cases, by their names; of "leave first" and "leave second" also "exit", seconds from closing
    to the end of the process."""
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


CASES = (
    *("overview", "color_bars", "story", "kernels", "dropping", "doctor", "palette_and_help", "open_by_path"),
    *("finding_frames", "neighbors", "marked_frames_and_rectangles", "walking_along_a_story", "appearance", "saving"),
    *("every_action", "restart"),
)


@pytest.mark.parametrize("name", CASES)
def test_case(seen, name):
    assert seen[name]["error"] is None, seen[name]["error"]
    assert name in seen["pictures"]


def test_closing_while_work_runs(seen):
    left = seen["leave first"]
    assert left["error"] is None, left["error"]
    assert left["exit"] < 3.0
    assert {name for name in seen if not name.startswith("leave ")} == {*CASES, "pictures"}
