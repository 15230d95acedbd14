"""GUI cases: ways of comparing, other settings as B, the worst frame and pixel, the walk through a story."""

from __future__ import annotations

import numpy as np
from viewer_gui_driver import KEY, SHIFT, Gui, collector

CASES, case = collector()
ALT = KEY.mod_alt.value


@case
def finding_frames(gui: Gui):
    """Every generated frame is measured; the worst one is found, and its worst pixel; a click goes to a frame."""
    model, survey = gui.model, gui.model.survey
    gui.key(KEY.k)
    model.comparison.with_settings()
    model.set("motion", False)
    gui.settle()
    gui.app.docks.show("Plot")
    model.measured.forget()  # what earlier cases have shown
    gui.frames(3)
    assert not gui.exists("//Plot/###survey")
    gui.shot("empty plot")
    gui.key(KEY.j, ALT)
    gui.wait(lambda: survey.on and not survey.busy, "the survey", 60)
    gui.frames(3)
    assert gui.exists("//Plot/###survey")
    assert all(survey.curve(side)[0].tolist() == list(range(1, 16, 2)) for side in (survey.a, survey.b))
    curve = dict(zip(*map(list, survey.curve(survey.a)), strict=True))
    gui.shot("plot")
    gui.key(KEY.j)
    gui.settle()
    assert model.slot == min(curve, key=curve.get)
    gui.key(KEY.m)
    gui.settle()
    gui.key(KEY.w, ALT)
    gui.settle()
    assert model.pointing.picked is not None and "largest: " in model.messages[-1].text
    model.comparison.set("off")
    gui.ctx.mouse_move("//Plot/###survey")
    left, top, width, height = gui.area("//Plot/###survey")
    gui.point(left + 0.62 * width, top + 0.4 * height)
    gui.ctx.mouse_click(0)
    gui.frames(2)
    gui.settle()
    assert model.slot == 9
    model.survey.on = False
    gui.app.docks.panel("Plot").is_visible = False
    gui.frames(3)


@case
def neighbors(gui: Gui):
    """B is a frame before or after, at the same place or along motion vectors, which explain most of the change."""
    model, differences = gui.model, {}
    model.playback.seek(12)
    slots = {"rendered frame before": (KEY.p, 0, 10), "rendered frame after": (KEY.p, SHIFT, 14)}
    for which, (key, modifiers, slot) in (slots | {"new frame before": (KEY.p, ALT, 11)}).items():
        gui.key(key, modifiers)
        for follows in (False, True):
            gui.settle()
            gui.frames(2)
            assert (model.comparison.neighbor, model.contents.second.slot, model.view.compare) == (
                which,
                slot,
                "difference",
            )
            picture = gui.picture()
            marked = (picture == (255, 0, 255)).all(-1)
            differences[which, follows] = float(picture[~marked].mean())
            gui.key(KEY.v)
        assert differences[which, True] < 0.8 * differences[which, False], (which, differences)
    gui.settle()
    gui.shot("neighbors")
    model.playback.seek(0)
    gui.settle()
    assert model.comparison.scale_text() == "there is no new frame before here: nothing is compared"
    model.comparison.with_layer("truth")


@case
def marked_frames_and_rectangles(gui: Gui):
    """I goes to the next marked frame; with Shift a drag marks a rectangle, whose statistics the inspector has."""
    model = gui.model
    gui.wait(lambda: not model.document.scan.busy, "the scan")
    model.document.scan._found |= {k: {"invalid": "3 pixels"} for k in (2, 6)}
    model.document.scan._marks = ((-1, 0), {})
    for modifiers, slot in ((0, 4), (0, 12), (SHIFT, 4)):
        gui.key(KEY.i, modifiers)
        gui.settle()
        assert model.slot == slot and "3 pixels" in model.messages[-1].text
    left, top, width = map(int, gui.area("//Timeline/###scrub")[:3])
    strip = gui.window()[top - 2, left + round(width * 2.5 / model.playback.count)]
    assert strip.tolist() == [255, 0, 255]
    gui.key(KEY.d)
    gui.settle()
    gui.ctx.key_down(KEY.mod_shift.value)
    gui.drag(gui.at(20.5, 30.5), gui.at(59.5, 49.5))
    gui.ctx.key_up(KEY.mod_shift.value)
    assert model.pointing.rectangle == (20, 30, 60, 50)
    gui.wait(lambda: len(model.statistics()) == 9, "the statistics of A, B and A − B")
    gui.point(*gui.at(30.5, 40.5))
    gui.frames(3)
    gui.shot("rectangle")
    gui.click("//Inspector/###forget_rectangle")
    assert model.pointing.rectangle is None


@case
def walking_along_a_story(gui: Gui):
    """The links of a story: to the rendered frame and pixel, to the layer that decided, and back."""
    model = gui.model
    gui.ctx.window_focus("//Inspector")
    model.pointing.pick((180, 84))  # on the walker
    gui.settle()
    story = model.pointing.story
    links = [(link.label, link.layer) for step in story.sentences for link in getattr(step, "links", ())]
    assert ("frame 6", "final") in links and ("dynamic mask", "history.dynamic_mask") in links
    way = np.array([point.px for point in story.way])
    assert [point.k for point in story.way] == [6, 5, 4, 3, 2, 1, 0]
    steps = np.diff(way, axis=0)  # back in time, a walker who comes nearer from the left
    assert (steps[:, 0] < -2).all() and (np.abs(steps) < 8).all()
    gui.shot("way of a fragment")
    before = model.view.a, model.slot, model.pointing.picked
    gui.click("//Inspector/###0 frame 6")
    gui.settle()
    assert model.slot == 12 and model.pointing.story.sentences[0] == "Rendered frame 6 as it is."
    assert np.abs(np.add(model.pointing.picked, 0.5) - way[0]).max() <= 0.5
    gui.click("//Inspector/###1 dynamic mask")
    gui.settle()
    assert model.view.a == "history.dynamic_mask"
    gui.click(f"//Inspector/###way {story.way[2].k}")
    gui.settle()
    assert model.slot == 8 and np.abs(np.add(model.pointing.picked, 0.5) - way[2]).max() <= 1.5
    for _ in range(3):
        gui.key(KEY.backspace)
        gui.settle()
    assert (model.view.a, model.slot, model.pointing.picked) == before
    assert gui.app.actions.why_not("back") == "no link was followed"
    model.pointing.pick(None)
