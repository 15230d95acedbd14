"""The viewer without a user: a script of actions, pictures and a film of the window (`gffe view --script`)."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from ..picture.files import save_png
from ..state.model import Model
from ..state.playback import EVERY_FRAME
from ..window.app import App
from .screenshot import PATIENCE, without_pointer
from .steps import DONE, Step, check, perform

RATE = 8.0  # steps of the clock per second, and frames of the film
SIZE = (1120, 700)  # of the window
FILMS = (".webp", ".gif")
_STILL_FRAMES = 3  # of the interface, after everything has arrived, before a picture is taken


def play_script(
    model: Model, path: Path, steps: list[Step], film: Path | None = None, size: tuple[int, int] | None = None
) -> None:
    """Run the steps of the script `path` in a window of its own, and write a `film` of it, WebP or GIF. Time passes
    only while the display is up to date, so that slow machines make the same film. Raises GffeError."""
    director = Director(path, steps, film is not None)
    app = App(model, on_frame=director)
    app.clock = director.clock
    app.run(size or SIZE, test=lambda app: None)
    if director.problem:
        raise GffeError(director.problem)
    if film is not None:
        _write_film(film, director.frames)


class Director:
    """Director of a script, called once per frame of the interface: does the next step when the last one is on the
    screen, and closes the window after the last; `frames` are those of the film."""

    def __init__(self, script: Path, steps: list[Step], film: bool):
        self._script, self._steps, self._film = script, list(steps), film
        self._checked = False
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
        model = app.model
        without_pointer()
        if self.problem is not None or self._is_stuck(model):
            app.close()
            return
        self._still = self._still + 1 if model.settled and self._taken else 0
        if self._still < _STILL_FRAMES:
            return
        self._still, self._patience = 0, None
        if self._until_done and _works_beside(model):
            self._time += 1 / RATE
            return
        if not self._checked:
            self._check(app)
        self._until_done = False
        if self._waits:
            self._waits -= 1
            self._time += 1 / RATE
            if self._film:
                self._take(app, self.frames.append)
        elif self._steps and self.problem is None:
            if self._film:  # at its own rate: none is left out
                model.playback.mode = EVERY_FRAME
            self._do(app, self._steps.pop(0))
        else:
            app.close()

    def _is_stuck(self, model: Model) -> bool:
        now = time.monotonic()
        self._patience = self._patience or now + PATIENCE
        self.problem = model.failure or (
            f"{self._script}: not done after {PATIENCE:.0f} s" if now > self._patience else None
        )
        return self.problem is not None

    def _take(self, app: App, use: Callable[[np.ndarray], object]) -> None:
        self._taken = False

        def taken(pixels: np.ndarray) -> None:
            use(pixels)
            self._taken = True

        app.capture(taken)

    def _check(self, app: App) -> None:
        self._checked = True
        try:
            check(app, self._script, self._steps)
        except GffeError as error:
            self.problem = str(error)

    def _do(self, app: App, step: Step) -> None:
        try:
            if step.command == "wait" and step.value == DONE:
                self._until_done = True
            elif step.command == "wait":
                self._waits = max(round(step.value * RATE), 1)
            elif step.command == "shot":
                self._shoot(app, step.value)
            else:
                perform(app, step.command, step.value)
        except GffeError as error:
            self.problem = f"{self._script}, line {step.line}: {error}"

    def _shoot(self, app: App, path: Path) -> None:
        def save(pixels: np.ndarray) -> None:
            try:
                save_png(path, pixels)
            except GffeError as error:
                self.problem = str(error)

        self._take(app, save)


def _works_beside(model: Model) -> bool:
    """Return whether frames are being measured, the doctor examines the sequence, or something is being saved."""
    examines = model.doctor is not None and not model.doctor.done
    return model.survey.busy or model.studies.busy or model.saving.work is not None or examines


def require_film(path: Path) -> None:
    """Raise GffeError if a film cannot be written to `path`."""
    if path.suffix.lower() not in FILMS:
        raise GffeError(f"{path}: a film's name must end in {' or '.join(FILMS)}")
    if not path.absolute().parent.is_dir():
        raise GffeError(f"{path}: cannot write: no such folder")


def _write_film(path: Path, frames: list[np.ndarray]) -> None:
    from PIL import Image

    from gffe_cl.engine.core.files import replacing

    if not frames:
        raise GffeError(f"{path}: nothing was filmed (expected a script that waits)")
    images = [Image.fromarray(np.ascontiguousarray(frame)) for frame in frames]
    how = {"quality": 55, "method": 4, "minimize_size": True} if path.suffix.lower() == ".webp" else {"optimize": True}
    with replacing(path) as part:
        images[0].save(
            part, path.suffix[1:].upper(), save_all=True, append_images=images[1:], duration=round(1000 / RATE), loop=0,
            **how,
        )  # fmt: skip
