"""Live examples: an engine's frames, generated frames, a resized window, a cut, a lost frame."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import gffe_cl as gffe
from gffe_cl.cli.commands import invoke

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


def _run(name, *words):
    command = [sys.executable, str(EXAMPLES / name), "--offscreen", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


@pytest.mark.long
def test_panda3d_gains_over_repeating():
    pytest.importorskip("panda3d")
    found = _run("panda3d_live.py", "--measure", "--frames", "5")
    assert found.returncode == 0, found.stderr
    figures = json.loads(found.stdout.splitlines()[-1])
    assert min(figures["gffe"], figures["gffe_network"]) > figures["repeat"] + 2


_EVENTS = """
import sys
from types import SimpleNamespace
import numpy as np
import pytest
sys.path.insert(0, sys.argv[1])
import gffe_cl as gffe
import panda3d_live

game = panda3d_live.Game((160, 90), offscreen=True, game=True)


def frames(*moments):
    return [frame for moment in moments if (frame := game.render(moment / 15))]


assert gffe.check(frames(0, 1, 2)) is None
nobody, path = game.base.mouseWatcherNode, game.look(0.2)
game.base.mouseWatcherNode = SimpleNamespace(hasMouse=lambda: True, getMouseX=lambda: 0.5, getMouseY=lambda: 0.25)
moved = game.look(0.2)
assert moved.position[2] == pytest.approx(path.position[2] + 0.5, abs=1e-4)  # z is up
assert moved.position[0] == pytest.approx(9 * np.sin(1), abs=1e-4)
game.base.mouseWatcherNode = nobody
game.switch("lose")
assert frames(3) == []
assert gffe.check(frames(4, 5, 6)) is None  # the first of them leads to frame 2
game.switch("cut")
after = frames(7, 8, 9)
assert [frame.reset for frame in after] == [True, False, False] and gffe.check(after) is None
game.switch("window")
wide = frames(10, 11, 12)
assert wide[2].camera.fx < wide[2].display_camera.fx and gffe.check(wide) is None
game.resize((200, 100))
resized = frames(13, 14)
assert resized[0].reset and resized[1].color.shape == (100, 200, 3)
image = game.generated(14.5 / 15, game.look(14.5 / 15))
for game.layer in range(1 + len(list(game.pipeline.named_buffers()))):
    game.show(image)
for name in ("generate", "network"):
    game.switch(name)
assert game.cut  # the new pipeline begins anew
later = game.base.taskMgr.doMethodLater
later(0.3, lambda task: game.switch("network"), "network")
later(0.6, lambda task: [game.switch("lose"), game.base.win.setSize(120, 70)] and None, "resize")
panda3d_live.play(game, 15, 30, 45)
assert game.pipeline.sizes.target == (120, 70)
"""


@pytest.mark.long
def test_panda3d_survives_what_happens_in_games():
    """As a game it has depth and motion of half the size, jitter, antialiasing over time and a HUD."""
    pytest.importorskip("panda3d")
    command = [sys.executable, "-c", _EVENTS, str(EXAMPLES)]
    found = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert found.returncode == 0, found.stderr


@pytest.mark.long
def test_the_recipe_for_panda3d_records_what_the_doctor_finds_sound(tmp_path):
    pytest.importorskip("panda3d")
    page = (EXAMPLES.parent / "formats.md").read_text()
    (recipe,) = re.findall(r"^```py\n(import gffe_cl.*?panda3d_live.*?)^```$", page, re.DOTALL | re.MULTILINE)
    shutil.copytree(EXAMPLES, tmp_path, dirs_exist_ok=True)
    (tmp_path / "record.py").write_text(recipe)
    command = [sys.executable, "record.py"]
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert found.returncode == 0, found.stderr
    assert len(gffe.open_sequence(tmp_path / "out" / "panda").rendered) == 16
    assert invoke(["check", str(tmp_path / "out" / "panda")]) in (None, 0)


@pytest.mark.long
def test_renderer_of_ones_own_gains_over_repeating():
    found = _run("moderngl_live.py", "--frames", "5")
    assert found.returncode == 0, found.stderr
    _, repeated, _, made = found.stdout.split()
    assert float(made) > float(repeated) + 2


@pytest.mark.long
@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="no Xvfb")
@pytest.mark.parametrize("name", ["panda3d_live.py", "moderngl_live.py"])
def test_a_window_opens(name):
    if name.startswith("panda3d"):
        pytest.importorskip("panda3d")
    command = ["xvfb-run", "-a", sys.executable, str(EXAMPLES / name), "--frames", "30"]
    found = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert found.returncode == 0 and "extrapolated=" in found.stdout, found.stderr
