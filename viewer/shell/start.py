"""Starting the viewer (`gffe view`), and leaving it."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from gffe_cl.engine.core.errors import GffeError
from ..state.model import Model


def view(model: Model, size: tuple[int, int] | None = None) -> None:
    """Run the viewer until it is closed. Without `size` the window is as large as last time. Raises GffeError without a
    display."""
    require_display()
    from .app import App

    App(model).run(size)


@contextmanager
def leaving(model: Model) -> Iterator[None]:
    """Close `model` at the end. If the device is still busy, end the program without shutting down the OpenCL
    runtime, which would abort or hang: with exit code 0, or as `gffe` does after the exception."""
    code = 2
    try:
        yield
        code = 0
    except KeyboardInterrupt:
        code = 130
        raise
    finally:
        model.close()
        threading.excepthook = lambda _: None  # of threads that the interpreter takes down in the midst of their work
        if model.left_working:
            atexit.register(_end, code)


def _end(code: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def require_display() -> None:
    """Raise GffeError where no window can be opened."""
    if not sys.platform.startswith("linux"):
        return
    without = "without a screen: xvfb-run -a gffe …"
    display = os.environ.get("DISPLAY")
    wayland = os.environ.get("WAYLAND_DISPLAY")
    if not display and not wayland:
        raise GffeError(f"no display to open a window on (expected DISPLAY to be set; {without})")
    import imgui_bundle  # noqa: F401  before glfw

    import glfw  # isort: skip

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        opened = glfw.init()
    if not opened and not display:
        raise GffeError(
            f"no X display: WAYLAND_DISPLAY is {wayland}, but this viewer's GLFW opens windows by X11 only (expected"
            f" DISPLAY, on Wayland by XWayland; {without})"
        )
    if not opened:
        raise GffeError(f"the display {display} cannot be opened (DISPLAY may be wrong; {without})")
