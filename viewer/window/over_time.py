"""Over time: the row of pixels through the picked one, frame by frame from top to bottom."""

from __future__ import annotations

from imgui_bundle import ImVec2, hello_imgui, imgui

from ..picture.canvas import Canvas
from ..picture.displays import FrameInfo
from ..picture.view import View
from . import widgets
from .interface import Interface

_NAME = "over time"  # of the layer on the canvas
_ACCENT = (0.35, 0.85, 1.0, 1.0)
_LEAST = 4.0  # em: height


def draw(app: Interface) -> None:
    model, study = app.model, app.model.studies.over_time
    here = widgets.studied(model, study)
    if here is None:
        return
    spec, picture = model.contents.spec(here.shown), study.picture(here)
    if picture is None or spec is None or here.pixel is None:
        widgets.hint("no frame has rows of this layer" if study.found and not study.busy else "computing …")
        return
    rows, slots = picture
    size = rows.shape[1], rows.shape[0]
    canvas = app.row_canvas = app.row_canvas or Canvas(app.canvas.ctx)
    canvas.frame = FrameInfo(size, exposure=here.exposure)
    canvas.upload(_NAME, rows[None] if spec.planes > 1 else rows, spec)
    texture = canvas.draw(View(_NAME, model.looks.of(spec.name), center=(size[0] / 2, size[1] / 2), grid=False), size)
    done = f"   {len(study.found)} of {study.parts}" if study.busy else ""
    text = f"row {here.pixel[1]} of {spec.label}, frames {slots.start} to {slots.stop - 1} downward{done}"
    imgui.text_disabled(widgets.cut(text, imgui.get_content_region_avail().x))
    room, origin = imgui.get_content_region_avail(), imgui.get_cursor_screen_pos()
    width, height = room.x, max(room.y, hello_imgui.em_size(_LEAST))
    imgui.image(imgui.ImTextureRef(texture.glo), ImVec2(width, height))
    if imgui.is_item_hovered():
        at = slots.start + int((imgui.get_mouse_pos().y - origin.y) / height * size[1])
        imgui.set_tooltip(f"frame {at}: click to go there")
        if imgui.is_mouse_clicked(imgui.MouseButton_.left):
            model.playback.seek(at)
    _marks(origin, width, height, size, here.pixel[0], model.slot - slots.start)


def _marks(origin, width: float, height: float, size: tuple[int, int], x: int, row: int) -> None:
    """Mark the picked pixel's column, and the shown frame."""
    marks, ink = imgui.get_window_draw_list(), imgui.get_color_u32(_ACCENT)
    right, down = origin.x + (x + 0.5) / size[0] * width, origin.y + (row + 0.5) / size[1] * height
    tick = 5 * widgets.mark_unit()
    for top, bottom in ((origin.y, origin.y + tick), (origin.y + height - tick, origin.y + height)):
        marks.add_line(ImVec2(right, top), ImVec2(right, bottom), ink, 2 * widgets.mark_unit())
    for left, end in ((origin.x, origin.x + 2 * tick), (origin.x + width - 2 * tick, origin.x + width)):
        marks.add_line(ImVec2(left, down), ImVec2(end, down), ink, 2 * widgets.mark_unit())
