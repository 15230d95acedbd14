"""Starting the viewer: by hand, or to take one screenshot (`gffe view`)."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.viewer.steps import found_layer

_SETTLED_FRAMES = 4  # interface frames after everything has arrived: layouts need a few to come to rest
PATIENCE = 120.0  # seconds
REPORT_SIZE = (1600, 900)  # of the window for screenshots and measuring


@dataclass(frozen=True)
class Look:
    """Displayed layers: `layer`, compared in the way `compare` with the layer `other`."""

    layer: str = "final"
    compare: str = "off"
    other: str | None = None

    def take(self, model) -> None:
        """Show it in a model that has layers. Raises GffeError."""
        shown, other = (name and found_layer(model, name) for name in (self.layer, self.other))
        model.show_layer(shown)
        if other:
            model.view.b = other
        if self.compare != "off":
            reason = model.comparison.why_not(self.compare)
            if reason:
                raise GffeError(f"--compare {self.compare}: {reason}")
            model.comparison.set(self.compare)


@dataclass(frozen=True)
class Shot:
    """A screenshot to take: `look` at the slot `frame`, with the story of `pixel`; `overview`: of all layers."""

    path: Path
    frame: int = 0
    look: Look = Look()
    pixel: tuple[int, int] | None = None
    overview: bool = False


def view(model, size: tuple[int, int] | None = None, shot: Shot | None = None) -> None:
    """Run the viewer until it is closed, or until `shot` is written. Without `size` the window is as large as last
    time, for a `shot` of REPORT_SIZE.

    Raises GffeError without a display, or when the screenshot cannot be made.
    """
    require_display()
    from gffe_cl.viewer.app import App

    if shot is None:
        App(model).run(size)
        return
    if not shot.path.absolute().parent.is_dir():
        raise GffeError(f"{shot.path}: cannot write: no such folder")
    if shot.path.suffix.lower() != ".png":
        raise GffeError(f"{shot.path}: a screenshot's name must end in .png")
    camera = _Photographer(shot)
    App(model, on_frame=camera).run(size or REPORT_SIZE, test=lambda app: None)
    if camera.problem:
        raise GffeError(camera.problem)
    _save(shot.path)


@contextmanager
def leaving(model) -> Iterator[None]:
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
    """GffeError where no window can be opened."""
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


def without_pointer() -> None:
    """Suppress everything that depends on the mouse position."""
    from imgui_bundle import imgui

    nowhere = float(np.finfo(np.float32).min)
    imgui.get_io().add_mouse_pos_event(nowhere, nowhere)


class _Photographer:
    """Sets up the view in the running application, waits until it stands, and closes the window."""

    def __init__(self, shot: Shot):
        self.shot, self.problem = shot, None
        self._still = 0
        self._arranged = False
        self._until = time.perf_counter() + PATIENCE

    def __call__(self, app) -> None:
        model = app.model
        without_pointer()
        problem = model.failure or model.parameters.network_fault
        if problem or time.perf_counter() > self._until:
            self.problem = problem or f"the screenshot was not ready after {PATIENCE:.0f} s"
            app.close()
        elif model.source is None or not model.contents.layers:
            return
        elif not self._arranged:
            self.problem = self._arrange(model)
            self._arranged = True
            if self.problem:
                app.close()
        else:
            self._still = self._still + 1 if model.settled else 0
            if self._still > _SETTLED_FRAMES:
                app.close()

    def _arrange(self, model) -> str | None:
        shot = self.shot
        if not 0 <= shot.frame < model.playback.slots:
            return f"--frame must be 0 to {model.playback.slots - 1}, got {shot.frame}"
        model.playback.pause()
        model.playback.seek(shot.frame)
        width, height = model.source.width, model.source.height
        if shot.pixel is not None and not (0 <= shot.pixel[0] < width and 0 <= shot.pixel[1] < height):
            return f"--pixel must be inside {width}×{height}, got {shot.pixel[0]},{shot.pixel[1]}"
        try:
            shot.look.take(model)
        except GffeError as error:
            return str(error)
        model.set_overview(shot.overview)
        model.pointing.enabled = False
        if shot.pixel is not None:
            model.pointing.pick(shot.pixel)
        return None


def _save(path: Path) -> None:
    from imgui_bundle import hello_imgui

    from gffe_cl.viewer.picture.files import save_png

    pixels = np.asarray(hello_imgui.final_app_window_screenshot())
    if not pixels.size:
        raise GffeError(f"{path}: the window gave no picture")
    save_png(path, pixels)
