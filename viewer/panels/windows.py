"""Windows that come and go: help, a path to open, what is being saved, messages."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import ImVec4, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from gffe_cl.errors import printable
from gffe_cl.scenes import scene_names
from gffe_cl.viewer.panels import widgets

_HELP_COLUMNS = 3
_OVER_PICTURE = {"error": 6.0, "title": 8.0}  # seconds that a message stands there, by its kind ...
_IN_STATUS = {"error": 30.0, "note": 8.0}  # ... and there
_RED, _BLUE = ImVec4(0.97, 0.5, 0.45, 1.0), ImVec4(0.36, 0.62, 0.95, 1.0)
_ABOVE_FOOT = 2.2  # em: messages stand above what is written at the foot of the picture


def help_window(app) -> None:
    if not app.help_open:
        return
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing.value, (0.5, 0.5))
    flags = imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.always_auto_resize
    widgets.floating()
    _, app.help_open = imgui.begin("Keys###help", True, int(flags))
    imgui.push_style_var(imgui.StyleVar_.cell_padding, (hello_imgui.em_size(0.8), 0.0))
    if imgui.begin_table("###keys", _HELP_COLUMNS, imgui.TableFlags_.sizing_fixed_fit.value):
        for column in _columns(app.actions.shortcut_table()):
            imgui.table_next_column()
            longest = max(imgui.calc_text_size(label).x for _, entries in column for _, label in entries)
            for group, entries in column:
                imgui.separator_text(group)
                for keys, label in entries:
                    imgui.text(label)
                    imgui.same_line(longest + hello_imgui.em_size(1.2))
                    imgui.text_disabled(keys)
        imgui.end_table()
    imgui.pop_style_var()
    imgui.text_disabled(
        "Wheel: zoom at the cursor.  Drag: pan, or the wipe's line.  Click: the story of a pixel."
        "  Shift+drag: statistics of a rectangle."
    )
    imgui.end()


def _columns(table: list) -> list[list]:
    """Groups of shortcuts in columns of about the same height."""
    heights = [len(entries) + 1.5 for _, entries in table]
    columns: list[list] = [[] for _ in range(_HELP_COLUMNS)]
    done = 0.0
    for group, height in zip(table, heights, strict=True):
        columns[min(int((done + height / 2) / sum(heights) * _HELP_COLUMNS), _HELP_COLUMNS - 1)].append(group)
        done += height
    return columns


def path_window(app) -> None:
    """A field for the path where there is no file dialog."""
    if app.path_text is None:
        return
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.appearing.value, (0.5, 0.5))
    flags = imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_collapse | imgui.WindowFlags_.always_auto_resize
    widgets.floating()
    _, is_open = imgui.begin("Open a sequence or a scene###open_path", True, int(flags))
    if imgui.is_window_appearing():
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(hello_imgui.em_size(34))
    enter = imgui.InputTextFlags_.enter_returns_true.value
    chosen, app.path_text = imgui.input_text_with_hint("###path", printable(str(Path.cwd())), app.path_text, enter)
    imgui.same_line()
    chosen |= imgui.button("open###open_this")
    imgui.text_disabled(f"The folder of a sequence, or a built-in scene: {scene_names()}")
    imgui.end()
    if chosen and app.path_text.strip():
        app.model.open(app.path_text.strip())
        app.path_text = None
    elif not is_open or imgui.is_key_pressed(imgui.Key.escape):
        app.path_text = None


def messages(app) -> None:
    """What went wrong lately, and a script's title, at the foot of the picture."""
    shown = [message for message in _lately(app, _OVER_PICTURE) if message.kind != "note"]
    if not shown:
        return
    x, y = app.foot or imgui.get_main_viewport().get_center()
    imgui.set_next_window_pos((x, y - hello_imgui.em_size(_ABOVE_FOOT)), imgui.Cond_.always.value, (0.5, 1.0))
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_docking
    flags |= imgui.WindowFlags_.no_focus_on_appearing | imgui.WindowFlags_.no_nav | imgui.WindowFlags_.no_inputs
    widgets.floating()
    imgui.begin("###messages", None, int(flags))
    imgui.push_text_wrap_pos(hello_imgui.em_size(36))
    for message in shown[-4:]:
        if message.error:
            imgui.text_colored(_RED, "error")
            imgui.same_line()
        imgui.text_unformatted(message.text)
    imgui.pop_text_wrap_pos()
    imgui.end()


def note(app) -> bool:
    """The newest message, in the status bar, where it hides nothing; whether there is one."""
    shown = [message for message in _lately(app, _IN_STATUS) if message.kind != "title"]
    if not shown:
        return False
    last = shown[-1]
    icon = icons.ICON_FA_TRIANGLE_EXCLAMATION if last.error else icons.ICON_FA_CIRCLE_INFO
    imgui.text_colored(_RED if last.error else _BLUE, icon)
    imgui.same_line()
    imgui.text(widgets.shortened(last.text.replace("\n", " "), imgui.get_content_region_avail().x))
    widgets.tooltip("\n".join(message.text for message in shown))
    return True


def _lately(app, seconds: dict[str, float]) -> list:
    """Messages that were shown first at most so many seconds ago, by their kind."""
    now = app.clock()
    for message in app.model.messages:
        message.since = now if message.since is None else message.since
    return [message for message in app.model.messages if now - message.since < seconds.get(message.kind, 0.0)]


def progress(model) -> None:
    """The export that is under way, with a button to stop it."""
    work = model.export
    if work is None:
        return
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
