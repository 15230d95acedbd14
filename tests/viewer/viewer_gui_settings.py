"""GUI cases: ways of comparing, other settings as B, the worst frame and pixel, the walk through a story."""

from __future__ import annotations

from viewer_gui_driver import KEY, Gui, collector

CASES, case = collector()
ALT = KEY.mod_alt.value


@case
def finding_frames(gui: Gui):
    """Every generated frame is measured; the worst one is found, and its worst pixel; a click goes to a frame."""
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
    gui.key(KEY.j)
    gui.settle()
    values["worst"] = [model.slot, min(curve, key=curve.get)]
    model.comparison.set("error")
    gui.settle()
    gui.key(KEY.w, ALT)
    gui.settle()
    values["worst pixel"] = [model.pointing.picked is not None, model.messages[-1].text]
    model.comparison.set("off")
    gui.ctx.mouse_move("//Plot/###survey")
    left, top, width, height = gui.area("//Plot/###survey")
    gui.point(left + 0.62 * width, top + 0.4 * height)
    gui.ctx.mouse_click(0)
    gui.frames(2)
    gui.settle()
    values["clicked"] = model.slot
    model.survey.on = False
    gui.app.docks.panel("Plot").is_visible = False
    gui.frames(3)


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
    values["back is disabled"] = gui.app.actions.why_not("back")
    model.pointing.pick(None)
