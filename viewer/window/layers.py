"""Layers: every named buffer of every stage, how each is displayed, and the histogram of the displayed one."""

from __future__ import annotations

import math
from functools import partial
from itertools import groupby

import numpy as np
from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, implot
from imgui_bundle import icons_fontawesome_6 as icons

from ..picture.displays import COLOR_MAPS, TONE_MAPS, default_display, shown_as
from ..picture.view import OVERLAYS
from ..state.captions import legend
from ..state.model import Model
from . import widgets
from .app import App
from .plot import scale_of


def draw(app: App) -> None:
    model = app.model
    widgets.toggle(
        "overview",
        model.choices.overview,
        lambda on: setattr(model.choices, "overview", on),
        "Every layer as a tile; click one to open it",
    )
    widgets.toggle(
        "clipping",
        model.view.overlay == "clipping",
        lambda on: setattr(model.view, "overlay", OVERLAYS[on]),
        "Colors below 0 are blue, above display white red, with the exposure of the display",
    )
    height = max(imgui.get_content_region_avail().y - app.display_height, hello_imgui.em_size(6))
    if imgui.begin_child("###layers", ImVec2(0, height), imgui.ChildFlags_.borders.value):
        imgui.push_style_var(imgui.StyleVar_.indent_spacing, hello_imgui.em_size(0.7))
        for group, specs in groupby(model.contents.layers, key=lambda spec: spec.group):
            if imgui.tree_node_ex(f"{group}###group {group}", imgui.TreeNodeFlags_.default_open.value):
                for spec in specs:
                    _row(app, spec)
                imgui.tree_pop()
        imgui.pop_style_var()
    imgui.end_child()
    top = imgui.get_cursor_pos_y()
    _display(model)
    app.display_height = imgui.get_cursor_pos_y() - top + hello_imgui.em_size(0.3)


def _row(app: App, spec) -> None:
    model = app.model
    shown = spec.name == model.view.a
    reason = model.contents.why_not(spec.name)
    imgui.begin_disabled(reason is not None)
    mark = f"{icons.ICON_FA_CODE_COMPARE} B" * (spec.name == model.view.b and model.view.compare != "off")
    taken = imgui.calc_text_size(mark).x + hello_imgui.em_size(0.8) if mark else 0.0
    label = widgets.cut(spec.label, imgui.get_content_region_avail().x - taken)
    if imgui.selectable(f"{label}###{spec.name}", shown)[0]:
        model.show_layer(spec.name)
    imgui.end_disabled()
    if shown and spec.name != app.row_seen:
        app.row_seen = spec.name
        if not imgui.is_item_visible():
            imgui.set_scroll_here_y()
    widgets.tooltip(reason or spec.description)
    if mark:
        imgui.same_line()
        imgui.text_disabled(mark)


def _display(model: Model) -> None:
    spec = model.contents.spec(model.view.a)
    if spec is None:
        return
    display, change = model.looks.of(spec.name), partial(model.looks.change, spec.name)
    imgui.separator_text(
        widgets.cut(f"Display of {spec.label}", imgui.get_content_region_avail().x - hello_imgui.em_size(3))
    )
    view, _ = shown_as(spec, display)
    if view == "color":
        widgets.slider("exposure", display.exposure, -8.0, 8.0, 0.0, lambda v: change(exposure=v), "%+.2f EV")
        widgets.choice("tone map", display.tone_map, list(TONE_MAPS), lambda v: change(tone_map=v))
    elif view in ("motion", "place"):
        widgets.slider(
            "full length",
            display.motion_scale,
            0.25,
            64.0,
            default_display(spec).motion_scale,
            lambda v: change(motion_scale=v),
            "%.2f px",
            "Motion of this length is fully bright",
        )
        widgets.toggle(
            "reversed", display.reverse, lambda on: change(reverse=on), "From then to now instead of now to then"
        )
    elif view in ("depth", "scalar", "world"):
        _range(display, change)
        if view == "depth":
            widgets.toggle("even in 1/z", display.inverse, lambda on: change(inverse=on))
        widgets.choice("color map", display.color_map, list(COLOR_MAPS), lambda v: change(color_map=v))
    if spec.planes > 1:
        shown = min(display.plane, spec.planes - 1) + 1
        widgets.slider(
            "plane",
            shown,
            1,
            spec.planes,
            1,
            lambda v: model.looks.choose_plane(spec.name, int(v) - 1),
            "%d",
            spec.description,
        )
    if len(spec.channels) > 1:
        channel = display.channel or spec.channels[0]
        widgets.choice("channel", channel, list(spec.channels), lambda v: change(channel=v))
    _fit_or_reset(model, spec.name, view not in ("mask", "label"))
    widgets.swatches(legend(spec, display).labels)


def _fit_or_reset(model: Model, name: str, has_range: bool = True) -> None:
    """Draw buttons that fit a layer's display to its picture, and that put it back to the default."""
    if has_range:
        if imgui.button("fit###fit_display"):
            model.looks.fit(name)
        widgets.tooltip("Range, or exposure, from the picture: 1 to 99 % of its finite values (N)")
        imgui.same_line()
    if imgui.button("reset###reset_display"):
        model.looks.reset(name)


def _range(display, change) -> None:
    above = widgets.leave_room_for("range")
    speed = max(abs(display.high - display.low) / 200, 1e-4)
    changed, low, high = imgui.drag_float_range2("###range", display.low, display.high, speed, 0.0, 0.0, "%.3g", "%.3g")
    if not above:
        widgets.beside("range")
    if changed:
        change(low=low, high=high)


_COLORS = {"R": ImVec4(0.95, 0.35, 0.3, 1), "G": ImVec4(0.4, 0.85, 0.4, 1), "B": ImVec4(0.4, 0.6, 1.0, 1)}
_PLAIN, _HANDLE = ImVec4(0.75, 0.75, 0.78, 1), ImVec4(0.96, 0.66, 0.28, 1.0)


def draw_histogram(app: App) -> None:
    model, histogram = app.model, app.model.histogram
    spec = model.contents.spec(model.view.a)
    histogram.update()
    if spec is None or histogram.counts is None:
        widgets.hint("Masks, labels and missing layers have no histogram" if spec else "Open a sequence or a scene")
        return
    imgui.text(widgets.cut(f"{spec.group}: {spec.label}", imgui.get_content_region_avail().x))
    widgets.toggle("log", histogram.log, lambda on: setattr(histogram, "log", on), "Logarithmic axis of shares")
    imgui.same_line()
    _fit_or_reset(model, spec.name)
    handles = histogram.handles()
    widgets.hint("   ".join(f"{name} {value:.4g}" for name, value in handles.items()))
    counts, flags = histogram.counts, implot.Flags_.no_mouse_text | implot.Flags_.no_legend | implot.Flags_.no_menus
    flags |= implot.Flags_.no_box_select
    height = min(max(imgui.get_content_region_avail().y, hello_imgui.em_size(7)), hello_imgui.em_size(16))
    if not implot.begin_plot("###histogram", ImVec2(-1, height), int(flags)):
        return
    low, high = (float(side) for side in (counts.edges[0], counts.edges[-1]))
    room = 0.02 * (high - low)
    implot.setup_axes(_unit(model, spec), "share of pixels, %")
    low, high = min(low, *handles.values()) - room, max(high, *handles.values()) + room
    implot.setup_axis_limits(implot.ImAxis_.x1, low, high, imgui.Cond_.always.value)
    _, _, levels, texts = scale_of(low, high)
    implot.setup_axis_ticks(implot.ImAxis_.x1, levels, texts)
    rows = counts.shares
    if histogram.log:  # each decade is as high, from the share of one pixel on
        foot = math.floor(math.log10(counts.least))
        rows = np.log10(np.maximum(rows, 10.0**foot)) - foot
        decades = range(math.ceil(float(rows.max())) + 1)
        implot.setup_axis_ticks(implot.ImAxis_.y1, list(decades), [f"{10.0 ** (at + foot):g}" for at in decades])
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
