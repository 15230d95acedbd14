"""GUI cases: comparing and measuring."""

from __future__ import annotations

import numpy as np
from viewer_gui_driver import KEY, Gui, collector

CASES, case = collector()


@case
def ways_of_comparing(gui: Gui):
    """Each by its button or key; T shows the truth alone."""
    model, values = gui.model, gui.values
    gui.ctx.window_focus("//Compare")
    gui.frames(2)
    gui.click("//Compare/###compare difference")
    gui.settle()
    values["ways"] = [(model.view.a, model.view.b, model.view.compare)]
    for key in (KEY.m, KEY.m, KEY.t, KEY.t):
        gui.key(key)
        gui.settle()
        values["ways"].append((model.view.a, model.view.b, model.view.compare))
    gui.ctx.window_focus("//Modules")


@case
def flip_error(gui: Gui):
    """NVIDIA's FLIP where it is installed, else the reason why not."""
    model, values = gui.model, gui.values
    values["reason"] = model.comparison.why_not("flip error")
    gui.ctx.window_focus("//Compare")
    gui.frames(2)
    if values["reason"] is None:
        model.comparison.flip_high = 1.0
        gui.click("//Compare/###compare flip error")
        gui.settle()
        gui.shot("FLIP error")
        values["drawn"] = int(gui.picture().max())
        model.set("n", 3)
        gui.settle()
        gui.key(KEY.right_arrow)  # to a time without ground truth
        gui.settle()
        values["colors without truth"] = len(np.unique(gui.inside().reshape(-1, 3), axis=0))
    gui.ctx.window_focus("//Modules")
