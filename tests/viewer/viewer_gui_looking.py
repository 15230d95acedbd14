"""GUI cases: layers, and looking closer."""

from __future__ import annotations

import numpy as np
from imgui_bundle import glfw_utils, imgui
from viewer_gui_driver import KEY, Gui, collector, glfw

from gffe_cl.lab.metrics import to_display

CASES, case = collector()


@case
def overview(gui: Gui):
    model = gui.model
    gui.key(KEY.o)
    gui.settle()
    left, top, width, height = gui.area("//Picture/**/###overview")
    size = int(width), int(height)
    caption = round(gui.on_screen(imgui.get_text_line_height)) + 3
    tiles = gui.on_screen(lambda: gui.app.canvas.overview(model.looks.tiles(), size, caption=caption)[1])
    assert [tile.name for tile in tiles] == [spec.name for spec in model.contents.layers]
    gui.shot("overview")
    tile = next(tile for tile in tiles if tile.name == "frame.depth")
    gui.point(left + tile.x + tile.width / 2, top + tile.y + tile.height / 2)
    gui.ctx.mouse_click(0)
    gui.settle()
    assert (model.view.a, model.choices.overview) == ("frame.depth", False)


@case
def color_bars(gui: Gui):
    """Beside a map stands its ramp, with numbers, or its wheel."""
    for name, has_bar in (("final", False), ("rendered.depth", True), ("rendered.motion", True)):
        gui.model.show_layer(name)
        gui.settle()
        gui.frames(2)
        left, top, width, height = map(int, gui.area())
        rows, columns = slice(height // 5, height), slice(4 * width // 5, width)
        drawn, picture = (image[rows, columns] for image in (gui.window()[top:, left : left + width], gui.picture()))
        colors = len(np.unique(drawn[(drawn[..., :3] != picture[..., :3]).any(-1)], axis=0))
        assert colors > 50 if has_bar else colors == 0, (name, colors)


@case
def story(gui: Gui):
    """A click on a pixel of the walker: its story, its trajectory over the picture; forgotten again."""
    model = gui.model
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
    assert model.pointing.picked == (x, y) and story.dynamic and len(story.sentences) >= 2
    assert len(story.trajectory) >= 3 and np.abs(np.subtract(story.trajectory[-1], (x + 0.5, y + 0.5))).max() <= 1
    gui.shot("story")
    after = gui.window()
    for point, color in ((story.trajectory[0], (255, 178, 64)), (story.trajectory[-1], (89, 217, 255))):
        sx, sy = map(int, gui.at(*point))
        assert np.abs(after[sy, sx].astype(int) - color).max() < 12
    assert (before != after).any() and (gui.picture() == plain).all(), "marks are over the picture"
    gui.click("//Inspector/###forget_story")
    gui.frames(3)
    assert model.pointing.picked is model.pointing.story is None and not gui.exists("//Inspector/###forget_story")


def shows_the_picture(gui: Gui):
    """The window has the picture at its place, below numbers and captions."""
    gui.settle()
    gui.frames(2)
    left, top, width, height = map(int, gui.area())
    on_screen, picture = gui.window()[top : top + height, left : left + width], gui.picture()
    colored = np.ptp(picture, axis=-1) > 9
    assert colored.mean() > 0.2 and (on_screen == picture)[colored].mean() > 0.6


def smoke(gui: Gui):
    """One look at everything that a person touches first."""
    model = gui.model
    model.playback.seek(0)
    gui.settle()
    image = to_display(model.contents.image("final")[..., :3].astype(np.float32), model.source.exposure)
    (left, top), picture = gui.area()[:2], gui.picture()
    for x, y in ((2, 3), (9, 6), (6, 1)):
        right, down = gui.at(x + 0.5, y + 0.5)
        assert np.abs(picture[int(down - top), int(right - left)] - 255 * image[y, x]).max() <= 2
    shows_the_picture(gui)
    glfw.set_window_size(glfw_utils.glfw_window_hello_imgui(), 1100, 800)
    gui.wait(lambda: imgui.get_io().display_size.y == 800, "the window's size")
    shows_the_picture(gui)
    gui.ctx.undock_window("//Picture")
    gui.wait(lambda: gui.app.beneath is None, "a floating picture")
    shows_the_picture(gui)
    gui.app.docks.reset()
    for key, slot in ((KEY.right_arrow, 1), (KEY.right_arrow, 2), (KEY.left_arrow, 1)):
        gui.key(key)
        gui.settle()
        assert model.contents.result.slot == slot
    for pixel in ((3, 4), (9, 7)):
        before = model.pointing.inspection
        gui.point(*gui.at(pixel[0] + 0.5, pixel[1] + 0.5))
        gui.wait(lambda before=before: (seen := model.pointing.inspection) and seen is not before, "values", 20)
        assert model.pointing.inspection.pixel == pixel
    at, zoom = gui.at(9.5, 7.5), model.view.zoom
    gui.ctx.mouse_wheel_y(1)
    gui.frames(2)
    assert model.view.zoom > zoom and np.allclose(gui.at(9.5, 7.5), at, atol=1), "zoomed at the pointer"
    gui.shot("smoke, numbers")
    gui.key(KEY.f)
    gui.key(KEY.w)
    left, top, width, height = gui.area()
    gui.drag((left + width / 2, top + height / 2), (left + width / 4, top + height / 2))
    assert abs(model.view.split - 0.25) <= 0.01
    gui.key(KEY.w)
    left, top, width, height = gui.area("//Timeline/###scrub")
    for share, slot in ((0.05, 0), (0.95, 5)):
        gui.drag((left + width / 2, top + height / 2), (left + share * width, top + height / 2))
        gui.settle()
        assert model.slot == slot
    gui.point(*gui.at(3.5, 4.5))
    gui.ctx.mouse_click(0)
    gui.settle()
    assert model.pointing.story.pixel == (3, 4)
    gui.click("//Modules/motion estimation")
    gui.settle()
    assert not model.contents.result.setup.options.motion
    model.show_layer("frame.depth")
    gui.app.docks.show("Brightest")
    gui.settle()
    gui.click("//Brightest/###brightest_final")
    assert model.view.a == "final", "the panel that docs/map.md has as an example"
