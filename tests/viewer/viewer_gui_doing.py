"""GUI cases: the window, saving, and what a restart finds."""

from __future__ import annotations

from pathlib import Path

import glfw
import numpy as np
from imgui_bundle import glfw_utils, imgui
from PIL import Image
from viewer_gui_driver import CTRL, KEY, Gui, collector

from gffe_cl.lab.metrics import to_display
from gffe_cl.viewer.engine.sources.opening import ScenePlan

CASES, case = collector()
_ON_SLIDERS = imgui.Col_.text, imgui.Col_.slider_grab, imgui.Col_.slider_grab_active


def _luminance(color) -> float:
    """Of WCAG 2, for contrasts."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (color.x, color.y, color.z)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@case
def appearance(gui: Gui):
    """Theme, size of the interface, hiding the panels."""
    app = gui.app

    def bright():
        return float(gui.window()[-8:].mean())

    def letters():
        return gui.area("//Modules/crack closing")[3]

    def contrast():
        style = imgui.get_style()
        text, *grabs = (_luminance(style.color_(of)) for of in _ON_SLIDERS)
        return min((max(text, grab) + 0.05) / (min(text, grab) + 0.05) for grab in grabs)

    gui.ctx.scroll_to_top("//Modules")  # cases before may have scrolled
    _, top, _, height = gui.area("//Modules/rendering window")  # the last module
    assert gui.on_screen(lambda: imgui.internal.find_window_by_name("Inspector").pos.y) > top + height
    assert bright() < 80 and gui.on_screen(contrast) > 4.5
    gui.key(KEY.t, CTRL)
    gui.frames(2)
    assert app.model.settings.theme == "light" and bright() > 180 and gui.on_screen(contrast) > 4.5
    gui.shot("light theme")
    gui.key(KEY.t, CTRL)
    gui.frames(2)
    usual = letters()
    gui.key(KEY.equal, CTRL)
    gui.frames(2)
    assert letters() > usual
    for _ in range(7):
        gui.key(KEY.equal, CTRL)
    gui.frames(3)
    gui.shot("twice as large")
    *_, width, height = gui.area("//Layers/###exposure")
    assert width > 2.5 * height, "of one line: +0.00 EV has room"
    for _ in range(8):
        gui.key(KEY.minus, CTRL)
    gui.frames(2)
    assert letters() == usual
    app.model.settings.ui_scale = 0.0
    width = gui.area()[2]
    app.docks.toggle("Kernels")
    gui.key(KEY.b, CTRL)
    gui.frames(4)
    assert gui.area()[2] > 1.3 * width and not app.docks.panel("Layers").is_visible
    gui.shot("panels hidden")
    gui.key(KEY.b, CTRL)
    gui.frames(4)
    assert abs(gui.area()[2] - width) <= 3 and not app.docks.panel("Kernels").is_visible
    app.docks.toggle("Layers")
    gui.frames(3)
    app.actions.run("layout")
    gui.frames(4)
    assert abs(gui.area()[2] - width) <= 8 and closed(app) == ["Doctor", "Differences", "Ablation", "Plot", "Over time"]


def closed(app) -> list[str]:
    return [name for name in app.docks.names if not app.docks.panel(name).is_visible]


def _made(before: set[Path]) -> list[Path]:
    return sorted(set(Path.cwd().iterdir()) - before)


@case
def saving(gui: Gui):
    """PNG and EXR in the working folder."""
    from gffe_cl.captures.sequence.exr import read_channels

    model = gui.model
    before = set(Path.cwd().iterdir())
    gui.key(KEY.s, CTRL)
    gui.settle()
    (png,) = _made(before)
    saved = np.asarray(Image.open(png).convert("RGB")).astype(int)
    shown = to_display(model.contents.result.images["final"][..., :3], model.source.exposure)
    height, width = shown.shape[:2]
    assert (height, width) == (108, 192) and np.abs(saved - shown * 255).max() < 1.5  # levels
    before = set(Path.cwd().iterdir())
    gui.key(KEY.e, CTRL)
    gui.frames(2)
    gui.wait(lambda: model.saving.work is None, "the layers")
    (folder,) = _made(before)
    images = gui.images()
    assert sorted(path.stem for path in folder.iterdir()) == sorted(images)
    depth = read_channels(folder / "frame.depth.exr", ["Y"], "depth")["Y"]
    assert np.array_equal(depth, images["frame.depth"]) and ".png" in gui.told() and "layers" in gui.told()


_NOT_ALONE = ("open", "open_path", "save_into", "b_from", "quit", "palette", "stop", "copy_command", "copy_command_b")


@case
def every_action(gui: Gui):
    """Each action without an argument is run, that of a switch twice, so that it is as before."""
    model, actions, before = gui.model, gui.app.actions, len(gui.model.messages)
    for action in [action for action in actions if not action.takes and action.id not in _NOT_ALONE]:
        if gui.on_screen(lambda id=action.id: actions.why_not(id)) is None:
            for _ in range(1 + (action.id == "help" or actions.checked(action.id) is not None)):
                gui.on_screen(lambda id=action.id: actions.run(id))
                gui.frames(2)
            gui.wait(lambda: model.saving.work is None and not model.document.notice, action.id)
            gui.app.palette.close()
            assert not (model.engine.build_error or model.document.failure), action.id
    assert not [message.text for message in model.messages[before:] if message.error]
    actions.release_all()
    gui.app.actions.run("layout")
    gui.frames(3)


def leave_while_working(gui: Gui) -> None:
    """Choices that are to be there after a restart; then work that goes on when the window is closed."""
    app, model = gui.app, gui.model
    gui.reset()
    model.show_layer("frame.depth")
    gui.settle()
    model.looks.change(model.view.a, low=2.0, high=9.0, color_map="viridis")
    gui.key(KEY.t, CTRL)
    for name in ("crack closing", "automatic static threshold"):
        gui.click(f"//Modules/{name}")
    gui.ctx.item_input_value("//Modules/###static threshold", 1.5)
    gui.choose("//Timeline/###mode", "every frame")
    gui.choose("//Timeline/###speed", "0.5×")
    gui.click("//Timeline/loop")
    model.comparison.with_layer("frame.motion")
    gui.key(KEY.w)
    model.view.split = 0.25
    app.docks.toggle("Timings")
    window = gui.on_screen(glfw_utils.glfw_window_hello_imgui)
    gui.on_screen(lambda: glfw.set_window_size(window, 1100, 700))
    model.document.plan = ScenePlan(1920, 1080, 0)
    model.open("forest")
    gui.wait(lambda: model.source.name == "forest", "the scene")
    model.playback.seek(60)
    gui.frames(3)
    assert model.busy


def found_again(gui: Gui) -> None:
    """What a restart has restored."""
    app, model = gui.app, gui.model
    gui.wait(lambda: model.settled, "a settled picture")
    gui.frames(3)
    shown, options = model.looks.of("frame.depth"), model.parameters.options
    assert (shown.low, shown.high, shown.color_map) == (2.0, 9.0, "viridis")
    assert model.settings.theme == "light" and gui.window()[-8:].mean() > 180
    recent = [Path(path).name for path in model.settings.recent]
    assert recent[0] == "small" and "large" in recent
    assert (options.crack_closing, options.static_threshold, options.shading_inputs) == (False, 1.5, True)
    assert model.playback.preferences() == {"mode": "every frame", "speed": 0.5, "loop": False}
    assert (model.view.compare, model.view.b, model.view.split) == ("split", "frame.motion", 0.25)
    assert closed(app) == ["Timings", "Doctor", "Differences", "Ablation", "Plot", "Over time"]
    assert tuple(imgui.get_io().display_size) == (1100, 700)
