"""GUI cases: other settings as B, the worst frame, regions of errors, and the walk through a pixel's story."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui
from viewer_gui_driver import KEY, SHIFT, Gui, collector

CASES, case = collector()
ALT = KEY.mod_alt.value


@case
def settings_a_and_b(gui: Gui):
    """K keeps what is chosen as B; A is changed, and compared with it in every way."""
    model, values = gui.model, gui.values
    gui.settle()
    values["usual"] = before = gui.picture()
    gui.key(KEY.k)
    values["kept"] = model.kept.b.name
    model.set("motion", False)
    gui.settle()
    values["A differs"] = bool((gui.picture() != before).any())
    a = gui.picture()
    gui.key(KEY.w)
    gui.settle()
    picture, split = gui.picture(), int(model.view.split * gui.picture().shape[1])
    gui.shot("settings, wipe")
    values["left is A"] = bool((picture[:, : split - 2] == a[:, : split - 2]).all())
    values["right is B"] = bool((picture[:, split + 2 :] == before[:, split + 2 :]).all())
    gui.key(KEY.d)
    gui.settle()
    difference = gui.picture()
    inside = (a != a[0, 0]).any(-1) & (before != before[0, 0]).any(-1)
    expected = np.clip(np.abs(a - before) * 4, 0, 255)
    values["largest fault of the difference"] = int(np.abs(difference - expected)[inside].max())
    model.show_layer("frame.filled_by")
    gui.settle()
    values["B follows A's layer"] = model.view.b
    gui.shot("settings, difference of another layer")
    model.show_layer("final")
    gui.key(KEY.d)
    gui.settle()
    gui.ctx.key_down(KEY.b.value)
    gui.frames(3)
    gui.settle()
    values["held shows B"] = bool((gui.picture() == before).all())
    gui.ctx.key_up(KEY.b.value)
    gui.frames(2)
    gui.ctx.window_focus("//Compare")
    gui.frames(2)
    model.comparison.set("split")
    gui.click("//Compare/measure")
    gui.wait(lambda: "ssim" in getattr(model.metrics.get(13), "values", {}), "A's metrics")
    gui.wait(lambda: "ssim" in getattr(model.metrics_of_second().get(13), "values", {}), "B's metrics")
    gui.shot("settings, scores")
    values["scores"] = [of[13].values["psnr"] for of in (model.metrics, model.metrics_of_second())]
    slots = []
    for _ in range(3):
        gui.key(KEY.right_arrow)
        gui.settle()
        slots.append([model.contents.result.request.slot, model.contents.second.request.slot])
    values["slots"] = slots
    gui.click("//Compare/measure")
    gui.key(KEY.k, ALT)
    values["command"] = gui.on_screen(imgui.get_clipboard_text)
    gui.key(KEY.k, SHIFT)
    gui.settle()
    values["swapped"] = model.parameters.value("motion")
    model.comparison.set("off")
    gui.ctx.window_focus("//Modules")
    values.pop("usual")
