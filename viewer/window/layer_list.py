"""Layers: every named buffer of every stage, shown singly or all at once; how each is displayed is remembered."""

from __future__ import annotations

from functools import partial
from itertools import groupby

from imgui_bundle import ImVec2, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from ..picture.colors import COLOR_MAPS
from ..picture.displays import TONE_MAPS, default_display, shown_as
from ..picture.legends import Legend, legend
from ..state.captions import disocclusion_colors
from ..state.model import Model
from . import widgets
from .interface import Interface

_OVERLAYS = ("none", "edges", "residual motion", "disocclusions", "clipping")
_OVERLAY_HELP = {
    "edges": "Edges of depth are red, of motion green, of color blue: white where all three meet",
    "residual motion": "Motion minus the camera's; its hue is its direction",
    "clipping": "Colors below 0 are blue, above display white red, with the exposure of the display",
    "disocclusions": "Pixels without a fragment of the rendered frame",
}


def draw(app: Interface) -> None:
    model = app.model
    widgets.toggle(
        "overview",
        model.overview,
        lambda on: setattr(model, "overview", on),
        "Every layer as a tile; click one to open it",
    )
    widgets.choice("overlay", model.view.overlay, list(_OVERLAYS), lambda name: setattr(model.view, "overlay", name))
    if model.view.overlay in _OVERLAY_HELP:
        widgets.hint(_OVERLAY_HELP[model.view.overlay])
    if model.disocclusions.on:
        widgets.show_legend(Legend("none", labels=disocclusion_colors()))
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


def _row(app: Interface, spec) -> None:
    model = app.model
    shown = spec.name == model.view.a
    reason = model.contents.why_not(spec.name)
    imgui.begin_disabled(reason is not None)
    if imgui.selectable(f"{widgets.cut(spec.label, imgui.get_content_region_avail().x)}###{spec.name}", shown)[0]:
        model.show_layer(spec.name)
    imgui.end_disabled()
    if shown and spec.name != app.row_seen:
        app.row_seen = spec.name
        if not imgui.is_item_visible():
            imgui.set_scroll_here_y()
    widgets.tooltip(reason or spec.description)
    if spec.name == model.view.b and model.view.compare != "off":
        imgui.same_line()
        imgui.text_disabled(f"{icons.ICON_FA_CODE_COMPARE} B")


def _display(model: Model) -> None:
    spec = model.contents.spec(model.view.a)
    if spec is None:
        return
    display, change = model.looks.of(spec.name), partial(model.looks.change, spec.name)
    widgets.heading(
        widgets.cut(f"Display of {spec.label}", imgui.get_content_region_avail().x - hello_imgui.em_size(3))
    )
    view, _ = shown_as(spec, display)
    if view == "color":
        widgets.slider("exposure", display.exposure, -8.0, 8.0, 0.0, lambda v: change(exposure=v), "%+.2f EV")
        widgets.choice("tone map", display.tone_map, list(TONE_MAPS), lambda v: change(tone_map=v))
    elif view in ("motion", "place"):
        widgets.slider(
            "full length", display.motion_scale, 0.25, 64.0, default_display(spec).motion_scale,
            lambda v: change(motion_scale=v), "%.2f px", "Motion of this length is fully bright",
        )  # fmt: skip
        widgets.toggle("arrows", model.arrows, lambda on: setattr(model, "arrows", on), "Arrows over the picture")
        imgui.same_line()
        if imgui.get_content_region_avail().x < imgui.calc_text_size("reversed").x + 2 * imgui.get_frame_height():
            imgui.new_line()
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
            "plane", shown, 1, spec.planes, 1, lambda v: model.looks.choose_plane(spec.name, int(v) - 1), "%d",
            spec.description,
        )  # fmt: skip
    if len(spec.channels) > 1:
        channel = display.channel or spec.channels[0]
        widgets.choice("channel", channel, list(spec.channels), lambda v: change(channel=v))
    if view not in ("mask", "label"):
        if imgui.button("fit###fit_range"):
            model.looks.fit(spec.name)
        widgets.tooltip("Range, or exposure, from the picture: 1 to 99 % of its finite values (N)")
        imgui.same_line()
    if imgui.button("reset###reset_display"):
        model.looks.reset(spec.name)
    widgets.show_legend(legend(spec, display))


def _range(display, change) -> None:
    above = widgets.leave_room_for("range")
    speed = max(abs(display.high - display.low) / 200, 1e-4)
    changed, low, high = imgui.drag_float_range2("###range", display.low, display.high, speed, 0.0, 0.0, "%.3g", "%.3g")
    if not above:
        widgets.beside("range")
    if changed:
        change(low=low, high=high)
