"""Looks at all panels in small and large windows; started by test_viewer_sizes.py under xvfb-run.

viewer_sizes_case.py DPI SEQUENCE REPORT.json PICTURES: opens the viewer on a screen of DPI (96: content scale 1), in
the smallest and the largest window with letters of `LETTERS`, shows one panel after the other, and writes what is cut
or overlaps.
"""

import json
import sys
from collections import defaultdict
from pathlib import Path

SMALLEST, LARGEST = (900, 620), (3840, 2160)  # windows: logical pixels, and the screen's
LETTERS = (12, 24)  # logical pixels
_USUAL = 15
_ITEMS = (
    *("text", "text_disabled", "text_colored", "text_unformatted", "text_wrapped", "text_link", "button", "selectable"),
    *("checkbox", "radio_button", "begin_combo", "slider_float", "slider_int", "input_text", "input_text_with_hint"),
    *("separator_text", "drag_float_range2", "color_button", "invisible_button"),
)
_TOLERANCE = 1.5  # pixels


class Recorder:
    """Rectangles of the items of a frame, by the window they are in: (text, left, top, right, bottom)."""

    def __init__(self):
        from imgui_bundle import imgui

        from gffe_cl.viewer.window import widgets

        self.items, self.captions, self.windows = defaultdict(list), [], {}
        for name in _ITEMS:
            setattr(imgui, name, self._recorded(getattr(imgui, name)))
        label = widgets.label

        def caption(marks, text, x, y, right=False):
            label(marks, text, x, y, right)
            size, pad = imgui.calc_text_size(text), 3 * widgets.mark_unit()
            left = x - size.x if right else x
            self.captions.append((text, left - pad, y - pad, left + size.x + pad, y + size.y + pad))

        widgets.label = caption

    def clear(self):
        self.items.clear()
        self.captions.clear()

    def _recorded(self, draw):
        from imgui_bundle import imgui

        def recorded(*arguments, **named):
            made = draw(*arguments, **named)
            window, text = (
                imgui.internal.get_current_window(),
                str(arguments[-1 if draw.__name__ == "text_colored" else 0]),
            )
            if draw.__name__ == "begin_combo" and made:
                return made
            first, last = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            self.items[window.name].append((f"{draw.__name__} {text}", first.x, first.y, last.x, last.y))
            clip = window.inner_rect
            self.windows[window.name] = clip.min.x, clip.min.y, clip.max.x, clip.max.y, window.scroll_max.y
            return made

        return recorded


def faults(recorder: Recorder, app) -> list[str]:
    """What is cut on the right or at the foot, and what overlaps."""
    found = []
    for name, items in recorder.items.items():
        left, _, right, bottom, scrolls = recorder.windows[name]
        for text, x0, _, x1, y1 in items:
            if text.startswith("selectable"):  # it reaches into the margins, and its text is cut to the room
                continue
            if x1 > right + _TOLERANCE or x0 < left - _TOLERANCE:
                found.append(f"{name}: '{text}' is cut: {x0:.0f} to {x1:.0f}, window {left:.0f} to {right:.0f}")
            if not scrolls and y1 > bottom + _TOLERANCE:
                found.append(f"{name}: '{text}' is below the window: {y1:.0f}, window to {bottom:.0f}")
        if name == "Timeline" and scrolls:
            found.append(f"{name}: is {scrolls:.0f} pixels too low")
        boxes = [item for item in items if not item[0].startswith(("invisible_button", "selectable"))]
        found += [f"{name}: '{a}' covers '{b}'" for a, b in overlapping(boxes)]
    found += [f"caption '{a}' covers '{b}'" for a, b in overlapping(recorder.captions)]
    model = app.model
    if model.framing.is_fitted and recorder.captions and not model.choices.overview:
        (x, y), (wide, high) = app.picture_at, model.contents.size
        first, last = (model.view.screen_at(app.canvas_size, *at) for at in ((0, 0), (wide, high)))
        picture = ("the picture", x + first[0], y + first[1], x + last[0], y + last[1])
        for caption in recorder.captions:
            found += [f"caption '{a}' covers {b}" for a, b in overlapping([caption, picture])]
    return found


def overlapping(boxes):
    """Pairs of texts whose boxes overlap."""
    for number, (a, *box) in enumerate(boxes):
        for b, *other in boxes[number + 1 :]:
            apart = [min(box[i + 2], other[i + 2]) - max(box[i], other[i]) for i in (0, 1)]
            if min(apart) > _TOLERANCE:
                yield a, b


def steps(app, recorder, report, pictures):
    """Yield once per frame of the interface."""
    from imgui_bundle import glfw_utils, hello_imgui
    from PIL import Image

    import glfw  # isort: skip
    from gffe_cl.viewer.window.docks import PANELS

    model, scale = app.model, hello_imgui.get_dpi_aware_params().dpi_window_size_factor
    window, found = glfw_utils.glfw_window_hello_imgui(), {}
    shown = {"Picture": ("rendered.depth", "difference"), "Compare": ("final", "split"), "Plot": ("final", "error")}
    while not model.settled:
        yield
    model.playback.seek(5)
    model.pointing.pick((40, 30))
    model.choices.measuring = model.survey.on = True
    for size in ([round(scale * side) for side in SMALLEST], LARGEST):
        glfw.set_window_size(window, *size)
        for letters in LETTERS:
            app.scale_by(letters / _USUAL / app.scale)
            yield from (None for _ in range(3))  # until the window has its size
            app.docks.reset()
            for name in PANELS:
                app.docks.show(name)
                model.view.a, way = shown.get(name, ("final", "off"))
                model.comparison.set(way)
                still = 0
                while still < 5:
                    recorder.clear()
                    yield
                    still = still + 1 if model.settled and not model.survey.busy else 0
                key = f"{size[0]}x{size[1]} scale {scale:g} letters {letters} {name}"
                found[key] = faults(recorder, app)
                assert sum(map(len, recorder.items.values())) > 15, key  # as drawn
                picture = pictures / f"{key.replace(' ', '_')}.png"
                app.captures.append(lambda pixels, picture=picture: Image.fromarray(pixels).save(picture))
                yield
    report.write_text(json.dumps({"faults": found, "scale": scale}))
    app.close()


def main(dpi: int, sequence: str, report: Path, pictures: Path) -> None:
    import viewer_dpi_case

    viewer_dpi_case.DPI = dpi
    viewer_dpi_case.set_dpi()
    from gffe_cl.viewer.state.model import Model
    from gffe_cl.viewer.state.settings import Settings
    from gffe_cl.viewer.window.running import new_app, run

    model, recorder = Model(Settings(), save_settings=False), Recorder()
    model.open(sequence)
    going = []

    def step(app):
        going[:] = going or [steps(app, recorder, report, pictures)]
        next(going[0], None)

    try:
        run(new_app(model, on_frame=step), (900, 620), test=lambda app: None)
    finally:
        model.close()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4]))
