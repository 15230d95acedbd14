"""Starting the viewer (`gffe view`), and leaving it."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from gffe_cl.engine.core.errors import GffeError
from ..state.model import Model


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


_WITHOUT_SCREEN = "without a screen: xvfb-run -a gffe …"


def require_display() -> None:
    """Raise GffeError where no window with OpenGL 3.3 can be opened."""
    display, wayland = os.environ.get("DISPLAY"), os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not display and not wayland:
        raise GffeError(f"no display to open a window on (expected DISPLAY to be set; {_WITHOUT_SCREEN})")
    import imgui_bundle  # noqa: F401  before glfw

    import glfw  # isort: skip

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not glfw.init():
            raise GffeError(_why_not(display, wayland, _words(glfw.get_error()[1])))
        hints = {
            glfw.VISIBLE: False,
            glfw.CONTEXT_VERSION_MAJOR: 3,
            glfw.CONTEXT_VERSION_MINOR: 3,
            glfw.OPENGL_PROFILE: glfw.OPENGL_CORE_PROFILE,
            glfw.OPENGL_FORWARD_COMPAT: True,  # macOS has no other
        }
        glfw.default_window_hints()
        for hint, value in hints.items():
            glfw.window_hint(hint, value)
        window = glfw.create_window(8, 8, "gffe-cl", None, None)
        reason = _words(glfw.get_error()[1])
        glfw.default_window_hints()
        if window:
            glfw.destroy_window(window)
            return
    where = f"the display {display}" if display else "the screen"
    raise GffeError(
        f"{where} has no OpenGL 3.3 ({reason}; expected the driver of the screen's GPU, or Mesa's software renderer;"
        f" over ssh or {_WITHOUT_SCREEN} --screenshot)"
    )


def _why_not(display: str | None, wayland: str | None, reason: str) -> str:
    """Return the message for a system on which GLFW, for its `reason`, cannot begin."""
    if display:
        return f"the display {display} cannot be opened (DISPLAY may be wrong; {_WITHOUT_SCREEN})"
    if wayland:
        return (
            f"no X display: WAYLAND_DISPLAY is {wayland}, but this viewer's GLFW opens windows by X11 only (expected"
            f" DISPLAY, on Wayland by XWayland; {_WITHOUT_SCREEN})"
        )
    return f"no window can be opened ({reason}; expected a screen)"


def _words(reason: Any) -> str:
    """Return GLFW's reason, bytes or None, as text in one line."""
    return " ".join((reason or b"GLFW gives no reason").decode("utf-8", "replace").split())
