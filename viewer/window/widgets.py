"""Small ImGui pieces that the panels share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from ..engine.messages import Failure
from ..picture.displays import Rgb, wheel_color
from ..state.captions import Legend
from ..state.model import Model
from ..state.studies import Here, Study

ACCENT = (0.35, 0.85, 1.0, 1.0)  # of the picked pixel, and of what is pointed at
_RED = ImVec4(0.97, 0.5, 0.45, 1.0), ImVec4(0.75, 0.12, 0.08, 1.0)  # on dark ground, and on light
_GRABS = imgui.Col_.slider_grab.value, imgui.Col_.slider_grab_active.value
_LEAST_CONTROL = 5.0  # em: a control narrower than this has its label above
_USUAL_LETTERS = 15.0  # screen pixels
_DISABLED_TOO = imgui.HoveredFlags_.allow_when_disabled.value


def red() -> ImVec4:
    """Return the color of errors, which is read on the ground of the present theme."""
    ground = imgui.get_style_color_vec4(imgui.Col_.menu_bar_bg)
    return _RED[ground.x + ground.y + ground.z > 1.5]


def floating() -> None:
    """Give the next window a background: it is not docked."""
    imgui.set_next_window_bg_alpha(1.0)


def tooltip(text: str) -> None:
    """Show a tooltip for the last item, disabled or not, on that side of it where the window has more room: it covers
    no item below."""
    if text and imgui.is_item_hovered(_DISABLED_TOO):
        first, last, view = imgui.get_item_rect_min(), imgui.get_item_rect_max(), imgui.get_main_viewport()
        left, gap = first.x + last.x > 2 * view.get_center().x, hello_imgui.em_size(0.8)
        if first.y < view.pos.y + view.size.y - 6 * gap:  # not of the status bar, which has room above it only
            at = (first.x - gap if left else last.x + gap, first.y)
            imgui.set_next_window_pos(at, imgui.Cond_.always.value, (1.0 if left else 0.0, 0.0))
        imgui.begin_tooltip()
        imgui.push_text_wrap_pos(hello_imgui.em_size(28))
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        imgui.end_tooltip()


def action_button(actions, name: str, icon: str, width: float = 2.2) -> None:
    """Draw a button for an action, `width` em, grayed out with the reason where it cannot run."""
    action = actions[name]
    reason = actions.why_not(name)
    imgui.begin_disabled(reason is not None)
    if imgui.button(f"{icon}###{name}", ImVec2(hello_imgui.em_size(width), 0)):
        actions.run(name)
    imgui.end_disabled()
    shortcut = f"  ({action.shortcut})" if action.shortcut else ""
    tooltip(reason or f"{action.label}{shortcut}")


def toggle(
    label: str, value: bool, change: Callable[[bool], object], help_text: str = "", reason: str | None = None
) -> None:
    """Draw a checkbox, grayed out with `reason` if there is one, with as much of its label as has room."""
    room = imgui.get_content_region_avail().x - imgui.get_frame_height() - imgui.get_style().item_inner_spacing.x
    shown = cut(label, room)
    imgui.begin_disabled(reason is not None)
    changed, new = imgui.checkbox(label if shown == label else f"{shown}###{label}", value)
    imgui.end_disabled()
    tooltip(reason or (help_text if shown == label else f"{label}\n{help_text}"))
    if changed:
        change(new)


def slider(
    label: str,
    value: float,
    low: float,
    high: float,
    default: float,
    change: Callable[[float], None],
    text: str = "%.2f",
    help_text: str = "",
) -> None:
    """Draw a slider with its unit in `text` and a button back to the default."""
    whole, room = isinstance(default, int), hello_imgui.em_size(11)  # the same for all, so that they line up
    needed = imgui.calc_text_size(label).x + 4 * imgui.get_style().item_spacing.x + imgui.get_frame_height()
    written = imgui.calc_text_size(text % value).x + 2 * imgui.get_style().frame_padding.x
    above = _above(label, needed, written)
    if above:
        needed -= imgui.calc_text_size(label).x
    _leave_room(needed if imgui.get_content_region_avail().x < 2 * room else max(room, needed), written)
    for grab in _GRABS:
        imgui.push_style_color(grab, ImVec4(0, 0, 0, 0))  # it would lie over the number
    if whole:
        changed, new = imgui.slider_int(f"###{label}", int(value), int(low), int(high), text)
    else:
        changed, new = imgui.slider_float(f"###{label}", value, low, high, text)
    imgui.pop_style_color(len(_GRABS))
    tooltip(help_text)
    _level((new - low) / (high - low), _GRABS[imgui.is_item_active()])
    if changed:
        change(min(max(new, low), high))
    imgui.same_line()
    imgui.begin_disabled(value == default)
    if imgui.button(f"{icons.ICON_FA_ROTATE_LEFT}###reset {label}"):
        change(default)
    imgui.end_disabled()
    tooltip(f"back to {default:g}")
    if not above:
        beside(label)


def _level(share: float, color: int) -> None:
    """Draw how far a slider is, at the foot of the item drawn last."""
    first, last, unit = imgui.get_item_rect_min(), imgui.get_item_rect_max(), mark_unit()
    right = first.x + min(max(share, 0.0), 1.0) * (last.x - first.x)
    corner = ImVec2(max(right, first.x + 3 * unit), last.y)
    marks = imgui.get_window_draw_list()
    marks.add_rect_filled(ImVec2(first.x, last.y - 3 * unit), corner, imgui.get_color_u32(color), 1.5 * unit)


def mark_unit() -> float:
    """Return the size of marks in screen pixels: 1 at the usual size of letters."""
    return imgui.get_font_size() / _USUAL_LETTERS


def beside(label: str) -> None:
    """Draw the label of the last item, as much of it as has room."""
    imgui.same_line()
    text = cut(label, imgui.get_content_region_avail().x)
    imgui.text(text)
    tooltip("" if text == label else label)


def leave_room_for(label: str) -> bool:
    """Make the next item leave space for `label` on its right, where it goes. Where the line is too narrow for both, it
    is drawn above, and True returned."""
    needed = imgui.calc_text_size(label).x + 2 * imgui.get_style().item_spacing.x
    above = _above(label, needed, hello_imgui.em_size(_LEAST_CONTROL))
    _leave_room(0.0 if above else needed)
    return above


def _above(label: str, needed: float, least: float) -> bool:
    """Draw `label` on a line of its own if, with `needed` pixels for it, fewer than `least` are left of the line.
    Returns whether it did."""
    above = imgui.get_content_region_avail().x - needed < least
    if above:
        imgui.text(cut(label, imgui.get_content_region_avail().x))
    return above


def _leave_room(pixels: float, least: float = 0.0) -> None:
    """Make the next item leave space of `pixels` on its right, but take a third of the line itself, and `least`
    pixels."""
    width = imgui.get_content_region_avail().x
    imgui.set_next_item_width(max(width - pixels, width / 3, least))


@contextmanager
def compact() -> Iterator[None]:
    """Make rows lower within the context."""
    style = imgui.get_style()
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(style.frame_padding.x, style.frame_padding.y / 3))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(style.item_spacing.x, style.item_spacing.y / 2))
    yield
    imgui.pop_style_var(2)


def choice(
    label: str,
    value: Any,
    options: dict[Any, str] | list[str],
    change: Callable[[Any], object],
    help_texts: dict[str, str] | None = None,
    width: float = 0.0,
) -> None:
    """Draw a combo box over keys of `options` (shown by their texts), with a `help_texts` for each; with a `width`, in
    em, without its label."""
    texts = options if isinstance(options, dict) else {name: name for name in options}
    if width:
        imgui.set_next_item_width(hello_imgui.em_size(width))
    above = not width and leave_room_for(label)
    if imgui.begin_combo(f"###{label}", texts.get(value, f"{value}")):
        for name, text in texts.items():
            chosen = imgui.selectable(text, name == value)[0]
            tooltip((help_texts or {}).get(name, ""))
            if chosen and name != value:
                change(name)
        imgui.end_combo()
    if not (above or width):
        beside(label)


def studied(model: Model, study: Study) -> Here | None:
    """Have a study made while it is shown, and draw the errors of frames that it wanted, each once, or why there is
    nothing of it. Returns where it is made, None if there is nothing."""
    study.look()
    here = model.studies.here
    reason = "Open a sequence or a scene" if here is None else study.why_not(here)
    if reason:
        hint(reason)
        return None
    for error in {made.error for made in study.found.values() if isinstance(made, Failure)}:
        colored(red(), error)
    return here


def hint(text: str) -> None:
    """Draw text that is less important than the rest, in as many lines as it takes."""
    colored(imgui.get_style_color_vec4(imgui.Col_.text_disabled), text)


def colored(color, text: str) -> None:
    """Draw text in a color, in as many lines as it takes."""
    imgui.push_style_color(imgui.Col_.text, color)
    imgui.text_wrapped(text)
    imgui.pop_style_color()


def cut(text: str, width: float) -> str:
    """Return as much of a text's beginning as has room in `width` pixels; a few letters in any case."""
    kept = len(text)
    while kept > 3 and imgui.calc_text_size(text[:kept] + "…" * (kept < len(text))).x > width:
        kept -= 1
    return text[:kept] + "…" * (kept < len(text))


@contextmanager
def in_rows(indent: float = 1.4) -> Iterator[Callable[[float], None]]:
    """Lay items out side by side, in as many rows as needed, `indent` em from the left. Yields a function to call
    with the width of each, pixels, before it."""
    first, gap = True, hello_imgui.em_size(0.8 if indent else 0.5)
    if indent:
        imgui.indent(hello_imgui.em_size(indent))

    def row(width: float) -> None:
        nonlocal first
        if not first:
            imgui.same_line(0, gap)
            if imgui.get_content_region_avail().x < width:
                imgui.new_line()
        first = False

    yield row
    if indent:
        imgui.unindent(hello_imgui.em_size(indent))


def swatches(labels: tuple[tuple[str, Rgb], ...]) -> None:
    """Draw a color and a text for each single value."""
    room, used, side = imgui.get_content_region_avail().x, 0.0, hello_imgui.em_size(0.9)
    for text, color in labels:
        width = imgui.calc_text_size(text).x + hello_imgui.em_size(2.3)
        if used and used + width < room:
            imgui.same_line()
        else:
            used = 0.0
        used += width
        no_tooltip = imgui.ColorEditFlags_.no_tooltip.value
        imgui.color_button(f"###swatch {text}", (*color, 1.0), no_tooltip, ImVec2(side, side))
        imgui.same_line(0, hello_imgui.em_size(0.3))
        imgui.text_wrapped(text) if width > room else imgui.text(text)


def label(marks, text: str, x: float, y: float, right: bool = False) -> None:
    """Write text on a dark ground."""
    size = imgui.calc_text_size(text)
    x = x - size.x if right else x
    _ground(marks, x, y, size.x, size.y)
    marks.add_text(ImVec2(x, y), imgui.get_color_u32((1, 1, 1, 0.95)), text)


def _ground(marks, x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
    """Draw a dark ground behind what has this place; return its left, top, right and bottom."""
    unit = mark_unit()
    ground = x - 5 * unit, y - 3 * unit, x + width + 5 * unit, y + height + 3 * unit
    marks.add_rect_filled(ImVec2(*ground[:2]), ImVec2(*ground[2:]), imgui.get_color_u32((0, 0, 0, 0.6)), 4 * unit)
    return ground


def vertical_bar(marks, shown: Legend, at, high: float, right: bool) -> tuple[float, float, float, float]:
    """Draw a ramp from low, at its foot, to high, `high` pixels with its unit above it, whose right or left upper
    corner is `at`. Returns the left, top, right and bottom of its ground."""
    em, line = hello_imgui.em_size(), imgui.get_text_line_height()
    sizes = [imgui.calc_text_size(text) for _, text, _ in shown.ticks]
    unit = imgui.calc_text_size(shown.unit).x if shown.unit else 0.0
    width = max(max(size.x for size in sizes) + 1.3 * em, unit)
    x, y = at[0] - width - 5 if right else at[0] + 5, at[1] + 3
    ground = _ground(marks, x, y, width, high)
    ink, top = imgui.get_color_u32((1, 1, 1, 0.95)), y + (1.8 * line if unit else 0.5 * line)
    if unit:
        marks.add_text(ImVec2(x + (width - unit if right else 0), y), ink, shown.unit)
    length, left = y + high - 0.5 * line - top, x + width - 0.8 * em if right else x
    for (a, _, lower), (b, _, upper) in pairwise(shown.ticks):
        colors = [imgui.get_color_u32((*color, 1.0)) for color in (upper, upper, lower, lower)]
        corners = ImVec2(left, top + (1 - b) * length), ImVec2(left + 0.8 * em, top + (1 - a) * length)
        marks.add_rect_filled_multi_color(*corners, *colors)
    steps = 1 if length >= 1.3 * line * (len(sizes) - 1) else 2 if length >= 1.3 * line * 2 else len(sizes) - 1
    for (position, text, _), size in list(zip(shown.ticks, sizes, strict=True))[::steps]:
        place = left - 0.4 * em - size.x if right else left + 1.2 * em
        marks.add_text(ImVec2(place, top + (1 - position) * length - line / 2), ink, text)
    return ground


def small_wheel(marks, shown: Legend, at, high: float, right: bool) -> tuple[float, float, float, float]:
    """Draw the wheel of directions with its unit, as `vertical_bar`. Returns the same."""
    radius, size = min(1.6 * hello_imgui.em_size(), high / 3), imgui.calc_text_size(shown.unit)
    width = max(2 * radius, size.x)
    x, y = at[0] - width - 5 if right else at[0] + 5, at[1] + 3
    ground = _ground(marks, x, y, width, 2 * radius + 1.3 * size.y)
    _wheel(marks, ImVec2(x + width - radius if right else x + radius, y + radius), radius)
    marks.add_text(ImVec2(x, y + 2 * radius + 0.2 * size.y), imgui.get_color_u32((1, 1, 1, 0.95)), shown.unit)
    return ground


def _wheel(marks, middle: ImVec2, radius: float) -> None:
    parts = 24
    for part in range(parts):
        start, end = (2 * math.pi * (part + side) / parts for side in (-0.5, 0.55))
        first, last = (ImVec2(middle.x + radius * math.cos(a), middle.y + radius * math.sin(a)) for a in (start, end))
        marks.add_triangle_filled(middle, first, last, imgui.get_color_u32((*wheel_color(part / parts, 1.0), 1.0)))
