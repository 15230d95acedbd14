"""Ablation: what each module gains in this frame, over the whole picture and by region."""

from __future__ import annotations

import math

from imgui_bundle import hello_imgui, imgui

from gffe_cl.engine.options import OPTIONS
from ..engine.figures import REGIONS
from ..state.model import Model
from ..state.studies import ALL, without
from . import widgets
from .interface import Interface

_SHORT = {"out of screen": "out", "disoccluded": "hole", "silhouettes": "edge", "dynamic": "mover"}  # headings
_FIRST = ("dynamic", "disoccluded", "out of screen", "silhouettes", "focus", "rest")  # to keep where room is little
_LEAST = 0.005  # dB: less is written as nothing


def draw(app: Interface) -> None:
    model, study = app.model, app.model.studies.ablation
    if widgets.studied(model, study) is None:
        return
    if study.busy:
        imgui.progress_bar(len(study.found) / max(study.parts, 1), (-1, 0), f"{len(study.found)} of {study.parts}")
    else:
        widgets.hint("dB that this frame loses without a module. A click compares with it off")
    with widgets.compact():
        _table(model)


def _table(model: Model) -> None:
    """Draw a row for each module: the gain over the image, and in the regions, or as many of them as have room."""
    number, names = hello_imgui.em_size(2.8), max(imgui.calc_text_size(_label(name)).x for name in OPTIONS)
    room = imgui.get_content_region_avail().x - min(names, hello_imgui.em_size(8))
    found = model.studies.ablation.sorted
    regions = [region for region in REGIONS if any(not math.isnan(gains[region]) for _, gains in found)]
    regions = with_room(regions, max(int(room / (number + 2 * imgui.get_style().cell_padding.x)) - 1, 1))
    flags = imgui.TableFlags_.row_bg.value
    if not imgui.begin_table("###ablation", 2 + len(regions), flags):
        return
    imgui.table_setup_column("module", imgui.TableColumnFlags_.width_stretch.value)
    for title in (ALL, *regions):
        imgui.table_setup_column(title, imgui.TableColumnFlags_.width_fixed.value, number)
    imgui.table_next_row()
    for title in ("", ALL, *regions):
        imgui.table_next_column()
        imgui.text_disabled(_SHORT.get(title, title))
        widgets.tooltip(f"{title}: {REGIONS[title]}" if title in REGIONS else "")
    for name, gains in found:
        imgui.table_next_row()
        imgui.table_next_column()
        text = widgets.cut(_label(name), imgui.get_content_region_avail().x)
        if imgui.selectable(f"{text}###ablation {name}", False, imgui.SelectableFlags_.span_all_columns.value)[0]:
            _compare(model, name)
        told = "\n".join(f"{region}: {_gain(gains[region])} dB" for region in (ALL, *REGIONS) if region in gains)
        widgets.tooltip(f"{_label(name)}\n{told}")
        for region in (ALL, *regions):
            imgui.table_next_column()
            imgui.text(_gain(gains[region]))
    imgui.end_table()


def with_room(regions: list[str], most: int) -> list[str]:
    """Return at most so many of the regions, in their order."""
    kept = [region for region in _FIRST if region in regions][:most]
    return [region for region in regions if region in kept]


def _label(name: str) -> str:
    return OPTIONS[name].off_label or OPTIONS[name].label


def _gain(gain: float) -> str:
    return "–" if math.isnan(gain) else "0" if abs(gain) < _LEAST else f"{gain:+.2f}"


def _compare(model: Model, name: str) -> None:
    """Make the settings without a module B, and show the difference."""
    kept = model.kept.keep(without(model.setup, name), model.recipe.kernels)
    model.comparison.with_settings(kept.name)
    model.comparison.set("difference")
