"""Overview: all layers as tiles; a click opens one."""

from __future__ import annotations

import math

from imgui_bundle import ImVec2, hello_imgui, imgui

from ..state.model import Model
from . import widgets
from .interface import Interface

_LEAST = 9.5  # em: width of a tile; where all do not fit, they are scrolled
_GAP = 6  # screen pixels
_ACCENT = (0.35, 0.85, 1.0, 1.0)


def draw(app: Interface, room: tuple[int, int]) -> None:
    """Draw all layers as tiles into `room`, screen pixels."""
    model = app.model
    model.pointing.hover(None)
    if imgui.begin_child("###tiles", ImVec2(*room)):
        caption = round(imgui.get_text_line_height() + 3)
        tiles = model.looks.tiles()
        size = _size(len(tiles), room, model.contents.size, caption)
        size = size[0], min(size[1], app.canvas.largest)
        texture, places = app.canvas.overview(tiles, size, caption=caption, gap=_GAP)
        origin = imgui.get_cursor_screen_pos()
        imgui.image(imgui.ImTextureRef(texture.glo), ImVec2(*size))
        imgui.set_cursor_screen_pos(origin)
        clicked = imgui.invisible_button("###overview", ImVec2(*size))
        for place in places:
            _tile(model, place, origin, caption, clicked)
    imgui.end_child()


def _size(count: int, room: tuple[int, int], picture: tuple[int, int], caption: int) -> tuple[int, int]:
    """Return `room`, or a size higher than it where tiles would be narrower than `_LEAST`."""
    width = room[0] - round(imgui.get_style().scrollbar_size)
    least = hello_imgui.em_size(_LEAST)
    columns = max(int((width - _GAP) / (least + _GAP)), 1)
    tile = (width - _GAP * (columns + 1)) / columns * picture[1] / picture[0]
    height = math.ceil(_GAP + math.ceil(count / columns) * (tile + caption + _GAP))
    return room if height <= room[1] else (width, height)


def _tile(model: Model, place, origin, caption: int, clicked: bool) -> None:
    """Draw a tile's name, and handle the pointer on it."""
    marks, at = imgui.get_window_draw_list(), imgui.get_mouse_pos()
    left, top = origin.x + place.x, origin.y + place.y
    right, bottom = left + place.width, top + place.height
    spec = model.contents.spec(place.name)
    if spec is None:
        return
    name = widgets.cut(f"{spec.group}: {spec.label}", place.width)
    marks.add_text(ImVec2(left, bottom + 1), imgui.get_color_u32((0.8, 0.8, 0.82, 1.0)), name)
    contents = model.contents
    reason = contents.why_not(place.name) or ("none in this frame" if place.name in contents.asked else "computing …")
    if contents.image(place.name) is None:
        why = widgets.cut(reason, place.width)
        marks.add_text(ImVec2(left + 4, top + 4), imgui.get_color_u32((0.8, 0.8, 0.82, 1.0)), why)
    inside = left <= at.x < right and top <= at.y < bottom
    if inside and model.pointing.enabled and imgui.is_item_hovered():
        marks.add_rect(ImVec2(left, top), ImVec2(right, bottom), imgui.get_color_u32(_ACCENT), 0, 2.0)
        imgui.set_tooltip(f"{spec.group}: {spec.label}\n{spec.description}")
        if clicked:
            model.overview = False
            model.show_layer(place.name)
