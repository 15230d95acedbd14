"""An installed copy as its users meet it: every module, every public name, every command, the viewer. Needs nothing but
what is installed with it, and xvfb-run. Works in the current folder, which must be empty.

    python -I try_installed.py              with the extras for research and videos
    python -I try_installed.py --quick      the demonstration and the self-test only
    python -I try_installed.py --default    without extras
    python -I try_installed.py --engine     with the packages that the engine needs, and no others
"""

import importlib
import importlib.metadata
import os
import pkgutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import gffe_cl

ENGINE = {"numpy", "platformdirs", "pyopencl", "pytools", "siphash24", "typing_extensions"}  # and what these need
OPTIONAL = {"cv2", "onnx", "torch"}  # modules that extras bring
GFFE = Path(sys.prefix) / "bin" / "gffe"
XVFB = ("xvfb-run", "-a", "-s", "-screen 0 1920x1200x24")
W, H = 96, 64
QUICK = """
demo --size 64x36 --output demo
selftest --quick --device {device}
"""
RENDERED = """
render plaza rendered --size 96x64 --frames 4 --ground-truth
run rendered extrapolated
compare extrapolated rendered
"""
COMMANDS = f"""
devices
formats
{QUICK.strip()}
{RENDERED.strip()}
check rendered
import rendered imported
bench --sizes 96x54 --repeats 2 --device {{device}}
eval rendered --methods gffe,baseline --out report
export exported
"""


def run(*command, code=0):
    """Return the output of a command. AssertionError, with all of it, for another exit code."""
    start = time.monotonic()
    environment = os.environ | {"LIBGL_ALWAYS_SOFTWARE": "1"}
    for _ in range(2 if command[: len(XVFB)] == XVFB else 1):
        child = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900)
        # GLFW 3.4.0, which the lowest version of imgui-bundle has, failed once so in glfwCreateWindow (BadWindow for
        # the window 0) and in none of 36 later starts: a fault of GLFW or Xvfb, before anything of ours is shown.
        if "X Error of failed request" not in child.stdout + child.stderr:
            break
    assert child.returncode == code, f"{' '.join(map(str, command))}: {child.returncode}\n{child.stdout}{child.stderr}"
    print(f"{time.monotonic() - start:5.1f} s  {' '.join(map(str, command[-6:]))}", flush=True)
    return child.stdout + child.stderr


def import_all():
    """Import every module and every public name. Those of optional packages may be missing."""
    count = 0
    for module in pkgutil.walk_packages(gffe_cl.__path__, "gffe_cl.", onerror=importlib.import_module):
        if not module.name.endswith(".__main__"):
            try:
                importlib.import_module(module.name)
                count += 1
            except ModuleNotFoundError as error:
                assert error.name in OPTIONAL, f"{module.name}: {error}"
    names = [getattr(gffe_cl, name) for name in gffe_cl.__all__]
    assert count > 150, f"{count} modules"
    print(f"{count} modules, {len(names)} names", flush=True)


def run_commands(given):
    """Run each of the lines and return their words."""
    lines = [line.format(device=gffe_cl.open_device().info.index).split() for line in given.strip().splitlines()]
    for line in lines:
        run(GFFE, *line)
    return lines


def run_without_extras():
    """Run the viewer and a comparison, which work, and commands that name the extra they need."""
    run_commands(RENDERED)
    view()
    for command, extra in (("eval", "lab"), ("demo", "lab,video"), ("train out", "train")):
        said = run(GFFE, *command.split(), code=2)
        assert f"pip install '.[{extra}]'" in said and len(said.splitlines()) <= 3, said


def run_engine():
    """New frames, with the network, from what a renderer links."""
    there = {each.metadata["Name"].lower() for each in importlib.metadata.distributions()}
    assert there - {"gffe-cl"} <= ENGINE, there
    frame = np.zeros((H, W, 3), np.float32), np.full((H, W), 5.0, np.float32), np.zeros((H, W, 2), np.float32)
    pipeline = gffe_cl.Pipeline(gffe_cl.open_device(), W, H)
    for k in range(3):
        camera = gffe_cl.Camera(np.eye(4), 80, 80, W / 2, H / 2)
        pipeline.submit(gffe_cl.RenderedFrame(*frame, camera, k / 30, reset=k == 0))
        made = pipeline.extrapolate(time=k / 30 + 1 / 60)
    assert made.numpy("color").shape[:2] == (H, W) and pipeline.options.corrects_shading
    assert run(GFFE, "devices", code=2) == "error: the command line needs typer: pip install typer\n"


def run_all_commands():
    """Every command once, `view` excepted."""
    from typer.main import get_command

    from gffe_cl.cli.commands import app

    lines = run_commands(COMMANDS)
    assert "torch" in run(GFFE, "train", "trained", code=2).lower()
    group: Any = get_command(app)
    shown = {name for name, command in group.commands.items() if not command.hidden}
    assert shown == {line[0] for line in lines} | {"train", "view"}


def view():
    """Take a screenshot, and run a script."""
    run(*XVFB, GFFE, "view", "rendered", "--screenshot", "shot.png", "--frame", "3")
    Path("steps.txt").write_text("layer frame.motion\nwait 0.2\nshot script.png\n")
    run(*XVFB, GFFE, "view", "rendered", "--script", "steps.txt")
    for name in ("shot", "script"):
        assert Path(f"{name}.png").read_bytes()[1:4] == b"PNG"


if __name__ == "__main__":
    assert Path(gffe_cl.__file__).is_relative_to(sys.prefix), f"{gffe_cl.__file__} is not installed"
    os.environ["XDG_CONFIG_HOME"] = os.getcwd()  # settings
    if "--quick" in sys.argv:
        run_commands(QUICK)
    elif "--default" in sys.argv:
        run_without_extras()
    elif "--engine" in sys.argv:
        run_engine()
    else:
        import_all()
        run_all_commands()
        view()
    print("installed copy: passed")
