"""Opening: sequences, scenes and running programs, one at a time; and messages to the user."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from typing import Any

from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.options import Options
from ..engine.background import Background
from ..engine.engine import Engine, open_viewer_device
from ..engine.sources.attached import AttachedSource, FrozenSource
from ..engine.sources.opening import ScenePlan, make_source
from ..engine.sources.preview import Preview, Previewer, preview_of
from ..engine.sources.program import FRAMES, RunningProgram
from ..engine.store import Store
from ..picture.current_frame import Contents
from .captions import Message
from .parameters import Parameters
from .playback import Playback


class Opening:
    """The engine with what it has open, and what is said about it. The model is a subclass.

    Attributes
    ----------
    program : RunningProgram or None
        That was attached to.
    preview : Preview or None
        Shown until the opened source has a result.
    notice : str
        What is being opened, or why it cannot be.
    reload_fault : str
        Why the open source could not be read again.
    keep_place : bool
        The source that is being opened is the present one, read again.
    """

    def __init__(
        self, options: Options, n: int, window: str | None, device: str | None, plan: ScenePlan, check: bool,
        cache_mib: int,
    ):  # fmt: skip
        self.plan, self._check = plan, check
        self.store = Store(cache_mib << 20)
        self.engine = Engine(partial(open_viewer_device, device), self.store)
        self.contents = Contents()
        self.playback = Playback(n=n)
        self.parameters = Parameters(options, self.playback, window)
        self.program: RunningProgram | None = None
        self.preview: Preview | None = None
        self.previewer: Previewer | None = None
        self.failure: str | None = None  # why the requested picture is not there
        self.notice = self.reload_fault = self._target = ""
        self.keep_place = False
        self._background = Background("attach")
        self._attaching: Future[RunningProgram] | None = None  # the program to follow once it answers
        self.messages: list[Message] = []

    @property
    def source(self) -> Any:
        """Return the open FrameSource, or None."""
        return self.contents.source

    def open(self, target: str) -> None:
        """Open a folder with a sequence, or the built-in scene of that name, in the background; `update` notices when
        it is open."""
        self._stop_attaching()
        self.failure = None
        self.notice = f"opening {target} …"
        self.previewer = preview_of(target) if self.source is None else None
        make = partial(
            make_source, target, self.parameters.window, self.plan, check=self._check, previewer=self.previewer
        )
        self.engine.open_source(make)

    def attach_to(self, name: str, frames: int = FRAMES) -> None:
        """Look for the program attached as `name` in the background; `update` follows it once it answers, or tells why
        not."""
        self._stop_attaching()
        self._attaching = self._background.run(RunningProgram, name.strip(), frames)

    def _take_attached(self) -> None:
        """Follow the program that was looked for, if it has answered."""
        job = self._attaching
        if job is None or not job.done():
            return
        self._attaching = None
        if (error := job.exception()) is not None:
            self.say(str(error) if isinstance(error, GffeError) else f"{type(error).__name__}: {error}", error=True)
            return
        before, self.program = self.program, job.result()
        self.follow()
        if before is not None:
            before.close()

    def _stop_attaching(self) -> None:
        """Do without the program that is looked for."""
        job, self._attaching = self._attaching, None
        if job is not None and not job.cancel():
            job.add_done_callback(_close_program)

    def attach(self, name: str, frames: int = FRAMES) -> None:
        """Follow the running program attached as `name`, which keeps its last `frames` rendered frames. Raises
        GffeError if there is none."""
        self.program = RunningProgram(name, frames)
        self.follow()

    def follow(self) -> None:
        """Show the program live, with its pipeline's options. If it has ended, look for another one of its name."""
        program = self.program
        assert program is not None  # as `attach` was called
        if program.ended:
            self.attach_to(program.name, program.frames)
            return
        self._stop_attaching()
        self.notice = f"attaching to {program.name} …"
        self.engine.open_source(lambda device: AttachedSource(program))

    def freeze(self) -> None:
        """Show the program's last rendered frames as they are now."""
        program = self.program
        assert program is not None
        self._stop_attaching()
        self.engine.open_source(lambda device: FrozenSource(program, device))

    def recording(self) -> Sequence:
        """Return the program's last rendered frames: those that are frozen, else those up to now. Raises GffeError."""
        assert self.program is not None
        return self.source.sequence if self.frozen else self.program.recording()

    @property
    def follows(self) -> bool:
        """Whether a running program is displayed live."""
        return self.source is not None and self.source.follows

    @property
    def frozen(self) -> bool:
        """Whether a program's last frames are displayed."""
        return isinstance(self.source, FrozenSource)

    def reload(self) -> None:
        """Open the present source again, and stay at the same slot."""
        self.keep_place = True
        self.open(self._target)

    def times(self, count: int) -> list[float] | None:
        """Return the times of `count` rendered frames in seconds; None in a built-in scene, and while a running program
        is followed."""
        return None if self.source.live or self.follows else [self.source.time(k) for k in range(count)]

    def _failed_attached(self) -> None:
        """Go on with the options of a running program that has refused others, and with its last frames if it has
        ended."""
        if self.follows and (program := self.program) is not None:
            if program.ended:
                self.freeze()
            self.parameters.take(program.options, None)
            self.source.flight += 1

    # ---- telling -------------------------------------------------------------------------------------------

    def say(self, text: str, error: bool = False) -> None:
        self.messages = [*self.messages[-20:], Message(text, "error" if error else "note")]

    def lately(self, now: float, seconds: dict[str, float]) -> list[Message]:
        """Return the messages that were shown first at most `seconds` ago, which are given by their kind."""
        found = []
        for message in self.messages:
            message.since = now if message.since is None else message.since
            if now - message.since < seconds.get(message.kind, 0.0):
                found.append(message)
        return found

    def dismiss_messages(self) -> None:
        """Take all messages away that stand over the picture."""
        for message in self.messages:
            message.dismissed = True


def _close_program(job: Future[RunningProgram]) -> None:
    """Close a program that has answered in vain."""
    if job.exception() is None:
        job.result().close()
