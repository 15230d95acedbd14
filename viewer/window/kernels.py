"""Kernels panel: reloading while the viewer runs, and the compiler's messages."""

from __future__ import annotations

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from gffe_cl.engine.opencl.program import kernel_folder
from . import widgets
from .interface import Interface

_GREEN = (0.5, 0.85, 0.5, 1.0)


def draw(app: Interface) -> None:
    engine = app.model.engine
    imgui.text_wrapped(f"{kernel_folder()}")
    widgets.action_button(app.actions, "reload_kernels", icons.ICON_FA_ARROWS_ROTATE)
    imgui.same_line()
    if engine.build_error:
        imgui.push_text_wrap_pos(0.0)
        imgui.text_colored(widgets.red(), "does not build; the last good kernels are running")
        imgui.text_unformatted(engine.build_log)
        imgui.pop_text_wrap_pos()
        if imgui.button("copy###copy_build_error"):
            imgui.set_clipboard_text(engine.build_log)
    else:
        imgui.text_colored(_GREEN, "built")
        widgets.hint("Save a .cl file: it is rebuilt at once")
