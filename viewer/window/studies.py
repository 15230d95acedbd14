"""Panels of studies: layers that differ between A and B, gains of modules, a row of pixels over time."""

from __future__ import annotations

import math
from itertools import groupby

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.options import OPTIONS
from ..engine.figures import REGIONS
from ..picture.canvas import Canvas
from ..picture.displays import FrameInfo
from ..picture.view import View
from ..state.model import Model
from ..state.studies import ALL, Difference, without
from . import widgets
from .app import App


def draw_differing(app: App) -> None:
    model, study = app.model, app.model.studies.differing
    if widgets.studied(model, study) is None:
        return
    shown, stale = [one for one in study.all if one.differs], study.stale
    done = f"{len(study.found)} of {study.parts} stages …   " if study.busy else ""
    widgets.hint(done + study.text)
    with widgets.compact():
        if stale:
            imgui.text_disabled("equal: stale, unless nothing moves")
            _differing_table(model, "stale", stale)
        for group, listed in groupby(shown, key=lambda one: one.spec.group):
            imgui.text_disabled(group)
            _differing_table(model, group, list(listed))
        folded: dict[str, list[Difference]] = {}
        for one in study.all:
            if not one.differs and one not in stale:
                folded.setdefault(one.remark or "equal", []).append(one)
        for title, listed in folded.items():
            if imgui.tree_node(f"{len(listed)} {title}###folded {title}"):
                _differing_table(model, title, listed)
                imgui.tree_pop()


def _differing_table(model: Model, group: str, listed: list[Difference]) -> None:
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
            show_difference(model, one)
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


def show_difference(model: Model, one: Difference) -> None:
    """Show a layer, and the difference between A's and B's, of several planes in that with the largest, and pick its
    pixel."""
    model.show_layer(one.spec.name)
    if one.planes:
        model.looks.choose_plane(one.spec.name, one.planes[0])
    if not model.comparison.neighbor:
        model.comparison.with_settings()
    model.comparison.set("difference")
    if one.worst:
        model.pointing.pick(one.worst)


_SHORT = {"out of screen": "out", "disoccluded": "hole", "silhouettes": "edge", "dynamic": "mover"}  # headings
_LEAST_GAIN = 0.005  # dB: less is written as nothing


def draw_ablation(app: App) -> None:
    model, study = app.model, app.model.studies.ablation
    if widgets.studied(model, study) is None:
        return
    if study.busy:
        imgui.progress_bar(len(study.found) / max(study.parts, 1), (-1, 0), f"{len(study.found)} of {study.parts}")
    else:
        widgets.hint("dB that this frame loses without a module. A click compares with it off")
    with widgets.compact():
        _ablation_table(model)


def _ablation_table(model: Model) -> None:
    """Draw a row for each module: the gain over the image, and in the regions, or as many of them as have room."""
    number, names = hello_imgui.em_size(2.8), max(imgui.calc_text_size(OPTIONS[name].label).x for name in OPTIONS)
    room = imgui.get_content_region_avail().x - min(names, hello_imgui.em_size(8))
    found = model.studies.ablation.sorted
    regions = [region for region in REGIONS if any(not math.isnan(gains[region]) for _, gains in found)]
    regions = regions[: max(int(room / (number + 2 * imgui.get_style().cell_padding.x)) - 1, 1)]
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
        text = widgets.cut(OPTIONS[name].label, imgui.get_content_region_avail().x)
        if imgui.selectable(f"{text}###ablation {name}", False, imgui.SelectableFlags_.span_all_columns.value)[0]:
            _compare(model, name)
        told = "\n".join(f"{region}: {_gain(gains[region])} dB" for region in (ALL, *REGIONS) if region in gains)
        widgets.tooltip(f"{OPTIONS[name].label}\n{told}")
        for region in (ALL, *regions):
            imgui.table_next_column()
            imgui.text(_gain(gains[region]))
    imgui.end_table()


def _gain(gain: float) -> str:
    return "–" if math.isnan(gain) else "0" if abs(gain) < _LEAST_GAIN else f"{gain:+.2f}"


def _compare(model: Model, name: str) -> None:
    """Make the settings without a module B, and show the difference."""
    kept = model.kept.keep(without(model.setup, name), model.recipe.kernels)
    model.comparison.with_settings(kept.name)
    model.comparison.set("difference")


_NAME = "over time"  # of the layer on the canvas
_LEAST_HEIGHT = 4.0  # em: height


def draw_over_time(app: App) -> None:
    model, study = app.model, app.model.studies.over_time
    here = widgets.studied(model, study)
    if here is None:
        return
    spec, picture = model.contents.spec(here.shown), study.picture(here)
    if picture is None or spec is None or here.pixel is None:
        widgets.hint("no frame has rows of this layer" if study.found and not study.busy else "computing …")
        return
    rows, slots = picture
    size = rows.shape[1], rows.shape[0]
    canvas = app.row_canvas = app.row_canvas or Canvas(app.canvas.ctx)
    canvas.frame = FrameInfo(size, exposure=here.exposure)
    canvas.upload(_NAME, rows[None] if spec.planes > 1 else rows, spec)
    texture = canvas.draw(View(_NAME, model.looks.of(spec.name), center=(size[0] / 2, size[1] / 2), grid=False), size)
    done = f"   {len(study.found)} of {study.parts}" if study.busy else ""
    text = f"row {here.pixel[1]} of {spec.label}, frames {slots.start} to {slots.stop - 1} downward{done}"
    imgui.text_disabled(widgets.cut(text, imgui.get_content_region_avail().x))
    room, origin = imgui.get_content_region_avail(), imgui.get_cursor_screen_pos()
    width, height = room.x, max(room.y, hello_imgui.em_size(_LEAST_HEIGHT))
    imgui.image(imgui.ImTextureRef(texture.glo), ImVec2(width, height))
    if imgui.is_item_hovered():
        at = slots.start + int((imgui.get_mouse_pos().y - origin.y) / height * size[1])
        imgui.set_tooltip(f"frame {at}: click to go there")
        if imgui.is_mouse_clicked(imgui.MouseButton_.left):
            model.playback.seek(at)
    _marks(origin, width, height, size, here.pixel[0], model.slot - slots.start)


def _marks(origin, width: float, height: float, size: tuple[int, int], x: int, row: int) -> None:
    """Mark the picked pixel's column, and the shown frame."""
    marks, ink = imgui.get_window_draw_list(), imgui.get_color_u32(widgets.ACCENT)
    right, down = origin.x + (x + 0.5) / size[0] * width, origin.y + (row + 0.5) / size[1] * height
    tick = 5 * widgets.mark_unit()
    for top, bottom in ((origin.y, origin.y + tick), (origin.y + height - tick, origin.y + height)):
        marks.add_line(ImVec2(right, top), ImVec2(right, bottom), ink, 2 * widgets.mark_unit())
    for left, end in ((origin.x, origin.x + 2 * tick), (origin.x + width - 2 * tick, origin.x + width)):
        marks.add_line(ImVec2(left, down), ImVec2(end, down), ink, 2 * widgets.mark_unit())


_AMBER, _GRAY = ImVec4(0.9, 0.7, 0.3, 1.0), ImVec4(0.6, 0.6, 0.62, 1.0)


def draw_doctor(app: App) -> None:
    model = app.model
    doctor = model.document.doctor
    widgets.action_button(app.actions, "doctor", icons.ICON_FA_STETHOSCOPE)
    imgui.same_line()
    if doctor is None:
        widgets.hint("Examine motion, depth, cameras and colors for faults, and propose repairs")
        return
    if not doctor.done:
        widgets.hint("examining motion, depth, cameras and colors …")
    elif doctor.problem:
        widgets.hint("could not be examined")
        widgets.colored(widgets.red(), doctor.problem)
    elif not doctor.findings:
        widgets.hint("everything fits")
    else:
        widgets.hint(f"{len(doctor.findings)} finding{'s' * (len(doctor.findings) > 1)}")
    _findings(model, doctor)
    if doctor.converts:
        imgui.separator()
        command = f"gffe check {model.source.target} --format-out FOUND.json"
        widgets.hint(printable(f"{command}  writes the format that undoes this, for gffe import --format"))


def _findings(model: Model, doctor) -> None:
    if not doctor.findings:
        return
    from gffe_cl.captures.doctor.findings import FAULT, NOTE  # loaded by now

    colors = {FAULT: widgets.red(), NOTE: _AMBER}
    for finding in doctor.findings:
        widgets.colored(colors.get(finding.kind, _GRAY), finding.kind)
        imgui.text_wrapped(str(finding))
        with widgets.in_rows() as row:
            for name, (frame, x, y) in finding.places.items():
                text = f"{name} in frame {frame}"
                row(imgui.calc_text_size(text).x)
                if imgui.text_link(f"{text}###place {finding.name} {name}"):
                    model.walk.follow_input(frame, (x, y))
                widgets.tooltip(f"rendered frame {frame}, pixel ({x}, {y}) of the input")
