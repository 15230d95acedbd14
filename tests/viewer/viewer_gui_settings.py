"""GUI cases: ways of comparing, other settings as B, the worst frame, regions of errors, the walk through a story."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui
from viewer_gui_driver import CTRL, KEY, SHIFT, Gui, collector

CASES, case = collector()
ALT = KEY.mod_alt.value


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
    gui.wait(lambda: "ssim" in getattr(model.survey.figures(model.survey.b).get(13), "values", {}), "B's metrics")
    gui.shot("settings, scores")
    values["scores"] = [of[13].values["psnr"] for of in (model.metrics, model.survey.figures(model.survey.b))]
    slots = []
    for _ in range(3):
        gui.key(KEY.right_arrow)
        gui.settle()
        slots.append([model.contents.result.slot, model.contents.second.slot])
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


@case
def finding_frames(gui: Gui):
    """Every generated frame is measured; the worst, the next worse and the largest difference are found."""
    model, values = gui.model, gui.values
    survey = model.survey
    gui.key(KEY.k)
    model.comparison.with_settings()
    model.set("motion", False)
    gui.settle()
    gui.app.docks.show("Plot")
    model.measured.forget()  # what earlier cases have shown
    gui.frames(3)
    values["empty"] = [gui.exists("//Plot/###survey")]
    gui.shot("empty plot")
    gui.key(KEY.j, ALT)
    gui.wait(lambda: survey.on and not survey.busy, "the survey", 60)
    gui.frames(3)
    values["empty"].append(gui.exists("//Plot/###survey"))
    values["slots"] = [sorted(map(int, survey.curve(side)[0])) for side in (survey.a, survey.b)]
    curve = dict(zip(*map(list, survey.curve(survey.a)), strict=True))
    gui.shot("plot")
    visited = []
    for modifiers in (0, SHIFT, SHIFT):
        gui.key(KEY.j, modifiers)
        gui.settle()
        visited.append(model.slot)
    values["visited"], values["worst"] = visited, sorted(curve, key=curve.get)[:3]
    gui.key(KEY.j, CTRL)
    gui.settle()
    a, b = (dict(zip(*survey.curve(side), strict=True)) for side in (survey.a, survey.b))
    values["most different"] = [model.slot, max(a, key=lambda slot: abs(a[slot] - b[slot]))]
    gui.ctx.mouse_move("//Plot/###survey")
    gui.click("//Plot/###quantity")
    gui.click("//$FOCUSED/disoccluded")
    gui.settle()
    gui.shot("plot of disocclusions")
    left, top, width, height = gui.area("//Plot/###survey")
    gui.point(left + 0.62 * width, top + 0.4 * height)
    gui.ctx.mouse_click(0)
    gui.frames(2)
    gui.settle()
    values["clicked"] = model.slot
    model.survey.on = False
    survey.quantity = "psnr"
    gui.app.docks.panel("Plot").is_visible = False
    gui.frames(3)


@case
def regions_of_errors(gui: Gui):
    """Where the error of a frame lies; one region is seen alone."""
    model, values = gui.model, gui.values
    model.set("motion", False)
    model.set("window", False)
    gui.settle()
    gui.key(KEY.k)
    model.comparison.with_settings()
    model.set("motion", True)
    model.comparison.set("split")
    gui.ctx.window_focus("//Regions")
    gui.frames(2)
    gui.settle()
    plain = gui.picture()
    gui.click("//Regions/over the picture")
    gui.settle()
    gui.shot("regions")
    values["tinted"] = float((gui.picture() != plain).any(-1).mean())
    gui.click("//Regions/###regions frame/###frame dynamic")
    gui.settle()
    gui.shot("one region")
    values["only"] = model.regions.only
    values["dimmed"] = float((gui.picture() != plain).any(-1).mean())
    gui.click("//Regions/###regions frame/###frame dynamic")
    values["all again"] = model.regions.only
    gui.key(KEY.r, ALT)
    gui.settle()
    values["as before"] = bool((gui.picture() == plain).all())
    model.comparison.set("off")
    gui.ctx.window_focus("//Inspector")
    gui.frames(2)


@case
def walking_along_a_story(gui: Gui):
    """The links of a story: to the rendered frame and pixel, to the layer that decided, and back."""
    model, values = gui.model, gui.values
    gui.ctx.window_focus("//Inspector")
    model.pointing.pick((180, 84))  # on the walker
    gui.settle()
    story = model.pointing.story
    values["links"] = [[link.label, link.layer] for step in story.sentences for link in getattr(step, "links", ())]
    values["way"] = [[point.k, *point.px] for point in story.way]
    gui.shot("way of a fragment")
    before = model.view.a, model.slot, model.pointing.picked
    gui.click("//Inspector/###0 frame 6")
    gui.settle()
    values["at the rendered frame"] = [model.slot, list(model.pointing.picked), model.pointing.story.sentences[0]]
    gui.click("//Inspector/###1 dynamic mask")
    gui.settle()
    values["layer"] = model.view.a
    gui.click(f"//Inspector/###way {story.way[2].k}")
    gui.settle()
    values["two before"] = [model.slot, list(model.pointing.picked)]
    for _ in range(3):
        gui.key(KEY.backspace)
        gui.settle()
    values["back"] = (model.view.a, model.slot, model.pointing.picked) == before
    values["back is disabled"] = gui.app.actions["back"].enabled()
    model.pointing.pick(None)


@case
def rectangle(gui: Gui):
    """Drawn with Shift: what filled its pixels, their errors, their motion."""
    model, values = gui.model, gui.values
    gui.settle()
    center = model.view.center
    gui.ctx.key_down(imgui.Key.mod_shift.value)
    gui.drag(gui.at(140.5, 40.5), gui.at(189.5, 99.5))
    gui.ctx.key_up(imgui.Key.mod_shift.value)
    gui.settle()
    values["rectangle"] = model.selection.rectangle
    values["panned"] = model.view.center != center
    gui.ctx.window_focus("//Inspector")
    gui.frames(3)
    gui.shot("rectangle of pixels")
    found = model.selection.statistics
    gui.click("//Inspector/###worst_pixel")
    gui.settle()
    values["worst"] = [list(found.worst), list(model.pointing.picked), list(model.pointing.story.pixel)]
    gui.click("//Inspector/###forget_rectangle")
    values["forgotten"] = model.selection.rectangle
    model.pointing.pick(None)
