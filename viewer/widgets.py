"""Small ImGui pieces that the panels share."""

from __future__ import annotations

from collections.abc import Callable

from imgui_bundle import ImVec2, hello_imgui, imgui
from imgui_bundle import icons_fontawesome_6 as icons


def tooltip(text: str) -> None:
    """For the last item, disabled or not."""
    if text and imgui.is_item_hovered(imgui.HoveredFlags_.allow_when_disabled.value):
        imgui.begin_tooltip()
        imgui.push_text_wrap_pos(hello_imgui.em_size(28))
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        imgui.end_tooltip()


def action_button(actions, name: str, icon: str) -> None:
    """A button for an action, greyed out with the reason where it cannot run."""
    action = actions[name]
    reason = action.enabled()
    imgui.begin_disabled(reason is not None)
    if imgui.button(f"{icon}###{name}", ImVec2(hello_imgui.em_size(2.2), 0)):
        actions.run(name)
    imgui.end_disabled()
    shortcut = f"  ({action.shortcut})" if action.shortcut else ""
    tooltip(reason or f"{action.label}{shortcut}")


def toggle(
    label: str, value: bool, change: Callable[[bool], None], help_text: str = "", reason: str | None = None
) -> None:
    """A checkbox; greyed out with `reason` where there is one."""
    imgui.begin_disabled(reason is not None)
    changed, new = imgui.checkbox(label, value)
    imgui.end_disabled()
    tooltip(reason or help_text)
    if changed:
        change(new)


def slider(
    label: str,
    value: float,
    low: float,
    high: float,
    default: float,
    change: Callable[[float], None],
    text: str = "%.2f",
    help_text: str = "",
) -> None:
    """A slider with its unit in `text` and a button back to the default."""
    whole = isinstance(default, int)
    imgui.set_next_item_width(-hello_imgui.em_size(11))
    if whole:
        changed, new = imgui.slider_int(f"###{label}", int(value), int(low), int(high), text)
    else:
        changed, new = imgui.slider_float(f"###{label}", value, low, high, text)
    tooltip(help_text)
    if changed:
        change(min(max(new, low), high))
    imgui.same_line()
    imgui.begin_disabled(value == default)
    if imgui.button(f"{icons.ICON_FA_ROTATE_LEFT}###reset {label}"):
        change(default)
    imgui.end_disabled()
    tooltip(f"back to {default:g}")
    imgui.same_line()
    imgui.text(label)


def choice(label: str, value: str, options: dict[str, str] | list[str], change: Callable[[str], None]) -> None:
    """A combo box over keys of `options` (shown by their texts)."""
    texts = options if isinstance(options, dict) else {name: name for name in options}
    imgui.set_next_item_width(-hello_imgui.em_size(11))
    if imgui.begin_combo(f"###{label}", texts.get(value, value)):
        for name, text in texts.items():
            if imgui.selectable(text, name == value)[0] and name != value:
                change(name)
        imgui.end_combo()
    imgui.same_line()
    imgui.text(label)


def heading(text: str) -> None:
    imgui.separator_text(text)
