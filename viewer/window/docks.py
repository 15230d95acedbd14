"""Docked panels: their table, where they are, which are open, how large and in which colors."""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any, NamedTuple

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui

from . import widgets


class Panel(NamedTuple):
    """A panel: the `space` of the window that it is docked in, the `function` of a `module` that draws it, called with
    the application once per frame of the interface while it is in view; and whether it `is_open` at the first start."""

    space: str
    module: str
    is_open: bool = True
    function: str = "draw"

    def draw(self, to: object) -> None:
        """Draw the panel of an application."""
        module: Any = import_module(f".{self.module}", __package__)
        getattr(module, self.function)(to)


PANELS = {
    "Picture": Panel("MainDockSpace", "picture"),
    "Layers": Panel("Left", "layers"),
    "Histogram": Panel("Left", "layers", function="draw_histogram"),
    "Modules": Panel("Right", "options", function="draw_modules"),
    "Compare": Panel("Right", "options", function="draw_compare"),
    "Inspector": Panel("RightBottom", "inspector"),
    "Timings": Panel("RightBottom", "timings"),
    "Kernels": Panel("RightBottom", "timings", function="draw_kernels"),
    "Doctor": Panel("Right", "studies", False, "draw_doctor"),
    "Differences": Panel("Right", "studies", False, "draw_differing"),
    "Ablation": Panel("Right", "studies", False, "draw_ablation"),
    "Plot": Panel("Above", "plot", is_open=False),
    "Over time": Panel("Above", "studies", False, "draw_over_time"),
    "Timeline": Panel("Bottom", "timeline"),
}


_ABOVE = "Above"  # the timeline
_STAY = ("Picture", "Plot", "Timeline")  # one above the other: there, too, where the panels on both sides are hidden
_TIMELINE_HEIGHT = 110.0  # pixels at the usual size of letters ...
_ROW_HEIGHT = 27.0  # ... and of one more row of controls ...
_ONE_ROW = 640.0  # ... where it is narrower than this
_PLOT_HEIGHT = 170.0
_HIGHEST = 0.42  # of the height: timeline and plot
_LEAST_PICTURE = 0.4  # of the height, above both
_SIDES = (264.0, 348.0)  # pixels left and right of the picture, at the usual size of letters ...
_WIDEST = (0.24, 0.32)  # ... but not more of the width
_LOWER_RIGHT = 0.52  # of the height on the right
_TAB = 6.5  # em: width of a tab with a button to close it
_FLAGS = imgui.internal.DockNodeFlagsPrivate_
_PLAIN_TABS = _FLAGS.no_window_menu_button.value | _FLAGS.no_close_button.value  # tabs have their own


class Docks:
    """The panels of an application, `of` which `scale` is the size of the interface."""

    def __init__(self, of: Any):
        self._app = of
        self._runner: hello_imgui.RunnerParams | None = None  # it stores a copy of the assigned value
        self.hidden = False  # the panels on both sides
        self._before_hiding: list[str] = []
        self._stretched: dict[str, tuple[float, float]] = {}  # sizes of docks that were set: now and at scale 1
        self._plot_due = self._plot_beside = False  # a plot beside the timeline: the window is too low for both
        self._to_front: str | None = None  # the panel that is brought there

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(PANELS)

    def arrange(self, runner: hello_imgui.RunnerParams, size: tuple[int, int], open_panels: dict[str, bool]) -> None:
        """Arrange the panels in a window of `size` pixels, before it is opened. `open_panels` has the differences
        from the default."""
        docking = hello_imgui.DockingParams()
        docking.main_dock_space_node_flags |= _PLAIN_TABS
        docking.docking_splits = self._splits(size)
        docking.dockable_windows = [self._window(name, open_panels) for name in PANELS]
        runner.docking_params, self._runner = docking, runner

    def _splits(self, size: tuple[float, float]) -> list[hello_imgui.DockingSplit]:
        """Return the splits of a window of `size`, pixels at 96 dpi, and note where the plot goes."""
        left, right = _sides(size[0], self._app.scale)
        bottom = min((_TIMELINE_HEIGHT * self._app.scale + _more_rows(size[0], self._app.scale)) / size[1], _HIGHEST)
        above = min(_PLOT_HEIGHT * self._app.scale / size[1] / (1 - bottom), _HIGHEST)
        self._plot_beside = (1 - bottom) * (1 - above) < _LEAST_PICTURE
        return [
            hello_imgui.DockingSplit("MainDockSpace", "Left", imgui.Dir.left, left),
            hello_imgui.DockingSplit("MainDockSpace", "Right", imgui.Dir.right, right / (1 - left)),
            hello_imgui.DockingSplit("MainDockSpace", "Bottom", imgui.Dir.down, bottom),
            hello_imgui.DockingSplit("MainDockSpace", _ABOVE, imgui.Dir.down, above),
            hello_imgui.DockingSplit("Right", "RightBottom", imgui.Dir.down, _LOWER_RIGHT),
        ]

    def _space(self, name: str) -> str:
        """Return the space of the window that a panel is docked in."""
        space = PANELS[name].space
        return PANELS["Timeline"].space if space == _ABOVE and self._plot_beside else space

    def _window(self, name: str, open_panels: dict[str, bool]) -> hello_imgui.DockableWindow:
        panel = PANELS[name]
        window = hello_imgui.DockableWindow(name, self._space(name), can_be_closed_=name != "Picture")
        window.is_visible = open_panels.get(name, panel.is_open)
        window.remember_is_visible = False  # the settings do
        window.call_begin_end, docked, narrow = False, True, True

        def draw_it():
            nonlocal docked, narrow
            if not docked:
                widgets.floating()
            unfolded, stays = imgui.begin(name, True if window.can_be_closed and not narrow else None)
            docked = imgui.is_window_docked()
            narrow = docked and _is_crowded(name)
            if unfolded:
                panel.draw(self._app)
            imgui.end()
            window.is_visible = stays is not False

        window.gui_function = draw_it
        return window

    # ---- which are open ----------------------------------------------------------------------------------

    @property
    def _running(self) -> hello_imgui.RunnerParams:
        assert self._runner is not None  # the window is open
        return self._runner

    def panel(self, name: str) -> hello_imgui.DockableWindow:
        return next(window for window in self._running.docking_params.dockable_windows if window.label == name)

    def toggle(self, name: str) -> None:
        window = self.panel(name)
        window.is_visible = not window.is_visible
        self.hidden = False

    def show(self, name: str) -> None:
        """Have a panel there, in front of those that are docked with it."""
        self.panel(name).is_visible = True
        self._plot_due |= name == "Plot"
        self._to_front = name

    def hide(self) -> None:
        """Show only the picture and the timeline, or restore the other panels."""
        sides = [name for name in PANELS if name not in _STAY]
        self.hidden = not self.hidden
        if self.hidden:
            self._before_hiding = [name for name in sides if self.panel(name).is_visible]
        for name in self._before_hiding or sides:
            self.panel(name).is_visible = not self.hidden

    def reset(self) -> None:
        """Restore the default arrangement, as this window and these letters have it."""
        size, docking = imgui.get_io().display_size, self._running.docking_params
        docking.docking_splits = self._splits((size.x / content_scale(), size.y / content_scale()))
        self._stretched.clear()
        for name, panel in PANELS.items():
            self.panel(name).is_visible, self.panel(name).dock_space_name = panel.is_open, self._space(name)
        self.hidden = False
        docking.layout_reset = True

    @property
    def remembered(self) -> dict[str, bool]:
        """Panels by name, and whether they are open, for the next start."""
        shown = {name: self.panel(name).is_visible for name in PANELS}
        return shown | (dict.fromkeys(self._before_hiding, True) if self.hidden else {})

    # ---- sizes, and stacking order -------------------------------------------------------------------------

    def update(self) -> None:
        """Carry out requests for panels that had to wait until those were there. Call once per frame of the
        interface."""
        self._make_room_for_plot()
        self._bring_to_front()

    def stretch(self, before: float, after: float) -> None:
        """Give the panels around the picture more or less room, for larger or smaller letters."""
        width, height = imgui.get_io().display_size
        around = {node.id_ for node in _nodes("Picture")}
        sizes = ("Layers", _WIDEST[0] * width), ("Modules", _WIDEST[1] * width), ("Timeline", _HIGHEST * height)
        for name, most in sizes:
            beside = [node for node in _nodes(name) if node.id_ not in around]
            if not beside:
                continue
            node, down = beside[-1], name == "Timeline"
            now = node.size.y if down else node.size.x
            made, usual = self._stretched.get(name, (0.0, 0.0))
            rows = [_more_rows(width, scale * content_scale()) if down else 0.0 for scale in (before, after)]
            if abs(now - made) > 2:  # the user chose another size
                usual = (now - rows[0]) / before
            made = min(usual * after + rows[1], most)
            self._stretched[name] = made, usual
            size = ImVec2(node.size.x, made) if down else ImVec2(made, node.size.y)
            imgui.internal.dock_builder_set_node_size(node.id_, size)

    def _bring_to_front(self) -> None:
        """Show the tab of the requested panel before the others, once it is there. The keyboard stays where it is
        unless it is at one of them."""
        front = self._to_front
        nodes = _nodes(front) if front else []
        if front is None or not nodes or nodes[0].tab_bar is None:
            return
        at = imgui.get_current_context().nav_window
        if at is not None and at.root_window.dock_node is not None and at.root_window.dock_node.id_ == nodes[0].id_:
            imgui.set_window_focus(front)
        nodes[0].tab_bar.next_selected_tab_id = imgui.internal.find_window_by_name(front).tab_id
        self._to_front = None

    def _make_room_for_plot(self) -> None:
        """Make the plot as high as it has to be at this size of letters, once it is there."""
        nodes = _nodes("Plot")
        if self._plot_due and nodes:
            wanted = _PLOT_HEIGHT * self._app.scale * content_scale()
            height = min(wanted, _HIGHEST * imgui.get_io().display_size.y)
            if len(nodes) > 1:
                height = min(height, nodes[1].size.y / 2)  # the other half is the picture's
            if nodes[0].size.y < height and not self._plot_beside:
                imgui.internal.dock_builder_set_node_size(nodes[0].id_, ImVec2(nodes[0].size.x, height))
            self._plot_due = False


def content_scale() -> float:
    """Return the window's pixels per pixel at 96 dpi, in which sizes of windows are given."""
    return hello_imgui.get_dpi_aware_params().dpi_window_size_factor


def _sides(width: float, scale: float) -> list[float]:
    """Return shares of a window's width, left and right of the picture."""
    return [min(side * scale / width, most) for side, most in zip(_SIDES, _WIDEST, strict=True)]


def _more_rows(width: float, scale: float) -> float:
    """Return the height of the timeline's controls that do not fit into the first row of a window of this width,
    pixels."""
    rows = math.ceil(_ONE_ROW * scale / ((1 - sum(_sides(width, scale))) * width))
    return _ROW_HEIGHT * scale * (rows - 1)


def _is_crowded(name: str) -> bool:
    """Return whether a panel's neighbors leave its tab no room for a button to close it: the menu Panels does it."""
    nodes = _nodes(name)
    tabs = nodes[0].tab_bar.tabs if nodes and nodes[0].tab_bar is not None else ()
    return len(tabs) > 1 and nodes[0].size.x < len(tabs) * hello_imgui.em_size(_TAB)


def _nodes(name: str) -> list:
    """Return the nodes that a window is docked in, from its own node to the root; empty if it floats or is not
    there."""
    window = imgui.internal.find_window_by_name(name)
    nodes = [window.dock_node if window is not None else None]
    while nodes[-1] is not None:
        nodes.append(nodes[-1].parent_node)
    return nodes[:-1]


_THEMES = {"dark": hello_imgui.ImGuiTheme_.darcula_darker, "light": hello_imgui.ImGuiTheme_.light_rounded}
# of sliders: their numbers stand on them; and while they are dragged
_GRABS = {"dark": ((0.16, 0.32, 0.52), (0.18, 0.38, 0.62)), "light": ((0.62, 0.77, 0.95), (0.52, 0.7, 0.93))}
_ROUNDING = 3.0
_ROUNDED = ("window", "child", "frame", "popup", "grab", "tab")


def _factor(scale: float) -> float:
    return scale * content_scale()


def is_scaled(scale: float) -> bool:
    """Return whether sizes are those of `apply_theme`: ImGui scales them once more where it learns of the screen."""
    return abs(imgui.get_style()._main_scale - _factor(scale)) < 1e-3


def apply_theme(name: str, scale: float) -> None:
    """Apply the theme "light" or "dark", and make everything `scale` times as large as usual on this screen.

    Windows have no background of their own: filling the screen several times takes a CPU longer than all else, so it is
    cleared with their color, and what floats asks for a background (`widgets.floating`).
    """
    style, usual, col = imgui.get_style(), imgui.Style(), imgui.Col_
    hello_imgui.apply_theme(_THEMES[name])
    for what in dir(usual):  # themes and scaling change sizes for good
        if not (what.startswith(("_", "font_")) or callable(getattr(usual, what))):
            setattr(style, what, getattr(usual, what))
    style._main_scale = 1.0  # factor of scale_all_sizes
    for kind in _ROUNDED:
        setattr(style, f"{kind}_rounding", _ROUNDING)
    style.tab_min_width_shrink = 3.0 * _ROUNDING  # many tabs get narrow, none is scrolled out
    style.frame_border_size = style.child_border_size = 1.0
    style.scale_all_sizes(_factor(scale))
    style.font_scale_main = scale
    ground = style.color_(col.window_bg)
    params = hello_imgui.get_runner_params()
    params.imgui_window_params.background_color = ImVec4(ground.x, ground.y, ground.z, 1.0)
    style.set_color_(col.window_bg, ImVec4(ground.x, ground.y, ground.z, 0.0))
    for opaque in (col.popup_bg, col.title_bg_active, col.menu_bar_bg):
        color = style.color_(opaque)
        style.set_color_(opaque, ImVec4(color.x, color.y, color.z, 1.0))
    for grab, color in zip((col.slider_grab, col.slider_grab_active), _GRABS[name], strict=True):
        style.set_color_(grab, ImVec4(*color, 1.0))
    if name == "light":
        style.set_color_(col.text_disabled, ImVec4(0.42, 0.42, 0.42, 1.0))
        style.set_color_(col.text_link, ImVec4(0.05, 0.36, 0.72, 1.0))
