"""Inspector: the values of all layers under the cursor, and the story of a pixel that was clicked."""

from __future__ import annotations

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from gffe_cl.viewer.panels import widgets
from gffe_cl.viewer.picture.legends import value_text


def draw(app) -> None:
    model = app.model
    if model.pointing.story is not None:
        _story(model)
    widgets.heading("Values")
    inspection = model.pointing.inspection
    if inspection is None:
        widgets.hint("Move over the picture; click a pixel for its story")
        return
    x, y = inspection.pixel
    at = f"pixel ({x}, {y})"
    if inspection.source is not None:
        at += f"   from ({inspection.source[0]:.2f}, {inspection.source[1]:.2f}) of the rendered frame"
    imgui.text_wrapped(at)
    if imgui.begin_table("###values", 2, imgui.TableFlags_.row_bg.value):
        for title, share in (("layer", 0.44), ("value", 0.56)):
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch.value, share)
        for label, description, value in _rows(app, inspection):
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.text_wrapped(label)
            widgets.tooltip(description)
            imgui.table_next_column()
            imgui.text_wrapped(value)
        imgui.end_table()


def _rows(app, inspection) -> list[tuple[str, str, str]]:
    """(layer, its description, its value), made once for an inspection."""
    known, rows = app.inspected
    if known is not inspection:
        rows = [
            (f"{spec.group}: {spec.label}", spec.description, value_text(spec, inspection.values[spec.name]))
            for spec in app.model.contents.layers
            if spec.name in inspection.values
        ]
        app.inspected = inspection, rows
    return rows


def _story(model) -> None:
    story = model.pointing.story
    widgets.heading(f"Story of pixel ({story.pixel[0]}, {story.pixel[1]})")
    for sentence in story.sentences:
        imgui.bullet()
        imgui.same_line()
        imgui.text_wrapped(sentence)
    if imgui.button(f"{icons.ICON_FA_XMARK} forget###forget_story"):
        model.pointing.pick(None)
