"""The application: window, docking, menus, keys, drops; one frame of the interface after the other."""

from __future__ import annotations

import shutil
import sys
import time
import traceback
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui, immapp, implot  # before glfw
from imgui_bundle import portable_file_dialogs as dialogs

from gffe_cl.viewer import commands, keys
from gffe_cl.viewer.actions import Actions
from gffe_cl.viewer.panels import (
    compare,
    doctor,
    inspector,
    kernels,
    layer_list,
    modules,
    picture,
    plot,
    regions,
    theme,
    timeline,
    timings,
    widgets,
    windows,
)
from gffe_cl.viewer.panels.palette import Palette
from gffe_cl.viewer.state.model import Model
from gffe_cl.viewer.state.settings import can_save

_TITLE = "gffe-cl"
_LAYOUT_VERSION = 3
_PANELS = {
    "Picture": (picture.draw, "MainDockSpace"),
    "Layers": (layer_list.draw, "Left"),
    "Modules": (modules.draw, "Right"),
    "Compare": (compare.draw, "Right"),
    "Inspector": (inspector.draw, "RightBottom"),
    "Regions": (regions.draw, "RightBottom"),
    "Timings": (timings.draw, "RightBottom"),
    "Kernels": (kernels.draw, "RightBottom"),
    "Doctor": (doctor.draw, "RightBottom"),
    "Plot": (plot.draw, "Above"),
    "Timeline": (timeline.draw, "Bottom"),
}
_HIDDEN = ("Plot", "Doctor")  # until they are asked for
SIDE_PANELS = tuple(
    name for name in _PANELS if name not in ("Picture", "Plot", "Timeline")
)  # those that are hidden together
_TIMELINE_HEIGHT = 110.0  # pixels at the usual size of letters
_PLOT_HEIGHT = 170.0
_LEAST_SCALE, _LARGEST_SCALE = 0.6, 3.0
_SIDES = (320.0, 464.0)  # pixels left and right of the picture, at the usual size of letters ...
_WIDEST = (0.24, 0.33)  # ... but not more of the width
_LOWER_RIGHT = 0.4  # of the height on the right


def has_dialogs() -> bool:
    """Whether the system has a dialog for folders that can be opened."""
    programs = ("zenity", "kdialog", "matedialog", "qarma")
    return not sys.platform.startswith("linux") or any(map(shutil.which, programs))


def _dock_nodes(name: str) -> list:
    """Where a window is docked, from its own node to the root; empty if it floats or is not there."""
    window = imgui.internal.find_window_by_name(name)
    nodes = [window.dock_node if window is not None else None]
    while nodes[-1] is not None:
        nodes.append(nodes[-1].parent_node)
    return nodes[:-1]


class App:
    """Ties the model to ImGui and GL.

    `on_frame(app)`, if given, is called once per interface frame: screenshots and tests hook in there.
    """

    def __init__(self, model: Model, on_frame=None):
        self.model = model
        self.on_frame = on_frame
        self.canvas = None  # made when there is a GL context
        self.panels_hidden = False
        self._before_hiding: list[str] = []
        self._themed: tuple[str, float] | None = None  # theme and scale that are applied
        self.clock = time.perf_counter  # what playback goes by
        self.steering = None  # of a script, instead of keys and mouse
        self._captures: list = []  # who wants the pixels of the window
        self.actions = Actions()
        self.panel_names = tuple(_PANELS)
        self.palette = Palette()
        commands.register(self)
        self._dropped: list[str] = []
        self._dialog = None
        self.help_open = False
        self.display_height = 200.0  # of the display settings below the list of layers, as last drawn
        self.path_text: str | None = None  # of "open by path" while it is open
        self._params: hello_imgui.RunnerParams | None = None
        self.row_seen = ""  # of the list of layers: it was scrolled to this one
        self._stretched: dict[str, tuple[float, float]] = {}  # sizes of docks that were set: now and at scale 1
        self.canvas_size = (0, 0)  # screen pixels
        self._drawn = self._texture = self._tiles = None
        self._all_there = True  # when the overview was drawn
        self._plot_due = False
        self._to_front: str | None = None  # the panel that is brought there
        self._told: tuple = (None, None)  # the pixel and the rectangle that the inspector tells of
        self.inspected: tuple = (None, [])  # an inspection, and its rows in the inspector
        self._layers_known: list = []  # those that have actions
        self.drags, self.pressed_at = "nothing", None  # by the mouse, in the picture

    # ---- running -----------------------------------------------------------------------------------------

    def run(self, size: tuple[int, int] | None = None, test=None) -> None:
        """Opens the window, as large as last time if no `size` is given, and returns when it is closed. `test`
        registers tests of ImGui's test engine."""
        params = hello_imgui.RunnerParams()
        size = size or self.model.settings.window_size
        self._params = params
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
        params.docking_params = self._docking(size)
        callbacks = params.callbacks
        callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
        callbacks.post_init = self._post_init
        callbacks.pre_new_frame = self._before_frame
        callbacks.show_menus = lambda: commands.menus(self)
        callbacks.show_status = self._status
        callbacks.show_gui = self._windows
        callbacks.before_swap = self._capture
        callbacks.before_exit = self._before_exit
        if test is not None:
            params.use_imgui_test_engine = True
            callbacks.register_tests = lambda: test(self)
        immapp.run(params, immapp.AddOnsParams(with_implot=True))

    def capture(self, use) -> None:
        """Have `use` called with the window, (H, W, 3) uint8, when the present frame is drawn."""
        self._captures.append(use)

    def _capture(self) -> None:
        if not self._captures:
            return
        wanted, self._captures = self._captures, []
        width, height = map(int, imgui.get_io().display_size)
        framebuffer = self.canvas.ctx.detect_framebuffer(0)
        pixels = np.frombuffer(framebuffer.read((width, height), components=3, alignment=1), np.uint8)
        for use in wanted:
            use(pixels.reshape(height, width, 3)[::-1].copy())

    def close(self) -> None:
        if self._params is not None:
            self._params.app_shall_exit = True

    def _docking(self, size: tuple[int, int]) -> hello_imgui.DockingParams:
        docking = hello_imgui.DockingParams()
        bottom = min(_TIMELINE_HEIGHT * self.scale / size[1], 0.4)
        above = min(_PLOT_HEIGHT * self.scale / size[1] / (1 - bottom), 0.4)
        left, right = (min(side * self.scale / size[0], most) for side, most in zip(_SIDES, _WIDEST, strict=True))
        docking.docking_splits = [
            hello_imgui.DockingSplit("MainDockSpace", "Bottom", imgui.Dir.down, bottom),
            hello_imgui.DockingSplit("MainDockSpace", "Above", imgui.Dir.down, above),
            hello_imgui.DockingSplit("MainDockSpace", "Left", imgui.Dir.left, left),
            hello_imgui.DockingSplit("MainDockSpace", "Right", imgui.Dir.right, right / (1 - left)),
            hello_imgui.DockingSplit("Right", "RightBottom", imgui.Dir.down, _LOWER_RIGHT),
        ]
        docking.dockable_windows = [self._panel(name, *panel) for name, panel in _PANELS.items()]
        return docking

    def _panel(self, name: str, draw, space: str) -> hello_imgui.DockableWindow:
        window = hello_imgui.DockableWindow(name, space, can_be_closed_=name != "Picture")
        window.is_visible = self.model.settings.panels.get(name, name not in _HIDDEN)
        window.remember_is_visible = False  # the settings do
        window.call_begin_end, docked = False, True

        def draw_it():
            nonlocal docked
            if not docked:
                widgets.floating()
            unfolded, stays = imgui.begin(name, window.is_visible if window.can_be_closed else None)
            docked = imgui.is_window_docked()
            if unfolded:
                try:
                    draw(self)
                except Exception:
                    traceback.print_exc()  # ImGui, in the middle of something, will end the program
                    raise
            imgui.end()
            window.is_visible = stays is not False

        window.gui_function = draw_it
        return window

    @property
    def scale(self) -> float:
        """Size of the interface; 1 is what suits the screen."""
        return min(max(self.model.settings.ui_scale or 1.0, _LEAST_SCALE), _LARGEST_SCALE)

    def scale_by(self, factor: float) -> None:
        self.model.settings.ui_scale = self.scale * factor
        self.model.settings.ui_scale = self.scale

    def _stretch_docks(self, before: float, after: float) -> None:
        """Give the panels around the picture more or less room, for larger or smaller letters."""
        width, height = imgui.get_io().display_size
        around = {node.id_ for node in _dock_nodes("Picture")}
        sizes = ("Layers", _WIDEST[0] * width), ("Modules", _WIDEST[1] * width), ("Timeline", 0.4 * height)
        for name, most in sizes:
            beside = [node for node in _dock_nodes(name) if node.id_ not in around]
            if not beside:
                continue
            node, down = beside[-1], name == "Timeline"
            now = node.size.y if down else node.size.x
            made, usual = self._stretched.get(name, (0.0, 0.0))
            if abs(now - made) > 2:  # the user chose another size
                usual = now / before
            made = min(usual * after, most)
            self._stretched[name] = made, usual
            size = ImVec2(node.size.x, made) if down else ImVec2(made, node.size.y)
            imgui.internal.dock_builder_set_node_size(node.id_, size)

    def panel(self, name: str) -> hello_imgui.DockableWindow:
        return next(window for window in self._params.docking_params.dockable_windows if window.label == name)

    def toggle_panel(self, name: str) -> None:
        window = self.panel(name)
        window.is_visible = not window.is_visible
        self.panels_hidden = False

    def show_panel(self, name: str) -> None:
        """Have a panel there, in front of those that are docked with it."""
        self.panel(name).is_visible = True
        self._to_front = name

    def show_survey(self, on: bool) -> None:
        """Measure every generated frame, and show the plot of it; off: no more frames are measured."""
        self.model.survey.on = on
        if on:
            self._show_plot()

    def _show_plot(self) -> None:
        self.panel("Plot").is_visible = True
        self._plot_due = True

    def _bring_to_front(self) -> None:
        """Once it is there: its tab before the others, the keyboard stays where it is unless it is at one of them."""
        nodes = _dock_nodes(self._to_front) if self._to_front else []
        if not nodes or nodes[0].tab_bar is None:
            return
        at = imgui.get_current_context().nav_window
        if at is not None and at.root_window.dock_node is not None and at.root_window.dock_node.id_ == nodes[0].id_:
            imgui.set_window_focus(self._to_front)
        nodes[0].tab_bar.next_selected_tab_id = imgui.internal.find_window_by_name(self._to_front).tab_id
        self._to_front = None

    def _make_room_for_plot(self) -> None:
        """Once it is there: as high as it has to be at this size of letters."""
        nodes = _dock_nodes("Plot")
        if self._plot_due and nodes:
            height = min(_PLOT_HEIGHT * self.scale, 0.4 * imgui.get_io().display_size.y)
            if nodes[0].size.y < height:
                imgui.internal.dock_builder_set_node_size(nodes[0].id_, ImVec2(nodes[0].size.x, height))
            self._plot_due = False

    def switch_regions(self) -> None:
        """Regions of errors over the picture, with the panel that says which is which; or off."""
        regions = self.model.regions
        regions.switch(not regions.on)
        if regions.on:
            self.show_panel("Regions")

    def find(self, find) -> None:
        """Go to a frame of the survey."""
        self._show_plot()
        self.model.go_to(find)

    def hide_panels(self) -> None:
        """Leave the picture and the timeline alone, and bring back what was there."""
        self.panels_hidden = not self.panels_hidden
        if self.panels_hidden:
            self._before_hiding = [name for name in SIDE_PANELS if self.panel(name).is_visible]
        for name in self._before_hiding or SIDE_PANELS:
            self.panel(name).is_visible = not self.panels_hidden

    def _post_init(self) -> None:
        import glfw
        import moderngl
        from imgui_bundle import glfw_utils

        from gffe_cl.viewer.picture.canvas import Canvas

        self.canvas = Canvas(moderngl.create_context())
        window = glfw_utils.glfw_window_hello_imgui()
        glfw.set_drop_callback(window, lambda _window, paths: self.drop(paths))
        implot.get_style().use_local_time = False

    def _before_frame(self) -> None:
        model = self.model
        if self._themed != (model.settings.theme, self.scale):
            if self._themed is not None:
                self._stretch_docks(self._themed[1], self.scale)
            self._themed = model.settings.theme, self.scale
            theme.apply(*self._themed)
        self._make_room_for_plot()
        self._bring_to_front()
        model.update(self.clock(), self.canvas)
        if model.contents.layers is not self._layers_known:
            self._layers_known = model.contents.layers
            commands.register_layers(self)
        model.fly(self.steering if self.steering and model.flying else keys.flight(model), self.clock())
        told = model.pointing.picked, model.selection.rectangle if self.drags == "nothing" else self._told[1]
        if told != self._told and told != (None, None) and self.panel("Inspector").is_visible:
            self._to_front = "Inspector"
        self._told = told
        at_work = model.playback.playing or model.flying or model.engine.busy or not model.comparison.ready
        at_work |= model.survey.busy or not model.regions.ready
        self._params.fps_idling.enable_idling = not (at_work or self._params.use_imgui_test_engine)

    def _before_exit(self) -> None:
        import glfw
        from imgui_bundle import glfw_utils

        shown = {name: self.panel(name).is_visible for name in _PANELS}
        if self.panels_hidden:
            shown |= dict.fromkeys(self._before_hiding, True)
        self.model.settings.panels = shown
        self.model.remember(glfw.get_window_size(glfw_utils.glfw_window_hello_imgui()))
        self.model.close()

    def default_layout(self) -> None:
        for name in _PANELS:
            self.panel(name).is_visible = name not in _HIDDEN
        self.panels_hidden = False
        self._params.docking_params.layout_reset = True

    def drawn(self, view, size: tuple[int, int]):
        """Texture of the canvas, drawn anew only if something changed."""
        what = (view, size, self.model.contents.changes, self.model.comparison.ready, self.model.regions.changes)
        if what != self._drawn:
            self._drawn, self._texture = what, self.canvas.draw(view, size)
        return self._texture

    def drawn_overview(self, tiles, size: tuple[int, int], caption: int, gap: int):
        """The same of all layers, and where they are."""
        what = (tiles, size, caption, self.model.contents.changes)
        if what != self._drawn or not self.model.screen.ready or not self._all_there:
            self._all_there = self.model.screen.ready
            self._drawn, self._tiles = what, self.canvas.overview(tiles, size, caption=caption, gap=gap)
        return self._tiles

    # ---- windows that come and go ------------------------------------------------------------------------

    def _windows(self) -> None:
        keys.dispatch(self.actions, keys.FLIGHT_KEYS if self.model.flying else frozenset())
        for path in self._dropped:
            self.model.open(path)
        self._dropped.clear()
        if self._dialog is not None and self._dialog.ready():
            chosen = self._dialog.result()
            chosen = chosen[0] if isinstance(chosen, list) and chosen else chosen
            self._dialog = None
            if chosen:
                self.model.open(chosen)
        self.palette.draw(self.actions, self.model.parameters)
        windows.help_window(self)
        windows.path_window(self)
        windows.progress(self.model)
        windows.messages(self)
        if self.on_frame is not None:
            self.on_frame(self)

    def drop(self, paths: list[str]) -> None:
        """Paths dropped onto the window; opened in the next frame."""
        self._dropped += paths[:1]

    def examine(self) -> None:
        """Have the doctor look at the sequence, and show what it says."""
        self.model.examine()
        self.show_panel("Doctor")

    def open_dialog(self) -> None:
        """The system's folder dialog where there is one, else a field for the path."""
        if has_dialogs():
            self._dialog = dialogs.select_folder("Open a sequence", str(Path.cwd()))
        else:
            self.path_text = ""

    def _status(self) -> None:
        model = self.model
        parts = [model.engine.device_name or "opening the device …"]
        if model.source is not None:
            info = model.source
            parts.append(f"{info.name}   {info.width}×{info.height}")
            if info.render_size != (info.width, info.height):
                parts.append(f"rendered {info.render_size[0]}×{info.render_size[1]}")
        if model.contents.result is not None:
            kept = "from the cache, " if model.from_cache else ""
            parts.append(f"{kept}computed in {model.contents.result.wall_ms:.0f} ms")
        parts += model.warnings
        imgui.text("     ".join(parts))
