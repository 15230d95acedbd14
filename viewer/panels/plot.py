"""Plot under the picture: what every generated frame is worth, for A and B; clicked, it goes there."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui, implot
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.viewer.engine.figures import QUANTITIES
from gffe_cl.viewer.panels import widgets

_A, _B = (0.96, 0.66, 0.28, 1.0), (0.36, 0.72, 0.95, 1.0)
_FEW = 80  # slots: these are marked one by one


def draw(app) -> None:
    model, survey = app.model, app.model.survey
    if model.source is None:
        imgui.text_disabled("Open a sequence or a scene")
        return
    _controls(app)
    flags = implot.Flags_.no_mouse_text | implot.Flags_.no_menus | implot.Flags_.no_box_select
    flags |= implot.Flags_.no_legend if survey.b is None else 0
    height = max(imgui.get_content_region_avail().y, hello_imgui.em_size(5))
    implot.push_style_var(implot.StyleVar_.fit_padding.value, ImVec2(0, 0.1))
    if implot.begin_plot("###survey", ImVec2(-1, height), int(flags)):
        _plot(model, survey)
        implot.end_plot()
    implot.pop_style_var()


def _plot(model, survey) -> None:
    quantity = QUANTITIES[survey.quantity]
    fit, plain = implot.AxisFlags_.auto_fit.value, implot.AxisFlags_.no_label.value
    implot.setup_axes("frame", f"{quantity.label} {quantity.unit}".rstrip(), plain, fit)
    slots = max(model.playback.slots, 1)
    implot.setup_axis_limits(implot.ImAxis_.x1, 0, slots, imgui.Cond_.always.value)
    marks = range(0, slots, _step(slots, imgui.get_content_region_avail().x / hello_imgui.em_size(4)))
    implot.setup_axis_ticks(implot.ImAxis_.x1, [slot + 0.5 for slot in marks], [str(slot) for slot in marks])
    curves = []
    for label, side, color in (("A", survey.a, _A), ("B", survey.b, _B)):  # the order of the legend
        if survey.curve(side)[0].size:
            implot.plot_dummy(label, spec=_spec(color, 2.5, False))
    for label, side, color, weight in (("B", survey.b, _B, 3.5), ("A", survey.a, _A, 1.5)):  # A over B: both are seen
        xs, ys = survey.curve(side)
        if xs.size:
            curves.insert(0, (label, xs, ys))
            _curve(label, xs, ys, color, weight, xs.size <= _FEW)
    implot.plot_inf_lines("###now", np.array([model.slot + 0.5]))
    if implot.is_plot_hovered():
        _hovered(model, curves, quantity)


def _step(slots: int, most: float) -> int:
    """Slots between two marks, of which there are at most so many: 1, 2 or 5 times a power of ten."""
    steps = (factor * 10**power for power in range(9) for factor in (1, 2, 5))
    return next(step for step in steps if slots / step <= max(most, 2) or step >= slots)


def _controls(app) -> None:
    model, survey = app.model, app.model.survey
    widgets.toggle("measure every frame", survey.on, app.show_survey, "Every generated frame, in the background")
    imgui.same_line()
    imgui.set_next_item_width(hello_imgui.em_size(9))
    if imgui.begin_combo("###quantity", QUANTITIES[survey.quantity].label):
        for name, quantity in QUANTITIES.items():
            if imgui.selectable(quantity.label, name == survey.quantity)[0]:
                survey.quantity = name
        imgui.end_combo()
    for name, icon in (
        ("worst", icons.ICON_FA_ARROW_DOWN_WIDE_SHORT),
        ("next_worst", icons.ICON_FA_ARROW_RIGHT),
        ("most_different", icons.ICON_FA_CODE_COMPARE),
    ):
        imgui.same_line()
        widgets.action_button(app.actions, name, icon)
    imgui.same_line()
    text = _state(model)
    imgui.text(widgets.shortened(text, imgui.get_content_region_avail().x) if text else "")


def _state(model) -> str:
    survey = model.survey
    quantity, (done, total) = QUANTITIES[survey.quantity], survey.progress
    parts = []
    for label, side in (("A", survey.a), ("B", survey.b)):
        mean = survey.mean(side, survey.quantity)
        if mean is not None:
            parts.append(f"{label} {quantity.text(mean)}")
    if survey.busy:
        parts.append(f"{done} of {total} measured" + (" (waits for playback)" if model.playback.playing else ""))
    elif not survey.on and done < total:
        parts.append(f"{done} of {total} known")
    return "   ".join(parts)


def _curve(label: str, xs: np.ndarray, ys: np.ndarray, color, weight: float, marked: bool) -> None:
    implot.plot_line(label, xs + 0.5, ys, spec=_spec(color, weight, marked))


def _spec(color, weight: float, marked: bool):
    spec = implot.Spec()
    spec.line_color, spec.line_weight = color, weight
    if marked:
        spec.marker, spec.marker_size, spec.marker_fill_color = implot.Marker_.circle.value, 1 + weight / 2, color
    return spec


def _hovered(model, curves, quantity) -> None:
    """The known slot nearest to the pointer: its values, and a click that goes there."""
    known = np.unique(np.concatenate([xs for _, xs, _ in curves])) if curves else ()
    if not len(known):
        return
    at = implot.get_plot_mouse_pos().x - 0.5
    slot = int(known[np.argmin(np.abs(known - at))])
    values = [
        f"{label}  {quantity.text(float(ys[np.flatnonzero(xs == slot)[0]]))}" for label, xs, ys in curves if slot in xs
    ]
    imgui.set_tooltip(f"frame {slot}: click to go there\n" + "\n".join(values))
    if imgui.is_mouse_clicked(imgui.MouseButton_.left):
        model.playback.seek(slot)
