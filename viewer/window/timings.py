"""Timings of the stages and their kernels over the last frames; kernels that are rebuilt when their files change."""

from __future__ import annotations

from imgui_bundle import ImVec2, hello_imgui, imgui, implot
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.engine.opencl.program import kernel_folder
from ..state.model import Model
from . import widgets
from .app import App

_COLUMNS = {"stage": 0.5, "time": 0.28, "ms": 0.22}
_NARROW = 20.0  # em: a narrower table has no bars


def draw(app: App) -> None:
    model = app.model
    means = model.timings.means()
    if not means:
        imgui.text_disabled("nothing computed yet")
        return
    imgui.text_wrapped(f"interface {imgui.get_io().framerate:.0f} frames/s   upload {model.screen.upload_ms:.1f} ms")
    count, wall, readback = model.timings.walls()
    imgui.text_wrapped(f"kernels: {model.timings.text}")
    widgets.tooltip("A frame that comes from the cache again does not count again")
    if count:
        of = f"mean of the {count} that followed the frame before"
        imgui.text_wrapped(f"request to picture {wall:.1f} ms, of this reading back {readback:.1f} ms: {of}")
        widgets.tooltip("A frame that was jumped to waits for all rendered frames since the last reset")
    held, mib = model.held, 1 << 20
    told = ", ".join(f"{name} {nbytes / mib:.0f}" for name, nbytes in held.items())
    imgui.text_wrapped(f"memory {sum(held.values()) / mib:.0f} of {model.store.most / mib:.0f} MiB: {told}")
    widgets.tooltip("What frames in the cache, pipelines with their sources, and textures hold (--cache)")
    longest, columns = max(means.values()), list(_COLUMNS)
    if imgui.get_content_region_avail().x < hello_imgui.em_size(_NARROW):
        columns.remove("time")
    if imgui.begin_table("###timings", len(columns), imgui.TableFlags_.row_bg.value):
        for title in columns:
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch.value, _COLUMNS[title])
        imgui.table_headers_row()
        for index, (name, milliseconds) in enumerate(means.items()):
            color = implot.get_colormap_color(index)
            imgui.table_next_column()
            flags = imgui.TreeNodeFlags_.span_avail_width.value | imgui.TreeNodeFlags_.no_tree_push_on_open.value
            room = imgui.get_content_region_avail().x - imgui.get_tree_node_to_label_spacing()
            is_open = imgui.tree_node_ex(f"{widgets.cut(name, room)}###stage {name}", flags)
            widgets.tooltip(name if name != "correction" else "")
            if name == "correction":
                network, copies = model.timings.network()
                widgets.tooltip(f"of this {network:.2f} ms in the network, {copies:.2f} ms in copies to it and back")
            _cost(columns, milliseconds, longest, color)
            if is_open:
                _kernels(model, columns, name, longest, color)
        imgui.table_next_column()
        imgui.text("all")
        _cost(columns, sum(means.values()), None, None)
        imgui.end_table()


def _cost(columns: list[str], milliseconds: float, longest: float | None, color) -> None:
    """Draw the cells of those `columns` that there are: a bar, full for the `longest` stage, and milliseconds."""
    if "time" in columns:
        imgui.table_next_column()
        if longest is not None:
            _bar(milliseconds / max(longest, 1e-9), color)
    imgui.table_next_column()
    imgui.text(f"{milliseconds:.2f}")


def _kernels(model: Model, columns: list[str], stage: str, longest: float, color) -> None:
    """Draw a row for each kernel of a stage."""
    for kernel, milliseconds in model.timings.of_stage(stage).items():
        imgui.table_next_column()
        imgui.indent(hello_imgui.em_size(2))
        imgui.text(widgets.cut(kernel, imgui.get_content_region_avail().x))
        widgets.tooltip(kernel)
        imgui.unindent(hello_imgui.em_size(2))
        _cost(columns, milliseconds, longest, color)


def _bar(share: float, color) -> None:
    """Draw a bar in a cell: `share` of its width."""
    origin, height = imgui.get_cursor_screen_pos(), imgui.get_text_line_height()
    width = max(imgui.get_content_region_avail().x * min(share, 1.0), 1.0)
    corner = ImVec2(origin.x + width, origin.y + 0.85 * height)
    ink = imgui.get_color_u32(color)
    imgui.get_window_draw_list().add_rect_filled(ImVec2(origin.x, origin.y + 0.2 * height), corner, ink)


_GREEN = (0.5, 0.85, 0.5, 1.0)


def draw_kernels(app: App) -> None:
    engine = app.model.engine
    imgui.text_wrapped(f"{kernel_folder()}")
    widgets.action_button(app.actions, "reload_kernels", icons.ICON_FA_ARROWS_ROTATE)
    imgui.same_line()
    if engine.build_error:
        imgui.push_text_wrap_pos(0.0)
        imgui.text_colored(widgets.red(), "does not build; the last good kernels are running")
        imgui.text_unformatted(engine.build_log)
        imgui.pop_text_wrap_pos()
    else:
        imgui.text_colored(_GREEN, "built")
        widgets.hint("Save a .cl file: it is rebuilt at once")
