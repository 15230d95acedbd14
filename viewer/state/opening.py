"""Opening: sequences and scenes, one at a time; and messages to the user."""

from __future__ import annotations

from functools import partial
from typing import Any

from gffe_cl.engine.options import Options
from ..engine.engine import Engine, open_viewer_device
from ..engine.sources.opening import Preview, Previewer, ScenePlan, make_source, preview_of
from ..engine.store import Store
from ..picture.current_frame import Contents
from .captions import Message
from .parameters import Parameters
from .playback import Playback


class Opening:
    """The engine with what it has open, and what is said about it. The model is a subclass.

    Attributes
    ----------
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
        self.preview: Preview | None = None
        self.previewer: Previewer | None = None
        self.failure: str | None = None  # why the requested picture is not there
        self.notice = self.reload_fault = self._target = ""
        self.keep_place = False
        self.messages: list[Message] = []

    @property
    def source(self) -> Any:
        """Return the open FrameSource, or None."""
        return self.contents.source

    def open(self, target: str) -> None:
        """Open a folder with a sequence, or the built-in scene of that name, in the background; `update` notices when
        it is open."""
        self.failure = None
        self.notice = f"opening {target} …"
        self.previewer = preview_of(target) if self.source is None else None
        make = partial(
            make_source, target, self.parameters.window, self.plan, check=self._check, previewer=self.previewer
        )
        self.engine.open_source(make)

    def reload(self) -> None:
        """Open the present source again, and stay at the same slot."""
        self.keep_place = True
        self.open(self._target)

    def times(self, count: int) -> list[float] | None:
        """Return the times of `count` rendered frames in seconds; None in a built-in scene."""
        return None if self.source.live else [self.source.time(k) for k in range(count)]

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
