"""Frames of a sequence on disk, read ahead; and watch over captures that are being written."""

from __future__ import annotations

import copy
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.captures.formats import open_capture
from gffe_cl.captures.offline.run import alphas_for
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.sequence import Sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from ..jobs import Jobs
from .source import CACHE_BYTES, FrameSource

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
                self._states[path] = state_of(path)

    def look(self) -> bool:
        """Look at some files, in turn. Returns whether any has changed so far."""
        files = list(self._states)
        turn = [files[(self._next + i) % len(files)] for i in range(min(len(files), _AT_ONCE))]
        self._next += len(turn)
        known = ((self._states[path], path) for path in turn)
        self.found |= any(before is not None and state_of(path) != before for before, path in known)
        return self.found


def state_of(path: Path) -> tuple[int, int] | None:
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
    return [state_of(path) for path in (folder, *(folder / name for name in _DESCRIPTIONS))]


def continues(sequence: Sequence, longer: Sequence) -> bool:
    """Return whether `longer` is `sequence` with more rendered frames after those that it has."""
    count = len(sequence.rendered)
    same = (sequence.width, sequence.height, sequence.fps, sequence.exposure) == (
        longer.width,
        longer.height,
        longer.fps,
        longer.exposure,
    )
    return same and len(longer.rendered) > count and longer.rendered[:count] == sequence.rendered


_AHEAD = 2  # frames read ahead


class RecordedSource(Recorded, FrameSource):
    """A sequence on disk, its decoded frames cached.

    `device` presents the display part for the window "off"; None is the window it was rendered through. `cache_bytes`:
    of decoded frames that are kept. Raises GffeError as `Recorded` does; for faults of a file when its frame is asked
    for.
    """

    def __init__(self, sequence: Sequence, device: Device, window: str | None = None, cache_bytes: int = CACHE_BYTES):
        self._rewritten = Rewritten()
        super().__init__(sequence, device, window)
        self.suspicions: list[str] = []
        self.check: Callable[[], str | None] | None = None  # finds a suspicion, on a thread of its own
        self.growth: Growth | None = None
        self._alphas = alphas_for(1)
        self._cache, self._is_sibling = _ReadAhead(cache_bytes), False

    def _take(self, sequence):
        super()._take(sequence)
        folder, entries = Path(sequence.path), (*sequence.rendered, *sequence.ground_truth)
        self._rewritten.watch(folder / entry.file for entry in entries)
        truths = sequence.ground_truth
        self._next_truth = dict(zip((entry.file for entry in truths), truths[1:], strict=False))
        self.has_truth = bool(truths)

    def sibling(self):
        other = copy.copy(self)
        other._is_sibling = True
        return other

    @property
    def nbytes(self):
        return 0 if self._is_sibling else self._cache.nbytes

    @property
    def changed_on_disk(self):
        return self._rewritten.found

    def grow(self):
        self._rewritten.look()
        sequence = self.growth and self.growth.look()
        if not sequence or not continues(self.sequence, sequence):
            return False
        self._take(sequence)
        return True

    def configure(self, window, n, scale=0.0):
        self._alphas = alphas_for(n)
        return self.choose(window)

    def look_closer(self):
        check, self.check = self.check, None
        if check is not None:
            Jobs("check").run(self._suspect, check)

    def _suspect(self, check):
        with suppress(GffeError):  # an unreadable frame: displaying it reports the error
            self.suspicions += filter(None, [check()])

    def rendered(self, k):
        make, read = super().rendered, super()._read
        made = self._cache.get(("shown", k), lambda: make(k)) if self._cut else make(k)
        following = [(k + i) % self.count for i in range(1, _AHEAD + 1)]
        self._cache.ahead("rendered", {("rendered", m): partial(read, m) for m in following})
        return made

    def stored(self, k):
        entry = self.entries[k]
        if self._cut or not (self.format or entry.geometry_size or any(entry.geometry_jitter)):
            return None
        return self._cache.get(("stored", k), lambda: self.sequence.read_stored(entry))

    def _read(self, k):
        return self._cache.get(("rendered", k), partial(super()._read, k))

    def camera(self, k, alpha):
        cameras = self.cameras_at([self.time(k, new) for new in self._alphas])
        return cameras and cameras[self._alphas.index(alpha)]

    def truth(self, k, alpha):
        entry = self.sequence.at("ground_truth", self.time(k, alpha))
        if entry is None:
            return None
        color = self._cache.get(("truth", entry.file), lambda: self.sequence.read_color(entry))
        following = self._next_truth.get(entry.file)
        ahead = {("truth", following.file): lambda: self.sequence.read_color(following)} if following else {}
        self._cache.ahead("truth", ahead)
        if color.shape[:2] != (self.height, self.width):
            raise GffeError(
                f"{entry.file}: {color.shape[1]}×{color.shape[0]} pixels, expected {self.width}×{self.height}"
            )
        return color

    def close(self):
        self._cache.close()


class _ReadAhead:
    """Results of reading, by (kind, …): the last `nbytes` of them are kept, some are read ahead on a thread."""

    def __init__(self, nbytes: int):
        self._most, self.nbytes = nbytes, 0
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._coming: dict[tuple, Future] = {}
        self._background = Jobs("read")

    def get(self, key: tuple, read: Callable[[], Any]) -> Any:
        """Return the stored or pending result, else that of `read`; raises its errors, and tries again next time."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        future = self._coming.pop(key, None)
        value = self._kept[key] = read() if future is None else future.result()
        self.nbytes += _nbytes(value)
        while self.nbytes > self._most and len(self._kept) > 1:
            self.nbytes -= _nbytes(self._kept.popitem(last=False)[1])
        return value

    def ahead(self, kind: str, wanted: dict[tuple, Callable[[], Any]]) -> None:
        """Read `wanted` next, and nothing else of this kind."""
        for key in [key for key in self._coming if key[0] == kind and key not in wanted]:
            self._coming.pop(key).cancel()
        for key, read in wanted.items():
            if key not in self._kept and key not in self._coming:
                self._coming[key] = self._background.run(read)

    def close(self) -> None:
        self._background.close()


def _nbytes(value: np.ndarray | RenderedFrame) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    return sum(array.nbytes for array in (value.color, value.depth, value.motion) if array is not None)
