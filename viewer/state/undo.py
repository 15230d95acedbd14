"""Undo of settings: the options and windows that were in use before."""

from __future__ import annotations

from gffe_cl.engine.options import Options
from .parameters import Parameters
from .playback import Playback

_MOST = 100
_TOGETHER = 0.5  # seconds: changes that follow each other faster are one, such as those of a slider
_State = tuple[Options, str | None, int]


class Undo:
    """Settings before and after the present ones."""

    def __init__(self, parameters: Parameters, playback: Playback):
        self._parameters, self._playback = parameters, playback
        self.done: list[_State] = []
        self.undone: list[_State] = []
        self._now = self._state
        self._changed_at = 0.0

    @property
    def _state(self) -> _State:
        return self._parameters.options, self._parameters.window, self._playback.n

    def forget(self) -> None:
        """Begin with the present settings."""
        self.done, self.undone, self._now = [], [], self._state

    def update(self, now: float) -> None:
        """Note changes. Call once per frame of the interface; `now` in seconds."""
        if (state := self._state) == self._now:
            return
        if not self.done or now - self._changed_at > _TOGETHER:
            self.done = [*self.done, self._now][-_MOST:]
        self.undone, self._now, self._changed_at = [], state, now

    def undo(self) -> None:
        """Go back to the settings before the last change."""
        self._go(self.done, self.undone)

    def redo(self) -> None:
        """Take the change back that was undone last."""
        self._go(self.undone, self.done)

    def _go(self, there: list[_State], here: list[_State]) -> None:
        if there:
            here.append(self._now)
            options, window, n = self._now = there.pop()
            self._parameters.take(options, window)
            self._playback.n = n
            self._now, self._changed_at = self._state, 0.0
