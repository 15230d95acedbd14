"""From ImGui's keys to the action table."""

from __future__ import annotations

from imgui_bundle import imgui

from gffe_cl.viewer.actions import IMGUI_KEYS

_KEYS = {getattr(imgui.Key, attribute): name for attribute, name in IMGUI_KEYS.items() if hasattr(imgui.Key, attribute)}


def dispatch(actions, taken: frozenset[str] = frozenset()) -> None:
    """Run what is bound to the keys that went down; let go of what was held by those that went up. Keys in `taken` mean
    something else now."""
    io = imgui.get_io()
    if io.want_text_input or io.app_focus_lost:
        actions.release_all()
        return
    pressed = (("Ctrl", io.key_ctrl), ("Shift", io.key_shift), ("Alt", io.key_alt), ("Super", io.key_super))
    modifiers = frozenset(name for name, down in pressed if down)
    for key, name in _KEYS.items():
        if name in taken and not modifiers - {"Shift"}:
            continue
        if imgui.is_key_pressed(key, False):
            actions.dispatch(modifiers, name)
        elif imgui.is_key_pressed(key, True):
            actions.dispatch(modifiers, name, repeated=True)
        if imgui.is_key_released(key):
            actions.release(name)
