"""Histogram: how often values of the displayed layer occur, with handles for the range of its colors."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, implot

from ..picture.displays import shown_as
from ..picture.legends import legend
from ..state.model import Model
from . import widgets
from .interface import Interface
from .plot import scale_of

_COLORS = {"R": ImVec4(0.95, 0.35, 0.3, 1), "G": ImVec4(0.4, 0.85, 0.4, 1), "B": ImVec4(0.4, 0.6, 1.0, 1)}
_PLAIN, _HANDLE = ImVec4(0.75, 0.75, 0.78, 1), ImVec4(0.96, 0.66, 0.28, 1.0)


def draw(app: Interface) -> None:
    model, histogram = app.model, app.model.histogram
    spec = model.contents.spec(model.view.a)
    histogram.update()
    if spec is None or histogram.counts is None:
        widgets.hint("Masks, labels and missing layers have no histogram" if spec else "Open a sequence or a scene")
        return
    imgui.text(widgets.cut(f"{spec.group}: {spec.label}", imgui.get_content_region_avail().x))
    widgets.toggle("log", histogram.log, lambda on: setattr(histogram, "log", on), "Logarithm of the numbers of pixels")
    imgui.same_line()
    if imgui.button("fit###fit_histogram"):
        model.looks.fit(spec.name)
    widgets.tooltip("Range, or exposure, from the picture: 1 to 99 % of its finite values (N)")
    imgui.same_line()
    if imgui.button("reset###reset_histogram"):
        model.looks.reset(spec.name)
    handles = histogram.handles()
    widgets.hint("   ".join(f"{name} {value:.4g}" for name, value in handles.items()))
    counts, flags = histogram.counts, implot.Flags_.no_mouse_text | implot.Flags_.no_legend | implot.Flags_.no_menus
    flags |= implot.Flags_.no_box_select
    height = min(max(imgui.get_content_region_avail().y, hello_imgui.em_size(7)), hello_imgui.em_size(16))
    if not implot.begin_plot("###histogram", ImVec2(-1, height), int(flags)):
        return
    low, high = (float(side) for side in (counts.edges[0], counts.edges[-1]))
    room = 0.02 * (high - low)
    numbers = "pixels, logarithm" if histogram.log else "pixels"
    implot.setup_axes(_unit(model, spec), numbers)
    low, high = min(low, *handles.values()) - room, max(high, *handles.values()) + room
    implot.setup_axis_limits(implot.ImAxis_.x1, low, high, imgui.Cond_.always.value)
    _, _, levels, texts = scale_of(low, high)
    implot.setup_axis_ticks(implot.ImAxis_.x1, levels, texts)
    rows = np.log10(counts.pixels + 1) if histogram.log else counts.pixels
    implot.setup_axis_limits(implot.ImAxis_.y1, 0, 1.05 * float(rows.max()), imgui.Cond_.always.value)
    for name, row in zip(counts.channels, rows, strict=True):
        line = implot.Spec()
        line.line_color, line.fill_color, line.fill_alpha = (*[_COLORS.get(name, _PLAIN)] * 2, 0.25)
        line.flags = implot.StairsFlags_.shaded.value
        implot.plot_stairs(name, counts.edges, np.append(row, row[-1]), line)
    for number, (name, value) in enumerate(handles.items()):
        moved, value, *_ = implot.drag_line_x(number, value, _HANDLE, 2.0)
        if moved:
            histogram.drag(name, float(value))
    implot.end_plot()


def _unit(model: Model, spec) -> str:
    """Return the name of the axis of values."""
    display = model.looks.of(spec.name)
    view = shown_as(spec, display)[0]
    if view == "color":
        return "linear color"
    return "length, px" if view in ("motion", "place") else legend(spec, display).unit or "value"
