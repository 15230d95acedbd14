"""GUI cases: layers, and looking closer."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui
from viewer_gui_driver import KEY, Gui, collector

from gffe_cl.lab.metrics import to_display

CASES, case = collector()


@case
def overview(gui: Gui):
    model, values = gui.model, gui.values
    gui.key(KEY.o)
    gui.settle()
    left, top, width, height = gui.area("//Picture/**/###overview")
    size = int(width), int(height)
    caption = round(gui.on_screen(imgui.get_text_line_height)) + 3
    tiles = gui.on_screen(lambda: gui.app.canvas.overview(model.looks.tiles(), size, caption=caption)[1])
    values["tiles"], values["layers"] = [tile.name for tile in tiles], [spec.name for spec in model.contents.layers]
    gui.shot("overview")
    tile = next(tile for tile in tiles if tile.name == "frame.depth")
    gui.point(left + tile.x + tile.width / 2, top + tile.y + tile.height / 2)
    gui.ctx.mouse_click(0)
    gui.settle()
    values["opened"] = model.view.a, model.choices.overview


@case
def color_bars(gui: Gui):
    """Beside a map stands its ramp, with numbers."""
    model, values = gui.model, gui.values
    colors = {}
    for name in ("final", "rendered.depth", "rendered.motion"):
        model.show_layer(name)
        gui.settle()
        gui.frames(2)
        left, top, width, height = map(int, gui.area())
        rows, columns = slice(height // 5, height // 2), slice(4 * width // 5, width)
        drawn, picture = (image[rows, columns] for image in (gui.window()[top:, left : left + width], gui.picture()))
        colors[name] = len(np.unique(drawn[(drawn[..., :3] != picture[..., :3]).any(-1)], axis=0))
    values["colors"] = colors


@case
def story(gui: Gui):
    """A click on a pixel of the walker: its story, its trajectory over the picture; forgotten again."""
    model, values = gui.model, gui.values
    mask = gui.images()["frame.dynamic"]
    ys, xs = np.nonzero(mask[:, : model.source.width - 8])
    x, y = int(np.median(xs)), int(np.median(ys))
    assert mask[y, x], "the walker has a hole in the middle"
    plain = gui.picture()
    gui.point(*gui.at(x + 0.5, y + 0.5))
    before = gui.window()
    gui.ctx.mouse_click(0)
    gui.settle()
    story = model.pointing.story
    values |= {
        "pixel": (x, y),
        "picked": model.pointing.picked,
        "dynamic": story.dynamic,
        "filled by": story.filled_by,
        "sentences": story.sentences,
        "trajectory": story.trajectory,
    }
    gui.shot("story")
    after = gui.window()
    values["marked"] = []
    for point in story.trajectory:
        sx, sy = gui.at(*point)
        r, g, b = after[int(sy), int(sx)].astype(int)
        values["marked"].append((int(r), int(g), int(b)))
    values["canvas changed"] = bool((gui.picture() != plain).any())
    values["window changed"] = bool((before != after).any())
    gui.click("//Inspector/###forget_story")
    gui.frames(3)
    values["forgotten"] = (
        model.pointing.picked is None and model.pointing.story is None and not gui.exists("//Inspector/###forget_story")
    )


def smoke(gui: Gui):
    """One look at everything that a person touches first."""
    model, values = gui.model, gui.values
    model.playback.seek(0)
    gui.settle()
    image = to_display(model.contents.image("final")[..., :3].astype(np.float32), model.source.exposure)
    pixels = [(2, 3), (9, 6), (6, 1)]
    values["expected"] = [255 * image[y, x] for x, y in pixels]
    left, top = gui.area()[:2]
    places = [gui.at(x + 0.5, y + 0.5) for x, y in pixels]
    picture = gui.picture()
    values["shown"] = [picture[int(y - top), int(x - left)] for x, y in places]
    values["slots after keys"] = []
    for key in (KEY.right_arrow, KEY.right_arrow, KEY.left_arrow):
        gui.key(key)
        gui.settle()
        values["slots after keys"].append(model.contents.result.slot)
    values["pointed at"] = []
    for x, y in ((3, 4), (9, 7)):
        before = model.pointing.inspection
        gui.point(*gui.at(x + 0.5, y + 0.5))
        gui.wait(lambda before=before: (seen := model.pointing.inspection) and seen is not before, "values", 20)
        values["pointed at"].append(model.pointing.inspection.pixel)
    at, zoom = gui.at(9.5, 7.5), model.view.zoom
    gui.ctx.mouse_wheel_y(1)
    gui.frames(2)
    values["zoomed at the pointer"] = model.view.zoom > zoom and bool(np.allclose(gui.at(9.5, 7.5), at, atol=1))
    gui.shot("smoke, numbers")
    gui.key(KEY.f)
    gui.key(KEY.w)
    left, top, width, height = gui.area()
    gui.drag((left + width / 2, top + height / 2), (left + width / 4, top + height / 2))
    values["wipe"] = model.view.split
    gui.key(KEY.w)
    left, top, width, height = gui.area("//Timeline/###scrub")
    values["scrubbed to"] = []
    for share in (0.05, 0.95):
        gui.drag((left + width / 2, top + height / 2), (left + share * width, top + height / 2))
        gui.settle()
        values["scrubbed to"].append(model.slot)
    gui.point(*gui.at(3.5, 4.5))
    gui.ctx.mouse_click(0)
    gui.settle()
    values["told"] = model.pointing.story.pixel
    gui.click("//Modules/motion estimation")
    gui.settle()
    values["switched"] = model.contents.result.setup.options.motion
    model.show_layer("frame.depth")
    gui.app.docks.show("Brightest")
    gui.settle()
    gui.click("//Brightest/###brightest_final")
    values["shown by a new panel"] = model.view.a
