"""GUI cases: kernels, opening, the palette."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from imgui_bundle import imgui
from viewer_gui_driver import CTRL, KEY, SHIFT, Gui, collector

from gffe_cl.viewer.window.app import has_dialogs
from gffe_cl.viewer.window.timeline import DOUBT

CASES, case = collector()


@case
def kernels(gui: Gui):
    """A broken edit is told where it is seen, also while the tab is hidden, until it is repaired."""
    model, path = gui.model, Path(os.environ["GFFE_KERNELS"]) / "warp.cl"
    text = path.read_text()
    path.write_text(f"{text}nonsense\n")
    gui.ctx.window_focus("//Inspector")
    gui.wait(lambda: "warp.cl:" in (model.engine.build_error or ""), "the file watch")  # without F5
    gui.settle()
    model.say("something else")
    gui.click("//**/###kernel_error")
    first, second = gui.on_screen(imgui.get_clipboard_text).splitlines()[:2]
    assert "does not build" in first and "warp.cl:" in second
    gui.ctx.window_focus("//Kernels")
    gui.frames(2)
    gui.shot("kernels, broken")
    path.write_text(text)
    gui.click("//Kernels/###reload_kernels")
    gui.wait(lambda: not model.engine.build_error and not model.busy, "the repaired kernels")
    gui.settle()
    assert not gui.exists("//**/###kernel_error")
    gui.ctx.window_focus("//Inspector")


@case
def dropping(gui: Gui):
    """A bad path: a message, the old sequence stays and goes on; then a good one."""
    model, folder = gui.model, gui.sequences
    before = gui.picture()
    gui.app.drop([str(folder / "no such thing")])
    gui.wait(lambda: model.messages, "a message")
    gui.settle()
    gui.frames(2)
    assert "no such folder" in gui.told() and gui.exists("//###messages")
    assert (gui.picture() == before).all() and model.source.name == "small"
    gui.key(KEY.left_arrow)
    gui.settle()
    assert model.contents.result.slot == 12 and Path(model.document.target).name == "small"
    gui.app.drop([str(folder / "large")])
    gui.wait(lambda: model.source.name == "large", "the other sequence")
    gui.settle()
    assert model.source.width == 960 and [Path(path).name for path in model.settings.recent[:2]] == ["large", "small"]
    gui.app.drop([str(folder / "small" / "sequence.json")])
    gui.wait(lambda: model.source.name == "small", "the small one again")
    gui.settle()


@case
def doctor(gui: Gui):
    """A good sequence is examined; frames that the doctor marks are marked on the timeline."""
    model = gui.model
    gui.key(KEY.d, CTRL)
    gui.wait(lambda: model.document.doctor is not None and model.document.doctor.done, "the doctor")
    gui.frames(3)
    assert model.document.doctor.findings == []
    marks = {3: "does not follow the frame before it"}
    model.document.doctor = SimpleNamespace(done=True, findings=[], marks=marks, problem="", converts=False)
    left, top, width, height = map(int, gui.area("//Timeline/###scrub"))
    gui.frames(2)
    column = gui.window()[top : top + height, left + round(width * 3 / model.playback.count)].astype(int)
    assert (np.abs(column - np.multiply(DOUBT[:3], 255)).max(-1) < 12).mean() > 0.5
    gui.key(KEY.escape)
    gui.app.docks.toggle("Doctor")


@case
def palette_and_help(gui: Gui):
    app, model = gui.app, gui.model
    gui.key(KEY.p, CTRL)
    gui.frames(2)
    assert gui.exists("//###palette")
    gui.ctx.key_chars("overview")
    gui.frames(2)
    gui.shot("palette")
    gui.key(KEY.enter)
    gui.settle()
    assert model.choices.overview and not app.palette.is_open
    model.choices.overview = False
    gui.key(KEY.p, CTRL)
    gui.ctx.key_chars("frame")
    gui.key(KEY.down_arrow)
    gui.frames(2)
    assert app.palette.at == 1
    gui.key(KEY.escape)
    gui.frames(2)
    assert not app.palette.is_open
    gui.key(KEY.slash, SHIFT)
    gui.frames(3)
    assert gui.exists("//###help")
    gui.shot("help")
    gui.key(KEY.o)
    assert not model.choices.overview, "no shortcut reaches what lies behind"
    gui.key(KEY.escape)
    gui.frames(2)
    assert not app.help.is_open


@case
def open_by_path(gui: Gui):
    """Ctrl+O falls back to the field for a path where the system has no dialog."""
    model = gui.model
    gui.key(KEY.o, CTRL | (SHIFT if has_dialogs() else 0))
    gui.frames(3)
    assert gui.exists("//###open_path")
    gui.shot("open by path")
    gui.ctx.key_chars("room")
    gui.frames(2)
    gui.key(KEY.enter)
    gui.wait(lambda: model.source.name == "room", "the scene")
    gui.settle()
    assert model.source.live and not gui.app.open_path.is_open
    gui.open(gui.sequences / "small")
