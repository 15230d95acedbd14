"""GUI cases: kernels, opening, flying, saving, the window."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import glfw
import numpy as np
from imgui_bundle import glfw_utils, imgui
from PIL import Image
from viewer_gui_driver import CTRL, KEY, SHIFT, Gui, collector

from gffe_cl.metrics import display_values
from gffe_cl.viewer.app import has_dialogs
from gffe_cl.viewer.canvas import read
from gffe_cl.viewer.opening import ScenePlan

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


@case
def appearance(gui: Gui):
    """Theme, size of the interface, hiding the panels."""
    app, values = gui.app, gui.values

    def bright():
        return float(gui.window()[-8:].mean())

    def letters():
        return gui.area("//Modules/crack closing")[3]

    values["bright"] = [bright()]
    gui.key(KEY.t, CTRL)
    gui.frames(2)
    values["bright"].append(bright())
    gui.shot("light theme")
    values["theme"] = app.model.settings.theme
    gui.key(KEY.t, CTRL)
    gui.frames(2)
    values["letters"] = [letters()]
    gui.key(KEY.equal, CTRL)
    gui.frames(2)
    values["letters"].append(letters())
    for _ in range(7):
        gui.key(KEY.equal, CTRL)
    gui.frames(3)
    gui.shot("twice as large")
    for _ in range(8):
        gui.key(KEY.minus, CTRL)
    gui.frames(2)
    values["letters"].append(letters())
    app.model.settings.ui_scale = 0.0
    widths = [gui.area()[2]]
    app.toggle_panel("Kernels")
    gui.key(KEY.b, CTRL)
    gui.frames(4)
    widths.append(gui.area()[2])
    values["layers when hidden"] = app.panel("Layers").is_visible
    gui.shot("panels hidden")
    gui.key(KEY.b, CTRL)
    gui.frames(4)
    widths.append(gui.area()[2])
    values["widths"] = widths
    values["kernels stay closed"] = not app.panel("Kernels").is_visible
    app.toggle_panel("Kernels")
    gui.frames(3)


@case
def resizing(gui: Gui):
    """After a resize the window shows what the canvas drew, where it belongs."""
    values, model = gui.values, gui.model
    window = gui.on_screen(glfw_utils.glfw_window_hello_imgui)
    values["sizes"] = []
    for size in ((900, 600), (1500, 950), (1280, 720)):
        gui.on_screen(lambda size=size: glfw.set_window_size(window, *size))
        gui.wait(lambda size=size: tuple(imgui.get_io().display_size) == size, f"a window of {size}")
        gui.frames(3)
        gui.key(KEY.f)
        gui.settle()
        whole, canvas = gui.window().astype(int), gui.picture()
        left, top, width, height = map(int, gui.area())
        part = whole[top : top + height, left : left + width]
        same = (part == canvas).all(-1)
        expected = gui.on_screen(
            lambda canvas=canvas: read(
                gui.app.canvas.draw(model.comparison.shown(), (canvas.shape[1], canvas.shape[0]), "test")
            )[..., :3].astype(int)
        )
        values["sizes"].append(
            {
                "window": (whole.shape[1], whole.shape[0]),
                "canvas": (canvas.shape[1], canvas.shape[0]),
                "area": (width, height),
                "same": float(same.mean()),
                "right": bool((canvas == expected).all()),
                "fits": bool(model.view.zoom * max(model.info.width / width, model.info.height / height) <= 1),
            }
        )
        gui.shot(f"resizing, {size[0]}×{size[1]}")


def _made(before: set[Path]) -> list[Path]:
    return sorted(set(Path.cwd().iterdir()) - before)


@case
def saving(gui: Gui):
    """PNG, EXR and MP4 in the working folder."""
    from gffe_cl.sequence.exr import read_channels

    model, values = gui.model, gui.values
    before = set(Path.cwd().iterdir())
    gui.key(KEY.s, CTRL)
    gui.frames(2)
    (png,) = _made(before)
    saved = np.asarray(Image.open(png).convert("RGB")).astype(int)
    shown = display_values(model.result.images["final"][..., :3], model.info.exposure)
    values["png"] = {"size": saved.shape, "fault": float(np.abs(saved - shown * 255).max())}
    before = set(Path.cwd().iterdir())
    gui.key(KEY.e, CTRL)
    gui.wait(lambda: model.export is None, "the layers")
    (folder,) = _made(before)
    images = gui.images()
    values["exr"] = {"files": sorted(path.stem for path in folder.iterdir()), "layers": sorted(images)}
    depth = read_channels(folder / "warp.depth.exr", ["Y"], "depth")["Y"]
    values["exr"]["depth is right"] = bool(np.array_equal(depth, images["warp.depth"]))
    model.playback.set_in(2)
    model.playback.set_out(9)
    before = set(Path.cwd().iterdir())
    gui.key(KEY.m, CTRL)
    gui.frames(2)
    values["progress"] = gui.exists("//###export")
    gui.shot("saving")
    gui.wait(lambda: model.export is None, "the video")
    (video,) = _made(before)
    import imageio_ffmpeg

    values["mp4"] = {"frames": imageio_ffmpeg.count_frames_and_secs(video)[0], "name": video.suffix}
    values["back at"] = model.playback.slot
    values["told"] = gui.told()


@case
def cancelling(gui: Gui):
    """A video that is cancelled leaves nothing."""
    model, values = gui.model, gui.values
    model.set_n(7)
    gui.settle()
    before = set(Path.cwd().iterdir())
    gui.key(KEY.m, CTRL)
    gui.wait(lambda: model.export is not None and model.export.done > 3, "some frames")
    values["of"] = model.export.total
    gui.click("//###export/###cancel_export")
    gui.wait(lambda: model.export is None, "the end")
    values["left over"] = [path.name for path in _made(before)]
    values["told"] = gui.told()


@case
def frame_rate(gui: Gui):
    """Frames of the interface per second while 960×540 is computed, the panels with the plots in front."""
    model, values = gui.model, gui.values
    gui.open(gui.sequences / "large")
    model.set_measuring(False)
    for name in ("Compare", "Timings"):
        gui.ctx.window_focus(f"//{name}")
    values["open"] = [name for name in gui.app.panel_names if gui.app.panel(name).is_visible]
    window = gui.on_screen(glfw_utils.glfw_window_hello_imgui)
    for size in ((1280, 720), (1600, 900)):
        gui.on_screen(lambda size=size: glfw.set_window_size(window, *size))
        gui.frames(10)
        model.playback.mode, model.playback.speed = "every frame", 4.0
        model.playback.play()
        gui.frames(5)
        frames, computed, start = 0, model.taken, time.perf_counter()
        longest = now = start
        longest = 0.0
        while now - start < 2.5:
            gui.frames()
            frames, before, now = frames + 1, now, time.perf_counter()
            longest = max(longest, now - before)
        name = f"{size[0]}×{size[1]}"
        values[name] = {
            "interface": frames / (now - start),
            "computed": (model.taken - computed) / (now - start),
            "longest": longest,
        }
        model.playback.pause()
        gui.shot(f"frame rate, {name}")
    values["load"] = os.getloadavg()[0]
    gui.on_screen(lambda: glfw.set_window_size(window, 1280, 720))
    for name in ("Modules", "Inspector"):
        gui.ctx.window_focus(f"//{name}")
    gui.open(gui.sequences / "small")


def leave_while_working(gui: Gui) -> None:
    """Choices that are to be there after a restart; then work that goes on when the window is closed."""
    app, model = gui.app, gui.model
    gui.reset()
    model.show_layer("warp.depth")
    gui.settle()
    model.looks.change(low=2.0, high=9.0, color_map="viridis")
    gui.key(KEY.t, CTRL)
    for name in ("crack closing", "automatic static threshold"):
        gui.click(f"//Modules/{name}")
    gui.ctx.item_input_value("//Modules/###static threshold", 1.5)
    gui.choose("//Timeline/###mode", "every frame")
    gui.choose("//Timeline/###speed", "0.5×")
    gui.click("//Timeline/loop")
    model.view.b = "warp.motion"
    gui.key(KEY.w)
    model.view.split = 0.25
    app.toggle_panel("Timings")
    window = gui.on_screen(glfw_utils.glfw_window_hello_imgui)
    gui.on_screen(lambda: glfw.set_window_size(window, 1100, 700))
    model.plan = ScenePlan(1920, 1080, 0)
    model.open("forest")
    gui.wait(lambda: model.info.name == "forest", "the scene")
    model.playback.seek(60)
    gui.frames(3)
    assert model.engine.busy


def found_again(gui: Gui) -> None:
    """What a restart has restored."""
    app, model, values = gui.app, gui.model, gui.values
    gui.wait(lambda: model.settled, "a settled picture")
    gui.frames(3)
    shown = model.looks.of("warp.depth")
    values |= {
        "display": (shown.low, shown.high, shown.color_map),
        "theme": model.settings.theme,
        "bright": float(gui.window()[-8:].mean()),
        "recent": [Path(path).name for path in model.settings.recent],
        "options": (model.options.crack_closing, model.options.static_threshold, model.options.shading_inputs),
        "playback": model.playback.preferences(),
        "compare": (model.view.compare, model.view.b, model.view.split),
        "panels": {name: app.panel(name).is_visible for name in app.panel_names},
        "window": tuple(imgui.get_io().display_size),
    }
