"""What is told to the user: notes, errors, and titles of scripts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Message:
    """Something to tell, of a kind: "note", "error", or "title" of a script; `since`: when it was shown first, seconds
    of the clock that playback goes by; `dismissed`: the user took it away from over the picture."""

    text: str
    kind: str
    since: float | None = None
    dismissed: bool = False

    @property
    def error(self) -> bool:
        return self.kind == "error"
