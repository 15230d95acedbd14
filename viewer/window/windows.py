"""Temporary windows: help, a path to open, progress of saving, messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from imgui_bundle import hello_imgui, imgui

from gffe_cl.captures.scenes import scene_names
from gffe_cl.engine.core.errors import printable
from . import widgets
from .interface import Interface

_HELP_COLUMNS = 3
_OVER_PICTURE = {"error": 6.0, "title": 8.0}  # seconds that a message stands there, by its kind
_ALONE = int(imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.always_auto_resize)
_ABOVE_FOOT = 2.2  # em: messages are above the captions at the bottom of the picture


class Help:
    """Window with all shortcuts."""

    def __init__(self):
        self.is_open = False

    def toggle(self) -> None:
        self.is_open = not self.is_open

    def close(self) -> None:
        self.is_open = False

    def draw(self, app: Interface) -> bool:
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing.value, (0.5, 0.5))
        widgets.floating()
        _, stays = imgui.begin("Keys###help", True, _ALONE)
        self.is_open = bool(stays)
        imgui.push_style_var(imgui.StyleVar_.cell_padding, (hello_imgui.em_size(0.8), 0.0))
        if imgui.begin_table("###keys", _HELP_COLUMNS, imgui.TableFlags_.sizing_fixed_fit.value):
            for column in _columns(app.actions.shortcut_table()):
                imgui.table_next_column()
                _key_column(column)
            imgui.end_table()
        imgui.pop_style_var()
        imgui.text_disabled(
            "Wheel: zoom at the cursor.  Drag: pan, or the wipe's line.  Click: the story of a pixel."
            "  Shift+drag: statistics of a rectangle.  Escape: close the topmost window."
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


class OpenPath:
    """Field for a path, without a file dialog. `text`: typed text, None while it is closed; `use` takes the path."""

    def __init__(self):
        self.text: str | None = None
        self.use: Callable[[str], object] = str
        self._title = ""

    @property
    def is_open(self) -> bool:
        return self.text is not None

    def open(self, use: Callable[[str], object], title: str = "Open a sequence or a scene") -> None:
        self.text, self.use, self._title = "", use, title

    def close(self) -> None:
        self.text = None

    def draw(self, app: Interface) -> bool:
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing.value, (0.5, 0.5))
        widgets.floating()
        _, stays = imgui.begin(f"{self._title}###open_path", True, _ALONE)
        if imgui.is_window_appearing():
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(hello_imgui.em_size(34))
        enter = imgui.InputTextFlags_.enter_returns_true.value
        chosen, self.text = imgui.input_text_with_hint("###path", printable(str(Path.cwd())), self.text or "", enter)
        imgui.same_line()
        chosen |= imgui.button("open###open_this")
        if self.use == app.model.open:
            imgui.text_disabled(f"The folder of a sequence, or a built-in scene: {scene_names()}")
        focused = imgui.is_window_focused()
        imgui.end()
        path = self.text.strip() if chosen else ""
        if path:
            self.use(path)
        if path or not stays:
            self.close()
        return focused


def messages(app: Interface) -> None:
    """Draw recent errors and a script's title at the foot of the picture; a click dismisses them, as Escape does
    where no window is open."""
    lately = app.model.lately(app.clock(), _OVER_PICTURE)
    shown = [message for message in lately if message.kind != "note" and not message.dismissed]
    if not shown:
        return
    app.spot = None
    x, y = app.foot or imgui.get_main_viewport().get_center()
    imgui.set_next_window_pos((x, y - hello_imgui.em_size(_ABOVE_FOOT)), imgui.Cond_.always.value, (0.5, 1.0))
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_docking
    flags |= imgui.WindowFlags_.no_focus_on_appearing | imgui.WindowFlags_.no_nav
    widgets.floating()
    imgui.begin("###messages", None, int(flags))
    imgui.push_text_wrap_pos(hello_imgui.em_size(36))
    for message in shown[-4:]:
        if message.error:
            imgui.text_colored(widgets.red(), "error")
            imgui.same_line()
        imgui.text_unformatted(message.text)
    imgui.pop_text_wrap_pos()
    if imgui.is_window_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.left):
        app.model.dismiss_messages()
    imgui.end()


def progress(app: Interface) -> None:
    """Draw the progress of the export that is under way, with a button to stop it."""
    work = app.model.saving.work
    if work is None:
        return
    app.spot = None
    center = imgui.get_main_viewport().get_center()
    imgui.set_next_window_pos(center, imgui.Cond_.appearing.value, (0.5, 0.5))
    flags = imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.no_docking
    widgets.floating()
    imgui.begin("Saving###export", None, int(flags))
    imgui.text(work.label)
    imgui.progress_bar(work.done / max(work.total, 1), (hello_imgui.em_size(22), 0), f"{work.done} of {work.total}")
    if imgui.button("cancel###cancel_export"):
        work.cancel()
    imgui.end()
