"""Plot under the picture: the quality of every generated frame, for A and B. A click goes to the frame."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui, implot
from imgui_bundle import icons_fontawesome_6 as icons

from ..engine.figures import QUANTITIES
from ..state.model import Model
from . import widgets
from .app import App

COLORS = {"A": (0.96, 0.66, 0.28, 1.0), "B": (0.36, 0.72, 0.95, 1.0)}
_LOW = 9.0  # em: in a panel that is lower, and narrow, the plot comes first, and its controls are scrolled to
_ONE_ROW = 30.0  # em: in less, the label of the first control is shorter
_FEW = 80  # slots: these are marked one by one


def draw(app: App) -> None:
    model = app.model
    if model.source is None:
        imgui.text_disabled(model.document.notice or "Open a sequence or a scene")
        return
    room = imgui.get_content_region_avail()
    is_low = room.y < hello_imgui.em_size(_LOW) and room.x < hello_imgui.em_size(_ONE_ROW)
    if not is_low:
        _controls(app)
    curves = _curves(model.survey)
    if not curves:
        widgets.hint(_why_empty(model))
        if is_low:
            _controls(app)
        return
    flags = implot.Flags_.no_mouse_text | implot.Flags_.no_menus | implot.Flags_.no_box_select | implot.Flags_.no_legend
    height = max(imgui.get_content_region_avail().y, hello_imgui.em_size(4))
    implot.push_style_var(implot.StyleVar_.plot_padding.value, ImVec2(0, 4))  # as wide as the timeline below
    if implot.begin_plot("###survey", ImVec2(-1, height), int(flags)):
        _plot(model, curves, height - 2 * imgui.get_text_line_height())
        implot.end_plot()
    implot.pop_style_var()
    if is_low:
        _controls(app)


def _curves(survey) -> list[tuple]:
    """Return (side, slots, values, weight) of each curve, A last: over B both are seen."""
    sides = ("B", survey.b, 3.5), ("A", survey.a, 1.5)
    curves = [(name, survey.curve(side), weight) for name, side, weight in sides]
    return [(name, slots, values, weight) for name, (slots, values), weight in curves if slots.size]


def _why_empty(model: Model) -> str:
    survey, label = model.survey, QUANTITIES[model.survey.quantity].label
    reason = survey.why_not(False)
    if survey.busy:
        return f"No frame is measured yet: {_progress(model)}."
    if survey.on:
        return f"No frame has a value of {label}" + (f": {reason}." if reason else ".")
    return (
        f"No frame is measured yet. 'measure every frame' plots {label} of every generated frame against ground truth."
    )


def _plot(model: Model, curves: list[tuple], height: float) -> None:
    slots = max(model.playback.slots, 1)
    _axes(slots, np.concatenate([ys for _, _, ys, _ in curves]), height, QUANTITIES[model.survey.quantity].unit)
    for name, xs, ys, weight in curves:
        _curve(name, xs, ys, COLORS[name], weight, xs.size <= _FEW)
    implot.plot_inf_lines("###now", np.array([model.slot + 0.5]))
    if implot.is_plot_hovered():
        _hovered(model, [curve[:3] for curve in reversed(curves)], QUANTITIES[model.survey.quantity])


def _axes(slots: int, values: np.ndarray, height: float, unit: str) -> None:
    """Set up the axes: slots as the timeline below has them, and a range for these values, whose numbers stand inside,
    with their `unit`; `height`: of the curves, pixels."""
    hidden = implot.AxisFlags_.no_label.value
    implot.setup_axes("frame", "value", hidden, hidden | implot.AxisFlags_.no_tick_labels.value)
    implot.setup_axis_limits(implot.ImAxis_.x1, 0, slots, imgui.Cond_.always.value)
    marks = range(0, slots, _step(slots, imgui.get_content_region_avail().x / hello_imgui.em_size(4)))
    implot.setup_axis_ticks(implot.ImAxis_.x1, [slot + 0.5 for slot in marks], [str(slot) for slot in marks])
    line = imgui.get_text_line_height()
    low, high, levels, texts = scale_of(float(values.min()), float(values.max()), height / (1.2 * line))
    texts = [f"{text} {unit}".rstrip() for text in texts]
    implot.setup_axis_limits(implot.ImAxis_.y1, low, high, imgui.Cond_.always.value)
    implot.setup_axis_ticks(implot.ImAxis_.y1, levels, texts)
    apart = (levels[1] - levels[0]) / (high - low) * height if len(levels) > 1 else height
    for level, text in zip(levels, texts, strict=True):
        size = imgui.calc_text_size(text)
        above = (high - level) / (high - low) * height > size.y  # there is room for it
        if above or apart > 2 * size.y:
            implot.plot_text(text, 0.0, level, ImVec2(size.x / 2 + 4, -size.y / 2 if above else size.y / 2))


def scale_of(least: float, most: float, count: float = 5.0) -> tuple[float, float, list[float], list[str]]:
    """Return the range of an axis on which these values have some room, two to five round numbers in it, and how they
    are written. `count`: as many have room: of more, the first and the last are left, or none where they collide."""
    room = max(0.1 * (most - least), 1e-3 * abs(most), 1e-3)
    low, high = least - room, most + 2 * room
    step = next(
        factor * 10.0**power
        for power in range(math.floor(math.log10(high - low)) - 1, 400)
        for factor in (1, 2, 5)
        if (high - low) / (factor * 10.0**power) <= 5
    )
    numbers = range(math.ceil(low / step), math.floor(high / step) + 1)
    levels = [min(max(number * step, low), high) for number in numbers]  # they may lie beyond by rounding
    if len(levels) > count:
        levels = [levels[0], levels[-1]] if (levels[-1] - levels[0]) / (high - low) * count >= 1 else []
    digits = max(-math.floor(math.log10(step)), 0)
    return low, high, levels, [f"{level:.{digits}f}" for level in levels]


def _step(slots: int, most: float) -> int:
    """Return the slots between two marks, of which there are at most so many: 1, 2 or 5 times a power of ten."""
    steps = (factor * 10**power for power in range(9) for factor in (1, 2, 5))
    return next(step for step in steps if slots / step <= max(most, 2) or step >= slots)


def _controls(app: App) -> None:
    """Draw the controls side by side, in as many rows as they need."""
    model, survey, em = app.model, app.model.survey, hello_imgui.em_size
    with widgets.in_rows(indent=0.0) as row:
        row(0)
        widgets.toggle(
            "measure every frame" if imgui.get_content_region_avail().x > em(_ONE_ROW) else "measure",
            survey.on,
            lambda _: app.actions.run("survey"),
            "Every generated frame, in the background",
        )
        row(em(12))
        quantities = {name: quantity.label for name, quantity in QUANTITIES.items()}
        widgets.choice("quantity", survey.quantity, quantities, partial(setattr, survey, "quantity"), width=12)
        for name, icon in (
            ("worst", icons.ICON_FA_ARROW_DOWN_WIDE_SHORT),
            ("next_worst", icons.ICON_FA_ARROW_RIGHT),
            ("most_different", icons.ICON_FA_CODE_COMPARE),
        ):
            row(em(2.2))
            widgets.action_button(app.actions, name, icon)
        means, count = survey.means(survey.quantity)
        for label, (mean, worst) in means.items():
            text = f"{QUANTITIES[survey.quantity].text(mean)} (95%: {worst:.{QUANTITIES[survey.quantity].digits}f})"
            row(imgui.calc_text_size(f"{label} {text}").x)
            imgui.text_colored(COLORS[label], label)
            imgui.same_line(0, em(0.3))
            imgui.text(text)
        if len(means) > 1:
            text = f"A−B {QUANTITIES[survey.quantity].text(means['A'][0] - means['B'][0], '+')}"
            row(imgui.calc_text_size(text).x)
            imgui.text(text)
        if means:
            text = f"mean of {count} frame{'s' * (count != 1)}" + " of both" * (len(means) > 1)
            row(imgui.calc_text_size(text).x)
            imgui.text_disabled(text)
            of = "Generated frames between the in and the out point, after the first two rendered ones"
            widgets.tooltip(f"{of}. 95%: 19 of 20 of them are as good, or better")
        text = _progress(model)
        if text:
            row(min(imgui.calc_text_size(text).x, em(8)))
            imgui.text(widgets.cut(text, imgui.get_content_region_avail().x))


def _progress(model: Model) -> str:
    survey = model.survey
    done, total = survey.progress
    if survey.busy:
        return f"{done} of {total} measured" + (" (waits for playback)" if model.playback.playing else "")
    return f"{done} of {total} known" if not survey.on and done < total else ""


def _curve(label: str, xs: np.ndarray, ys: np.ndarray, color, weight: float, marked: bool) -> None:
    spec = implot.Spec()
    unit = widgets.mark_unit()
    spec.line_color, spec.line_weight = color, weight * unit
    if marked:
        spec.marker, spec.marker_fill_color = implot.Marker_.circle.value, color
        spec.marker_size = (1 + weight / 2) * unit
    implot.plot_line(label, xs + 0.5, ys, spec=spec)


def _hovered(model: Model, curves, quantity) -> None:
    """Show the values of the known slot nearest to the pointer; a click goes there."""
    known = np.unique(np.concatenate([xs for _, xs, _ in curves]))
    at = implot.get_plot_mouse_pos().x - 0.5
    slot = int(known[np.argmin(np.abs(known - at))])
    values = [
        f"{label}  {quantity.text(float(ys[np.flatnonzero(xs == slot)[0]]))}" for label, xs, ys in curves if slot in xs
    ]
    imgui.set_tooltip(f"frame {slot}: click to go there\n" + "\n".join(values))
    if imgui.is_mouse_clicked(imgui.MouseButton_.left):
        model.playback.seek(slot)
