"""Command palette: every action, toggle and parameter, by a few letters."""

from __future__ import annotations

from imgui_bundle import hello_imgui, imgui

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.options import Option
from ..state.parameters import ALL, Parameters, by_hand, parsed
from . import widgets
from .interface import Interface

_FOUND = 12  # actions that are listed
_STEPS = 20  # of a number that is not whole, over its usual range


class Palette:
    """Command palette. `text`: typed text, None while it is closed; `at`: index of the chosen hit; `asked`: name of
    the number being asked for in place of an action."""

    def __init__(self):
        self.text: str | None = None
        self.at = 0
        self.asked: str | None = None
        self._problem = ""
        self._refocus = False  # the field, which Enter has left

    def open(self, text: str = "") -> None:
        if self.text is not None:  # the field keeps the value from when it became active
            imgui.internal.clear_active_id()
            self._refocus = True
        self.text, self.at, self.asked = text, 0, None

    def ask(self, name: str) -> None:
        """Ask for the value of a number."""
        self.text, self.asked, self._problem = "", name, ""

    @property
    def is_open(self) -> bool:
        return self.text is not None

    def close(self) -> None:
        self.text = self.asked = None

    def draw(self, app: Interface) -> bool:
        actions, asked = app.actions, self.asked
        viewport = imgui.get_main_viewport()
        top = (viewport.pos.x + viewport.size.x / 2, viewport.pos.y + viewport.size.y * 0.15)
        imgui.set_next_window_pos(top, imgui.Cond_.always.value, (0.5, 0.0))
        imgui.set_next_window_size((hello_imgui.em_size(34), 0))
        flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_move
        widgets.floating()
        imgui.begin(f"Command palette###palette{'_value' if asked else ''}", None, int(flags))
        appearing = imgui.is_window_appearing()
        chosen = self._number(app.model.parameters) if asked else self._search(actions)
        lost = not imgui.is_window_focused() and not appearing
        imgui.end()
        if chosen is not None or lost:
            self.close()
        if chosen:
            actions.run(chosen)
        return not lost

    def _typed(self, hint: str) -> bool:
        """Draw the field, and return whether Enter was pressed."""
        if imgui.is_window_appearing() or self._refocus:
            imgui.set_keyboard_focus_here()
        self._refocus = False
        imgui.set_next_item_width(-1)
        enter = imgui.InputTextFlags_.enter_returns_true.value
        entered, text = imgui.input_text_with_hint("###command", hint, self.text or "", enter)
        self.at = 0 if text != self.text else self.at
        self.text = text
        return entered

    def _search(self, actions) -> str | None:
        """Draw the field and the actions that match. Return the id of the action that Enter or a click has chosen; ""
        if Enter was pressed where none matches, None until then."""
        entered = self._typed("command")
        found = actions.search(self.text)[:_FOUND]
        self.at = min(max(self.at + _arrows(), 0), max(len(found) - 1, 0))
        run = found[self.at].id if entered and found else None
        for index, action in enumerate(found):
            reason = action.enabled()
            imgui.begin_disabled(reason is not None)
            if imgui.selectable(f"{action.group}: {action.label}###palette {action.id}", index == self.at)[0]:
                run = action.id
            imgui.end_disabled()
            widgets.tooltip("\n".join(filter(None, (action.tooltip, reason))))
            imgui.same_line(0, hello_imgui.em_size(1))
            _at_right(reason or action.shortcut or _state(action))
        return "" if entered and not found else run

    def _number(self, parameters: Parameters) -> str | None:
        """Draw the field for a number, and return "" when a value was taken, else None."""
        name = self.asked
        assert name is not None  # it is open
        option, value = ALL[name], parameters.value(name)
        now = option.automatic if value is None else f"{value:g} {option.unit}".rstrip()
        entered = self._typed(f"{option.label}: {option.expected}")
        step = -_arrows()
        if step:
            parameters.set(name, stepped(option, value, step))
        if entered:
            try:
                parameters.set(name, parsed(option, self.text or ""))
            except GffeError as error:
                self._problem, self._refocus, self.text = str(error), True, ""
            else:
                return ""
        imgui.text(f"{option.label}: {now}")
        widgets.hint(self._problem or f"{option.sentence} Enter applies the typed value, the arrows step.")
        return None


def _at_right(text: str) -> None:
    """Draw as much of the text as the line has room for, at its end."""
    room = imgui.get_content_region_avail().x
    text = widgets.cut(text, room)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room - imgui.calc_text_size(text).x)
    imgui.text_disabled(text)


def _arrows() -> int:
    return imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)


def _state(action) -> str:
    return {None: "", True: "on", False: ""}[action.checked()]


def stepped(option: Option, value: float | None, steps: int) -> float | int:
    """Return the value `steps` steps further, within the range."""
    high = option.high if option.usual_high is None else option.usual_high
    size = 1 if option.kind is int else (high - option.low) / _STEPS
    start = by_hand(option) if value is None else value
    return option.kind(min(max(start + steps * size, option.low), max(high, start)))
