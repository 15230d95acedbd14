"""`gffe view`: pictures and figures without a person, and what is told when something is wrong."""

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tiny_sequence
from PIL import Image
from viewer_session import Session
from xvfb import SCREEN, require_screen

from gffe_cl.cli import main
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.viewer.state.actions import Actions
from gffe_cl.viewer.window.script import Director, parse, unopened

GUIDE = Path(__file__).parents[2] / "docs" / "guide.md"
GFFE = [sys.executable, "-c", "from gffe_cl.cli import main; main()", "view"]


@pytest.fixture
def gffe(tmp_path):
    """Runs `gffe view ARGS…` in a folder with the sequence "in"; (exit code, stdout, stderr)."""
    tiny_sequence.write(tmp_path / "in")

    def call(*arguments, display=None, **environment):
        environment = {"XDG_CONFIG_HOME": str(tmp_path / "config"), "LIBGL_ALWAYS_SOFTWARE": "1"} | environment
        bare = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
        if display is not None:
            bare["DISPLAY"] = display
        child = subprocess.run(
            [*(SCREEN if display is None else ()), *GFFE, *arguments],
            env=bare | environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=200,
        )
        return child.returncode, child.stdout, child.stderr

    return call


@pytest.fixture
def screen():
    require_screen()


def refused(gffe, *arguments, display=None, **environment):
    """The one line that is told."""
    code, out, err = gffe(*arguments, display=display, **environment)
    lines = err.splitlines()
    assert (code, out, len(lines)) == (2, "", 1) and lines[0].startswith("error: "), (code, out, err)
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--screenshot", "a.png"], "needs a sequence or a scene"),
        (["--export", "page"], "--export needs a sequence or a scene"),
        (["in", "--export", "nowhere/page"], "--export nowhere/page: cannot write (No such file"),
        (["in", "--cache", "-1"], "--cache must be"),
        (["--script", "steps.txt"], "--script needs a sequence or a scene"),
        (["in", "--script", "none.txt"], "none.txt: cannot be read"),
        (["in", "--script", "a.txt", "--screenshot", "a.png"], "--screenshot and --script exclude each other"),
        (["in", "--film", "a.webp"], "--film needs a --script"),
        (["in", "--script", "a.txt", "--film", "a.mp4"], "must end in .webp or .gif"),
        (["in", "-n", "9"], "-n must be 1 to 7"),
        (["in", "--window", "fixed:1.2"], "only built-in scenes"),
        (["in", "--window-size", "10x900"], "--window-size must be at least 200"),
        (["in", "--scn-model", "none.onnx"], "none.onnx: no such file"),
        (["in", "--scn-model", "in/sequence.json"], "in/sequence.json: cannot be loaded"),
        (["in", "--scn"], "no trained weights"),
        (["in", "--no-scn", "--scn-model", "none.onnx"], "--no-scn and --scn-model exclude each other"),
        (["in"], "expected DISPLAY to be set"),
    ],
)
def test_refused_before_anything_is_opened(tmp_path, monkeypatch, capsys, arguments, told):
    """In this process: a new one takes more than a second."""
    tiny_sequence.write(tmp_path / "in")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["gffe", "view", *arguments])
    for name, value in (("DISPLAY", ""), ("WAYLAND_DISPLAY", ""), ("XDG_CONFIG_HOME", str(tmp_path / "config"))):
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as stopped:
        main()
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert (stopped.value.code, out, len(lines)) == (2, "", 1) and lines[0].startswith("error: "), (out, err)
    assert told in lines[0]


def test_display_that_is_not_there(gffe):
    assert "the display :977 cannot be opened" in refused(gffe, "in", display=":977")


def test_display_without_opengl(gffe, screen):
    """One line with GLFW's reason, before anything is opened or written."""
    receiving, sending = os.pipe()
    command = ["Xvfb", "-displayfd", str(sending), "-noreset", "-screen", "0", "640x480x24", "-extension", "GLX"]
    with subprocess.Popen(command, pass_fds=[sending], stderr=subprocess.DEVNULL) as x, open(receiving) as number:
        os.close(sending)
        try:
            display = f":{number.readline().strip()}"
            told = refused(gffe, "in", "--screenshot", "a.png", display=display)
        finally:
            x.terminate()
    reason = "GLX: GLX extension not found"
    assert f"the display {display} has no OpenGL 3.3 ({reason}; expected the driver of the screen's GPU" in told


def test_wayland_without_x11_is_named(monkeypatch):
    glfw = pytest.importorskip("glfw")
    monkeypatch.setattr(glfw, "init", lambda: False)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("WAYLAND_DISPLAY", "wl-9")
    from gffe_cl.viewer.window.running import require_display

    with pytest.raises(GffeError, match=r"no X display: WAYLAND_DISPLAY is wl-9, .* XWayland; without a screen: xvfb"):
        require_display()


@pytest.mark.slow
def test_screenshot(gffe, screen, tmp_path):
    assert gffe("in", "--screenshot", "a.png", "--frame", "3") == (0, "", "")
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert picture.shape[:2] == (900, 1600) and len(np.unique(picture[200:700, 400:1000].reshape(-1, 4), axis=0)) > 50
    assert not (tmp_path / "config").exists()  # pictures for reports neither use nor change what is remembered


STEPS = """# comment

seek 3
layer frame.motion
wait 0.5
set levels off
shot off.png
set levels on
with truth
compare split
split 0.7
pixel 3,4
survey
wait done
panel Plot
type depth
wait 0.1
type none
brighter
play
wait 0.5
"""


@pytest.mark.long
def test_a_script_is_done_and_filmed(gffe, screen, tmp_path):
    (tmp_path / "steps.txt").write_text(STEPS)
    size = ("--window-size", "640x480")
    code, out, err = gffe("in", "--script", "steps.txt", "--film", "film.webp", *size)
    assert (code, out, err) == (0, "", "")
    with Image.open(tmp_path / "off.png") as shot, Image.open(tmp_path / "film.webp") as film:
        assert shot.size == film.size == (640, 480) and film.n_frames >= 3
    (tmp_path / "wrong.txt").write_text("seek 1\nlayer nonsense\nshot never.png\n")
    assert "wrong.txt, line 2: no layer is called 'nonsense' (nearest: " in refused(
        gffe, "in", "--script", "wrong.txt", *size
    )
    assert not (tmp_path / "never.png").exists()


WRONG_SCRIPTS = {
    "# only this": "nothing to do",
    "wait 1\npley": "steps.txt, line 2: no action is called 'pley' (nearest: play",
    "seek": "steps.txt, line 1: expected seek FRAME",
    "play 3": "no action is called 'play 3'",
}


@pytest.fixture(scope="module")
def unopened_app():
    return unopened()


def test_scripts_are_checked_before_anything_starts(tmp_path, unopened_app):
    for text, told in WRONG_SCRIPTS.items():
        (tmp_path / "steps.txt").write_text(text)
        with pytest.raises(GffeError, match=re.escape(told)):
            parse(tmp_path / "steps.txt", unopened_app.actions)


WRONG_STEPS = {
    "seek x": "expected a frame's number on the timeline",
    "seek 99": "expected 0 to 5",
    "pixel 99,99": "expected a pixel inside 13×9, got 99,99",
    "pixel a,b": "expected 2 numbers, with commas, got 'a,b'",
    "layer finall": "no layer is called 'finall' (nearest: final",
    "with final": "'final' is compared with itself",
    "compare nonsense": "expected off, split",
    "set nonsense 1": "unknown option 'nonsense'",
    "set levels 99": "background levels must be",
    "set levels inf": "background levels must be",
    "set crack_closing 1": "crack closing must be on or off",
    "set hole_filling nonsense": "hole filling must be ",
    "plane 2": "expected 1 to 1, which 'final' has, got 2",
    "from nowhere": "nowhere",
    "split nan": "expected 1 number, got 'nan'",
    "panel Nonsense": "no panel is called 'Nonsense' (expected Picture, Layers",
    "wait -5": "expected 0 to 3600 seconds, or done, got -5",
    "shot there/a.png": "there/a.png: cannot write: no such folder",
    "layer upscaling.lock": "no layer is called",
    "set levels 2\nwait -5": "expected 0 to 3600",
}


def test_a_step_that_cannot_be_done_is_named(tmp_path, unopened_app):
    session, path = Session(tiny_sequence.write(tmp_path / "in")), tmp_path / "steps.txt"
    app = SimpleNamespace(model=session.model, docks=unopened_app.docks)
    app.actions = Actions(app)
    for action in unopened_app.actions:
        app.actions.register(action)

    def problem(text: str) -> str | None:
        path.write_text(text)
        try:
            app.director = Director(parse(path, app.actions), film=False)
        except GffeError as error:
            return str(error)
        for step in app.director._steps:
            app.director._do(app, step)
        return app.director.problem

    try:
        for text, told in WRONG_STEPS.items():
            assert f"{path}, line {len(text.splitlines())}: " in (said := problem(text) or "") and told in said, (
                text,
                said,
            )
        steps = "set n 3", "seek 11", "set levels off", "set motion on", "layer Depth against motion"
        assert problem("\n".join((*steps, "layer frame: motion", "split 0.7"))) is None
        assert session.model.playback.slot == 11 and session.model.parameters.value("levels") == 0
        assert problem(f"from {tmp_path / 'in'}") is None
        assert session.model.kept.b.place == str(tmp_path / "in") and session.model.comparison.by_settings
    finally:
        session.model.close()


def test_actions_are_listed(gffe):
    """All that a script can do, without a display."""
    code, out, err = gffe("--actions")
    assert (code, err) == (0, "") and {"play", "quit", "seek", "toggle Plot"} <= {
        line[:32].strip() for line in out.splitlines()
    }


@pytest.mark.parametrize(("fault", "code"), [("None", 0), ("GffeError('wrong')", 2), ("KeyboardInterrupt()", 130)])
def test_leaving_while_the_device_works(tmp_path, fault, code):
    """The process ends before the runtime is taken down, with all that was printed and the right exit code."""
    (tmp_path / "script.py").write_text(
        "import atexit\n"
        "from types import SimpleNamespace\n"
        "from gffe_cl.engine.core.errors import GffeError\n"
        "from gffe_cl.viewer.engine.jobs import leaving\n"
        "atexit.register(print, 'taken down')\n"
        "print('figures')\n"
        "with leaving(SimpleNamespace(close=lambda: print('closed'), left_working=True)):\n"
        f"    fault = {fault}\n"
        "    if fault:\n"
        "        raise fault\n"
    )
    child = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert child.returncode == code and child.stdout.split() == ["figures", "closed"]
