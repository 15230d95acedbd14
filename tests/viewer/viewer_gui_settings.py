"""GUI cases: other settings as B, the worst frame, regions of errors, and the walk through a pixel's story."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui
from viewer_gui_driver import CTRL, KEY, SHIFT, Gui, collector

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
    from gffe_cl.lab.metrics import psnr, to_display

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
    values["curve"] = curve
    gui.shot("plot")
    visited = []
    for modifiers in (0, SHIFT, SHIFT):
        gui.key(KEY.j, modifiers)
        gui.settle()
        visited.append(model.slot)
    values["visited"], values["worst"] = visited, sorted(curve, key=curve.get)[:3]
    model.view.b = None
    model.comparison.with_layer("truth")
    model.comparison.set("flip")
    gui.settle()
    images = model.contents.result.images
    shown, true = (to_display(images[name][..., :3], model.source.exposure) for name in ("final", "truth"))
    values["by hand"], values["in the plot"] = psnr(shown, true), curve[model.slot]
    model.comparison.set("off")
    model.comparison.with_settings()
    gui.key(KEY.j, CTRL)
    gui.settle()
    a, b = (dict(zip(*survey.curve(side), strict=True)) for side in (survey.a, survey.b))
    values["most different"] = [model.slot, max(a, key=lambda slot: abs(a[slot] - b[slot]))]
    names = survey.figures(survey.a)[13].values
    values["quantities"] = {name: float(value) for name, value in names.items()}
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
    found = model.regions.map
    values["pixels"] = {name: part.pixels for name, part in found.a.items()}
    values["errors"] = {name: [found.a[name].error, found.b[name].error] for name in found.a}
    gui.click("//Regions/###regions frame/###frame dynamic")
    gui.settle()
    gui.shot("one region")
    values["only"] = model.regions.only
    picture = gui.picture()
    bright = (picture == plain).all(-1)
    inside = []
    for y in range(0, model.source.height, 7):
        for x in range(0, model.source.width, 7):
            sx, sy = (int(c) for c in model.view.screen_at(picture.shape[1::-1], x + 0.5, y + 0.5))
            inside.append((bool(found.labels[y, x] == 3), bool(bright[sy, sx]), int(plain[sy, sx].sum())))
    values["bright inside"] = all(bright for is_inside, bright, _ in inside if is_inside)
    values["dim outside"] = float(np.mean([not bright for is_inside, bright, sum_ in inside if not is_inside]))
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
    source = story.source
    values["source"] = list(source)
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
    from gffe_cl.lab.metrics import psnr, to_display

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
    images = {name: image[40:100, 140:190] for name, image in model.contents.result.images.items() if image.ndim > 1}
    shown, true = (to_display(images[name][..., :3], model.source.exposure) for name in ("final", "truth"))
    error = np.abs(shown - true).mean(-1)
    y, x = np.unravel_index(error.argmax(), error.shape)
    values["psnr"] = [found.psnr, psnr(shown, true)]
    values["worst"] = [list(found.worst), [140 + int(x), 40 + int(y)]]
    values["filled"] = [found.filled, float((images["frame.filled_by"] == 0).mean())]
    values["lengths"] = [found.lengths.sum(), found.count]
    gui.click("//Inspector/###worst_pixel")
    gui.settle()
    values["picked"] = [list(model.pointing.picked), list(model.pointing.story.pixel)]
    gui.key(KEY.right_arrow)
    gui.settle()
    values["of a rendered frame"] = [model.selection.statistics.psnr, model.selection.statistics.filled]
    gui.click("//Inspector/###forget_rectangle")
    values["forgotten"] = model.selection.rectangle
    model.pointing.pick(None)
