"""Watch over captures that are being written while they are looked at."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError

_AT_ONCE = 256  # files that are looked at in one turn
_DESCRIPTIONS = ("sequence.json", "cameras.json")


class Growth:
    """Detects changes of the capture at `place`. `look` is called repeatedly from one thread."""

    def __init__(self, place: Path):
        self.place = place
        self._known = self._seen = state_of_capture(place)

    def look(self) -> Sequence | None:
        """Return the reopened capture if it has changed since it was opened and not since the last look, so that no
        writer is in the middle of something. If it cannot be opened, the next look tries again."""
        before, self._seen = self._seen, state_of_capture(self.place)
        if self._seen == self._known or self._seen != before:
            return None
        try:
            sequence = open_capture(self.place)
        except GffeError:
            return None
        self._known = self._seen
        return sequence


class Rewritten:
    """Detects files that were written again, or removed, since they were first given here. `look` is called repeatedly
    from one thread."""

    def __init__(self) -> None:
        self._states: dict[Path, tuple[int, int] | None] = {}
        self._next = 0
        self.found = False

    def watch(self, files: Iterable[Path]) -> None:
        """Watch these files, too."""
        for path in files:
            if path not in self._states:
                self._states[path] = _state_of(path)

    def look(self) -> bool:
        """Look at some files, in turn. Returns whether any has changed so far."""
        files = list(self._states)
        turn = [files[(self._next + i) % len(files)] for i in range(min(len(files), _AT_ONCE))]
        self._next += len(turn)
        known = ((self._states[path], path) for path in turn)
        self.found |= any(before is not None and _state_of(path) != before for before, path in known)
        return self.found


def _state_of(path: Path) -> tuple[int, int] | None:
    """Return time of change (nanoseconds) and size (bytes) of a file or folder; None if it is missing."""
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_mtime_ns, state.st_size


def state_of_capture(place: Path) -> list[tuple[int, int] | None]:
    """Return time of change (nanoseconds) and size (bytes) of the capture's folder and of the files that describe it;
    None for missing ones. `place`: the folder, or a file in it."""
    folder = place if place.is_dir() else place.parent
    return [_state_of(path) for path in (folder, *(folder / name for name in _DESCRIPTIONS))]


def continues(sequence: Sequence, longer: Sequence) -> bool:
    """Return whether `longer` is `sequence` with more rendered frames after those that it has."""
    count = len(sequence.rendered)
    same = (sequence.width, sequence.height, sequence.fps, sequence.exposure) == (
        longer.width, longer.height, longer.fps, longer.exposure,
    )  # fmt: skip
    return same and len(longer.rendered) > count and longer.rendered[:count] == sequence.rendered
