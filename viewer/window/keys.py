"""Keyboard and mouse: ImGui's keys for the action table, and for the camera that is flown."""

from __future__ import annotations

from imgui_bundle import imgui

from ..state.actions import IMGUI_KEYS
from ..state.model import Model
from ..state.navigation import Flight

FLIGHT_KEYS = frozenset("WASDQE")
_TURN = 0.25  # degrees per pixel of mouse

_MODIFIERS = {name: getattr(imgui.Key, f"mod_{name.lower()}") for name in ("Ctrl", "Shift", "Alt", "Super")}
_KEYS = {getattr(imgui.Key, attribute): name for attribute, name in IMGUI_KEYS.items() if hasattr(imgui.Key, attribute)}


def dispatch(actions, taken: frozenset[str] = frozenset(), covered: bool = False) -> str | None:
    """Run the actions of pressed keys, and end those of released keys. Keys in `taken` have another function now.
    While a window is open over the panels (`covered`) or text is typed, only actions that work anywhere run. Returns
    why the action of a pressed key cannot run, None without one."""
    io = imgui.get_io()
    covered |= io.want_text_input
    if covered or io.app_focus_lost:
        actions.release_all()
    modifiers = frozenset(name for name, key in _MODIFIERS.items() if _is_or_was_down(key))
    if io.app_focus_lost or (io.want_text_input and not modifiers - {"Shift"}):
        return None
    refused = None
    for key, name in _KEYS.items():
        if name in taken and not modifiers - {"Shift"}:
            continue
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


def flight(model: Model) -> Flight | None:
    """Return the steering of the camera now; None while it is not flown."""
    io = imgui.get_io()
    if not model.flying or io.want_text_input:
        return None

    def held(positive, negative):
        return float(imgui.is_key_down(positive)) - float(imgui.is_key_down(negative))

    key = imgui.Key
    move = (held(key.d, key.a), held(key.e, key.q), held(key.w, key.s))
    turning = imgui.is_mouse_down(imgui.MouseButton_.right)
    dx, dy = (io.mouse_delta.x, io.mouse_delta.y) if turning else (0.0, 0.0)
    return Flight(move, 4.0 if io.key_shift else 1.0, _TURN * dx, _TURN * dy)
