"""Windows over the panels. Escape closes the top one, and no shortcut reaches the panels behind."""

from __future__ import annotations

from typing import Protocol

from imgui_bundle import imgui

from .interface import Interface

_ANY_POPUP = imgui.PopupFlags_.any_popup.value


class Window(Protocol):
    """Window over the panels; `draw` returns whether it has the focus."""

    @property
    def is_open(self) -> bool: ...

    def close(self) -> None: ...

    def draw(self, app: Interface) -> bool: ...


class Stack:
    """Stack of open windows; `windows`: all that there are.

    Attributes
    ----------
    covers : bool
        Whether one of them is open, or a menu or list of ImGui's.
    """

    def __init__(self, *windows: Window):
        self._windows = windows
        self._open: list[Window] = []  # the one on top last
        self._popup = self.covers = False

    def draw(self, app: Interface) -> None:
        """Draw those that are open; after Escape without the one on top."""
        self._sort()
        popup = imgui.is_popup_open("", _ANY_POPUP)
        if imgui.is_key_pressed(imgui.Key.escape, False):
            # ImGui has closed its own menu or list by now
            self._escape(app, taken=popup or self._popup)
        self._popup = popup
        for window in list(self._open):
            if window.draw(app):
                self._open.remove(window)
                self._open.append(window)
        self._sort()
        self.covers = bool(self._open) or popup

    def _sort(self) -> None:
        still = [window for window in self._open if window.is_open]
        self._open = still + [window for window in self._windows if window.is_open and window not in still]

    def _escape(self, app: Interface, taken: bool) -> None:
        if self._open and not taken:
            self._open.pop().close()
        elif not taken:
            app.model.dismiss_messages()
