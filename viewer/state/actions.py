"""Actions of the user, defined once: menus, shortcuts, help, the command palette and scripts all use `Actions`."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from gffe_cl.engine.core.errors import GffeError

if TYPE_CHECKING:
    from ..picture.current_frame import Contents
    from .playback import Playback

_NEAR = 3  # names that are suggested where one is unknown
_LONGEST_WAIT = 3600.0  # seconds

MODIFIERS = ("Ctrl", "Alt", "Shift", "Super")  # in the order in which they are written
_ALIKE = ("Space", "Home", "End", "Insert", "Delete", "Backspace", "Enter", "Escape", "Tab")
_NAMED = {name: name.lower() for name in _ALIKE} | {"PageUp": "page_up", "PageDown": "page_down"}
_NAMED |= {name: f"{name.lower()}_arrow" for name in ("Left", "Right", "Up", "Down")}
_SYMBOLS = {
    "'": "apostrophe",
    ",": "comma",
    "-": "minus",
    ".": "period",
    "/": "slash",
    ";": "semicolon",
    "=": "equal",
    "[": "left_bracket",
    "\\": "backslash",
    "]": "right_bracket",
    "`": "grave_accent",
}
_KEYPAD = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "decimal": ".", "enter": "Enter", "equal": "="}
# with Shift, as on a US keyboard: there "?" and "Shift+/" are one shortcut
_SHIFTED = dict(zip("',-./;=[\\]`", '"<_>?:+{|}~', strict=True))
_UNSHIFTED = {shifted: plain for plain, shifted in _SHIFTED.items()}

# attribute of imgui.Key → the name of the key as `Actions.dispatch` takes it
IMGUI_KEYS: dict[str, str] = (
    {attribute: name for name, attribute in (_NAMED | _SYMBOLS).items()}
    | {letter: letter.upper() for letter in string.ascii_lowercase}
    | {f"_{digit}": digit for digit in string.digits}
    | {f"f{i}": f"F{i}" for i in range(1, 25)}
    | {f"keypad{digit}": digit for digit in string.digits}
    | {f"keypad_{name}": key for name, key in _KEYPAD.items()}
)
_KEYS = set(IMGUI_KEYS.values()) | set(_UNSHIFTED)

Shortcut = tuple[frozenset[str], str]


def parse_shortcut(text: str) -> Shortcut:
    """Return (modifiers, key) of a shortcut such as "Ctrl+O", "Shift+E", "Space", "F5", "1" or "?".

    Shift is part of a symbol that is typed with it: "?" and "Shift+/" both give (no modifiers, "?"). Raises ValueError.
    """
    head, _, start = text[:-1].rpartition("+")  # the key itself may be "+"
    modifiers, key = frozenset(filter(None, head.split("+"))), start + text[-1:]
    if not modifiers <= set(MODIFIERS) or key not in _KEYS:
        raise ValueError(f"shortcut {text!r}: expected {', '.join(MODIFIERS)}, and a key such as A, 1, F5, Left or ?")
    return canonical(modifiers, key)


def canonical(modifiers: frozenset[str], key: str) -> Shortcut:
    """Return the one form of a shortcut: Shift is dropped where it is part of the symbol."""
    if "Shift" in modifiers and key in _SHIFTED:
        key = _SHIFTED[key]
    return frozenset(modifiers) - ({"Shift"} if key in _UNSHIFTED else set()), key


@dataclass(frozen=True)
class Action:
    """Something that the user can do.

    `id` names it in the program and in scripts, `label` and `group` for people. `shortcut` is text ("Ctrl+O") or "",
    `also` holds further ones. `run(app)` does it, or with `takes`, the form of an argument, `run(app, argument)`: only
    scripts have arguments, of which `check(argument)` refuses those that are wrong wherever it runs. `enabled(app)`
    gives the reason why it cannot run now, None if it can; `checked(app)` the state of a switch, None for no switch.
    `release(app)`, if given, is called when its key goes up. `repeat`: a key that is kept down runs it again and again.
    `anywhere`: its shortcut works over an open window, too.
    """

    id: str
    label: str
    group: str
    shortcut: str
    run: Callable[..., object]
    enabled: Callable[[Any], str | None] = lambda app: None
    checked: Callable[[Any], bool | None] = lambda app: None
    tooltip: str = ""
    release: Callable[[Any], object] | None = None
    repeat: bool = False
    anywhere: bool = False
    also: tuple[str, ...] = ()
    takes: str = ""
    check: Callable[[str], object] = lambda text: None

    @property
    def shortcuts(self) -> list[Shortcut]:
        return [parse_shortcut(text) for text in (self.shortcut, *self.also) if text]


class Actions:
    """All actions `of` an application, in the order in which they were registered."""

    def __init__(self, of: Any):
        self._app = of
        self._actions: dict[str, Action] = {}
        self._by_shortcut: dict[Shortcut, Action] = {}
        self._held: dict[str, str | None] = {}  # action id → the key that holds it; None: switched on without a key
        self.last_refusal: str | None = None  # why the latest `dispatch` or `run` did nothing

    def __iter__(self):
        return iter(self._actions.values())

    def __contains__(self, id: str) -> bool:
        return id in self._actions

    def __getitem__(self, id: str) -> Action:
        try:
            return self._actions[id]
        except KeyError:
            raise KeyError(f"no action is called {id!r}") from None

    def register(self, action: Action) -> Action:
        """Add an action, and return it. Raises ValueError if its id or a shortcut is taken."""
        if action.id in self._actions:
            other = self._actions[action.id]
            raise ValueError(f"action {action.id!r} ({action.label}) is registered already ({other.label})")
        for shortcut in action.shortcuts:
            other = self._by_shortcut.get(shortcut)
            if other is not None or action.shortcuts.count(shortcut) > 1:
                raise ValueError(f"{shortcut} of action {action.id!r} is taken by {(other or action).id!r}")
        self._actions[action.id] = action
        self._by_shortcut |= dict.fromkeys(action.shortcuts, action)
        return action

    def grouped(self) -> dict[str, list[Action]]:
        """Return the actions without an argument by group, both in the order of registration."""
        groups: dict[str, list[Action]] = {}
        for action in (action for action in self if not action.takes):
            groups.setdefault(action.group, []).append(action)
        return groups

    def shortcut_table(self) -> list[tuple[str, list[tuple[str, str]]]]:
        """Return (group, [(shortcuts, label)]) of all actions that have a shortcut, for the help."""
        table = []
        for group, actions in self.grouped().items():
            rows = []
            for action in actions:
                text = " or ".join(filter(None, (action.shortcut, *action.also)))
                if text:
                    rows.append((f"hold {text}" if action.release else text, action.label))
            if rows:
                table.append((group, rows))
        return table

    def why_not(self, id: str) -> str | None:
        """Return the reason why an action cannot run now; None if it can."""
        return self[id].enabled(self._app)

    def checked(self, id: str) -> bool | None:
        """Return the state of a switch; None for no switch."""
        return self[id].checked(self._app)

    def run(self, id: str, *argument: str) -> bool:
        """Run an action from a menu, a button or a script. Returns False if it is disabled (`last_refusal` has the
        reason). A click cannot be held, so it toggles an action that is released."""
        action = self[id]
        self.last_refusal = None
        if id in self._held:
            self._let_go(id)
            return True
        return self._start(action, None, *argument)

    def dispatch(
        self, modifiers: frozenset[str], key: str, *, repeated: bool = False, covered: bool = False
    ) -> str | None:
        """Handle a key press: run the action of that shortcut and return its id; None if there is none or it is
        disabled (`last_refusal` has the reason). `repeated`: the key is held down; `covered`: a window covers the
        panels."""
        self.last_refusal = None
        action = self._by_shortcut.get(canonical(frozenset(modifiers), key))
        if action is None or (repeated and not action.repeat) or (covered and not action.anywhere):
            return None
        if action.id in self._held:  # from now on this key holds it
            self._held[action.id] = key
            return action.id
        return action.id if self._start(action, key) else None

    def release(self, key: str) -> str | None:
        """Handle a key release, with any modifiers: end the actions that it holds; return the id of the last one."""
        plain, released = _UNSHIFTED.get(key, key), None
        for id, by in list(self._held.items()):
            if by is not None and _UNSHIFTED.get(by, by) == plain:
                self._let_go(id)
                released = id
        return released

    def release_all(self) -> None:
        """Let go of everything: the window lost the keyboard."""
        for id in list(self._held):
            self._let_go(id)

    def _start(self, action: Action, key: str | None, *argument: str) -> bool:
        self.last_refusal = action.enabled(self._app)
        if self.last_refusal is not None:
            return False
        if action.release is not None:
            self._held[action.id] = key
        action.run(self._app, *argument)
        return True

    def _let_go(self, id: str) -> None:
        del self._held[id]
        if (release := self._actions[id].release) is not None:
            release(self._app)

    def search(self, text: str) -> list[Action]:
        """Return the actions whose label or group has every word of `text`, or a part of it, those that can run first,
        then those of whose label it is the beginning of a word; all for no text."""
        words = _words(text)
        found = []
        for place, action in enumerate(action for action in self if not action.takes):
            label = " ".join(_words(action.label))
            if all(word in f"{label} {' '.join(_words(action.group))}" for word in words):
                begun = sum(f" {word}" in f" {label}" for word in words)
                length = len(label) if words else 0
                found.append((action.enabled(self._app) is not None, -begun, length, place, action))
        return [action for *_, action in sorted(found, key=lambda entry: entry[:-1])]


def _words(text: str) -> list[str]:
    return re.findall(r"[^\W_]+", text.casefold())


# ---- arguments of actions ----------------------------------------------------------------------------------------


def frame_of(text: str) -> re.Match:
    """Return the parts of a slot that is written as `slot_of` has it. Raises GffeError."""
    found = re.fullmatch(r"(\d+)(?:\s*\+\s*(?:0|(\d+)/(\d+)))?", text.strip(), re.ASCII)
    if found is None or (found[3] and not 0 < int(found[2]) < int(found[3])):
        raise GffeError(
            "expected a frame's number on the timeline, generated ones counted (9), or a rendered frame's and a part"
            f" of the way to the next (4+1/2; 4+0: itself), got '{text}'"
        )
    return found


def slot_of(text: str, playback: Playback) -> int:
    """Return the slot written as "9", its number on the timeline, "4+1/2", or "4+0", a rendered frame. Raises
    GffeError."""
    found = frame_of(text)
    parts, slot = playback.n + 1, Fraction(int(found[1]))
    if "+" in text:
        slot = (slot + (Fraction(int(found[2]), int(found[3])) if found[3] else 0)) * parts
    if slot.denominator != 1:
        raise GffeError(f"{text}: generated frames are at {found[1]}+1/{parts} and so on")
    if slot >= playback.slots:
        last = f"{playback.count - 1}+{playback.n}/{parts}"
        raise GffeError(f"expected 0 to {playback.slots - 1} (0 to {last}), got {text}")
    return int(slot)


def found_layer(contents: Contents, name: str) -> str:
    """Return the full name of a layer that can be shown. Raises GffeError."""
    found = contents.find(name)
    if found is None:
        near = nearest(name, [spec.name for spec in contents.layers])
        raise GffeError(f"no layer is called '{name}' (nearest: {near})")
    if reason := contents.why_not(found):
        raise GffeError(f"layer '{found}': {reason}")
    return found


def numbers(text: str, count: int) -> list[float]:
    """Return so many finite numbers of a list such as "1,2.5". Raises GffeError."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise GffeError(f"expected {count} number{'s, with commas' * (count > 1)}, got '{text}'")
    return values


def seconds_of(text: str) -> float:
    """Return a time to wait, seconds; 0 for "done". Raises GffeError."""
    seconds = 0.0 if text == "done" else numbers(text, 1)[0]
    if not 0 <= seconds <= _LONGEST_WAIT:
        raise GffeError(f"expected 0 to {_LONGEST_WAIT:.0f} seconds, or done, got {text}")
    return seconds


def nearest(text: str, known: list[str]) -> str:
    """Return the names that are most similar to `text`, best first."""
    return ", ".join(get_close_matches(text, known, _NEAR, cutoff=0.0))
