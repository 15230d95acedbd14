"""What can be done: the action table, and the menus, help and command palette that come from it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

from imgui_bundle import hello_imgui, imgui

from gffe_cl.scenes import SCENES
from gffe_cl.viewer.actions import Action
from gffe_cl.viewer.panels import widgets
from gffe_cl.viewer.state import saving

_EXPOSURE_STEP = 0.5
_HELP_COLUMNS = 3
_FOUND = 12  # actions that the palette lists
_TURN = 0.25  # degrees per pixel of mouse
FLIGHT_KEYS = frozenset("WASDQE")


class Flight(NamedTuple):
    """Steering of one interface frame: (right, up, forward) in −1 … 1 and times faster; turns in degrees."""

    move: tuple[float, float, float]
    faster: float
    yaw: float
    pitch: float


def register(app) -> None:
    """Fill `app.actions`."""
    model = app.model

    def add(id, label, group, shortcut, run, enabled=lambda: None, **more):
        app.actions.register(Action(id, label, group, shortcut, run, enabled, **more))

    def opened():
        return None if model.info is not None else "nothing is open"

    def live():
        return opened() or (None if model.info.live else "only in a built-in scene")

    def savable():
        return opened() or ("something is being saved" if model.export is not None else None)

    def save(work):
        return lambda: setattr(model, "export", work(model))

    def playback(name, *arguments):
        return lambda: getattr(model.playback, name)(*arguments)

    add("open", "Open …", "File", "Ctrl+O", app.open_dialog)
    add("open_path", "Open by path …", "File", "Ctrl+Shift+O", lambda: setattr(app, "path_text", ""))
    add("reload", "Reload frames", "File", "Ctrl+R", model.reload, opened)
    add("save_png", "Save picture as PNG", "File", "Ctrl+S", lambda: saving.save_picture(model, app.canvas), opened)
    add("save_exr", "Save layers as EXR", "File", "Ctrl+E", save(saving.LayersWork), savable)
    add("save_video", "Save playback as MP4", "File", "Ctrl+M", save(saving.VideoWork), savable)
    add("quit", "Quit", "File", "Ctrl+Q", app.close)

    add("play", "Play / stop", "Playback", "Space", playback("toggle"), opened)
    add("step", "Next frame", "Playback", "Right", playback("step", 1), opened, repeat=True)
    add("step_back", "Previous frame", "Playback", "Left", playback("step", -1), opened, repeat=True)
    add(
        "next_rendered",
        "Next rendered frame",
        "Playback",
        "Shift+Right",
        playback("step_rendered", 1),
        opened,
        repeat=True,
    )
    add("previous_rendered", "Previous rendered frame", "Playback", "Shift+Left", playback("step_rendered", -1), opened,
        repeat=True)  # fmt: skip
    add("first", "First frame", "Playback", "Home", playback("home"), opened)
    add("last", "Last frame", "Playback", "End", playback("end"), opened)
    add("set_in", "Set in point", "Playback", "[", playback("set_in"), opened)
    add("set_out", "Set out point", "Playback", "]", playback("set_out"), opened)
    add("clear_points", "Clear in and out points", "Playback", "\\", playback("clear_points"), opened)

    add("fit", "Fit", "View", "F", lambda: setattr(model, "fit_pending", True), opened)
    add("one_to_one", "1 : 1", "View", "Ctrl+0", lambda: setattr(model.view, "zoom", 1.0), opened)
    add("zoom_in", "Zoom in", "View", "+", lambda: model.zoom(2.0), opened, also=("=",))
    add("zoom_out", "Zoom out", "View", "-", lambda: model.zoom(0.5), opened)
    add("next_layer", "Next layer", "View", "Down", lambda: model.next_layer(1), opened, repeat=True)
    add("previous_layer", "Previous layer", "View", "Up", lambda: model.next_layer(-1), opened, repeat=True)
    add("next_channel", "Next channel", "View", "C", model.looks.next_channel, opened)
    add("overview", "Overview of all layers", "View", "O", lambda: model.set_overview(not model.overview), opened,
        checked=lambda: model.overview)  # fmt: skip
    add("brighter", "Brighter", "View", "E", lambda: model.looks.expose(_EXPOSURE_STEP), opened)
    add("darker", "Darker", "View", "Shift+E", lambda: model.looks.expose(-_EXPOSURE_STEP), opened)
    add("normalise", "Fit range to the picture", "View", "N", model.looks.fit, opened)
    add("reset_display", "Reset display", "View", "R", model.looks.reset, opened)
    add("flip", "Show B (hold)", "Compare", "B", model.comparison.flip, opened, hold=True)
    for way, text, key in (
        ("split", "Split wipe", "W"),
        ("difference", "Difference", "D"),
        ("error", "Error map", "M"),
    ):
        add(f"compare_{way}", text, "Compare", key, partial(model.comparison.toggle, way),
            lambda way=way: opened() or model.comparison.why_not(way),
            checked=lambda way=way: model.view.compare == way)  # fmt: skip
    add("truth", "Show ground truth", "Compare", "T", model.comparison.toggle_truth,
        lambda: opened() or model.why_not("truth"))  # fmt: skip
    add("fly", "Fly the camera", "Camera", "G", model.toggle_flying, live, checked=lambda: model.flying,
        tooltip="W A S D and Q E move, the right mouse button turns, Shift is faster")  # fmt: skip
    add("home_camera", "Back to the scene's camera", "Camera", "H", model.stop_flying, live)

    add("reload_kernels", "Reload kernels", "Tools", "F5", model.engine.reload_kernels)
    add("palette", "Command palette", "Tools", "Ctrl+P", app.open_palette)
    add("theme", "Light theme", "Tools", "Ctrl+T", lambda: _theme(app), checked=lambda: model.settings.theme == "light")
    add("larger", "Larger interface", "Tools", "Ctrl+=", lambda: app.scale_by(1.1))
    add("smaller", "Smaller interface", "Tools", "Ctrl+-", lambda: app.scale_by(1 / 1.1))
    add("panels", "Hide panels", "Panels", "Ctrl+B", app.hide_panels, checked=lambda: app.panels_hidden)
    for name in app.panel_names:
        add(f"panel {name}", name, "Panels", "", partial(app.toggle_panel, name),
            checked=lambda name=name: app.panel(name).is_visible)  # fmt: skip
    add("layout", "Default arrangement", "Panels", "", app.default_layout)

    add("help", "Keys and help", "Help", "?", lambda: setattr(app, "help_open", not app.help_open))


def _theme(app) -> None:
    app.model.settings.theme = "dark" if app.model.settings.theme == "light" else "light"


def menus(app) -> None:
    for group, actions in app.actions.grouped().items():
        if imgui.begin_menu(f"{group}###menu {group}"):
            for action in actions:
                _item(app.actions, action)
            if group == "File":
                _file_menu(app.model)
            imgui.end_menu()


def _item(actions, action) -> None:
    reason = action.enabled()
    clicked, _ = imgui.menu_item(
        f"{action.label}###{action.id}", action.shortcut, bool(action.checked()), reason is None
    )
    if reason or action.tooltip:
        imgui.set_item_tooltip(reason or action.tooltip)
    if clicked:
        actions.run(action.id)


def _file_menu(model) -> None:
    imgui.separator()
    if imgui.begin_menu("Built-in scenes###scenes"):
        for name, text in SCENES.items():
            if imgui.menu_item_simple(f"{name}###scene {name}"):
                model.open(name)
            imgui.set_item_tooltip(text)
        imgui.end_menu()
    if imgui.begin_menu("Recent###recent", bool(model.settings.recent)):
        for path in list(model.settings.recent):
            if imgui.menu_item_simple(path):
                model.open(path)
        imgui.end_menu()


def palette(app) -> None:
    """Type a few letters; Enter runs the hit that the arrows have chosen."""
    if app.palette_text is None:
        return
    viewport = imgui.get_main_viewport()
    top = (viewport.pos.x + viewport.size.x / 2, viewport.pos.y + viewport.size.y * 0.15)
    imgui.set_next_window_pos(top, imgui.Cond_.always.value, (0.5, 0.0))
    imgui.set_next_window_size((hello_imgui.em_size(30), 0))
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_move
    widgets.floating()
    imgui.begin("Command palette###palette", None, int(flags))
    if imgui.is_window_appearing():
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    enter = imgui.InputTextFlags_.enter_returns_true.value
    chosen, text = imgui.input_text_with_hint("###command", "command", app.palette_text, enter)
    app.palette_at = 0 if text != app.palette_text else app.palette_at
    app.palette_text = text
    found = app.actions.search(text)[:_FOUND]
    step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
    app.palette_at = min(max(app.palette_at + step, 0), max(len(found) - 1, 0))
    run = found[app.palette_at] if chosen and found else None
    for index, action in enumerate(found):
        reason = action.enabled()
        imgui.begin_disabled(reason is not None)
        if imgui.selectable(f"{action.group}: {action.label}###palette {action.id}", index == app.palette_at)[0]:
            run = action
        imgui.end_disabled()
        imgui.same_line(hello_imgui.em_size(20))
        imgui.text_disabled(reason or action.shortcut)
    lost = not imgui.is_window_focused() and not imgui.is_window_appearing()
    imgui.end()
    if run is not None or lost or imgui.is_key_pressed(imgui.Key.escape):
        app.palette_text = None
    if run is not None:
        app.actions.run(run.id)


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
            for group, entries in column:
                imgui.separator_text(group)
                for keys, label in entries:
                    imgui.text(label)
                    imgui.same_line(hello_imgui.em_size(12))
                    imgui.text_disabled(keys)
        imgui.end_table()
    imgui.pop_style_var()
    imgui.text_disabled("Wheel: zoom at the cursor.  Drag: pan, or the wipe's line.  Click: the story of a pixel.")
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
    chosen, app.path_text = imgui.input_text_with_hint("###path", str(Path.cwd()), app.path_text, enter)
    imgui.same_line()
    chosen |= imgui.button("open###open_this")
    imgui.text_disabled(f"The folder of a sequence, or a built-in scene: {', '.join(SCENES)}")
    imgui.end()
    if chosen and app.path_text.strip():
        app.model.open(app.path_text.strip())
        app.path_text = None
    elif not is_open or imgui.is_key_pressed(imgui.Key.escape):
        app.path_text = None


def flight(app) -> Flight | None:
    """How the camera is steered now; None while it is not flown."""
    io = imgui.get_io()
    if not app.model.flying or io.want_text_input:
        return None

    def held(positive, negative):
        return float(imgui.is_key_down(positive)) - float(imgui.is_key_down(negative))

    key = imgui.Key
    move = (held(key.d, key.a), held(key.e, key.q), held(key.w, key.s))
    turning = imgui.is_mouse_down(imgui.MouseButton_.right)
    dx, dy = (io.mouse_delta.x, io.mouse_delta.y) if turning else (0.0, 0.0)
    return Flight(move, 4.0 if io.key_shift else 1.0, _TURN * dx, _TURN * dy)
