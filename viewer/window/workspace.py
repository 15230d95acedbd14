"""Contents of the window: panels, the palette, and windows over them; and what actions do with these."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from imgui_bundle import hello_imgui, imgui
from imgui_bundle import portable_file_dialogs as dialogs

from ..state.model import Model
from . import windows
from .docks import Docks
from .interface import Interface
from .palette import Palette
from .table import PANELS
from .window_stack import Stack

_LEAST_SCALE, _LARGEST_SCALE = 0.6, 3.0


def has_dialogs() -> bool:
    """Return whether the system has a dialog for folders that can be opened."""
    programs = ("zenity", "kdialog", "matedialog", "qarma")
    return not sys.platform.startswith("linux") or any(map(shutil.which, programs))


class Workspace(Interface):
    """The interface with its panels and windows."""

    def __init__(self, model: Model):
        super().__init__(model)
        self.docks = Docks(self, PANELS, lambda: self.scale)
        self.palette, self.help, self.open_path = Palette(), windows.Help(), windows.OpenPath()
        self.stack = Stack(self.palette, self.help, self.open_path)
        self._dropped: list[str] = []
        self._dialog: Any = None
        self._chosen: Callable[[str], object] = model.open  # what takes the path of the dialog
        self._params: hello_imgui.RunnerParams | None = None  # while the window is open

    def close(self) -> None:
        if self._params is not None:
            self._params.app_shall_exit = True

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

    def switch_regions(self) -> None:
        """Toggle regions of errors over the picture, with the panel that has their legend."""
        regions = self.model.regions
        regions.switch(not regions.on)
        if regions.on:
            self.docks.show("Regions")

    def find(self, find) -> None:
        """Go to a frame of the survey."""
        self.docks.show("Plot")
        self.model.go_to(find)

    def drop(self, paths: list[str]) -> None:
        """Note paths dropped onto the window; the first one is opened in the next frame."""
        self._dropped += paths[:1]

    def examine(self) -> None:
        """Run the doctor on the sequence, and show its report."""
        self.model.examine()
        self.docks.show("Doctor")

    def copy(self, text: str) -> None:
        """Copy text to the clipboard."""
        imgui.set_clipboard_text(text)
        self.model.say(f"copied: {text}" if "\n" not in text else f"copied {text.count(chr(10)) + 1} rows of numbers")

    def open_dialog(
        self, title: str = "Open a sequence", use: Callable[[str], object] | None = None, of_file: bool = False
    ) -> None:
        """Open the system's dialog for folders, or `of_file` for files, if there is one, else a field for the path.
        `use` takes the path; None: it is opened."""
        self._chosen = use or self.model.open
        if has_dialogs():
            self._dialog = (dialogs.open_file if of_file else dialogs.select_folder)(title, str(Path.cwd()))
        else:
            self.open_path.open(self._chosen, title)

    def _open_given(self) -> None:
        """Open what was dropped, or chosen in the dialog."""
        for path in self._dropped:
            self.model.open(path)
        self._dropped.clear()
        if self._dialog is not None and self._dialog.ready():
            chosen: Any = self._dialog.result()
            self._dialog = None
            if chosen:
                self._chosen(chosen[0] if isinstance(chosen, list) else chosen)
