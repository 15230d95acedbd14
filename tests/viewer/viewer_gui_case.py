"""Runs the viewer under Dear ImGui's test engine; started by test_viewer_gui.py under xvfb-run.

    viewer_gui_case.py make|first|second|smoke FOLDER ARTIFACTS [CASE …]

"make" writes the sequences "small" (ground truth, a rendering window from its second frame on) and "large" into FOLDER.
"first" runs all cases, or those named, and "second" finds what it has left; "smoke" runs the short one of
test_viewer_window.py alone. The outcome goes to FOLDER/first.json and so on, pictures to ARTIFACTS.
"""

import sys
from pathlib import Path


def make(folder: Path) -> None:
    from gffe_cl.captures.scenes import load_scene
    from gffe_cl.captures.scenes.renderer import render_sequence
    from gffe_cl.engine.opencl.device import open_device

    device, scene = open_device(), load_scene("corridor")
    render_sequence(scene, folder / "small", device, 192, 108, 8, 30.0, ground_truth=True, window="adaptive")
    render_sequence(scene, folder / "large", device, 960, 540, 4, 30.0, ground_truth=False, samples=1)


def add_panel_of_the_map() -> None:
    """Register the panel that docs/map.md has as an example."""
    import importlib.util
    import re

    from gffe_cl.viewer.window import docks

    text = Path(__file__).parents[2].joinpath("docs", "map.md").read_text(encoding="utf-8")
    code, line = re.findall(r"```python\n(.*?)```", text.partition("## Add a panel")[2], re.DOTALL)[:2]
    spec = importlib.util.spec_from_loader(f"{docks.__package__}.brightest", None)
    module = importlib.util.module_from_spec(spec)
    exec(code, module.__dict__)
    sys.modules[spec.name] = module
    docks.PANELS |= eval(f"{{{line}}}", {"Panel": docks.Panel})


def run(phase: str, folder: Path, artifacts: Path, only: list[str]) -> None:
    import viewer_gui_doing as doing
    import viewer_gui_driver as driver
    import viewer_gui_looking as looking
    import viewer_gui_opening as opening
    import viewer_gui_settings as settings_cases

    from gffe_cl.engine.inference import network
    from gffe_cl.viewer.engine.jobs import leaving
    from gffe_cl.viewer.engine.sources.opening import ScenePlan
    from gffe_cl.viewer.state.model import Model
    from gffe_cl.viewer.state.settings import Settings
    from gffe_cl.viewer.window.running import new_app

    network.default_model = lambda: None  # nothing hangs on weights that are installed
    settings, warning = Settings.load()
    model = Model(settings, plan=ScenePlan(160, 90, 0))
    assert warning is None, warning
    model.open(str(folder / "small"))
    cases = looking.CASES | opening.CASES | settings_cases.CASES | doing.CASES
    cases = {name: case for name, case in cases.items() if name in only or not only}
    report = folder / f"{phase}.json"
    with leaving(model):
        if phase == "smoke":
            add_panel_of_the_map()
            driver.run(new_app(model), {"smoke": looking.smoke}, report, artifacts, None, (1280, 720))
        elif phase == "first":
            driver.run(new_app(model), cases, report, artifacts, doing.leave_while_working, (1280, 720))
        else:
            driver.run(new_app(model), {"restart": doing.found_again}, report, artifacts)


if __name__ == "__main__":
    if sys.argv[1] == "make":
        make(Path(sys.argv[2]))
    else:
        run(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:])
