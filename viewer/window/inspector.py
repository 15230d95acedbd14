"""Inspector: the values of all layers under the cursor, and the story of a pixel that was clicked."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import NamedTuple

import numpy as np
from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection, Story
from gffe_cl.engine.inspection.layers import LayerSpec
from ..picture.shown_numbers import STATISTICS
from ..state.captions import value_text
from ..state.model import Model
from . import widgets
from .app import App
from .picture import short

HERE, FROM = "here", "from"  # the pixel under the pointer, and where its content comes from
_NAMES = 0.4  # of the width: names of layers


class Row(NamedTuple):
    """A layer's value: `group` is its stage, `description` the layer's; `where`: HERE, FROM, or nothing where both are
    one; `is_bad`: NaN or infinite."""

    group: str
    label: str
    description: str
    where: str
    value: str
    is_bad: bool


def draw(app: App) -> None:
    model = app.model
    if model.walk.can_go_back:
        widgets.action_button(app.actions, "back", icons.ICON_FA_ARROW_LEFT)
    if model.pointing.story is not None:
        imgui.begin_disabled(model.pointing.story_is_due or not model.current)
        _story(model, model.pointing.story)
        imgui.end_disabled()
    _statistics(model)
    _buffers(model)
    pinned = model.pointing.picked is not None
    imgui.separator_text("Values of the picked pixel" if pinned else "Values")
    inspection, stale = model.values
    if inspection is None:
        widgets.hint("Move over the picture; click a pixel for its story; Shift and drag: statistics of a rectangle")
        return
    if stale:
        imgui.text_disabled("computing … these values are of another frame or setting")
    imgui.begin_disabled(stale)
    _inspection(app, inspection)
    imgui.end_disabled()


def _inspection(app: App, inspection: Inspection) -> None:
    """Draw the values of a pixel, under the positions that they are of."""
    x, y = inspection.pixel
    imgui.text_wrapped(f"{HERE}: pixel ({x}, {y})")
    if inspection.origin and inspection.source is not None:
        right, down = inspection.source
        imgui.text_wrapped(f"{FROM}: ({right:.2f}, {down:.2f}) of the rendered frame, where the warp's motion leads")
    if inspection.fault:
        told = f"invalid in the input, {FROM} where it comes" if inspection.origin else "invalid in the input"
        widgets.colored(widgets.red(), f"{told}: {inspection.fault}")
    _values(app, inspection)


def _statistics(model: Model) -> None:
    """Draw least, most, mean and median of the shown layers in the marked rectangle."""
    rectangle = model.pointing.rectangle
    if rectangle is None:
        return
    x0, y0, x1, y1 = rectangle
    imgui.separator_text(f"Rectangle ({x0}, {y0}), {x1 - x0}×{y1 - y0} pixels")
    rows, spec = model.statistics(), model.contents.spec(model.view.a)
    if spec is not None:
        widgets.hint(f"{spec.label}: values as stored, without NaN and infinity")
    with widgets.compact():
        if imgui.begin_table("###statistics", 1 + len(STATISTICS), imgui.TableFlags_.row_bg.value):
            for text in ("", *STATISTICS):
                imgui.table_next_column()
                imgui.text_disabled(text)
            for name, values, share in rows:
                imgui.table_next_column()
                imgui.text(name)
                widgets.tooltip(f"{share:.1%} of the values are finite" if share < 1 else "")
                for value in values or [float("nan")] * len(STATISTICS):
                    imgui.table_next_column()
                    room = int(imgui.get_content_region_avail().x / imgui.calc_text_size("0").x)
                    imgui.text("–" if value != value else short(value, room))
                    widgets.tooltip(f"{value:.6g}")
            imgui.end_table()
    if imgui.button(f"{icons.ICON_FA_XMARK} forget###forget_rectangle"):
        model.pointing.rectangle = None


def _buffers(model: Model) -> None:
    """Draw the description of the engine's buffers, if they differ from our conventions."""
    result = model.contents.result
    if result is not None and result.buffers:
        imgui.separator_text("Buffers as given")
        for line in result.buffers:
            imgui.text_wrapped(line)
        widgets.tooltip("Where the buffers of this frame differ from our conventions (docs/engines.md)")


def _values(app: App, inspection) -> None:
    """Draw a table for each stage, under its name: layers, and their values."""
    with widgets.compact():
        for group, of_group in groupby(_rows(app, inspection), key=lambda row: row.group):
            imgui.text_disabled(group)
            _table(group, list(of_group))


def _table(group: str, rows: list[Row]) -> None:
    """Draw the rows of a stage."""
    if not imgui.begin_table(f"###values {group}", 2, imgui.TableFlags_.row_bg.value):
        return
    for title, share in (("layer", _NAMES), ("value", 1 - _NAMES)):
        imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch.value, share)
    for row in rows:
        imgui.table_next_row()
        imgui.table_next_column()
        imgui.text_wrapped(f"{row.label} {row.where}".strip())
        widgets.tooltip(f"{row.label}: {row.description}")
        imgui.table_next_column()
        text_color = widgets.red() if row.is_bad else imgui.get_style_color_vec4(imgui.Col_.text)
        widgets.colored(text_color, row.value)
    imgui.end_table()


def _rows(app: App, inspection) -> list[Row]:
    """Return the rows of an inspection, which are made once for it."""
    known, rows = app.inspected
    if known is not inspection:
        rows = rows_of(app.model.contents.layers, inspection)
        app.inspected = inspection, rows
    return rows


def rows_of(layers: Iterable[LayerSpec], inspection: Inspection) -> list[Row]:
    """Return the rows of an inspection in the order of `layers`: for each the value at the pixel; then, of layers on
    the rendered image, the one where the pixel's content comes from."""
    rows = []
    for spec in layers:
        named = ((HERE, inspection.values), (FROM, inspection.origin))
        for where, values in ((where, values[spec.name]) for where, values in named if spec.name in values):
            told = where if spec.name in inspection.origin else ""
            text, bad = value_text(spec, values), _is_bad(spec, values)
            rows.append(Row(spec.group, spec.label, spec.description, told, text, bad))
    return rows


def _is_bad(spec: LayerSpec, values: np.ndarray) -> bool:
    """Return whether the values (planes?, channels) of a pixel hold NaN or infinity. Infinite depth is sky, and of a
    position or a sum whose fourth value is 0 nothing is known."""
    if values.dtype.kind != "f" or spec.view in ("mask", "label"):
        return False
    sky = np.isposinf(values) if spec.view == "depth" else False
    known = values[..., 3:4] != 0 if spec.view == "world" or spec.components[3:] == ("weight",) else True
    return bool((~np.isfinite(values) & ~np.asarray(sky) & known).any())


def _story(model: Model, story: Story) -> None:
    imgui.separator_text(f"Story of pixel ({story.pixel[0]}, {story.pixel[1]})")
    for number, sentence in enumerate(story.sentences):
        imgui.bullet()
        imgui.same_line()
        imgui.text_wrapped(sentence)
        _links(model, number, getattr(sentence, "links", ()))
    if len(story.way) > 1:
        imgui.bullet()
        imgui.same_line()
        imgui.text_wrapped("Its way through the rendered frames before:")
        with widgets.in_rows() as row:
            for point in story.way[1:]:
                row(imgui.calc_text_size(f"{point.k}").x)
                if imgui.text_link(f"{point.k}###way {point.k}"):
                    model.walk.follow_way(point)
                widgets.tooltip(f"rendered frame {point.k}, pixel ({point.px[0]:.1f}, {point.px[1]:.1f})")
    if imgui.button(f"{icons.ICON_FA_XMARK} forget###forget_story"):
        model.pointing.pick(None)


def _links(model: Model, number: int, links) -> None:
    """Draw the links of a step, under it."""
    with widgets.in_rows() as row:
        for link in links:
            reason, name = model.walk.why_not(link), f"{link.label}###{number} {link.label}"
            row(imgui.calc_text_size(link.label).x)
            if reason:
                imgui.text_disabled(link.label)
            elif imgui.text_link(name):
                model.walk.follow(link)
            widgets.tooltip(reason or _where(link))


def _where(link) -> str:
    parts = [] if link.frame is None else [f"rendered frame {link.frame}"]
    parts += [] if link.pixel is None else [f"pixel ({link.pixel[0]}, {link.pixel[1]})"]
    parts += [f"layer {link.layer}"] if link.layer and link.frame is None else []
    return "Go to " + ", ".join(parts)
