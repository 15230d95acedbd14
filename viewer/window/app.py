"""The application: it opens the window, and draws one frame of the interface after the other."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui, immapp, implot  # before glfw

from ..picture.canvas import Canvas
from ..state.model import Model
from ..state.navigation import Flight
from ..state.settings import can_save
from . import commands, keys, status, theme, windows
from .docks import content_scale
from .picture_frames import PictureFrames
from .workspace import Workspace

_TITLE = "gffe-cl"
_LAYOUT_VERSION = 5
_IDLE_RATE = 0.7  # frames of the interface per second in which nothing changes, or less
_LONGEST_REST = 0.01  # seconds before a slot in which nothing is drawn


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


class App(Workspace):
    """Ties the model to ImGui and GL.

    `on_frame(app)`, if given, is called once per interface frame: screenshots and tests hook in there.
    """

    def __init__(self, model: Model, on_frame: Callable[[App], None] | None = None):
        super().__init__(model)
        self.on_frame = on_frame
        self._themed: tuple[str, float] | None = None  # theme and scale that are applied
        self.steering: Flight | None = None  # of a script, instead of keys and mouse
        self._captures: list = []  # who wants the pixels of the window
        self.may_idle = True  # where nothing happens, frames are drawn seldom
        self.at_work = True  # something is shown, made or measured
        commands.register(self)
        self.picture_frames = PictureFrames(self)
        self._told: tuple = (None, None)  # the inspector's pixel and rectangle
        self._layers_known: list = []  # those that have actions

    # ---- running -----------------------------------------------------------------------------------------

    def run(self, size: tuple[int, int] | None = None, test=None) -> None:
        """Open the window, as large as last time if no `size` is given, until it is closed. `test` registers tests of
        ImGui's test engine."""
        params = hello_imgui.RunnerParams()
        size = _within_screen(size or self.model.settings.window_size)
        self._params, self.may_idle = params, test is None
        params.fps_idling.fps_idle = _IDLE_RATE
        params.app_window_params.window_title = _TITLE
        params.app_window_params.window_geometry.size = size
        params.app_window_params.restore_previous_geometry = False
        params.imgui_window_params.default_imgui_window_type = (
            hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
        )
        params.imgui_window_params.show_menu_bar = True
        params.imgui_window_params.show_menu_app = False
        params.imgui_window_params.show_menu_view = False
        params.imgui_window_params.show_status_bar = True
        params.imgui_window_params.show_status_fps = False
        params.imgui_window_params.remember_theme = False
        # multisampling costs a CPU more than all that is drawn, and ImGui smooths its edges itself
        params.renderer_backend_options.open_gl_options.anti_aliasing_samples = 0
        params.ini_disable = test is not None or not can_save()
        params.ini_folder_type = hello_imgui.IniFolderType.app_user_config_folder
        params.ini_filename = f"gffe-cl/layout{_LAYOUT_VERSION}.ini"
        self.docks.arrange(params, size, self.model.settings.panels)
        callbacks = params.callbacks
        callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
        callbacks.post_init = self._post_init
        callbacks.pre_new_frame = self._before_frame
        callbacks.show_menus = lambda: commands.menus(self)
        callbacks.show_status = lambda: status.draw(self)
        callbacks.show_gui = self._windows
        callbacks.before_swap = self._before_swap
        callbacks.before_exit = self._before_exit
        if test is not None:
            params.use_imgui_test_engine = True
            callbacks.register_tests = lambda: test(self)
        immapp.run(params, immapp.AddOnsParams(with_implot=True))

    def capture(self, use) -> None:
        """Have `use` called with the window, (H, W, 3) uint8, when the present frame is drawn."""
        self._captures.append(use)

    def _before_swap(self) -> None:
        if self.clock is time.perf_counter and not self._captures:
            self.picture_frames.allow(self.stack.covers)
        if not self._captures:
            return
        wanted, self._captures = self._captures, []
        width, height = map(int, imgui.get_io().display_size)
        framebuffer = self.canvas.ctx.detect_framebuffer(0)
        pixels = np.frombuffer(framebuffer.read((width, height), components=3, alignment=1), np.uint8)
        for use in wanted:
            use(pixels.reshape(height, width, 3)[::-1].copy())

    def _post_init(self) -> None:
        import glfw
        import moderngl
        from imgui_bundle import glfw_utils

        self.canvas = Canvas(moderngl.create_context())
        window: Any = glfw_utils.glfw_window_hello_imgui()
        dropped: Any = lambda _window, paths: self.drop(paths)  # noqa: E731
        glfw.set_drop_callback(window, dropped)
        self.model.engine.wake = glfw.post_empty_event
        implot.get_style().use_local_time = False
        implot.get_style().plot_min_size = ImVec2(40, 40)  # pixels: narrow panels show whole plots

    def _before_frame(self) -> None:
        model = self.model
        if self._themed != (model.settings.theme, self.scale) or not theme.is_scaled(self.scale):
            if self._themed is not None and self._themed[1] != self.scale:
                self.docks.stretch(self._themed[1], self.scale)
            self._themed = model.settings.theme, self.scale
            theme.apply(*self._themed)
        self.docks.update()
        if self.clock is time.perf_counter:
            self.picture_frames.show()
            # drawing just before the next slot is due would delay it
            time.sleep(min(model.playback.rest(self.clock()), _LONGEST_REST))
        model.update(self.clock(), self.canvas)
        if model.contents.layers is not self._layers_known:
            self._layers_known = model.contents.layers
            commands.register_layers(self)
        by_hand = None if self.stack.covers else keys.flight(model)
        model.flights.steer(self.steering if self.steering and model.flying else by_hand, self.clock())
        told = model.pointing.picked, model.selection.rectangle if self.drags == "nothing" else self._told[1]
        if told != self._told and told != (None, None) and self.docks.panel("Inspector").is_visible:
            self.docks.show("Inspector")
        self._told = told
        self.at_work = model.playback.playing or model.flying or model.busy or not model.comparison.ready
        self.at_work |= model.survey.busy or model.studies.busy or not model.regions.ready
        assert self._params is not None and self._params.fps_idling is not None  # it runs
        self._params.fps_idling.enable_idling = self.may_idle and not self.at_work

    def _before_exit(self) -> None:
        import glfw
        from imgui_bundle import glfw_utils

        self.model.engine.wake = lambda: None
        self.model.settings.panels = self.docks.remembered
        window: Any = glfw_utils.glfw_window_hello_imgui()
        width, height = (round(side / content_scale()) for side in glfw.get_window_size(window))
        self.model.remember((width, height))
        self.model.close()

    # ---- windows that come and go ------------------------------------------------------------------------

    def _windows(self) -> None:
        taken = keys.FLIGHT_KEYS if self.model.flying else frozenset()
        if refused := keys.dispatch(self.actions, taken, self.stack.covers):
            self.model.say(refused)
        self._open_given()
        self.stack.draw(self)
        windows.progress(self)
        windows.messages(self)
        self.picture_frames.look_for_input()
        if self.on_frame is not None:
            self.on_frame(self)
