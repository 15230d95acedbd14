"""Timings of the stages: milliseconds and bytes per pixel, and how they went over the last frames."""

from __future__ import annotations

import math

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui, implot
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.viewer.panels import widgets

_BAR, _NECESSARY = (0.36, 0.62, 0.95, 0.25), (0.36, 0.62, 0.95, 0.55)


def draw(app) -> None:
    model = app.model
    means = model.timings.means()
    if not means:
        imgui.text_disabled("nothing computed yet")
        return
    imgui.text_wrapped(
        f"interface {imgui.get_io().framerate:.0f} frames/s   frame {model.timings.wall():.1f} ms"
        f"   reading back {model.timings.readback():.1f} ms   upload {model.screen.upload_ms:.1f} ms"
    )
    bandwidth, pixels = model.engine.bandwidth, math.prod(model.contents.size)
    if imgui.begin_table("###timings", 3, imgui.TableFlags_.row_bg.value):
        for title, share in (("stage", 0.46), ("ms", 0.24), ("bytes/px", 0.3)):
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch.value, share)
        imgui.table_headers_row()
        for index, (name, milliseconds) in enumerate((*means.items(), ("all", sum(means.values())))):
            per_pixel = f"{milliseconds * 1e6 * bandwidth / pixels:.0f}" if bandwidth else "–"
            imgui.table_next_column()
            is_open = False
            if name in means:
                imgui.text_colored(implot.get_colormap_color(index), icons.ICON_FA_SQUARE)
                imgui.same_line()
                flags = imgui.TreeNodeFlags_.span_avail_width.value | imgui.TreeNodeFlags_.no_tree_push_on_open.value
                is_open = imgui.tree_node_ex(f"{name}###stage {name}", flags)
            else:
                imgui.text(name)
            if name == "correction":
                network, copies = model.timings.network(), model.timings.copies()
                widgets.tooltip(f"of this {network:.2f} ms in the network, {copies:.2f} ms in copies to it and back")
            for text in (f"{milliseconds:.2f}", per_pixel):
                imgui.table_next_column()
                imgui.text(text)
            if is_open:
                _kernels(model, name, sum(means.values()))
        imgui.end_table()
    _measure(model, bandwidth)
    flags = implot.Flags_.no_mouse_text.value | implot.Flags_.no_legend.value  # the table says which is which
    if implot.begin_plot("###history", ImVec2(-1, hello_imgui.em_size(10)), flags):
        flags = implot.AxisFlags_.auto_fit.value
        implot.setup_axes("computed frame", "ms", flags, flags)
        for name, values in model.timings.stages.items():
            implot.plot_line(name, np.array(values, np.float64))
        implot.end_plot()


def _kernels(model, stage: str, frame_ms: float) -> None:
    """A row for each kernel of a stage: its share of the frame as a bar; of its bytes those that had to move."""
    bandwidth, pixels = model.engine.bandwidth, math.prod(model.contents.size)
    must_move = model.engine.traffic.get(stage, {})
    for kernel, milliseconds in model.timings.of_stage(stage).items():
        moved = milliseconds * 1e6 * bandwidth / pixels if bandwidth else None
        must = must_move.get(kernel)
        imgui.table_next_column()
        _bar(milliseconds / max(frame_ms, 1e-9), None if moved is None or must is None else must / max(moved, 1e-9))
        imgui.text_disabled(f"   {kernel}")
        imgui.table_next_column()
        imgui.text_disabled(f"{milliseconds:.2f}")
        imgui.table_next_column()
        imgui.text_disabled(("–" if moved is None else f"{moved:.0f}") + ("" if must is None else f" / {must:.0f}"))
        widgets.tooltip("bytes per pixel: measured / had to move, as its stage declares them")


def _bar(share: float, necessary: float | None) -> None:
    """Behind the row's first cell: `share` of its width, of this the part `necessary` in another colour."""
    origin, height = imgui.get_cursor_screen_pos(), imgui.get_text_line_height()
    width = imgui.get_content_region_avail().x * min(share, 1.0)
    draw = imgui.get_window_draw_list()
    for part, color in ((1.0, _BAR), (min(necessary or 0.0, 1.0), _NECESSARY)):
        corner = ImVec2(origin.x + width * part, origin.y + height)
        draw.add_rect_filled(origin, corner, imgui.get_color_u32(color))


def _measure(model, bandwidth: float | None) -> None:
    if bandwidth:
        imgui.text_wrapped(f"bytes per pixel = time × {bandwidth:.1f} GB/s of copying ÷ pixels")
    if imgui.button(f"{'measure' if bandwidth is None else 'count again'}###bandwidth"):
        model.measure_cost()
    widgets.tooltip(
        "Bandwidth as in `gffe bench` (takes a second and 512 MiB on the device), and the bytes that the frame shown"
        " had to move: open a stage to see them beside those measured"
    )
