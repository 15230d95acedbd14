"""The application as its panels see it: what they draw with, and what they remember from one frame to the next."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import portable_file_dialogs as dialogs

from ..picture.canvas import Canvas
from ..picture.view import Size, View
from ..state.actions import Actions
from ..state.model import Model
from .docks import Docks
from .windows import Help, OpenPath, Palette, Stack

_LEAST_SCALE, _LARGEST_SCALE = 0.6, 3.0


def has_dialogs() -> bool:
    """Return whether the system has a dialog for folders that can be opened."""
    programs = ("zenity", "kdialog", "matedialog", "qarma")
    return not sys.platform.startswith("linux") or any(map(shutil.which, programs))


class App:
    """Ties the model to ImGui and GL; `Window` draws it.

    Attributes
    ----------
    actions : Actions
        Filled by `commands.register`.
    canvas : Canvas
        Made when there is a GL context.
    clock : callable
        Clock of playback, seconds.
    on_frame : callable or None
        Called with this once per frame of the interface: scripts and tests hook in there.
    captures : list of callables
        Called with the window, (H, W, 3) uint8, when the present frame is drawn, once.
    closing : bool
        Whether the window is to be closed.
    beneath : tuple or None
        Picture that lies beneath the interface: view, lower left corner and size in the window, pixels.
    is_bare : bool
        Whether nothing is drawn over that picture.
    foot : tuple or None
        Middle of the picture's lower edge, screen pixels.
    """

    canvas: Canvas

    def __init__(self, model: Model, on_frame: Callable[[App], None] | None = None):
        self.model, self.actions, self.on_frame = model, Actions(self), on_frame
        self.clock: Callable[[], float] = time.perf_counter
        self.captures: list[Callable[[np.ndarray], object]] = []
        self.closing = False
        self.docks = Docks(self)
        self.palette, self.help = Palette(self.actions), Help(self.actions)
        self.open_path = OpenPath()
        self.stack = Stack(model.dismiss_messages, self.palette, self.help, self.open_path)
        self._dropped: list[str] = []
        self._dialog: Any = None
        self._chosen: Callable[[str], object] = model.open  # what takes the path of the dialog
        self.beneath: tuple[View, Size, Size] | None = None
        self.is_bare = False
        self.foot: tuple[float, float] | None = None
        self.canvas_size: tuple[int, int] = (0, 0)  # screen pixels
        self.picture_at: tuple[float, float] = (0.0, 0.0)  # the upper left corner of the picture's panel, screen pixels
        self.drags, self.pressed_at = "nothing", ImVec2()  # by the mouse, in the picture
        self.row_seen = ""  # of the list of layers: it was scrolled to this one
        self.display_height = 200.0  # of the display settings below the list of layers, as last drawn
        self.inspected: tuple = (None, [])  # an inspection, and its rows in the inspector
        self.row_canvas: Canvas | None = None  # of the panel that shows a row over time
        self.director: Any = None  # of a script: it lets time pass, and saves pictures of the window
        self._current_at = -math.inf  # clock, when the picture was the requested one

    def close(self) -> None:
        self.closing = True

    def stale_for(self, seconds: float) -> bool:
        """Return whether the picture has not been the requested one for longer than that. Call once per frame of the
        interface."""
        model = self.model
        if model.current or model.showing.is_preview or model.saving.work is not None:
            self._current_at = self.clock()
        return self.clock() - self._current_at > seconds

    @property
    def scale(self) -> float:
        """Size of the interface; 1 is the default for the screen."""
        return min(max(self.model.settings.ui_scale or 1.0, _LEAST_SCALE), _LARGEST_SCALE)

    def scale_by(self, factor: float) -> None:
        self.model.settings.ui_scale = self.scale * factor
        self.model.settings.ui_scale = self.scale

    def show_survey(self, on: bool) -> None:
        """Measure every generated frame, and show the plot of it; off: no more frames are measured."""
        self.model.survey.on = on
        if on:
            self.docks.show("Plot")

    def find(self, find: Callable[[], int | None]) -> None:
        """Go to a frame of the survey."""
        self.docks.show("Plot")
        self.model.go_to(find)

    def examine(self) -> None:
        """Run the doctor on the sequence, and show its report."""
        self.model.examine()
        self.docks.show("Doctor")

    def copy(self, text: str) -> None:
        """Copy text to the clipboard."""
        imgui.set_clipboard_text(text)
        self.model.say(f"copied: {text}")

    def drop(self, paths: list[str]) -> None:
        """Note paths dropped onto the window; the first one is opened in the next frame."""
        self._dropped += paths[:1]

    def open_dialog(self, title: str = "Open a sequence", use: Callable[[str], object] | None = None) -> None:
        """Open the system's dialog for folders if there is one, else a field for the path. `use` takes the path; None:
        it is opened."""
        self._chosen = use or self.model.open
        if has_dialogs():
            self._dialog = dialogs.select_folder(title, str(Path.cwd()))
        else:
            self.open_path.open(self._chosen, title if use else "")

    def open_given(self) -> None:
        """Open what was dropped, or chosen in the dialog. Call once per frame of the interface."""
        for path in self._dropped:
            self.model.open(path)
        self._dropped.clear()
        if self._dialog is not None and self._dialog.ready():
            chosen: Any = self._dialog.result()
            self._dialog = None
            if chosen:
                self._chosen(chosen)
