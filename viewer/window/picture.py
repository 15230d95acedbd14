"""Picture panel: zoom at the cursor, pan, wipe, choice of a pixel, overlays; and all layers as tiles."""

from __future__ import annotations

import math

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui

from gffe_cl.engine.inspection import names
from ..picture.shown_numbers import Numbers, numbers_of
from ..picture.view import View
from ..state.captions import layer_text, slot_text
from ..state.model import Model
from ..state.presets import told
from . import widgets
from .app import App

_ZOOM_STEP = 1.2
_DRAG = 4.0  # screen pixels: less is a click
_LINE = 2.0  # screen pixels at the usual size of letters: the wipe's line ...
_GRIP = 10.0  # ... and on both sides of it, where it is taken hold of
_VALUES = 3  # that are written into a pixel where it is large enough: so many ...
_LEAST_LETTERS = 8.0  # ... in letters of at least this size, screen pixels at the usual size of letters ...
_LETTERS_WIDE, _LETTER = 4, 0.55  # ... of which as many have room, each so wide, em
_WARM = (1.0, 0.7, 0.25, 1.0)
_WAY = (0.55, 1.0, 0.5, 1.0)
_NEAR = 7.0  # screen pixels
_GRAY = (0.3, 0.3, 0.32, 0.6)  # over a picture that is not the requested one ...
_STRIP = 1.9  # em: above and below the fitted picture, for captions
_STILL_FRESH = 0.15  # ... for so many seconds: less would flicker


def draw(app: App) -> None:
    model = app.model
    size = imgui.get_content_region_avail()
    width, height = max(int(size.x), 16), max(int(size.y), 16)
    origin = imgui.get_cursor_screen_pos()
    app.foot, app.picture_at = (origin.x + width / 2, origin.y + height), (origin.x, origin.y)
    if model.source is None:
        _welcome(app, size)
        return
    if model.framing.due or (model.framing.is_fitted and app.canvas_size != (width, height)):
        model.framing.fit(
            (width, max(height - 2 * round(hello_imgui.em_size(_STRIP)), height // 2)), model.contents.size
        )
    app.canvas_size = width, height
    if model.choices.overview:
        _overview(app, (width, height))
        return
    view = model.comparison.shown()
    view.line = _LINE * widgets.mark_unit()
    io = imgui.get_io()
    if imgui.is_window_docked() and io.display_framebuffer_scale.x == 1:  # it has no background
        app.beneath = view, (int(origin.x), int(io.display_size.y) - int(origin.y) - height), (width, height)
    else:
        imgui.image(imgui.ImTextureRef(app.canvas.draw(view, (width, height)).glo), ImVec2(width, height))
        imgui.set_cursor_screen_pos(origin)
        app.beneath = None
    imgui.invisible_button(
        "###picture",
        ImVec2(width, height),
        imgui.ButtonFlags_.mouse_button_left.value | imgui.ButtonFlags_.mouse_button_middle.value,
    )
    place = Placement(model, origin, (width, height))
    _mouse(app, place)
    marks = imgui.get_window_draw_list()
    marks.push_clip_rect(origin, ImVec2(origin.x + width, origin.y + height), True)
    drawn = marks.vtx_buffer.size()
    if app.stale_for(_STILL_FRESH):
        marks.add_rect_filled(origin, ImVec2(origin.x + width, origin.y + height), imgui.get_color_u32(_GRAY))
    _numbers(model, view, place, marks)
    _way(model, place, marks)
    _trajectory(model, place, marks)
    if model.pointing.rectangle is not None:
        x0, y0, x1, y1 = model.pointing.rectangle
        ink = imgui.get_color_u32(widgets.ACCENT)
        marks.add_rect(place.to_screen(x0, y0), place.to_screen(x1, y1), ink, 0, 1.5 * widgets.mark_unit())
    _bars(model, origin, width, height, marks)
    marks.pop_clip_rect()
    beside = model.framing.is_fitted and not model.states  # captions
    app.is_bare = app.beneath is not None and beside and marks.vtx_buffer.size() == drawn
    _caption(model, origin, width, height, marks)


class Placement:
    """Conversion between display pixels and positions on the screen."""

    def __init__(self, model: Model, origin, size):
        self.view, self.origin, self.size = model.view, origin, size

    def to_screen(self, x: float, y: float) -> ImVec2:
        right, down = self.view.screen_at(self.size, x, y)
        return ImVec2(self.origin.x + right, self.origin.y + down)

    def to_display(self, at: ImVec2) -> tuple[float, float]:
        return self.view.display_at(self.size, at.x - self.origin.x, at.y - self.origin.y)


def _welcome(app: App, size) -> None:
    notice, doing = app.model.document.notice, app.model.engine.activity
    text = (
        f"{notice}   {doing}"
        if notice
        else "Drop a sequence here, or open one (Ctrl+O), or a built-in scene (File menu)"
    )
    wide = imgui.calc_text_size(text)
    imgui.set_cursor_pos(ImVec2(max((size.x - wide.x) / 2, 0), max((size.y - wide.y) / 2, 0)))
    imgui.text_disabled(text)


def _mouse(app: App, place) -> None:
    """Handle the mouse on the item drawn last: hover, zoom at the cursor, drag the wipe's line or the picture, click a
    pixel."""
    model, io, view = app.model, imgui.get_io(), app.model.view
    at = imgui.get_mouse_pos()
    hovered = imgui.is_item_hovered()
    model.pointing.hover(place.to_display(at) if hovered else None)
    if hovered and io.mouse_wheel and not io.key_ctrl:
        before = place.to_display(at)
        model.framing.zoom(_ZOOM_STEP**io.mouse_wheel)
        after = place.to_display(at)
        view.center = (view.center[0] + before[0] - after[0], view.center[1] + before[1] - after[1])
    line = place.origin.x + view.split * place.size[0]
    near = abs(at.x - line) < _GRIP * widgets.mark_unit()
    on_line = view.compare == "split" and not model.comparison.flipped and near
    if (hovered and on_line and not imgui.is_item_active()) or app.drags == "line":
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew.value)
    if imgui.is_item_activated():
        left = imgui.is_mouse_down(imgui.MouseButton_.left)
        app.pressed_at = at
        marks = "rectangle" if io.key_shift else "nothing yet"
        app.drags = "picture" if not left else "line" if on_line else marks
    if imgui.is_item_active():
        if app.drags == "nothing yet" and _distance(at, app.pressed_at) >= _DRAG:
            app.drags = "picture"
        if app.drags == "line":
            view.split = min(max((at.x - place.origin.x) / place.size[0], 0.0), 1.0)
        elif app.drags == "rectangle":
            model.pointing.mark(place.to_display(app.pressed_at), place.to_display(at))
        elif app.drags == "picture":
            delta = io.mouse_delta
            view.center = (view.center[0] - delta.x / view.zoom, view.center[1] - delta.y / view.zoom)
    if imgui.is_item_deactivated():
        if app.drags == "nothing yet":
            x, y = place.to_display(at)
            model.pointing.pick((math.floor(x), math.floor(y)))
        app.drags = "nothing"


def _distance(a, b) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)


def _numbers(model: Model, view: View, place, marks) -> None:
    """Write the numbers of the picture into its pixels, where these are large enough."""
    for numbers in numbers_of(view, model.contents, model.comparison.flip_map):
        _write(numbers, place, marks)


def _write(numbers: Numbers, place, marks) -> None:
    """Write numbers into the pixels of their part of the picture, where these are large enough."""
    grid = numbers.grid
    (height, width), scale, start = grid.image.shape[:2], grid.scale, grid.start
    from_x, to_x = (place.origin.x + share * place.size[0] for share in numbers.part)
    left, top = place.to_display(ImVec2(from_x, place.origin.y))
    right, bottom = place.to_display(ImVec2(to_x, place.origin.y + place.size[1]))
    whole = grid.frame.display_size
    top, bottom = ((y - start[1]) / scale[1] for y in (max(top, 0), min(bottom, whole[1])))
    left, right = ((x - start[0]) / scale[0] for x in (max(left, 0), min(right, whole[0])))
    rows = np.arange(max(int(top), 0), min(math.ceil(bottom), height))
    columns = np.arange(max(int(left), 0), min(math.ceil(right), width))
    wide, high = (along * place.view.zoom for along in scale)
    lines = min(numbers.of(np.zeros(1, int), np.zeros(1, int)).shape[1], _VALUES)
    size = min(imgui.get_font_size(), wide / (_LETTERS_WIDE * _LETTER + 0.3), high / (lines + 0.3))
    if size < _LEAST_LETTERS * widgets.mark_unit() or not (len(rows) and len(columns)):
        return
    ink, shade = imgui.get_color_u32((1, 1, 1, 1)), imgui.get_color_u32((0, 0, 0, 0.8))
    font, letters, edge = imgui.get_font(), int((wide / size - 0.3) / _LETTER), 0.15 * size
    marks.push_clip_rect(ImVec2(from_x, place.origin.y), ImVec2(to_x, place.origin.y + place.size[1]), True)
    grid_rows, grid_columns = (at.ravel() for at in np.meshgrid(rows, columns, indexing="ij"))
    for row, column, values in zip(grid_rows, grid_columns, numbers.of(grid_rows, grid_columns), strict=True):
        text = "\n".join(short(float(value), letters) for value in values[:_VALUES])
        at = place.to_screen(column * scale[0] + start[0], row * scale[1] + start[1])
        for offset, color in ((1, shade), (0, ink)):
            marks.add_text(font, size, ImVec2(at.x + edge + offset, at.y + edge + offset), color, text)
    marks.pop_clip_rect()


def short(value: float, letters: int) -> str:
    """Return a number with three digits, or as many as so many letters have room for; without the zero before the
    point."""
    for digits in (3, 2, 1):
        text = f"{value:.{digits}g}"
        text = text.replace("0.", ".", 1) if text.lstrip("-").startswith("0.") else text
        if len(text) <= letters:
            break
    return text


def _trajectory(model: Model, place, marks) -> None:
    """Draw the picked pixel, and the origin of its content."""
    if model.pointing.picked is None:
        return
    x, y = model.pointing.picked
    accent, warm, unit = imgui.get_color_u32(widgets.ACCENT), imgui.get_color_u32(_WARM), widgets.mark_unit()
    half = max(model.view.zoom / 2, 4 * unit)
    middle = place.to_screen(x + 0.5, y + 0.5)
    corners = ImVec2(middle.x - half, middle.y - half), ImVec2(middle.x + half, middle.y + half)
    marks.add_rect(*corners, accent, 0, 2 * unit)
    story = model.pointing.story
    if story is None or len(story.trajectory) < 2:
        return
    points = [place.to_screen(*point) for point in story.trajectory]
    for a, b in zip(points, points[1:], strict=False):
        marks.add_line(a, b, warm, 2 * unit)
    for point in points[:-1]:
        marks.add_circle_filled(point, 3 * unit, warm)
    marks.add_circle_filled(points[-1], 4 * unit, accent)


def _way(model: Model, place, marks) -> None:
    """Draw the positions of the picked fragment in the last rendered frames."""
    story = model.pointing.story
    if story is None or len(story.way) < 2:
        return
    line, rim, unit = imgui.get_color_u32(_WAY), imgui.get_color_u32((0, 0, 0, 0.8)), widgets.mark_unit()
    points = [place.to_screen(*point.px) for point in story.way]
    for a, b in zip(points, points[1:], strict=False):
        marks.add_line(a, b, rim, 3.5 * unit)
        marks.add_line(a, b, line, 1.5 * unit)
    at = imgui.get_mouse_pos()
    for point, spot in zip(story.way, points, strict=True):
        near = _distance(at, spot) < _NEAR * unit
        marks.add_circle_filled(spot, (4.5 if near else 3.5) * unit, rim)
        marks.add_circle_filled(spot, (3.5 if near else 2.5) * unit, line)
        if near and imgui.is_window_hovered():
            imgui.set_tooltip(f"rendered frame {point.k}: ({point.px[0]:.1f}, {point.px[1]:.1f})")


def _caption(model: Model, origin, width, height, marks) -> None:
    """Write layer names and changed display settings into the corners."""
    view = model.view

    def label(text: str, x: float, y: float, right: bool = False) -> None:
        widgets.label(marks, text, origin.x + x, origin.y + y, right)

    line = hello_imgui.em_size(1.6)
    if height < 2.6 * line:
        pass  # there is room for the line at the foot only
    elif model.comparison.flipped and view.b:
        label(f"B  {_layer_text(model, view.b)}", 10, 8)
    elif view.compare != "off" and view.b:
        first = model.contents.result
        settings = f"{told(first.setup)}   " if model.comparison.by_settings and first is not None else ""
        builds = model.comparison.builds
        texts = (f"A  {settings}{builds[0]}{_layer_text(model, view.a)}", f"B  {builds[1]}{_layer_text(model, view.b)}")
        a, b = (widgets.cut(text, width / 2 - 24 * widgets.mark_unit()) for text in texts)
        label(a, 10, 8)
        label(b, width - 10, 8, right=True)
    else:
        label(_layer_text(model, view.a), 10, 8)
    kind = f"{model.captions.frame}   {view.zoom * 100:.0f} %"
    if (result := model.contents.result) is not None and (bad := result.bad_pixels):
        kind += f"   {bad.color + bad.depth + bad.motion + bad.long} invalid pixels of the input"
    state = model.comparison.scale_text()
    if not (model.comparison.ready and model.current) or (model.busy and not model.playback.playing):
        state = (
            model.waiting_text
            if model.document.failure is None or model.busy
            else f"not this frame: {model.document.failure}"
        )
    state = widgets.cut(state, max(0.6 * width, width - 40 - imgui.calc_text_size(kind).x))
    label(widgets.cut(kind, width - 40 - imgui.calc_text_size(state).x), 10, height - line)
    if state:
        label(state, width - 10, height - line, right=True)
    for number, state in enumerate(model.states):
        text = widgets.cut(state, width - 24)
        if height > (6 + number) * line:
            label(text, (width - imgui.calc_text_size(text).x) / 2, (1.6 + 1.2 * number) * line)


def _bars(model: Model, origin, width: int, height: int, marks) -> None:
    """Draw a color bar with numbers and unit for each map, at the right edge, of A in a wipe at the left one: below the
    picture where there is room."""
    em = hello_imgui.em_size()
    below = model.view.screen_at((width, height), *model.contents.size)[1] + 0.5 * em
    top = below if model.framing.is_fitted and below < height - 5.1 * em else 2.4 * em
    foot = (_STRIP + 0.2) * em
    high = min(height - foot - top, 11 * em)
    if high < 3 * em or width < 20 * em:
        return
    for side, shown in model.captions.legends():
        left = side == "A"
        at = origin.x + (0.3 * em if left else width - 0.3 * em), origin.y + top
        draw = widgets.vertical_bar if shown.kind == "ramp" else widgets.small_wheel
        _, y0, _, y1 = draw(marks, shown, at, high, right=not left)
        top += 0 if left else y1 - y0 + 0.5 * em
        high = min(high, height - top - foot)
        if high < 3 * em:
            break


def _layer_text(model: Model, name: str) -> str:
    """Return the layer's name and its display settings, or the reason why it is missing."""
    spec = model.contents.spec(name)
    if spec is None:
        return f"{names.plain(name)}: {model.contents.why_absent(name)}"
    text = layer_text(spec, model.looks.of(name))
    result = model.contents.second if names.is_second(name) else model.contents.result
    if names.is_second(name):
        neighbor, kept = model.comparison.neighbor, model.kept.b
        whose = slot_text(result.slot, model.n) if neighbor and result else neighbor or (kept.name if kept else "")
        if model.showing.fault_of_b:
            return f"{whose}: {model.showing.fault_of_b}"
        text = f"{whose}   {text}" if model.comparison.flipped else whose  # else A has the layer's name
    if result and names.plain(name) in result.layers and model.contents.image(name) is None:
        text += "   (none for this frame)"
    return text


_LEAST = 9.5  # em: width of a tile; where all do not fit, they are scrolled
_GAP = 6  # screen pixels


def _overview(app: App, room: tuple[int, int]) -> None:
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
    name = f"{spec.group}: {spec.label}"
    name = widgets.cut(name if imgui.calc_text_size(name).x <= place.width else spec.label, place.width)
    marks.add_text(ImVec2(left, bottom + 1), imgui.get_color_u32((0.8, 0.8, 0.82, 1.0)), name)
    contents = model.contents
    reason = contents.why_not(place.name) or ("none in this frame" if place.name in contents.asked else "computing …")
    if contents.image(place.name) is None:
        why = widgets.cut(reason, place.width)
        marks.add_text(ImVec2(left + 4, top + 4), imgui.get_color_u32((0.8, 0.8, 0.82, 1.0)), why)
    inside = left <= at.x < right and top <= at.y < bottom
    if inside and model.pointing.enabled and imgui.is_item_hovered():
        marks.add_rect(ImVec2(left, top), ImVec2(right, bottom), imgui.get_color_u32(widgets.ACCENT), 0, 2.0)
        imgui.set_tooltip(f"{spec.group}: {spec.label}\n{spec.description}")
        if clicked:
            model.choices.overview = False
            model.show_layer(place.name)
