"""Opens the viewer on a screen with 144 dpi, without a sequence; started by test_viewer_window.py under xvfb-run.

viewer_dpi_case.py REPORT.json: sizes of the first frames of the interface, and what is remembered of the window.
"""

import ctypes
import json
import sys
from pathlib import Path

DPI = 144
_RESOURCE_MANAGER, _STRING = 23, 31  # predefined atoms of X11


def set_dpi() -> None:
    """Set the screen's resources as xrdb does: GLFW takes its content scale from them."""
    x11 = ctypes.CDLL("libX11.so.6")
    x11.XOpenDisplay.restype, x11.XDefaultRootWindow.restype = ctypes.c_void_p, ctypes.c_ulong
    display, text = ctypes.c_void_p(x11.XOpenDisplay(None)), f"Xft.dpi:\t{DPI}\n".encode()
    root = ctypes.c_ulong(x11.XDefaultRootWindow(display))
    x11.XChangeProperty(
        display, root, ctypes.c_ulong(_RESOURCE_MANAGER), ctypes.c_ulong(_STRING), 8, 0, text, len(text)
    )
    x11.XCloseDisplay(display)


def main(report: Path) -> None:
    set_dpi()
    from imgui_bundle import imgui

    from gffe_cl.viewer.state.model import Model
    from gffe_cl.viewer.state.settings import Settings
    from gffe_cl.viewer.window.running import new_app, run

    model, frames = Model(Settings(), start=False, save_settings=False), []

    def look(app):
        style = imgui.get_style()
        frames.append([style.scrollbar_size, style.window_padding.x])
        if len(frames) == 4:
            model.settings.theme = "light"
        if len(frames) > 8:
            app.close()

    remembered = []
    model.remember = remembered.append
    run(new_app(model, on_frame=look), (600, 400))
    report.write_text(json.dumps({"frames": frames, "remembered": remembered[0]}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
