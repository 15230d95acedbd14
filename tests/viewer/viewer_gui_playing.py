"""GUI cases: playing, and choosing what is computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from imgui_bundle import imgui
from scn_models import movers_model
from viewer_gui_driver import KEY, SHIFT, Gui, collector

from gffe_cl.engine.inference import network as inference
from gffe_cl.viewer.engine.slot_maker import SlotMaker
from gffe_cl.viewer.window.timeline import CACHED

CASES, case = collector()


def _slots_played(gui: Gui, frames: int) -> list[int]:
    slots = []
    for _ in range(frames):
        gui.frames()
        if not slots or slots[-1] != gui.model.playback.slot:
            slots.append(gui.model.playback.slot)
    return slots


def _changed(before: dict, after: dict) -> dict[str, list[str]]:
    """Layers by what became of them."""
    both = [name for name in before if name in after]
    same = [
        name
        for name in both
        if before[name].shape == after[name].shape and np.array_equal(before[name], after[name], equal_nan=True)
    ]
    return {
        "same": same,
        "changed": [name for name in both if name not in same],
        "gone": [name for name in before if name not in after],
    }


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


@case
def scrubbing(gui: Gui):
    playback, values = gui.model.playback, gui.values
    left, top, width, height = gui.area("//Timeline/###scrub")
    middle = top + height / 2
    gui.key(KEY.space)
    gui.frames(3)
    gui.point(left + 0.3 * width, middle)
    gui.ctx.mouse_down(0)
    gui.frames(2)
    values["playing while scrubbing"] = playback.playing
    seen = []
    for share in (0.3, 0.5, 0.8, 1.3, 1.3, 0.6, -0.4, -0.4):
        gui.point(left + share * width, middle)
        gui.frames(2)
        seen.append(playback.slot)
    gui.ctx.mouse_up(0)
    gui.frames(3)
    values |= {"slots": seen, "last": playback.slots - 1, "playing afterwards": playback.playing}
    gui.settle()
    values["shown afterwards"] = gui.model.contents.result.slot


@case
def in_and_out(gui: Gui):
    playback, values = gui.model.playback, gui.values
    for slot, key in ((4, KEY.left_bracket), (9, KEY.right_bracket)):
        playback.seek(slot)
        gui.frames()
        gui.key(key)
    values["points"] = (playback.first, playback.last)
    gui.choose("//Timeline/###mode", "every frame")
    gui.key(KEY.space)
    values["looped"] = _slots_played(gui, 60)
    gui.click("//Timeline/loop")
    gui.wait(lambda: not playback.playing, "the out point")
    values["stopped at"] = playback.slot
    gui.key(KEY.backslash)
    values["cleared"] = (playback.first, playback.last, playback.slots)


@case
def cached_playback(gui: Gui):
    """Idle time fills the cache, which the timeline shows; what is played then comes from there."""
    model, values = gui.model, gui.values
    model.show_layer("frame.motion")
    gui.settle()
    gui.wait(lambda: len(model.ahead.cached) == model.playback.slots, "the cache")
    gui.frames(2)
    left, top, width, height = map(int, gui.area("//Timeline/###scrub"))
    below = gui.window()[top + height + 1, left + 1 : left + width - 1].astype(int)
    values["share marked as cached"] = float((np.abs(below - np.multiply(CACHED[:3], 255)).max(-1) < 3).mean())
    computed, make = [], SlotMaker.make
    SlotMaker.make = lambda self, key, layers, **how: computed.append(key.slot) or make(self, key, layers, **how)
    try:
        gui.key(KEY.space)
        gui.wait(lambda: model.playback.shown >= 24, "one and a half laps")
        values["plays while nothing is computed"] = model.playback.playing and not model.busy
        gui.shot("cached_playback, playing")
        gui.key(KEY.space)
        gui.settle()
    finally:
        SlotMaker.make = make
    values["computed"] = computed
    values["shown"] = model.contents.result.slot == model.playback.slot


@case
def modules(gui: Gui):
    """Every toggle of the panel: what it changes, and that switching it back restores everything."""
    before = gui.images()
    for name in ("motion estimation", "background collection", "crack closing", "hole filling"):
        gui.click(f"//Modules/{name}")
        gui.settle()
        gui.values[name] = _changed(before, gui.images())
        gui.shot(f"modules, {name} off")
        gui.click(f"//Modules/{name}")
        gui.settle()
        gui.values[name]["after switching back"] = _changed(before, gui.images())["changed"]


def _disabled(gui: Gui) -> list[str]:
    flags = {name: gui.ctx.item_info(f"//Modules/{name}").item_flags for name in ("shading correction", "focus mask")}
    return [name for name, value in flags.items() if value & imgui.ItemFlags_.disabled.value]


@case
def shading_correction(gui: Gui):
    """Grayed out without a model; with one, both toggles do what they say."""
    model, values = gui.model, gui.values
    model.parameters.set("image_flow", False)  # it changes other pixels, too
    values["disabled without a model"] = _disabled(gui)
    off, installed = gui.images(), inference.default_model
    network = Path(movers_model(gui.sequences / "scn.onnx"))
    inference.default_model = lambda: network
    try:
        on = gui.images()
        values["disabled with a model"] = _disabled(gui)
        mask = on["correction.focus_mask"] > 0
        values["corrected"] = float(mask.mean())
        values["only within the mask"] = bool(((on["final"] != on["gae"]).any(-1) == mask).all())
        values["elsewhere as before"] = bool((on["final"][~mask] == off["final"][~mask]).all())
        x, y = (int(c) for c in np.argwhere(mask)[len(np.argwhere(mask)) // 2][::-1])
        gui.point(*gui.at(x + 0.5, y + 0.5))
        gui.ctx.mouse_click(0)
        gui.settle()
        values["story"] = model.pointing.story.sentences[-1]
        seen = model.pointing.inspection.values["network_input.frames"].ravel()
        values["inspected"] = bool((seen == on["network_input.frames"][:, y // 2, x // 2]).all())
        gui.shot("shading correction, story")
        model.pointing.pick(None)
        for name, plane in (("network_input.frames", 1), ("correction.correction", 5), ("correction.focus_mask", 1)):
            model.show_layer(name)
            gui.settle()
            if plane > 1:
                gui.ctx.item_input_value("//Layers/###plane", plane)
                gui.settle()
            values[f"seen of {name}"] = len(np.unique(gui.inside().reshape(-1, 3), axis=0))
            gui.shot(f"shading correction, {name}")
        gui.click("//Modules/focus mask")
        gui.settle()
        whole = gui.images()
        values["whole image"] = bool((whole["final"] == on["correction.refined"]).all())
        gui.click("//Modules/focus mask")
        gui.settle()
        values["focus mask back"] = _changed(on, gui.images())["changed"]
        gui.click("//Modules/shading correction")
        gui.settle()
        values["switched off"] = _changed(off, gui.images()) | {"disabled": _disabled(gui)}
        gui.click("//Modules/shading correction")
        gui.settle()
        values["switched on"] = _changed(on, gui.images())
    finally:
        model.parameters.set("image_flow", True)
        inference.default_model = installed


@case
def parameters(gui: Gui):
    """The static threshold by its slider, and the number of generated frames."""
    model, values = gui.model, gui.values
    before = gui.images()
    gui.click("//Modules/automatic static threshold")
    gui.settle()
    for name, threshold in (("low", 0.0), ("high", 8.0)):
        gui.ctx.item_input_value("//Modules/###static threshold", threshold)
        gui.settle()
        after = gui.images()
        values[name] = _changed(before, after) | {
            "threshold": model.parameters.options.static_threshold,
            "dynamic pixels": int(after["history.dynamic_mask"].sum()),
        }
    values["dynamic pixels before"] = int(before["history.dynamic_mask"].sum())
    gui.click("//Modules/###reset static threshold")
    values["threshold after reset"] = model.parameters.options.static_threshold
    gui.click("//Modules/automatic static threshold")
    gui.settle()
    gui.ctx.item_input_value("//Modules/###generated frames", 3)
    gui.settle()
    same_time = gui.images()
    values["n = 3"] = _changed(before, same_time) | {"slot": model.playback.slot, "slots": model.playback.slots}
    gui.key(KEY.right_arrow)
    gui.settle()
    values["a quarter later"] = _changed(same_time, gui.images()) | {"alpha": model.contents.result.moment.alpha}


@case
def rendering_window(gui: Gui):
    """The sequence is rendered through a window from its second frame on."""
    values, model = gui.values, gui.model

    def windowed():
        return model.contents.result.moment.render_camera != model.contents.result.moment.display_camera

    before, values["windowed"] = gui.images(), windowed()
    gui.click("//Modules/rendering window")
    gui.settle()
    values |= _changed(before, gui.images()) | {"windowed when off": windowed()}
    gui.shot("rendering window off")
    gui.click("//Modules/rendering window")
    gui.settle()
    values["windowed again"] = windowed()
    values["after switching back"] = _changed(before, gui.images())["changed"]
