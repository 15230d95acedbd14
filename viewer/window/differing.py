"""Differences: the layers of this frame that differ between A's and B's settings, in the order of the stages."""

from __future__ import annotations

import math
from itertools import groupby

from imgui_bundle import hello_imgui, imgui

from ..state.model import Model
from ..state.studies import Difference
from . import widgets
from .interface import Interface


def draw(app: Interface) -> None:
    model, study = app.model, app.model.studies.differing
    if widgets.studied(model, study) is None:
        return
    first, shown = study.first, [one for one in study.all if one.differs or not one.common or app.lists_equal]
    imgui.begin_disabled(first is None)
    if imgui.button("go to the first###first_differing") and first is not None:
        show(model, first)
        model.pointing.pick(first.worst)
    imgui.end_disabled()
    widgets.tooltip("Show the difference of the first layer that differs, and pick the pixel where it is largest")
    imgui.same_line()
    widgets.toggle("show equal layers", app.lists_equal, lambda on: setattr(app, "lists_equal", on))
    done = f"{len(study.found)} of {study.parts} stages …   " if study.busy else ""
    widgets.hint(done + study.text)
    with widgets.compact():
        for group, listed in groupby(shown, key=lambda one: one.spec.group):
            imgui.text_disabled(group)
            _table(model, group, list(listed))


def _table(model: Model, group: str, listed: list[Difference]) -> None:
    """Draw the layers of a stage with the pixels that differ, and by how much at most."""
    if not imgui.begin_table(f"###differing {group}", 3, imgui.TableFlags_.row_bg.value):
        return
    number = hello_imgui.em_size(4.2)
    imgui.table_setup_column("layer", imgui.TableColumnFlags_.width_stretch.value)
    for title in ("pixels", "largest"):
        imgui.table_setup_column(title, imgui.TableColumnFlags_.width_fixed.value, number)
    for one in listed:
        imgui.table_next_row()
        imgui.table_next_column()
        text = widgets.cut(one.label, imgui.get_content_region_avail().x)
        spans = imgui.SelectableFlags_.span_all_columns.value
        if not one.differs:
            imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(imgui.Col_.text_disabled))
        if imgui.selectable(f"{text}###differing {one.spec.name}", model.view.a == one.spec.name, spans)[0]:
            show(model, one)
        told = one.remark or f"{one.pixels} of {one.of} pixels differ"
        widgets.tooltip(f"{one.label}: {told}. {one.spec.description}")
        imgui.table_next_column()
        imgui.text(one.remark if one.remark else f"{one.pixels}" if one.pixels else "=")
        imgui.table_next_column()
        if one.pixels:
            imgui.text("–" if math.isnan(one.largest) else f"{one.largest:.3g}")
        if not one.differs:
            imgui.pop_style_color()
    imgui.end_table()


def show(model: Model, one: Difference) -> None:
    """Show a layer, and the difference between A's and B's, of several planes in that with the largest."""
    model.show_layer(one.spec.name)
    if one.planes:
        model.looks.choose_plane(one.spec.name, one.planes[0])
    model.comparison.with_settings()
    model.comparison.set("difference")
