"""The viewer without a user: a script of actions, pictures and a film of the window (`gffe view --script`)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from imgui_bundle import imgui

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import read_bounded, replacing
from ..state.actions import Actions, nearest, seconds_of
from ..state.model import Model
from ..state.playback import EVERY_FRAME
from ..state.saving import require_file, save_png
from ..state.settings import Settings
from .app import App
from .running import new_app, run

RATE = 8.0  # steps of the clock per second, and frames of the film
SIZE, SHOT_SIZE = (1120, 700), (1600, 900)  # of the window: of a script, and of a screenshot
FILMS = (".webp", ".gif")
PATIENCE = 120.0  # seconds
_STILL_FRAMES = 3  # of the interface, after everything has arrived, before the next step
_MOST_BYTES = 1 << 20  # of a script


@dataclass(frozen=True)
class Line:
    """An action with its argument, if it takes one. `where` it is written begins the messages of its errors. `settles`:
    it waits until the picture stands."""

    where: str
    action: str
    argument: tuple[str, ...] = ()
    settles: bool = True


def unopened() -> App:
    """Return an application without a window and without a device: for its actions."""
    return new_app(Model(Settings(), start=False, save_settings=False))


def parse(path: Path, actions: Actions) -> list[Line]:
    """Return the steps of a script: one a line, empty lines and those that begin with # left out. Raises GffeError for
    unknown actions, and for arguments that are wrong in any sequence."""
    try:
        lines = read_bounded(path, _MOST_BYTES).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise GffeError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    steps = [
        _step(f"{path}, line {number}", text.strip(), actions)
        for number, text in enumerate(lines, 1)
        if text.strip() and not text.strip().startswith("#")
    ]
    if not steps:
        raise GffeError(f"{path}: nothing to do in it")
    return steps


def _step(where: str, text: str, actions: Actions) -> Line:
    id, *argument = text.split(None, 1)
    if id in actions and actions[id].takes:
        if not argument:
            raise GffeError(f"{where}: expected {id} {actions[id].takes}")
        try:
            actions[id].check(argument[0])
        except GffeError as error:
            raise GffeError(f"{where}: {error}") from None
        return Line(where, id, (argument[0],))
    if text not in actions:
        near = nearest(text, [action.id for action in actions])
        raise GffeError(f"{where}: no action is called '{text}' (nearest: {near}; all: gffe view --actions)")
    return Line(where, text)


def play_script(model: Model, steps: list[Line], film: Path | None = None, size: tuple[int, int] | None = None) -> None:
    """Run the steps in a window of its own, and write a `film` of it, WebP or GIF. Time passes only while the display
    is up to date, so that slow machines make the same film. Raises GffeError."""
    director = Director(steps, film is not None)
    app = new_app(model, on_frame=director)
    app.clock, app.director = director.clock, director
    run(app, size or SIZE, test=lambda app: None)
    if director.problem:
        raise GffeError(director.problem)
    if film is not None:
        _write_film(film, director.frames)


def take_screenshot(
    model: Model, path: Path, steps: list[tuple[str, str, str]], size: tuple[int, int] | None = None
) -> None:
    """Save a picture of the window to `path` after the steps (option, action, argument). Raises GffeError."""
    require_file(path, "picture", (".png",))
    listed = [
        Line(option, action, (argument,) if argument else (), settles=False) for option, action, argument in steps
    ]
    play_script(model, [*listed, Line("--screenshot", "shot", (str(path),))], size=size or SHOT_SIZE)


class Director:
    """Director of a script, called once per frame of the interface: does the next step when the last one is on the
    screen, and closes the window after the last; `frames` are those of the film."""

    def __init__(self, steps: list[Line], film: bool):
        self._steps, self._film = list(steps), film
        self._where = steps[0].where  # of the last step
        self.problem: str | None = None
        self.frames: list[np.ndarray] = []
        self._time = 0.0
        self._waits = 0  # steps of the clock still to pass
        self._until_done = False  # ... and not filmed, until background work is done
        self._still = 0
        self._patience: float | None = None
        self._taken = True

    def clock(self) -> float:
        """Return the seconds that have passed in the script."""
        return self._time

    def __call__(self, app: App) -> None:
        model, nowhere = app.model, float(np.finfo(np.float32).min)
        imgui.get_io().add_mouse_pos_event(nowhere, nowhere)
        if self.problem is not None or self._is_stuck(model):
            app.close()
            return
        self._still = self._still + 1 if model.settled and self._taken else 0
        if self._still < _STILL_FRAMES:
            return
        self._still, self._patience = 0, None
        scan = model.document.scan
        if self._until_done and (model.works_beside or (scan is not None and scan.busy)):
            self._time += 1 / RATE
            return
        self._until_done = False
        if self._waits:
            self._waits -= 1
            self._time += 1 / RATE
            if self._film:
                self._take(app, self.frames.append)
        elif self._steps:
            if self._film:  # at its own rate: none is left out
                model.playback.mode = EVERY_FRAME
            self._do(app, self._steps.pop(0))
            while self._steps and not self._steps[0].settles and self.problem is None:
                self._do(app, self._steps.pop(0))
        else:
            app.close()

    def wait(self, text: str) -> None:
        """Let time pass: so many seconds, or until background work is done. Raises GffeError."""
        if text == "done":
            self._until_done = True
            return
        self._waits = max(round(seconds_of(text) * RATE), 1)

    def shoot(self, app: App, path: Path) -> None:
        """Save a picture of the window. Raises GffeError."""
        require_file(path, "picture", (".png",))

        def save(pixels: np.ndarray) -> None:
            try:
                save_png(path, pixels)
            except GffeError as error:
                self.problem = str(error)

        self._take(app, save)

    def _is_stuck(self, model: Model) -> bool:
        now = time.monotonic()
        self._patience = self._patience or now + PATIENCE
        late = f"{self._where}: not done after {PATIENCE:.0f} s" if now > self._patience else None
        self.problem = model.document.failure or model.parameters.network_fault or late
        return self.problem is not None

    def _take(self, app: App, use: Callable[[np.ndarray], object]) -> None:
        self._taken = False

        def taken(pixels: np.ndarray) -> None:
            use(pixels)
            self._taken = True

        app.captures.append(taken)

    def _do(self, app: App, step: Line) -> None:
        self._where = step.where
        try:
            if step.action not in app.actions or not app.actions.run(step.action, *step.argument):
                raise GffeError(app.actions.last_refusal or f"no action is called '{step.action}'")
        except GffeError as error:
            self.problem = f"{step.where}: {error}"


def _write_film(path: Path, frames: list[np.ndarray]) -> None:
    from PIL import Image

    if not frames:
        raise GffeError(f"{path}: nothing was filmed (expected a script that waits)")
    images = [Image.fromarray(np.ascontiguousarray(frame)) for frame in frames]
    how = {"quality": 55, "method": 4, "minimize_size": True} if path.suffix.lower() == ".webp" else {"optimize": True}
    kind, duration = path.suffix[1:].upper(), round(1000 / RATE)
    with replacing(path) as part:
        images[0].save(part, kind, save_all=True, append_images=images[1:], duration=duration, loop=0, **how)
