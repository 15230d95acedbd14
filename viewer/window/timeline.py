"""Timeline: rendered and generated frames in different colors, in and out points, scrubbing; transport buttons."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

from imgui_bundle import ImVec2, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from ..state.document import ALONE, INVALID, MISPLACED, REPEATED, START, UNEVEN
from ..state.model import Model
from . import widgets
from .app import App

RENDERED = (0.36, 0.62, 0.95, 1.0)
GENERATED = (0.96, 0.66, 0.28, 1.0)
DOUBT = (0.98, 0.85, 0.25, 1.0)
RESET = (0.93, 0.30, 0.30, 1.0)
CACHED = (0.35, 0.80, 0.45, 1.0)
FLAGS = {START: RESET, MISPLACED: DOUBT}  # over the height of the slots
STRIP = {
    INVALID: (1.0, 0.0, 1.0, 1.0),
    REPEATED: (0.35, 0.85, 1.0, 1.0),
    UNEVEN: (0.65, 0.45, 1.0, 1.0),
    ALONE: (0.3, 0.7, 0.3, 1.0),
}  # above them
_CACHED_HEIGHT = 3.0  # pixels at the usual size of letters
_NARROW = 2.5  # screen pixels
_LEAST_STATUS = 4.5  # em: with less room it has a row of its own
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def draw(app: App) -> None:
    model = app.model
    if model.source is None:
        imgui.text_disabled(model.document.notice or "Open a sequence or a scene")
        return
    _bar(model)  # first: where the window is low, it is there
    imgui.dummy(ImVec2(0, 0))
    _transport(app)


def _transport(app: App) -> None:
    """Draw the controls side by side, in as many rows as they need."""
    playback, width = app.model.playback, hello_imgui.em_size
    with widgets.in_rows(indent=0.0) as row:
        for name, icon in (
            ("first", icons.ICON_FA_BACKWARD_FAST),
            ("step_back", icons.ICON_FA_BACKWARD_STEP),
            ("play", icons.ICON_FA_PAUSE if playback.playing else icons.ICON_FA_PLAY),
            ("step", icons.ICON_FA_FORWARD_STEP),
            ("last", icons.ICON_FA_FORWARD_FAST),
            ("next_fault", icons.ICON_FA_FLAG),
        ):
            row(width(2))
            widgets.action_button(app.actions, name, icon, 2)
        row(width(4.5))
        widgets.toggle(
            "loop", playback.loop, partial(setattr, playback, "loop"), "From the last frame to the first one"
        )
        row(width(7))
        modes = {"real time": "drops frames that come too late", "every frame": "waits for each"}
        widgets.choice("mode", playback.mode, list(modes), partial(setattr, playback, "mode"), modes, 7)
        widgets.tooltip("\n".join(f"{mode}: {text}" for mode, text in modes.items()))
        row(width(4))
        speeds = {speed: f"{speed:g}×" for speed in _SPEEDS}
        widgets.choice("speed", playback.speed, speeds, partial(setattr, playback, "speed"), width=4)
        row(width(_LEAST_STATUS))
        imgui.align_text_to_frame_padding()
        long, short = _status(app.model)
        room = imgui.get_content_region_avail().x
        imgui.text(long if imgui.calc_text_size(long).x <= room else widgets.cut(short, room))
        widgets.tooltip(long)


def _status(model: Model) -> tuple[str, str]:
    """Return the displayed frame and its time, or the state of playback; and the same in fewer letters."""
    playback = model.playback
    seconds = f"{playback.time_of(playback.slot):.3f} s"
    if playback.playing:
        rate, dropped = f"{playback.rate:.0f} of {playback.target_rate:.0f}/s", playback.dropped
        return f"{seconds}   {rate}" + (f"   {dropped} dropped" if dropped else ""), f"{rate}, −{dropped}"
    k, j = divmod(playback.slot, model.n + 1)
    at = f"{k} + {j}/{model.n + 1}" if j else f"{k}"
    return f"{'generated' if j else 'rendered'} {at}   t = {seconds}", at


def _bar(model: Model) -> None:
    playback = model.playback
    count = playback.slots
    width, height = max(imgui.get_content_region_avail().x, 50), hello_imgui.em_size(1.8)
    origin = imgui.get_cursor_screen_pos()
    imgui.invisible_button("###scrub", ImVec2(width, height))
    _scrub(model, origin.x, width, count)
    draw, unit = imgui.get_window_draw_list(), widgets.mark_unit()
    step = width / count
    shades = [imgui.get_color_u32((*c[:3], 0.85)) for c in (RENDERED, GENERATED)]
    outside = [imgui.get_color_u32((*c[:3], 0.25)) for c in (RENDERED, GENERATED)]
    first, last = playback.first, playback.last
    if step < _NARROW:  # too many to distinguish: a band of each kind
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
    _cached(model, draw, origin, step, height)
    faults = model.document.faults
    _strip(model, draw, origin, step, faults)
    for frame, color in ((frame, color) for frame in faults for kind, color in FLAGS.items() if kind in faults[frame]):
        x, ink = round(origin.x + frame * (model.n + 1) * step), imgui.get_color_u32(color)
        draw.add_line(ImVec2(x, origin.y), ImVec2(x, origin.y + height), ink, 2 * unit)
        flag = ImVec2(x + 7 * unit, origin.y + 3 * unit), ImVec2(x, origin.y + 6 * unit)
        draw.add_triangle_filled(ImVec2(x, origin.y), *flag, ink)
    at = round(origin.x + (playback.slot + 0.5) * step)
    ink = imgui.get_color_u32(imgui.Col_.text)
    draw.add_line(ImVec2(at, origin.y), ImVec2(at, origin.y + height), ink, 2 * unit)
    top = ImVec2(at - 5 * unit, origin.y), ImVec2(at + 5 * unit, origin.y)
    draw.add_triangle_filled(*top, ImVec2(at, origin.y + 7 * unit), ink)
    green = imgui.get_color_u32((0.4, 0.9, 0.5, 0.9))
    for slot in (first, last + 1):
        x = round(origin.x + slot * step)
        draw.add_line(ImVec2(x, origin.y), ImVec2(x, origin.y + height), green, 2 * unit)


def _strip(model: Model, draw, origin, step: float, faults: dict[int, dict[str, str]]) -> None:
    """Draw a mark above the slots of each rendered frame with a fault, as wide as they are."""
    high, wide = 4 * widgets.mark_unit(), max((model.n + 1) * step - 1, 3 * widgets.mark_unit())
    for frame, kinds in faults.items():
        x, shown = origin.x + frame * (model.n + 1) * step, [color for kind, color in STRIP.items() if kind in kinds]
        for number, color in enumerate(shown):
            left, right = (x + wide * part / len(shown) for part in (number, number + 1))
            ink = imgui.get_color_u32(color)
            draw.add_rect_filled(ImVec2(left, origin.y - high), ImVec2(right, origin.y), ink)


def _cached(model: Model, draw, origin, step: float, height: float) -> None:
    """Draw the cached slots that the picture can use: a line below the slots."""
    ink, bottom = imgui.get_color_u32(CACHED), origin.y + height
    for start, end in runs(model.document.ahead.cached):
        corner = ImVec2(origin.x + end * step, bottom + _CACHED_HEIGHT * widgets.mark_unit())
        draw.add_rect_filled(ImVec2(origin.x + start * step, bottom), corner, ink)


def runs(slots: frozenset[int]) -> list[tuple[int, int]]:
    """Return (first, last + 1) of each stretch of consecutive numbers."""
    found = sorted(slots)
    breaks = [i for i in range(1, len(found)) if found[i] != found[i - 1] + 1]
    return [(found[a], found[b - 1] + 1) for a, b in pairwise([0, *breaks, len(found)])] if found else []


def _scrub(model: Model, left: float, width: float, count: int) -> None:
    playback = model.playback
    if imgui.is_item_active():
        at = imgui.get_mouse_pos().x - left
        playback.scrubbing = True
        playback.seek(int(at / width * count))
    elif playback.scrubbing:
        playback.scrubbing = False
    if imgui.is_item_hovered() and not imgui.is_item_active():
        slot = min(max(int((imgui.get_mouse_pos().x - left) / width * count), 0), count - 1)
        frame = slot // (model.n + 1)
        reasons = (f"{kind}: {text}" for kind, text in model.document.faults.get(frame, {}).items())
        imgui.set_tooltip("\n".join((f"frame {slot}: drag to scrub", *reasons)))
