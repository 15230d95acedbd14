"""The window: it is opened, and one frame of the interface is drawn after the other; keyboard and mouse."""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui, immapp, implot  # before glfw

from gffe_cl.engine.core.errors import GffeError
from ..picture.canvas import Canvas
from ..state.actions import IMGUI_KEYS, Actions
from ..state.model import Model
from ..state.settings import can_save
from . import commands, status
from .app import App
from .docks import apply_theme, content_scale, is_scaled

_TITLE = "gffe-cl"
_LAYOUT_VERSION = 5
_WORK_RATE, _TOLD_RATE, _IDLE_RATE = (
    10.0,
    0.7,
    0.05,
)  # frames of the interface per second without input: while something
# is made, while messages stand there, and where nothing changes
_AFTER_INPUT = 0.5  # seconds in which every frame is drawn
_ALONE = 1 / 12  # seconds in which the picture alone is played, between frames of the interface
_SHORTEST_REST = 0.001  # seconds between looks for the next picture
_LONGEST_REST = 0.01  # seconds before a slot in which nothing is drawn


def new_app(model: Model, on_frame: Callable[[App], None] | None = None) -> App:
    """Return an application with its actions, without a window."""
    app = App(model, on_frame)
    commands.register(app)
    return app


def run(app: App, size: tuple[int, int] | None = None, test: Callable[[App], None] | None = None) -> None:
    """Open the window, as large as last time if no `size` is given, until it is closed. `test` registers tests of
    ImGui's test engine."""
    _Window(app).run(size, test)


def _within_screen(size: tuple[int, int]) -> tuple[int, int]:
    """Return a window's size, in pixels at 96 dpi, or less where the screen is smaller."""
    import glfw

    monitor = glfw.get_primary_monitor() if glfw.init() else None
    if not monitor:
        return size
    _, _, *room = glfw.get_monitor_workarea(monitor)
    scales = glfw.get_monitor_content_scale(monitor)
    width, height = (
        min(side, int(most / scale)) if most > 0 and scale > 0 else side
        for side, most, scale in zip(size, room, scales, strict=True)
    )
    return width, height


class _Window:
    """The window of an application."""

    def __init__(self, app: App):
        self._app, self._params = app, hello_imgui.RunnerParams()
        self._themed: tuple[str, float] | None = None  # theme and scale that are applied
        self._on_cpu = False  # who draws
        self._may_idle = True  # where nothing happens, frames are drawn seldom
        self._told: tuple = (None, None)  # the inspector's pixel and rectangle
        self._layers_known: list = []  # those that have actions

    def run(self, size: tuple[int, int] | None, test: Callable[[App], None] | None) -> None:
        app, params = self._app, self._params
        size = _within_screen(size or app.model.settings.window_size)
        self._may_idle = test is None
        params.fps_idling.time_active_after_last_event = _AFTER_INPUT
        params.app_window_params.window_title = _TITLE
        params.app_window_params.window_geometry.size = size
        params.app_window_params.restore_previous_geometry = False
        window = params.imgui_window_params
        window.default_imgui_window_type = hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
        window.show_menu_bar = window.show_status_bar = True
        window.show_menu_app = window.show_menu_view = window.show_status_fps = window.remember_theme = False
        # multisampling costs a CPU more than all that is drawn, and ImGui smooths its edges itself
        params.renderer_backend_options.open_gl_options.anti_aliasing_samples = 0
        params.ini_disable = test is not None or not can_save()
        params.ini_folder_type = hello_imgui.IniFolderType.app_user_config_folder
        params.ini_filename = f"gffe-cl/layout{_LAYOUT_VERSION}.ini"
        app.docks.arrange(params, size, app.model.settings.panels)
        callbacks = params.callbacks
        callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
        callbacks.post_init = self._post_init
        callbacks.pre_new_frame = self._before_frame
        callbacks.show_menus = lambda: commands.menus(app)
        callbacks.show_status = lambda: status.draw(app)
        callbacks.show_gui = self._windows
        callbacks.before_imgui_render = self._beneath
        callbacks.before_swap = self._before_swap
        callbacks.before_exit = self._before_exit
        if test is not None:
            params.use_imgui_test_engine = True
            callbacks.register_tests = lambda: test(app)
        immapp.run(params, immapp.AddOnsParams(with_implot=True))

    def _beneath(self) -> None:
        """Draw the picture into the window: a copy of it would cost a CPU more."""
        canvas, beneath = self._app.canvas, self._app.beneath
        if beneath is not None:
            canvas.draw_into(canvas.ctx.detect_framebuffer(0), *beneath)

    def _play_alone(self) -> None:
        """Where a CPU draws the window, play on for a moment and draw the picture alone: the interface costs more.
        There a swap of buffers keeps the rest of the window. Input ends it with the next frame of the interface."""
        import glfw
        from imgui_bundle import glfw_utils

        app, model, end = self._app, self._app.model, self._app.clock() + _ALONE
        tells = imgui.is_any_item_hovered() and model.pointing.pixel is None  # a tooltip may reach over the picture
        if not (app.is_bare and self._may_idle and self._on_cpu) or tells or imgui.is_any_item_active():
            return
        window: Any = glfw_utils.glfw_window_hello_imgui()
        while model.playback.playing and not (app.stack.covers or app.captures or model.saving.work):
            rest = model.playback.rest(app.clock())
            if app.clock() + rest > end:
                return
            time.sleep(max(rest, _SHORTEST_REST))
            changes = model.contents.changes
            model.update(app.clock(), app.canvas)
            if model.contents.changes != changes and app.beneath is not None:
                app.canvas.draw_into(app.canvas.ctx.detect_framebuffer(0), *app.beneath, alone=True)
                glfw.swap_buffers(window)

    def _before_swap(self) -> None:
        app = self._app
        if not app.captures:
            return
        wanted, app.captures = app.captures, []
        width, height = map(int, imgui.get_io().display_size)
        framebuffer = app.canvas.ctx.detect_framebuffer(0)
        pixels = np.frombuffer(framebuffer.read((width, height), components=3, alignment=1), np.uint8)
        for use in wanted:
            use(pixels.reshape(height, width, 3)[::-1].copy())

    def _post_init(self) -> None:
        import glfw
        import moderngl
        from imgui_bundle import glfw_utils

        app = self._app
        app.canvas = Canvas(moderngl.create_context())
        self._on_cpu = "llvmpipe" in app.canvas.ctx.info["GL_RENDERER"]
        window: Any = glfw_utils.glfw_window_hello_imgui()
        dropped: Any = lambda _window, paths: app.drop(paths)  # noqa: E731
        glfw.set_drop_callback(window, dropped)
        app.model.engine.wake = glfw.post_empty_event
        implot.get_style().use_local_time = False
        implot.get_style().plot_min_size = ImVec2(40, 40)  # pixels: narrow panels show whole plots

    def _before_frame(self) -> None:
        app, model = self._app, self._app.model
        if self._themed != (model.settings.theme, app.scale) or not is_scaled(app.scale):
            if self._themed is not None and self._themed[1] != app.scale:
                app.docks.stretch(self._themed[1], app.scale)
            self._themed = model.settings.theme, app.scale
            apply_theme(*self._themed)
        app.docks.update()
        if app.clock is time.perf_counter:
            self._play_alone()
            # drawing just before the next slot is due would delay it
            time.sleep(min(model.playback.rest(app.clock()), _LONGEST_REST))
        app.beneath, app.is_bare = None, False
        model.update(app.clock(), app.canvas)
        if model.contents.layers is not self._layers_known:
            self._layers_known = model.contents.layers
            commands.register_layers(app)
        told = model.pointing.picked, model.pointing.rectangle
        is_new = any(one and one != before for one, before in zip(told, self._told, strict=True))
        if is_new and app.docks.panel("Inspector").is_visible:
            app.docks.show("Inspector")
        self._told = told
        idling, messages = self._params.fps_idling, status.lately(app)
        idling.enable_idling = self._may_idle and not model.moves
        idling.fps_idle = _WORK_RATE if model.at_work else _TOLD_RATE if messages else _IDLE_RATE
        self._params.app_shall_exit |= app.closing

    def _before_exit(self) -> None:
        import glfw
        from imgui_bundle import glfw_utils

        model = self._app.model
        model.engine.wake = lambda: None
        model.settings.panels = self._app.docks.remembered
        window: Any = glfw_utils.glfw_window_hello_imgui()
        width, height = (round(side / content_scale()) for side in glfw.get_window_size(window))
        model.remember((width, height))
        model.close()

    def _windows(self) -> None:
        app = self._app
        if refused := dispatch(app.actions, app.stack.covers):
            app.model.say(refused)
        app.open_given()
        app.stack.draw()
        status.progress(app)
        status.messages(app)
        if app.on_frame is not None:
            app.on_frame(app)


# ---- a screen -----------------------------------------------------------------------------------------------------

_WITHOUT_SCREEN = "without a screen: xvfb-run -a gffe …"


def require_display() -> None:
    """Raise GffeError where no window with OpenGL 3.3 can be opened."""
    display, wayland = os.environ.get("DISPLAY"), os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not display and not wayland:
        raise GffeError(f"no display to open a window on (expected DISPLAY to be set; {_WITHOUT_SCREEN})")
    import glfw

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


# ---- keyboard and mouse --------------------------------------------------------------------------------------------

_MODIFIERS = {name: getattr(imgui.Key, f"mod_{name.lower()}") for name in ("Ctrl", "Shift", "Alt", "Super")}
_KEYS = {getattr(imgui.Key, attribute): name for attribute, name in IMGUI_KEYS.items() if hasattr(imgui.Key, attribute)}


def dispatch(actions: Actions, covered: bool = False) -> str | None:
    """Run the actions of pressed keys, and end those of released keys. While a window is open over the panels
    (`covered`) or text is typed, only actions that work anywhere run. Returns why the action of a pressed key cannot
    run, None without one."""
    io = imgui.get_io()
    covered |= io.want_text_input
    if covered or io.app_focus_lost:
        actions.release_all()
    modifiers = frozenset(name for name, key in _MODIFIERS.items() if _is_or_was_down(key))
    if io.app_focus_lost or (io.want_text_input and not modifiers - {"Shift"}):
        return None
    refused = None
    for key, name in _KEYS.items():
        if imgui.is_key_pressed(key, False):
            actions.dispatch(modifiers, name, covered=covered)
            refused = actions.last_refusal or refused
        elif imgui.is_key_pressed(key, True):
            actions.dispatch(modifiers, name, repeated=True, covered=covered)
        if imgui.is_key_released(key):
            actions.release(name)
    return refused


def _is_or_was_down(key: imgui.Key) -> bool:
    """Return whether a modifier is down, or was let go in this frame: where frames are long, that is after the key that
    was pressed with it."""
    return imgui.is_key_down(key) or imgui.is_key_released(key)
