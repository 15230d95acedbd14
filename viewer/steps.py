"""What a script of the viewer can do, a step a line, and how each step is done (`gffe view --script`)."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from gffe_cl.errors import GffeError
from gffe_cl.viewer.state.comparing import WAYS
from gffe_cl.viewer.state.flying import Flight
from gffe_cl.viewer.state.messages import Message
from gffe_cl.viewer.state.parameters import ALL

COMMANDS = {
    "seek": "seek SLOT: a frame, generated ones counted",
    "layer": "layer NAME: what is shown",
    "with": "with NAME: what it is compared with",
    "compare": "compare WAY: off, split, difference, error or flip error",
    "split": "split SHARE: where the line of the wipe is, 0 to 1",
    "pixel": "pixel X,Y: its story; none: no more",
    "rectangle": "rectangle LEFT,TOP,RIGHT,BOTTOM: statistics of its pixels; none: no more",
    "set": "set OPTION VALUE: a parameter or module of the panel, as on, off, a number or a choice",
    "do": "do ACTION: any action of the palette, by its id or label",
    "panel": "panel NAME: in front of those beside it",
    "palette": "palette TEXT: the palette with this typed into it; none: closed",
    "steer": "steer RIGHT,UP,FORWARD,YAW,PITCH: while the camera flies, keys held (-1 to 1), degrees per second; none",
    "say": "say TEXT: a title over the picture's foot",
    "wait": "wait SECONDS: let it play, or be looked at; wait done: until nothing is measured, examined or saved",
    "shot": "shot FILE.png: a picture of the window",
}


_NEAR = 3  # names that are told where one is unknown


@dataclass(frozen=True)
class Step:
    """`line` of the script: what to do, with what."""

    line: int
    command: str
    argument: str


def parse(path: Path) -> list[Step]:
    """The steps of a script: one a line, empty lines and those that begin with # left out. Raises GffeError."""
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise GffeError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    steps = []
    for number, text in enumerate(lines, 1):
        command, _, argument = text.strip().partition(" ")
        if not command or command.startswith("#"):
            continue
        if command not in COMMANDS:
            raise GffeError(f"{path}, line {number}: unknown command '{command}' (expected {', '.join(COMMANDS)})")
        if not argument.strip():
            raise GffeError(f"{path}, line {number}: expected {COMMANDS[command]}")
        steps.append(Step(number, command, argument.strip()))
    if not steps:
        raise GffeError(f"{path}: nothing to do in it")
    return steps


def perform(app, command: str, argument: str) -> None:
    """Do one step, but "wait" and "shot", in the running application. Raises GffeError if it cannot be done."""
    _DOING[command](app, argument)


def _seek(app, argument: str) -> None:
    playback = app.model.playback
    slot = number(argument)
    if not 0 <= slot < playback.slots:
        raise GffeError(f"seek must be 0 to {playback.slots - 1}, got {argument}")
    playback.seek(int(slot))


def _layer(app, argument: str) -> None:
    app.model.show_layer(found_layer(app.model, argument))


def _with(app, argument: str) -> None:
    app.model.comparison.with_layer(found_layer(app.model, argument))


def found_layer(model, name: str) -> str:
    """Full name of a layer that can be shown. Raises GffeError."""
    found = model.contents.find(name)
    if found is None:
        raise GffeError(f"no layer is called '{name}' (nearest: {', '.join(_nearest(model, name))})")
    reason = model.contents.why_not(found)
    if reason:
        raise GffeError(f"layer '{found}': {reason}")
    return found


def _nearest(model, text: str) -> list[str]:
    """Names of layers that are meant perhaps, best first."""
    known: dict[str, str] = {}  # full names by what somebody may write
    for spec in model.contents.layers:
        for written in (spec.name, spec.name.partition(".")[2], spec.label.lower()):
            known.setdefault(written, spec.name)
    found = get_close_matches(text.lower(), [written for written in known if written], 2 * _NEAR, cutoff=0.0)
    return list(dict.fromkeys(known[written] for written in found))[:_NEAR]


def _compare(app, argument: str) -> None:
    comparison = app.model.comparison
    if argument not in WAYS:
        raise GffeError(f"compare must be {', '.join(WAYS)}, got '{argument}'")
    reason = comparison.why_not(argument)
    if reason:
        raise GffeError(reason)
    comparison.set(argument)


def _split(app, argument: str) -> None:
    share = number(argument)
    if not 0 <= share <= 1:
        raise GffeError(f"split must be 0 to 1, got {argument}")
    app.model.view.split = share


def _pixel(app, argument: str) -> None:
    if argument == "none":
        app.model.pointing.pick(None)
        return
    width, height = app.model.contents.size
    pixel = [int(n) for n in numbers(argument)]
    if len(pixel) != 2 or not (0 <= pixel[0] < width and 0 <= pixel[1] < height):
        raise GffeError(f"pixel must be inside {width}×{height}, as 12,34, got '{argument}'")
    app.model.pointing.pick(tuple(pixel))


def _rectangle(app, argument: str) -> None:
    if argument == "none":
        app.model.selection.forget()
        return
    width, height = app.model.contents.size
    edges = numbers(argument)
    if len(edges) != 4 or not (0 <= edges[0] < edges[2] <= width and 0 <= edges[1] < edges[3] <= height):
        raise GffeError(f"rectangle must be inside {width}×{height}, as 12,34,56,78, got '{argument}'")
    app.model.selection.draw(edges[:2], [edge - 0.5 for edge in edges[2:]])


def _set(app, argument: str) -> None:
    name, _, text = argument.partition(" ")
    parameters, text, option = app.model.parameters, text.strip(), ALL.get(name)
    if option is None:
        raise GffeError(f"unknown option '{name}' (expected {', '.join(ALL)})")
    reason = parameters.why_not(name)
    if reason:
        raise GffeError(f"{option.label}: {reason}")
    if text in ("on", "off") and option.is_module:
        parameters.switch(name, text == "on")
    elif option.kind in (int, float):
        parameters.set(name, option.checked(option.kind(number(text))))
    else:
        parameters.set(name, text)


def _run(app, wanted: str) -> None:
    actions = app.actions
    found = next((action for action in actions if wanted in (action.id, action.label)), None)
    if found is None:
        near = ", ".join(action.id for action in actions.search(wanted)[:3])
        raise GffeError(f"no action is called '{wanted}'" + (f" (like {near})" if near else ""))
    if not actions.run(found.id):
        raise GffeError(f"{found.label}: {actions.last_refusal}")


def _panel(app, argument: str) -> None:
    if argument not in app.docks.names:
        raise GffeError(f"no panel is called '{argument}' (there are: {', '.join(app.docks.names)})")
    app.docks.show(argument)


def _palette(app, argument: str) -> None:
    if argument == "none":
        app.palette.close()
        return
    app.palette.open(argument)


def _steer(app, argument: str) -> None:
    if argument == "none":
        app.steering = None
        return
    parts = numbers(argument)
    if len(parts) != 5 or any(abs(part) > 1 for part in parts[:3]):
        raise GffeError(f"expected {COMMANDS['steer']}, got '{argument}'")
    if not app.model.flying:
        raise GffeError("steer: the camera does not fly (expected: do fly)")
    app.steering = Flight(tuple(parts[:3]), 1.0, 0.0, 0.0, tuple(parts[3:]))


def _say(app, argument: str) -> None:
    app.model.messages = [Message(argument, "title")]  # one at a time


_DOING = {
    "seek": _seek,
    "layer": _layer,
    "with": _with,
    "compare": _compare,
    "split": _split,
    "pixel": _pixel,
    "rectangle": _rectangle,
    "set": _set,
    "do": _run,
    "panel": _panel,
    "palette": _palette,
    "steer": _steer,
    "say": _say,
}


def number(text: str) -> float:
    """Raises GffeError."""
    try:
        return float(text)
    except ValueError:
        raise GffeError(f"expected a number, got '{text}'") from None


def numbers(text: str) -> list[float]:
    """Of "1,2.5"; raises GffeError."""
    return [number(part) for part in text.split(",")]
