"""Windows over the panels: help, a path to open, the command palette; Escape closes the top one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from imgui_bundle import hello_imgui, imgui

from gffe_cl.captures.scenes import scene_names
from gffe_cl.engine.core.errors import printable
from ..state.actions import Actions
from . import widgets

_HELP_COLUMNS = 3
_ALONE = int(imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.always_auto_resize)


class Popup:
    """Window over the panels; `draw` returns whether it has the focus."""

    is_open = False

    def close(self) -> None:
        self.is_open = False

    def draw(self) -> bool:
        raise NotImplementedError


class Help(Popup):
    """Window with all shortcuts."""

    def __init__(self, actions: Actions):
        self._actions = actions

    def toggle(self) -> None:
        self.is_open = not self.is_open

    def draw(self) -> bool:
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing.value, (0.5, 0.5))
        widgets.floating()
        _, stays = imgui.begin("Keys###help", True, _ALONE)
        self.is_open = bool(stays)
        imgui.push_style_var(imgui.StyleVar_.cell_padding, (hello_imgui.em_size(0.8), 0.0))
        if imgui.begin_table("###keys", _HELP_COLUMNS, imgui.TableFlags_.sizing_fixed_fit.value):
            for column in _columns(self._actions.shortcut_table()):
                imgui.table_next_column()
                _key_column(column)
            imgui.end_table()
        imgui.pop_style_var()
        imgui.text_disabled(
            "Wheel: zoom at the cursor.  Drag: pan, or the wipe's line; with Shift: statistics of a rectangle."
            "  Click: the story of a pixel.  Escape: close the topmost window."
        )
        focused = imgui.is_window_focused()
        imgui.end()
        return focused


def _key_column(groups: list) -> None:
    longest = max(imgui.calc_text_size(label).x for _, entries in groups for _, label in entries)
    for group, entries in groups:
        imgui.separator_text(group)
        for keys, label in entries:
            imgui.text(label)
            imgui.same_line(longest + hello_imgui.em_size(1.2))
            imgui.text_disabled(keys)


def _columns(table: list) -> list[list]:
    """Return the groups of shortcuts in columns of about the same height."""
    heights = [len(entries) + 1.5 for _, entries in table]
    columns: list[list] = [[] for _ in range(_HELP_COLUMNS)]
    done = 0.0
    for group, height in zip(table, heights, strict=True):
        columns[min(int((done + height / 2) / sum(heights) * _HELP_COLUMNS), _HELP_COLUMNS - 1)].append(group)
        done += height
    return columns


class OpenPath(Popup):
    """Field for a path, without a file dialog. `text`: typed text; `use` takes the path."""

    def __init__(self):
        self.text = ""
        self.use: Callable[[str], object] = str
        self._title, self._of_source = "", True

    def open(self, use: Callable[[str], object], title: str = "") -> None:
        """Ask for a path; without a `title` it is that of a sequence or a scene."""
        self.is_open, self.text, self.use = True, "", use
        self._of_source, self._title = not title, title or "Open a sequence or a scene"

    def draw(self) -> bool:
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing.value, (0.5, 0.5))
        widgets.floating()
        _, stays = imgui.begin(f"{self._title}###open_path", True, _ALONE)
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(hello_imgui.em_size(34))
        enter = imgui.InputTextFlags_.enter_returns_true.value
        chosen, self.text = imgui.input_text_with_hint("###path", printable(str(Path.cwd())), self.text, enter)
        imgui.same_line()
        chosen |= imgui.button("open###open_this")
        if self._of_source:
            imgui.text_disabled(f"The folder of a sequence, or a built-in scene: {scene_names()}")
        focused = imgui.is_window_focused()
        imgui.end()
        path = self.text.strip() if chosen else ""
        if path:
            self.use(path)
        if path or not stays:
            self.close()
        return focused


_FOUND = 12  # actions that are listed


class Palette(Popup):
    """Command palette. `text`: typed text; `at`: index of the chosen hit."""

    def __init__(self, actions: Actions):
        self._actions = actions
        self.text, self.at = "", 0
        self._refocus = False  # the field, which Enter has left

    def open(self, text: str = "") -> None:
        if self.is_open:  # the field keeps the value from when it became active
            imgui.internal.clear_active_id()
            self._refocus = True
        self.is_open, self.text, self.at = True, text, 0

    def draw(self) -> bool:
        viewport = imgui.get_main_viewport()
        top = (viewport.pos.x + viewport.size.x / 2, viewport.pos.y + viewport.size.y * 0.15)
        imgui.set_next_window_pos(top, imgui.Cond_.always.value, (0.5, 0.0))
        imgui.set_next_window_size((hello_imgui.em_size(34), 0))
        flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_move
        widgets.floating()
        imgui.begin("Command palette###palette", None, int(flags))
        appearing = imgui.is_window_appearing()
        chosen = self._search(self._actions)
        lost = not imgui.is_window_focused() and not appearing
        imgui.end()
        if chosen is not None or lost:
            self.close()
        if chosen:
            self._actions.run(chosen)
        return not lost

    def _search(self, actions: Actions) -> str | None:
        """Draw the field and the actions that match. Return the id of the action that Enter or a click has chosen; ""
        if Enter was pressed where none matches, None until then."""
        if imgui.is_window_appearing() or self._refocus:
            imgui.set_keyboard_focus_here()
        self._refocus = False
        imgui.set_next_item_width(-1)
        enter, before = imgui.InputTextFlags_.enter_returns_true.value, self.text
        entered, self.text = imgui.input_text_with_hint("###command", "command", before, enter)
        found = actions.search(self.text)[:_FOUND]
        step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
        self.at = min(max(self.at + step, 0), max(len(found) - 1, 0)) if self.text == before else 0
        run = found[self.at].id if entered and found else None
        for index, action in enumerate(found):
            reason = actions.why_not(action.id)
            imgui.begin_disabled(reason is not None)
            if imgui.selectable(f"{action.group}: {action.label}###palette {action.id}", index == self.at)[0]:
                run = action.id
            imgui.end_disabled()
            widgets.tooltip("\n".join(filter(None, (action.tooltip, reason))))
            imgui.same_line(0, hello_imgui.em_size(1))
            _at_right(reason or action.shortcut or "on" * bool(actions.checked(action.id)))
        return "" if entered and not found else run


def _at_right(text: str) -> None:
    """Draw as much of the text as the line has room for, at its end."""
    room = imgui.get_content_region_avail().x
    text = widgets.cut(text, room)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room - imgui.calc_text_size(text).x)
    imgui.text_disabled(text)


_ANY_POPUP = imgui.PopupFlags_.any_popup.value


class Stack:
    """Stack of open windows; `windows`: all that there are; `dismiss` is called by Escape where none is open.

    Attributes
    ----------
    covers : bool
        Whether one of them is open, or a menu or list of ImGui's.
    """

    def __init__(self, dismiss: Callable[[], None], *windows: Popup):
        self._dismiss, self._windows = dismiss, windows
        self._open: list[Popup] = []  # the one on top last
        self._popup = self.covers = False

    def draw(self) -> None:
        """Draw those that are open; after Escape without the one on top."""
        self._sort()
        popup = imgui.is_popup_open("", _ANY_POPUP)
        if imgui.is_key_pressed(imgui.Key.escape, False):
            # ImGui has closed its own menu or list by now
            self._escape(taken=popup or self._popup)
        self._popup = popup
        for window in list(self._open):
            if window.draw():
                self._open.remove(window)
                self._open.append(window)
        self._sort()
        self.covers = bool(self._open) or popup

    def _sort(self) -> None:
        still = [window for window in self._open if window.is_open]
        self._open = still + [window for window in self._windows if window.is_open and window not in still]

    def _escape(self, taken: bool) -> None:
        if self._open and not taken:
            self._open.pop().close()
        elif not taken:
            self._dismiss()
