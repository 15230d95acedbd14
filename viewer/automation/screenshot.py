"""A screenshot of the whole window (`gffe view --screenshot`)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from imgui_bundle import hello_imgui, imgui

from gffe_cl.engine.core.errors import GffeError
from ..picture.files import save_png
from ..state.model import Model
from ..window.app import App
from .steps import FIRST, Place, found_layer

_SETTLED_FRAMES = 4  # interface frames after everything has arrived: layouts need a few to come to rest
PATIENCE = 120.0  # seconds
_SIZE = (1600, 900)  # of the window


@dataclass(frozen=True)
class Look:
    """Displayed layers: `layer`, compared in the way `compare` with the layer `other`."""

    layer: str = "final"
    compare: str = "off"
    other: str | None = None

    def take(self, model: Model) -> None:
        """Show these layers in a model that has layers. Raises GffeError."""
        model.show_layer(found_layer(model, self.layer))
        if self.other:
            model.view.b = found_layer(model, self.other)
            if model.view.b == model.view.a:
                raise GffeError(f"--with {self.other}: the layer is compared with itself (expected another one)")
        if self.compare != "off":
            reason = model.comparison.why_not(self.compare)
            if reason:
                raise GffeError(f"--compare {self.compare}: {reason}")
            model.comparison.set(self.compare)


@dataclass(frozen=True)
class Shot:
    """A screenshot to take: `look` at `frame`, with the story of `pixel`; `overview`: of all layers."""

    path: Path
    frame: Place = FIRST
    look: Look = Look()
    pixel: tuple[int, int] | None = None
    overview: bool = False


def take_screenshot(model: Model, shot: Shot, size: tuple[int, int] | None = None) -> None:
    """Run the viewer until `shot` is written. Raises GffeError when it cannot be made."""
    if not shot.path.absolute().parent.is_dir():
        raise GffeError(f"{shot.path}: cannot write: no such folder")
    if shot.path.suffix.lower() != ".png":
        raise GffeError(f"{shot.path}: a screenshot's name must end in .png")
    camera = _Photographer(shot)
    App(model, on_frame=camera).run(size or _SIZE, test=lambda app: None)
    if camera.problem:
        raise GffeError(camera.problem)
    pixels = np.asarray(hello_imgui.final_app_window_screenshot())
    if not pixels.size:
        raise GffeError(f"{shot.path}: the window gave no picture")
    save_png(shot.path, pixels)


def without_pointer() -> None:
    """Suppress everything that depends on the mouse position."""
    nowhere = float(np.finfo(np.float32).min)
    imgui.get_io().add_mouse_pos_event(nowhere, nowhere)


class _Photographer:
    """Sets up the view in the running application, waits until it stands, and closes the window."""

    def __init__(self, shot: Shot):
        self.shot, self.problem = shot, None
        self._still = 0
        self._arranged = False
        self._until = time.perf_counter() + PATIENCE

    def __call__(self, app: App) -> None:
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

    def _arrange(self, model: Model) -> str | None:
        shot = self.shot
        width, height = model.source.width, model.source.height
        if shot.pixel is not None and not (0 <= shot.pixel[0] < width and 0 <= shot.pixel[1] < height):
            return f"--pixel must be inside {width}×{height}, got {shot.pixel[0]},{shot.pixel[1]}"
        try:
            model.playback.seek(shot.frame.slot(model.playback, "--frame"))
            shot.look.take(model)
        except GffeError as error:
            return str(error)
        model.overview = shot.overview
        model.pointing.enabled = False
        if shot.pixel is not None:
            model.pointing.pick(shot.pixel)
        return None
