"""Timings of the stages: milliseconds and bytes per pixel, and how they went over the last frames."""

from __future__ import annotations

import math

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui, implot
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.viewer.panels import widgets


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
            if name in means:
                imgui.text_colored(implot.get_colormap_color(index), icons.ICON_FA_SQUARE)
                imgui.same_line()
            imgui.text(name)
            if name == "correction":
                widgets.tooltip(f"of this {model.timings.network():.2f} ms in the network")
            for text in (f"{milliseconds:.2f}", per_pixel):
                imgui.table_next_column()
                imgui.text(text)
        imgui.end_table()
    if bandwidth:
        imgui.text_disabled(f"bytes per pixel = time × {bandwidth:.1f} GB/s of copying ÷ pixels")
    elif imgui.button("measure bandwidth###bandwidth"):
        model.engine.measure_bandwidth()
    widgets.tooltip("As in `gffe bench`; takes a second and 512 MiB on the device")
    flags = implot.Flags_.no_mouse_text.value | implot.Flags_.no_legend.value  # the table says which is which
    if implot.begin_plot("###history", ImVec2(-1, hello_imgui.em_size(10)), flags):
        flags = implot.AxisFlags_.auto_fit.value
        implot.setup_axes("computed frame", "ms", flags, flags)
        for name, values in model.timings.stages.items():
            implot.plot_line(name, np.array(values, np.float64))
        implot.end_plot()
