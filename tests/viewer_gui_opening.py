"""GUI cases: kernels, opening, the palette, flying."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import numpy as np
from viewer_gui_driver import CTRL, KEY, SHIFT, Gui, collector

from gffe_cl.viewer.app import has_dialogs

CASES, case = collector()


@case
def kernels(gui: Gui):
    """A good edit changes the picture, a broken one shows where it is wrong, and repairing it recovers."""
    model, values, path = gui.model, gui.values, Path(os.environ["GFFE_KERNELS"]) / "warp.cl"
    text = path.read_text()
    gui.ctx.window_focus("//Kernels")
    gui.frames(2)
    before = gui.picture()
    darker = re.sub(r"store_color\(resample", "store_color(0.25f * resample", text)
    assert darker != text
    path.write_text(darker)
    gui.key(KEY.f5)
    gui.wait(lambda: not model.engine.busy, "the rebuilt kernels")
    gui.settle()
    dark = gui.picture()
    values["darker by"] = float(dark.mean() / before.mean())
    line = 1 + next(i for i, row in enumerate(text.splitlines()) if "store_color(resample" in row)
    path.write_text(text.replace("store_color(resample", "store_color(no_such_thing + resample"))
    gui.wait(lambda: model.engine.build_error, "the file watch")  # without F5
    gui.settle()
    gui.shot("kernels, broken")
    values |= {"line": line, "error": model.engine.build_error}
    values["picture stays"] = bool((gui.picture() == dark).all())
    values["error is shown"] = gui.exists("//Kernels/copy###copy_build_error")
    path.write_text(text)
    gui.click("//Kernels/###reload_kernels")
    gui.wait(lambda: not model.engine.build_error and not model.engine.busy, "the repaired kernels")
    gui.settle()
    values["recovered"] = bool((gui.picture() == before).all())
    gui.ctx.window_focus("//Inspector")


@case
def dropping(gui: Gui):
    """Bad paths: a message each, the old sequence stays and goes on; then a good one."""
    model, values = gui.model, gui.values
    folder = gui.sequences
    (folder / "empty").mkdir(exist_ok=True)
    (folder / "text.txt").write_text("not a sequence")
    before = gui.picture()
    values["bad"] = {}
    for name in ("no such thing", "empty", "text.txt"):
        model.messages = []
        gui.app.drop([str(folder / name)])
        gui.wait(lambda: model.messages, "a message")
        gui.settle()
        gui.frames(2)
        values["bad"][name] = {
            "message": gui.told(),
            "error": model.messages[-1].error,
            "shown": gui.exists("//###messages"),
            "name": model.info.name,
            "picture stays": bool((gui.picture() == before).all()),
        }
        gui.shot(f"dropping, {name}")
    gui.key(KEY.left_arrow)
    gui.settle()
    values["goes on"] = model.result.request.slot
    values["target"] = Path(model._target).name
    gui.app.drop([str(folder / "large")])
    gui.wait(lambda: model.info.name == "large", "the other sequence")
    gui.settle()
    values["opened"] = model.info.name, model.info.width
    values["recent"] = [Path(path).name for path in model.settings.recent[:2]]
    gui.app.drop([str(folder / "small" / "sequence.json")])
    gui.wait(lambda: model.info.name == "small", "the small one again")
    gui.settle()
    values["by its file"] = model.info.name


@case
def palette_and_help(gui: Gui):
    app, model, values = gui.app, gui.model, gui.values
    gui.key(KEY.p, CTRL)
    gui.frames(2)
    values["palette"] = gui.exists("//###palette")
    gui.ctx.key_chars("over")
    gui.frames(2)
    gui.shot("palette")
    gui.key(KEY.enter)
    gui.settle()
    values["overview"], values["palette closed"] = model.overview, app.palette_text is None
    model.set_overview(False)
    gui.key(KEY.p, CTRL)
    gui.ctx.key_chars("frame")
    gui.key(KEY.down_arrow)
    gui.frames(2)
    values["chosen by Down"] = app.palette_at
    gui.key(KEY.escape)
    gui.frames(2)
    values["closed by Escape"] = app.palette_text is None
    gui.key(KEY.slash, SHIFT)
    gui.frames(3)
    values["help"] = gui.exists("//###help")
    gui.shot("help")
    gui.key(KEY.slash, SHIFT)
    gui.frames(2)
    values["help closed"] = not app.help_open


@case
def open_by_path(gui: Gui):
    """Ctrl+O falls back to the field for a path where the system has no dialog."""
    values, model = gui.values, gui.model
    values["system dialog"] = has_dialogs()
    gui.key(KEY.o, CTRL | (SHIFT if values["system dialog"] else 0))
    gui.frames(3)
    values["window"] = gui.exists("//###open_path")
    gui.shot("open by path")
    gui.ctx.key_chars("room")
    gui.frames(2)
    gui.key(KEY.enter)
    gui.wait(lambda: model.info.name == "room", "the scene")
    gui.settle()
    values["opened"] = model.info.name, model.info.live
    values["closed"] = gui.app.path_text is None
    gui.open(gui.sequences / "small")


@case
def flying(gui: Gui):
    """A built-in scene: the camera is flown, the window follows it, and H brings it home."""
    model, values = gui.model, gui.values
    gui.open("corridor")
    gui.choose("//Modules/###rendering window", "adaptive")
    gui.settle()
    values["window"] = model.window
    camera, before = model.result.camera, gui.picture()
    start, facing = camera.position.copy(), camera.direction.copy()
    gui.key(KEY.g)
    values["flying"] = model.flying
    left, top, width, height = gui.area()
    gui.point(left + width / 2, top + height / 2)
    gui.ctx.key_down(KEY.w.value)
    gui.ctx.mouse_down(1)
    windowed, end, turned = False, time.perf_counter() + 10, 0
    while turned < 30 or (not windowed and time.perf_counter() < end):
        turned += 1
        gui.point(left + width / 2 + 6 * (turned % 40), top + height / 2)
        gui.frames(2)
        windowed |= model.result.source_camera.intrinsics != model.result.display_camera.intrinsics
    gui.ctx.mouse_up(1)
    gui.ctx.key_up(KEY.w.value)
    gui.frames(2)
    values["windowed while turning"] = windowed
    values["compare is not toggled by W"] = model.view.compare
    model.playback.pause()
    gui.settle()
    values["moved by"] = float(np.linalg.norm(model.result.camera.position - start))
    values["turned"] = float(np.abs(model.result.camera.direction - facing).max())
    values["picture changed"] = float((gui.picture() != before).any(-1).mean())
    gui.shot("flying")
    gui.key(KEY.h)
    gui.settle()
    k, alpha = model.result.k, model.result.alpha
    home = model.info.scene.camera(model.info.time(k, alpha), model.info.width, model.info.height)
    values["home"] = float(np.abs(model.result.camera.position - home.position).max())
    values["still flying"] = model.flying
    gui.open(gui.sequences / "small")
