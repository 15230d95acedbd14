"""GUI cases: playing, and choosing what is computed."""

from __future__ import annotations

from imgui_bundle import imgui
from viewer_gui_driver import KEY, SHIFT, Gui, collector

CASES, case = collector()


@case
def playback(gui: Gui):
    model, values = gui.model, gui.values
    gui.reset(0)
    gui.click("//Timeline/###play")
    values["plays after the button"] = model.playback.playing
    gui.frames(30)
    values["slots seen"] = model.playback.shown
    gui.click("//Timeline/###play")
    values["plays after the button again"] = model.playback.playing
    for press in ("first", "second"):
        gui.key(KEY.space)
        values[f"plays after the {press} Space"] = model.playback.playing
    gui.reset(5)
    steps = {
        "Right": (KEY.right_arrow, 0),
        "Left": (KEY.left_arrow, 0),
        "Shift+Right": (KEY.right_arrow, SHIFT),
        "Shift+Left": (KEY.left_arrow, SHIFT),
        "End": (KEY.end, 0),
        "Home": (KEY.home, 0),
    }
    values["slots after keys"] = {}
    for name, (key, modifiers) in steps.items():
        gui.key(key, modifiers)
        gui.settle()
        values["slots after keys"][name] = (model.playback.slot, model.contents.result.slot)
    gui.click("//Timeline/###step")
    values["slot after the step button"] = model.playback.slot
    for slot, key in ((4, KEY.left_bracket), (9, KEY.right_bracket)):
        model.playback.seek(slot)
        gui.frames()
        gui.key(key)
    values["points"] = [(model.playback.first, model.playback.last)]
    gui.key(KEY.backslash)
    values["points"].append((model.playback.first, model.playback.last))


def _disabled(gui: Gui) -> list[str]:
    flags = {name: gui.ctx.item_info(f"//Modules/{name}").item_flags for name in ("shading correction", "focus mask")}
    return [name for name, value in flags.items() if value & imgui.ItemFlags_.disabled.value]


@case
def parameters(gui: Gui):
    """Sliders and their reset; what belongs to shading correction is grayed out without a model."""
    model, values = gui.model, gui.values
    values["disabled without a model"] = _disabled(gui)
    gui.click("//Modules/automatic static threshold")
    gui.ctx.item_input_value("//Modules/###static threshold", 8.0)
    gui.settle()
    values["thresholds"] = [model.parameters.options.static_threshold]
    gui.click("//Modules/###reset static threshold")
    values["thresholds"].append(model.parameters.options.static_threshold)
    gui.ctx.item_input_value("//Modules/###generated frames", 3)
    gui.settle()
    values["slots"] = model.playback.slot, model.playback.slots
    gui.click("//Modules/rendering window")
    gui.settle()
    moment = model.contents.result.moment
    values["windowed when off"] = moment.render_camera != moment.display_camera
    gui.click("//Modules/rendering window")
    gui.settle()
