"""Steps of a viewer's script, one per line: how each is written, checked and done (`gffe view --script`)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from pathlib import Path
from typing import Any

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import read_bounded
from gffe_cl.engine.options import Option
from ..state.actions import Action, Actions
from ..state.captions import Message
from ..state.comparing import WAYS
from ..state.model import Model
from ..state.navigation import Flight
from ..state.parameters import ALL, parsed
from ..state.playback import Playback
from ..state.settings import Settings
from ..window.app import App

_MOST_BYTES = 1 << 20  # of a script
_NEAR = 3  # names that are suggested where one is unknown
_LONGEST_WAIT = 3600.0  # seconds
DONE = "done"  # of "wait": until nothing is measured, examined or saved


@dataclass(frozen=True)
class Command:
    """Command of a script. `usage`: its syntax; `read(text, app)` checks and converts its argument before anything
    is open; `fits(app, value)` checks it against the open sequence; `do(app, value)` executes it. All raise
    GffeError. `lasting`: whether the result of `fits` does not depend on the options. Without `do` the director of
    the script executes it."""

    usage: str
    read: Callable[[str, App], Any]
    do: Callable[[App, Any], object] | None = None
    fits: Callable[[App, Any], object] = lambda app, value: None
    lasting: bool = False


@dataclass(frozen=True)
class Step:
    """A `line` of the script, with its command and the value from `Command.read`."""

    line: int
    command: str
    value: Any


def parse(path: Path, app: App | None = None) -> list[Step]:
    """Return the steps of a script: one a line, empty lines and those that begin with # left out. Everything is checked
    that does not depend on the sequence. `app`: whose actions and panels there are (None: a viewer's that is never
    opened). Raises GffeError."""
    try:
        lines = read_bounded(path, _MOST_BYTES).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise GffeError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    app, steps = app or unopened(), []
    for number, text in enumerate(lines, 1):
        if not text.strip() or text.strip().startswith("#"):
            continue
        command, *argument = text.split(None, 1)
        try:
            steps.append(Step(number, command, _read(command, argument[0].strip() if argument else "", app)))
        except GffeError as error:
            raise GffeError(f"{path}, line {number}: {error}") from None
    if not steps:
        raise GffeError(f"{path}: nothing to do in it")
    return steps


def _read(command: str, argument: str, app: App) -> Any:
    if command not in COMMANDS:
        raise GffeError(f"unknown command '{command}' (expected {', '.join(COMMANDS)})")
    if not argument:
        raise GffeError(f"expected {COMMANDS[command].usage}")
    return COMMANDS[command].read(argument, app)


def unopened() -> App:
    """Return an application without a window and without a device: for its actions and panels."""
    return App(Model(Settings(), start=False, save_settings=False))


def check(app: App, path: Path, steps: list[Step]) -> None:
    """Check all steps against the open sequence and its first frame. Steps that depend on the options are checked up
    to the first step that changes them. Raises GffeError."""
    same_options = True
    for step in steps:
        command = COMMANDS[step.command]
        try:
            if same_options or command.lasting:
                command.fits(app, step.value)
        except GffeError as error:
            raise GffeError(f"{path}, line {step.line}: {error}") from None
        same_options &= not _changes_options(app, step)


def _changes_options(app: App, step: Step) -> bool:
    if step.command == "do":
        action = _action(app.actions, step.value)
        return action is not None and action.group in ("Modules", "Parameters")
    return step.command == "set"


def perform(app: App, command: str, value: Any) -> None:
    """Do one step, but "wait" and "shot", in the running application. Raises GffeError if it cannot be done."""
    COMMANDS[command].fits(app, value)
    do = COMMANDS[command].do
    assert do is not None  # of all but "wait" and "shot"
    do(app, value)


# ---- places and names ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Place:
    """Place on the timeline as it is `written`: slot `number`, or the frame generated `part` of the way after rendered
    frame `number`."""

    written: str
    number: int
    part: Fraction | None = None

    def slot(self, playback: Playback, name: str) -> int:
        """Return the slot. Raises GffeError, beginning with `name`, if there is none."""
        slot, parts = Fraction(self.number), playback.n + 1
        if self.part is not None:
            slot = (slot + self.part) * parts
        if slot.denominator != 1:
            raise GffeError(f"{name} {self.written}: generated frames are at {self.number}+1/{parts} and so on")
        if slot >= playback.slots:
            least = f" (0 to {playback.count - 1}+{playback.n}/{parts})"
            raise GffeError(f"{name} must be 0 to {playback.slots - 1}{least}, got {self.written}")
        return int(slot)


FIRST = Place("0", 0)


def read_place(text: str, name: str) -> Place:
    """Return the place written as "9", the number of a slot, "4+1/2", or "4+0", a rendered frame. Raises GffeError,
    beginning with `name`."""
    found = re.fullmatch(r"(\d+)(?:\s*\+\s*(?:0|(\d+)/(\d+)))?", text.strip(), re.ASCII)
    if found is None or (found[3] and not 0 < int(found[2]) < int(found[3])):
        raise GffeError(
            f"{name} must be a frame's number on the timeline, generated ones counted (9), or a rendered frame's and a"
            f" part of the way to the next (4+1/2; 4+0: itself), got '{text}'"
        )
    part = Fraction(int(found[2]), int(found[3])) if found[3] else Fraction(0)
    return Place(text, int(found[1]), part if "+" in text else None)


def _seek(app: App, place: Place) -> None:
    app.model.playback.seek(place.slot(app.model.playback, "seek"))


def found_layer(model: Model, name: str) -> str:
    """Return the full name of a layer that can be shown. Raises GffeError."""
    found = model.contents.find(name)
    if found is None:
        raise GffeError(f"no layer is called '{name}' (nearest: {', '.join(_nearest(model, name))})")
    reason = model.contents.why_not(found)
    if reason:
        raise GffeError(f"layer '{found}': {reason}")
    return found


def _nearest(model: Model, text: str) -> list[str]:
    """Return similar names of layers, best first."""
    known: dict[str, str] = {}  # full names by possible spellings
    for spec in model.contents.layers:
        for written in (spec.name, spec.name.partition(".")[2], spec.label.lower()):
            known.setdefault(written, spec.name)
    return _close(text, known)


def _close(text: str, known: dict[str, str]) -> list[str]:
    """Return the names whose spellings are closest to `text`, best first."""
    found = get_close_matches(text.lower(), [written for written in known if written], 2 * _NEAR, cutoff=0.0)
    return list(dict.fromkeys(known[written] for written in found))[:_NEAR]


def _layer_fits(app: App, name: str) -> None:
    found_layer(app.model, name)


def _layer(app: App, name: str) -> None:
    app.model.show_layer(found_layer(app.model, name))


def _with(app: App, name: str) -> None:
    app.model.comparison.with_layer(found_layer(app.model, name))


def _existing(text: str, _app: App) -> str:
    if not Path(text).expanduser().exists():
        raise GffeError(f"{text}: no such file or folder")
    return text


def _plane(text: str, _app: App) -> int:
    if not re.fullmatch(r"[1-9][0-9]?", text):
        raise GffeError(f"plane must be a whole number from 1, got '{text}'")
    return int(text)


def _show_plane(app: App, plane: int) -> None:
    spec = app.model.contents.spec(app.model.view.a)
    if spec is None or plane > spec.planes:
        planes = 1 if spec is None else spec.planes
        raise GffeError(f"plane must be 1 to {planes}, which '{app.model.view.a}' has, got {plane}")
    app.model.looks.choose_plane(spec.name, plane - 1)


def _way(text: str, _app: App) -> str:
    if text not in WAYS:
        raise GffeError(f"compare must be {', '.join(WAYS)}, got '{text}'")
    return text


def _compare(app: App, way: str) -> None:
    reason = app.model.comparison.why_not(way)
    if reason:
        raise GffeError(reason)
    app.model.comparison.set(way)


def _share(text: str, _app: App) -> float:
    share = number(text)
    if not 0 <= share <= 1:
        raise GffeError(f"split must be 0 to 1, got {text}")
    return share


def _whole(name: str, count: int, example: str) -> Callable[[str, Any], tuple[int, ...] | None]:
    """Return a function that reads `count` coordinates, or "none"."""

    def read(text: str, _app: App) -> tuple[int, ...] | None:
        if text == "none":
            return None
        values = numbers(text)
        if len(values) != count or any(value < 0 or value != int(value) for value in values):
            raise GffeError(f"{name} must be {count} whole numbers, 0 or more, as {example}, got '{text}'")
        return tuple(map(int, values))

    return read


def _pixel_fits(app: App, pixel: tuple[int, int] | None) -> None:
    width, height = app.model.contents.size
    if pixel is not None and not (pixel[0] < width and pixel[1] < height):
        raise GffeError(f"pixel must be inside {width}×{height}, got {_listed(pixel)}")


def _edges(text: str, app: App) -> tuple[int, ...] | None:
    edges = _whole("rectangle", 4, "12,34,56,78")(text, app)
    if edges is not None and not (edges[0] < edges[2] and edges[1] < edges[3]):
        raise GffeError(f"rectangle must be LEFT,TOP,RIGHT,BOTTOM with LEFT < RIGHT and TOP < BOTTOM, got '{text}'")
    return edges


def _rectangle_fits(app: App, edges: tuple[int, ...] | None) -> None:
    width, height = app.model.contents.size
    if edges is not None and not (edges[2] <= width and edges[3] <= height):
        raise GffeError(f"rectangle must be inside {width}×{height}, got {_listed(edges)}")


def _rectangle(app: App, edges: tuple[int, ...] | None) -> None:
    if edges is None:
        app.model.selection.forget()
    else:
        left, top, right, bottom = edges
        app.model.selection.draw((left, top), (right - 0.5, bottom - 0.5))


def _listed(values) -> str:
    return ",".join(map(str, values))


# ---- options and actions -------------------------------------------------------------------------------------


def _setting(text: str, _app: App) -> tuple[str, bool, Any]:
    """Return (option, whether it is a switch, value)."""
    name, _, value = text.partition(" ")
    option, value = ALL.get(name), value.strip()
    if option is None:
        raise GffeError(f"unknown option '{name}' (expected {', '.join(ALL)})")
    if value in ("on", "off") and option.is_module:
        return name, True, value == "on"
    return name, False, _value(option, value)


def _value(option: Option, text: str) -> Any:
    if option.kind in (int, float):
        return parsed(option, text)
    if option.kind is bool and text in ("on", "off"):
        return text == "on"
    try:
        return option.checked(text)
    except GffeError:
        switch = "on, off, " if option.is_module and option.kind is not bool else ""
        raise GffeError(f"{option.label} must be {switch}{option.expected}, got '{text}'") from None


def _set(app: App, setting: tuple[str, bool, Any]) -> None:
    name, is_switch, value = setting
    parameters = app.model.parameters
    reason = parameters.why_not(name)
    if reason:
        raise GffeError(f"{ALL[name].label}: {reason}")
    (parameters.switch if is_switch else parameters.set)(name, value)


def _action(actions: Actions, wanted: str) -> Action | None:
    return next((action for action in actions if wanted in (action.id, action.label)), None)


def _known_action(text: str, app: App) -> str:
    of_layer = text.startswith("layer ") or ": " in text  # there are none before the first frame
    if not of_layer:
        _action_fits(app, text)
    return text


def _action_fits(app: App, wanted: str) -> None:
    if _action(app.actions, wanted) is None:
        known = {written.lower(): action.id for action in app.actions for written in (action.label, action.id)}
        near = ", ".join(_close(wanted, known))
        raise GffeError(f"no action is called '{wanted}' (nearest: {near}; all: gffe view --actions)")


def _run(app: App, wanted: str) -> None:
    action = _action(app.actions, wanted)
    assert action is not None  # `_action_fits` was asked
    if not app.actions.run(action.id):
        raise GffeError(f"{action.label}: {app.actions.last_refusal}")


def _panel(text: str, app: App) -> str:
    if text not in app.docks.names:
        raise GffeError(f"no panel is called '{text}' (expected {', '.join(app.docks.names)})")
    return text


# ---- the window ----------------------------------------------------------------------------------------------


def _palette(app: App, text: str) -> None:
    if text == "none":
        app.palette.close()
    else:
        app.palette.open(text)


def _flight(text: str, _app: App) -> Flight | None:
    if text == "none":
        return None
    parts = numbers(text)
    if len(parts) != 5 or any(abs(part) > 1 for part in parts[:3]):
        raise GffeError(f"expected {COMMANDS['steer'].usage}, got '{text}'")
    return Flight((parts[0], parts[1], parts[2]), 1.0, 0.0, 0.0, (parts[3], parts[4]))


def _steer(app: App, flight: Flight | None) -> None:
    if flight is not None and not app.model.flying:
        raise GffeError("steer: the camera does not fly (expected: do fly)")
    app.steering = flight


def _say(app: App, text: str) -> None:
    app.model.messages = [Message(text, "title")]  # one at a time


def _seconds(text: str, _app: App) -> float | str:
    if text == DONE:
        return DONE
    seconds = number(text)
    if not 0 <= seconds <= _LONGEST_WAIT:
        raise GffeError(f"wait must be 0 to {_LONGEST_WAIT:.0f} seconds, or {DONE}, got {text}")
    return seconds


def _picture_file(text: str, _app: App) -> Path:
    path = Path(text)
    if path.suffix.lower() != ".png" or not path.absolute().parent.is_dir():
        raise GffeError(f"{text}: expected a .png in an existing folder")
    return path


def _text(text: str, _app: App) -> str:
    return text


COMMANDS: dict[str, Command] = {
    "seek": Command(
        "seek FRAME: its number on the timeline, generated ones counted, as 9, or as 4+1/2 (4+0: rendered frame 4)",
        lambda text, app: read_place(text, "seek"), _seek, lambda app, place: place.slot(app.model.playback, "seek"),
    ),
    "layer": Command("layer NAME: the displayed layer", _text, _layer, _layer_fits),
    "plane": Command("plane N: of the displayed layer, from 1", _plane, _show_plane),
    "from": Command(
        "from FOLDER: B is another sequence, an output of gffe run or kernels, or a file of figures", _existing,
        lambda app, place: app.model.sides.load_b(place), lasting=True,
    ),
    "with": Command("with NAME: the layer to compare with", _text, _with, _layer_fits),
    "compare": Command("compare WAY: off, split, difference, error or flip error", _way, _compare),
    "split": Command(
        "split SHARE: where the line of the wipe is, 0 to 1", _share,
        lambda app, share: setattr(app.model.view, "split", share),
    ),
    "pixel": Command(
        "pixel X,Y: its story; none: no more", _whole("pixel", 2, "12,34"),
        lambda app, pixel: app.model.pointing.pick(pixel), _pixel_fits, lasting=True,
    ),
    "rectangle": Command(
        "rectangle LEFT,TOP,RIGHT,BOTTOM: statistics of its pixels; none: no more", _edges, _rectangle,
        _rectangle_fits, lasting=True,
    ),
    "set": Command("set OPTION VALUE: a parameter or module of the panel, as on, off, a number or a choice", _setting,
                   _set),
    "do": Command("do ACTION: an action by its id or label (gffe view --actions)", _known_action, _run, _action_fits),
    "panel": Command("panel NAME: bring it to the front", _panel, lambda app, name: app.docks.show(name)),
    "palette": Command("palette TEXT: the palette with this typed into it; none: closed", _text, _palette),
    "steer": Command(
        "steer RIGHT,UP,FORWARD,YAW,PITCH: while the camera flies, keys held (-1 to 1), degrees per second; none",
        _flight, _steer,
    ),
    "say": Command("say TEXT: show a title at the bottom of the picture", _text, _say),
    "wait": Command(
        "wait SECONDS: let it play, or be looked at; wait done: until nothing is measured, examined or saved", _seconds
    ),
    "shot": Command("shot FILE.png: a picture of the window", _picture_file),
}  # fmt: skip


def number(text: str) -> float:
    """Return the finite number in `text`. Raises GffeError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise GffeError(f"expected a number, got '{text}'")
    return value


def numbers(text: str) -> list[float]:
    """Return the numbers of a list such as "1,2.5". Raises GffeError."""
    return [number(part) for part in text.split(",")]
