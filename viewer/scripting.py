"""The viewer without a person: a script of what to do, pictures and a film of the window (`gffe view --script`)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gffe_cl.errors import GffeError
from gffe_cl.viewer.start import PATIENCE, require_display
from gffe_cl.viewer.state.comparing import WAYS
from gffe_cl.viewer.state.parameters import ALL
from gffe_cl.viewer.state.playback import EVERY_FRAME

RATE = 8.0  # steps of the clock per second, and frames of the film
SIZE = (1120, 700)  # of the window
FILMS = (".webp", ".gif")
_STILL_FRAMES = 3  # of the interface, after everything has arrived, before a picture is taken
COMMANDS = {
    "seek": "seek SLOT: a frame, generated ones counted",
    "layer": "layer NAME: what is shown",
    "with": "with NAME: what it is compared with",
    "compare": "compare WAY: off, split, difference, error or flip error",
    "pixel": "pixel X,Y: its story; none: no more",
    "set": "set OPTION VALUE: a parameter or module of the panel, as on, off, a number or a choice",
    "do": "do ACTION: any action of the palette, by its id or label",
    "say": "say TEXT: a message",
    "wait": "wait SECONDS: let it play, or be looked at",
    "shot": "shot FILE.png: a picture of the window",
}


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


def play_script(model, path: Path, film: Path | None = None, size: tuple[int, int] | None = None) -> None:
    """Run a script in a window of its own, and write a `film` of it, WebP or GIF. Time passes only while everything
    that is shown is what was asked for, so that slow machines make the same film. Raises GffeError."""
    steps = parse(path)
    require_display()
    from gffe_cl.viewer.app import App

    director = Director(path, steps, film is not None)
    app = App(model, on_frame=director)
    app.clock = director.clock
    app.run(size or SIZE, test=lambda app: None)
    if director.problem:
        raise GffeError(director.problem)
    if film is not None:
        _write_film(film, director.frames)


class Director:
    """Called once per frame of the interface: does the next step when the last one is on the screen, and closes the
    window after the last; `frames` are those of the film."""

    def __init__(self, script: Path, steps: list[Step], film: bool):
        self._script, self._steps, self._film = script, list(steps), film
        self.problem: str | None = None
        self.frames: list[np.ndarray] = []
        self._time = 0.0
        self._waits = 0  # steps of the clock still to pass
        self._still = 0
        self._patience: float | None = None
        self._taken = True

    def clock(self) -> float:
        """Seconds."""
        return self._time

    def __call__(self, app) -> None:
        model = app.model
        if self.problem is not None or self._is_stuck(model):
            app.close()
            return
        self._still = self._still + 1 if model.settled and self._taken else 0
        if self._still < _STILL_FRAMES:
            return
        self._still, self._patience = 0, None
        if self._waits:
            self._waits -= 1
            self._time += 1 / RATE
            if self._film:
                self._take(app, self.frames.append)
        elif self._steps:
            if self._film:  # at its own rate: none is left out
                model.playback.mode = EVERY_FRAME
            self._do(app, self._steps.pop(0))
        else:
            app.close()

    def _is_stuck(self, model) -> bool:
        now = time.monotonic()
        self._patience = self._patience or now + PATIENCE
        self.problem = model.failure or (
            f"{self._script}: not done after {PATIENCE:.0f} s" if now > self._patience else None
        )
        return self.problem is not None

    def _take(self, app, use: Callable[[np.ndarray], object]) -> None:
        self._taken = False

        def taken(pixels: np.ndarray) -> None:
            use(pixels)
            self._taken = True

        app.capture(taken)

    def _do(self, app, step: Step) -> None:
        try:
            if step.command == "wait":
                self._waits = max(round(_number(step.argument) * RATE), 1)
            elif step.command == "shot":
                self._shoot(app, step.argument)
            else:
                perform(app, step.command, step.argument)
        except GffeError as error:
            self.problem = f"{self._script}, line {step.line}: {error}"

    def _shoot(self, app, name: str) -> None:
        from gffe_cl.viewer.picture.files import save_png

        path = Path(name)
        if path.suffix.lower() != ".png" or not path.absolute().parent.is_dir():
            raise GffeError(f"{name}: expected a .png in a folder that is there")

        def save(pixels: np.ndarray) -> None:
            try:
                save_png(path, pixels)
            except GffeError as error:
                self.problem = str(error)

        self._take(app, save)


def perform(app, command: str, argument: str) -> None:
    """Do one step in the running application. Raises GffeError if it cannot be done."""
    model = app.model
    if command == "say":
        model.say(argument)
    elif command == "seek":
        slot = _number(argument)
        if not 0 <= slot < model.playback.slots:
            raise GffeError(f"seek must be 0 to {model.playback.slots - 1}, got {argument}")
        model.playback.seek(int(slot))
    elif command in ("layer", "with"):
        found = model.contents.find(argument)
        reason = f"no layer is called '{argument}'" if found is None else model.contents.why_not(found)
        if reason:
            raise GffeError(reason)
        if command == "with":
            model.view.b = found
        else:
            model.show_layer(found)
    elif command == "compare":
        if argument not in WAYS:
            raise GffeError(f"compare must be {', '.join(WAYS)}, got '{argument}'")
        reason = model.comparison.why_not(argument)
        if reason:
            raise GffeError(reason)
        model.comparison.set(argument)
    elif command == "pixel":
        model.pointing.pick(None if argument == "none" else _pixel(argument, model.contents.size))
    elif command == "set":
        _set(model.parameters, *argument.partition(" ")[::2])
    else:
        _run(app.actions, argument)


def _pixel(text: str, size: tuple[int, int]) -> tuple[int, int]:
    parts = [int(_number(part)) for part in text.split(",")]
    if len(parts) != 2 or not all(0 <= at < most for at, most in zip(parts, size, strict=True)):
        raise GffeError(f"pixel must be inside {size[0]}×{size[1]}, as 12,34, got '{text}'")
    return tuple(parts)


def _set(parameters, name: str, text: str) -> None:
    text, option = text.strip(), ALL.get(name)
    if option is None:
        raise GffeError(f"unknown option '{name}' (expected {', '.join(ALL)})")
    reason = parameters.why_not(name)
    if reason:
        raise GffeError(f"{option.label}: {reason}")
    if text in ("on", "off") and option.is_module:
        parameters.switch(name, text == "on")
    elif option.kind in (int, float):
        parameters.set(name, option.checked(option.kind(_number(text))))
    else:
        parameters.set(name, text)


def _run(actions, wanted: str) -> None:
    found = next((action for action in actions if wanted in (action.id, action.label)), None)
    if found is None:
        near = ", ".join(action.id for action in actions.search(wanted)[:3])
        raise GffeError(f"no action is called '{wanted}'" + (f" (like {near})" if near else ""))
    if not actions.run(found.id):
        raise GffeError(f"{found.label}: {actions.last_refusal}")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise GffeError(f"expected a number, got '{text}'") from None


def require_film(path: Path) -> None:
    """GffeError if a film cannot be written to `path`."""
    if path.suffix.lower() not in FILMS:
        raise GffeError(f"{path}: a film's name must end in {' or '.join(FILMS)}")
    if not path.absolute().parent.is_dir():
        raise GffeError(f"{path}: cannot write: no such folder")


def _write_film(path: Path, frames: list[np.ndarray]) -> None:
    from PIL import Image

    from gffe_cl.files import replacing

    if not frames:
        raise GffeError(f"{path}: nothing was filmed (expected a script that waits)")
    images = [Image.fromarray(np.ascontiguousarray(frame)) for frame in frames]
    how = {"quality": 55, "method": 4, "minimize_size": True} if path.suffix.lower() == ".webp" else {"optimize": True}
    with replacing(path) as part:
        images[0].save(
            part, path.suffix[1:].upper(), save_all=True, append_images=images[1:], duration=round(1000 / RATE), loop=0,
            **how,
        )  # fmt: skip
