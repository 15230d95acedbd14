"""Colors and sizes of the interface."""

from __future__ import annotations

from imgui_bundle import ImVec4, hello_imgui, imgui

from .docks import content_scale

_THEMES = {"dark": hello_imgui.ImGuiTheme_.darcula_darker, "light": hello_imgui.ImGuiTheme_.light_rounded}
# of sliders: their numbers stand on them; and while they are dragged
_GRABS = {"dark": ((0.16, 0.32, 0.52), (0.18, 0.38, 0.62)), "light": ((0.62, 0.77, 0.95), (0.52, 0.7, 0.93))}
_ROUNDING = 3.0
_ROUNDED = ("window", "child", "frame", "popup", "grab", "tab")


def _factor(scale: float) -> float:
    return scale * content_scale()


def is_scaled(scale: float) -> bool:
    """Return whether sizes are as `apply` makes them: ImGui scales them once more where it learns of the screen."""
    return abs(imgui.get_style()._main_scale - _factor(scale)) < 1e-3


def apply(name: str, scale: float) -> None:
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
