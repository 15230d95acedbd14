"""Timeline: transport buttons, rendered and generated frames told apart, in and out points, scrubbing."""

from __future__ import annotations

from imgui_bundle import ImVec2, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.viewer.panels import widgets

RENDERED = (0.36, 0.62, 0.95, 1.0)
GENERATED = (0.96, 0.66, 0.28, 1.0)
RESET = (0.93, 0.30, 0.30, 1.0)
_NARROW = 2.5  # screen pixels
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def draw(app) -> None:
    model = app.model
    if model.source is None:
        imgui.text_disabled("Open a sequence or a scene")
        return
    _transport(app)
    _bar(model)


def _transport(app) -> None:
    playback = app.model.playback
    for name, icon in (
        ("first", icons.ICON_FA_BACKWARD_FAST),
        ("step_back", icons.ICON_FA_BACKWARD_STEP),
        ("play", icons.ICON_FA_PAUSE if playback.playing else icons.ICON_FA_PLAY),
        ("step", icons.ICON_FA_FORWARD_STEP),
        ("last", icons.ICON_FA_FORWARD_FAST),
    ):
        widgets.action_button(app.actions, name, icon)
        imgui.same_line()
    changed, loop = imgui.checkbox("loop", playback.loop)
    if changed:
        playback.loop = loop
    imgui.same_line()
    imgui.set_next_item_width(hello_imgui.em_size(8))
    if imgui.begin_combo("###mode", playback.mode):
        for mode in ("real time", "every frame"):
            if imgui.selectable(mode, mode == playback.mode)[0]:
                playback.mode = mode
        imgui.end_combo()
    widgets.tooltip("real time drops frames that come too late; every frame waits for each")
    imgui.same_line()
    imgui.set_next_item_width(hello_imgui.em_size(5))
    if imgui.begin_combo("###speed", f"{playback.speed:g}×"):
        for speed in _SPEEDS:
            if imgui.selectable(f"{speed:g}×", speed == playback.speed)[0]:
                playback.speed = speed
        imgui.end_combo()
    imgui.same_line()
    imgui.text(_status(app.model))


def _status(model) -> str:
    playback = model.playback
    slot = playback.slot
    k, j = divmod(slot, model.n + 1)
    kind = f"rendered {k}" if j == 0 else f"generated {k} + {j}/{model.n + 1}"
    text = f"{kind}   t = {model.playback.time_of(slot):.3f} s"
    if playback.playing:
        text += f"   {playback.rate:.0f} of {playback.target_rate:.0f} frames/s"
        if playback.dropped:
            text += f", {playback.dropped} dropped"
    return text


def _bar(model) -> None:
    playback = model.playback
    count = playback.slots
    width, height = max(imgui.get_content_region_avail().x, 50), hello_imgui.em_size(1.8)
    origin = imgui.get_cursor_screen_pos()
    imgui.invisible_button("###scrub", ImVec2(width, height))
    _scrub(model, origin.x, width, count)
    draw = imgui.get_window_draw_list()
    step = width / count
    shades = [imgui.get_color_u32((*c[:3], 0.85)) for c in (RENDERED, GENERATED)]
    outside = [imgui.get_color_u32((*c[:3], 0.25)) for c in (RENDERED, GENERATED)]
    first, last = playback.first, playback.last
    if step < _NARROW:  # too many to tell apart: a band of each kind
        for generated, (top, bottom) in enumerate(((0.15, 0.55), (0.6, 1.0))):
            y0, y1 = origin.y + top * height, origin.y + bottom * height
            draw.add_rect_filled(ImVec2(origin.x, y0), ImVec2(origin.x + width, y1), outside[generated])
            x0, x1 = origin.x + first * step, origin.x + (last + 1) * step
            draw.add_rect_filled(ImVec2(x0, y0), ImVec2(x1, y1), shades[generated])
    else:
        for slot in range(count):
            generated = slot % (model.n + 1) > 0
            left, top = origin.x + slot * step, origin.y + (height * 0.35 if generated else height * 0.15)
            colors = shades if first <= slot <= last else outside
            corner = ImVec2(left + max(step - 1.0, 1.0), origin.y + height)
            draw.add_rect_filled(ImVec2(left, top), corner, colors[generated])
    for frame in model.contents.resets:
        x, ink = origin.x + frame * (model.n + 1) * step, imgui.get_color_u32(RESET)
        draw.add_line(ImVec2(x, origin.y), ImVec2(x, origin.y + height), ink, 2.0)
        draw.add_triangle_filled(ImVec2(x, origin.y), ImVec2(x + 7, origin.y + 3), ImVec2(x, origin.y + 6), ink)
    at = origin.x + (playback.slot + 0.5) * step
    ink = imgui.get_color_u32(imgui.Col_.text)
    draw.add_line(ImVec2(at, origin.y), ImVec2(at, origin.y + height), ink, 2.0)
    draw.add_triangle_filled(ImVec2(at - 5, origin.y), ImVec2(at + 5, origin.y), ImVec2(at, origin.y + 7), ink)
    for slot in (first, last + 1):
        x = origin.x + slot * step
        draw.add_line(ImVec2(x, origin.y), ImVec2(x, origin.y + height), imgui.get_color_u32((0.4, 0.9, 0.5, 0.9)), 2.0)


def _scrub(model, left: float, width: float, count: int) -> None:
    playback = model.playback
    if imgui.is_item_active():
        at = imgui.get_mouse_pos().x - left
        playback.scrubbing = True
        playback.seek(int(at / width * count))
    elif playback.scrubbing:
        playback.scrubbing = False
    if imgui.is_item_hovered() and not imgui.is_item_active():
        slot = min(max(int((imgui.get_mouse_pos().x - left) / width * count), 0), count - 1)
        reason = model.contents.resets.get(slot // (model.n + 1))
        imgui.set_tooltip(f"frame {slot}: drag to scrub" + (f"\n{reason}" if reason else ""))
