"""Regions: how much of the error lies where, of A and B; a click shows one region alone."""

from __future__ import annotations

import math

from imgui_bundle import ImVec2, hello_imgui, imgui

from ..engine.figures import REGIONS, Part
from ..state.captions import region_colors
from . import widgets
from .interface import Interface


def draw(app: Interface) -> None:
    model = app.model
    if model.source is None:
        imgui.text_disabled(model.notice or "Open a sequence or a scene")
        return
    regions = model.regions
    reason = regions.why_not()
    told = "Where errors are counted, each region in its color"
    widgets.toggle("over the picture", regions.on, regions.switch, told, None if regions.on else reason)
    if regions.only:
        imgui.same_line()
        text = f"only {regions.only}: click again for all"
        imgui.text_disabled(widgets.cut(text, imgui.get_content_region_avail().x))
    if not regions.on:
        widgets.hint(reason or "Switch them on to see where the error of this frame lies")
    elif reason:
        widgets.hint(f"This frame: {reason}")
    elif regions.map is not None:
        stale = not (regions.ready and model.current)
        imgui.begin_disabled(stale)
        baseline = model.survey.figures(model.survey.b).get(model.slot) if regions.map.b is None else None
        b = regions.map.b if baseline is None else baseline.parts or None
        _table(regions, "frame", "this frame" + (" …" if stale else ""), regions.map.a, b)
        imgui.end_disabled()
    whole, count = model.survey.parts()
    if "A" in whole:
        of = f"{count} frame{'s' * (count != 1)}" + " of both" * ("B" in whole)
        _table(regions, "all", of, whole["A"], whole.get("B"))


def _table(regions, name: str, of: str, a: dict[str, Part], b: dict[str, Part] | None) -> None:
    """Draw a row for each region; `of`: which frames, instead of a heading."""
    number = hello_imgui.em_size(2.6)
    columns = {"pixels": number, "error": 1.2 * number}
    columns |= {"dB": number} if b is None else {"A dB": number, "B dB": number, "A−B": number}
    names = max(imgui.calc_text_size(region).x for region in REGIONS) + hello_imgui.em_size(1.5)
    for least in ("pixels", "B dB"):  # they are in the tooltip, too
        gaps = 2 * (len(columns) + 1) * imgui.get_style().cell_padding.x
        if imgui.get_content_region_avail().x < sum(columns.values()) + names + gaps:
            columns.pop(least, None)
    if not imgui.begin_table(f"###regions {name}", len(columns) + 1, imgui.TableFlags_.row_bg.value):
        return
    imgui.table_setup_column(of, imgui.TableColumnFlags_.width_stretch.value)
    for title, width in columns.items():
        imgui.table_setup_column(title, imgui.TableColumnFlags_.width_fixed.value, width)
    imgui.table_headers_row()
    for number, (region, meaning) in enumerate(REGIONS.items()):
        part, texts = a[region], {"pixels": _share(a[region].pixels), "dB": _level(a[region].psnr)}
        if b is not None:
            difference = part.psnr - b[region].psnr
            texts |= {"A dB": texts["dB"], "B dB": _level(b[region].psnr), "A−B": _level(difference, "+")}
        imgui.table_next_row()
        imgui.table_next_column()
        widgets.swatch(f"color {number}", region_colors()[region], 0.8)
        spans = imgui.SelectableFlags_.span_all_columns.value
        text = widgets.cut(region, imgui.get_content_region_avail().x - hello_imgui.em_size(0.2))
        if imgui.selectable(f"{text}###{name} {region}", regions.only == region, spans)[0]:
            regions.see_only(region)
        levels = f"; A {texts['A dB']} dB, B {texts['B dB']} dB" if b is not None else ""
        widgets.tooltip(f"{region}: {meaning}; {texts['pixels']} of the pixels{levels}")
        for title in columns:
            imgui.table_next_column()
            if title == "error":
                _bar(part.error)
                widgets.tooltip("Share of A's squared error")
            else:
                imgui.text(texts[title])
    imgui.end_table()


def _level(level: float, sign: str = "") -> str:
    return f"{level:{sign}.1f}" if math.isfinite(level) else "–"


def _bar(share: float) -> None:
    """Draw a share as its number over a bar."""
    draw, at = imgui.get_window_draw_list(), imgui.get_cursor_screen_pos()
    width, height = imgui.get_content_region_avail().x, imgui.get_text_line_height()
    color = imgui.get_color_u32((0.85, 0.35, 0.3, 0.9))
    foot, unit = at.y + height + widgets.mark_unit(), widgets.mark_unit()
    draw.add_rect_filled(ImVec2(at.x, foot - 3 * unit), ImVec2(at.x + max(width * share, unit), foot), color)
    imgui.text(_share(share))


def _share(share: float) -> str:
    return f"{share:.1%}" if share >= 0.01 or share == 0 else f"{share:.2%}"
