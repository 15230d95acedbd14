"""The open document: the engine with its source, the store of slots, and what is wanted of both ahead."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from gffe_cl.captures.sequence import FrameEntry, Sequence
from gffe_cl.captures.sequence.reader import uneven_intervals
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from ..engine.engine import Engine, open_viewer_device
from ..engine.jobs import Jobs
from ..engine.messages import Key, Recipe
from ..engine.sources.opening import ScenePlan, make_source
from ..engine.sources.source import FrameSource
from ..engine.store import Playhead, Store, Want
from ..picture.current_frame import Contents
from .playback import MOST_GENERATED, Playback

if TYPE_CHECKING:
    from gffe_cl.captures.doctor import Finding

_WRONG_PLACE = "does not follow the frame before it"


class Doctor:
    """Diagnosis of a sequence (`gffe check`), on a thread of its own; nothing is found before it is `done`."""

    def __init__(self, sequence: Sequence):
        self._job = Jobs("doctor").run(_examined, sequence)

    @property
    def done(self) -> bool:
        return self._job.done()

    @property
    def problem(self) -> str:
        """Why the sequence could not be examined."""
        error = self._job.exception() if self.done else None
        return "" if error is None else str(error) if isinstance(error, GffeError) else repr(error)

    @property
    def findings(self) -> list[Finding]:
        """Faults first, then notes and what cannot be told."""
        return self._job.result().findings if self.done and not self.problem else []

    @property
    def converts(self) -> bool:
        """Whether a format to paste undoes all faults."""
        return bool(self.findings) and self._job.result().found is not None

    @property
    def marks(self) -> dict[int, str]:
        """Rendered frames that something is said of, with what."""
        if not self.findings:
            return {}
        from gffe_cl.captures.doctor.findings import UNKNOWN, AtFrame, TruthOfAnotherTime  # loaded by now

        alone = [one for one in self.findings if isinstance(one, AtFrame) and one.kind != UNKNOWN]
        truths = [one for one in self.findings if isinstance(one, TruthOfAnotherTime)]
        marks = {k: one.words() for one in truths for k in one.frames}
        return marks | {one.frame: _WRONG_PLACE for one in alone}


def _examined(sequence: Sequence) -> Any:
    from gffe_cl.captures.doctor import examine

    return examine(sequence, sequence.exposure)


INVALID, REPEATED, UNEVEN, START = "invalid", "repeated", "uneven time", "reset or cut"
MISPLACED, ALONE = "doctor", "ground truth without a frame"
_REST = 3  # frames in a row with the camera before: of more the camera rests
_MOVES = 0.3  # pixels: half of the vectors are longer where the camera moves
_MOST_UNEVEN = 1 / 3  # share of frames, beyond which uneven times are usual


class Scan:
    """Faults of the rendered frames of a recorded source, found in idle time on a thread of its own.

    Attributes
    ----------
    done : int
        Frames that were looked at, from the first on.
    """

    def __init__(self, source: FrameSource, wake: Callable[[], object] = lambda: None):
        self._source: Any = source
        self._wake = wake  # at the end
        self._jobs = Jobs("scan")
        self._job: Future | None = None
        self._may_run = False
        self._before: RenderedFrame | None = None  # looked at last
        self._truth: tuple[FrameEntry, np.ndarray] | None = None  # read last
        self._found: dict[int, dict[str, str]] = {}
        self._copies: dict[int, str] = {}  # frames with the camera of those before, and what else they have of them
        self._marks: tuple[tuple[int, int], dict[int, dict[str, str]]] = ((-1, 0), {})  # and what they were made of
        self.done = 0

    def update(self, may_run: bool) -> None:
        """Go on while there is nothing else to do. Call once per frame of the interface."""
        self._may_run = may_run
        if may_run and self.busy and (self._job is None or self._job.done()):
            self._job = self._jobs.run(self._run)

    @property
    def busy(self) -> bool:
        """Whether frames are left to look at."""
        return self.done < self._source.count

    def close(self) -> None:
        self._may_run = False
        self._jobs.close()

    @property
    def marks(self) -> dict[int, dict[str, str]]:
        """Faults by rendered frame and kind, in words, as far as they are known."""
        known = self.done, self._source.count
        if known != self._marks[0]:
            self._marks = known, self._made()
        return self._marks[1]

    def _made(self) -> dict[int, dict[str, str]]:
        found = {k: dict(kinds) for k, kinds in self._found.copy().items()}
        runs: list[list[int]] = []
        for k in sorted(self._copies):
            runs[-1].append(k) if runs and runs[-1][-1] == k - 1 else runs.append([k])
        for k in (k for run in runs if len(run) <= _REST for k in run):
            found[k] = {REPEATED: self._copies[k]} | found.get(k, {})
        for k, text in _uneven(self._source.sequence.rendered).items():
            found.setdefault(k, {})[UNEVEN] = text
        for k, text in ({} if self.busy else _alone(self._source)).items():
            found.setdefault(k, {})[ALONE] = text
        return found

    def _run(self) -> None:
        while self._may_run and self.busy:
            k, entry = self.done, self._source.sequence.rendered[self.done]
            try:
                frame = self._source.sequence.read(entry)
                kinds = self._kinds(k, frame, self._before if k and not entry.reset else None)
                again = self._truth_again(k)
                kinds |= {REPEATED: f"{kinds[REPEATED]}; {again}" if REPEATED in kinds else again} if again else {}
            except GffeError as error:
                frame, kinds = None, {INVALID: str(error)}
            self._found |= {k: kinds} if kinds else {}
            self._before, self.done = frame, k + 1
        self._wake()

    def _kinds(self, k: int, frame: RenderedFrame, before: RenderedFrame | None) -> dict[str, str]:
        bad = replace(frame.bad, clamped=0, far=0)
        kinds = {INVALID: str(bad)} if bad else {}
        if before is None:
            return kinds
        pairs = {name: (getattr(frame, name), getattr(before, name)) for name in ("color", "depth", "motion")}
        both = {name: pair for name, pair in pairs.items() if all(array is not None for array in pair)}
        same = [name for name, pair in both.items() if np.array_equal(*pair, equal_nan=True)]
        if frame.camera != before.camera and same:
            kinds[REPEATED] = f"{', '.join(same)} of the frame before, to the bit, although the camera moves"
        elif frame.camera == before.camera and {"color", "depth"} <= set(same):
            self._copies[k] = "repeats the frame before, with its camera"
        elif frame.camera == before.camera and frame.motion is not None:
            lengths = np.linalg.norm(np.nan_to_num(frame.motion[::4, ::4]), axis=-1)
            if np.median(lengths) > _MOVES:
                self._copies[k] = "camera of the frame before, although vectors move"
        return kinds

    def _truth_again(self, k: int) -> str:
        """Return which ground truth from frame `k` to the next equals that before it, although the camera moves, in
        words; empty if none does."""
        sequence, again = self._source.sequence, []
        here, *following = sequence.rendered[k : k + 2]
        beside, until = (following[0], following[0].time) if following else (sequence.rendered[k - 1], np.inf)
        for truth in (one for one in sequence.ground_truth if here.time <= one.time < until):
            known, self._truth = self._truth, (truth, sequence.read_color(truth))
            if known and beside.render_camera != here.render_camera and np.array_equal(known[1], self._truth[1]):
                again.append(f"ground truth {truth.file} equals {known[0].file}, although the camera moves")
        return "; ".join(again)


def _uneven(entries: list[FrameEntry]) -> dict[int, str]:
    """Return rendered frames that do not come at the usual interval, in words; none where that is usual."""
    steps, usual = uneven_intervals(entries)
    texts = {
        k: f"{1e3 * step:.1f} ms after the frame before, usually {1e3 * usual:.1f} ms" for k, step in steps.items()
    }
    return texts if len(texts) <= _MOST_UNEVEN * len(entries) else {}


def _alone(source: Any) -> dict[int, str]:
    """Return rendered frames after which ground truth is of a time that no generated frame has, in words."""
    sequence, times = source.sequence, [entry.time for entry in source.sequence.rendered]
    alphas = {j / (n + 1) for n in range(1, MOST_GENERATED + 1) for j in range(n + 1)}
    slots = (source.time(k, alpha) for k in range(len(times)) for alpha in alphas)
    shown = {entry.file for time in slots if (entry := sequence.at("ground_truth", time)) is not None}
    alone = (entry for entry in sequence.ground_truth if entry.file not in shown)
    return {max(bisect_right(times, one.time) - 1, 0): f"{one.file}, {one.time:.4f} s" for one in alone}


class Document:
    """The open sequence or scene, one at a time.

    Attributes
    ----------
    engine, store : Engine, Store
    contents : Contents
        Of the picture; `source` is the open FrameSource, or None.
    ahead : Ahead
    plan : ScenePlan
        For built-in scenes.
    notice, failure, reload_fault : str, str or None, str
        What is being opened, or why it cannot be; why the requested picture is not there; why the open source could not
        be read again.
    keep_place : bool
        The source that is being opened is the present one, read again.
    doctor : Doctor or None
        Of the open source, once requested.
    scan : Scan or None
        Of a recorded source.
    """

    def __init__(self, playback: Playback, device: str | None, plan: ScenePlan, check: bool, cache_mib: int):
        self.plan, self._check = plan, check
        self.store = Store(cache_mib << 20)
        self.engine = Engine(partial(open_viewer_device, device), self.store)
        self.contents = Contents()
        self.ahead = Ahead(self.store, playback)
        self.failure: str | None = None
        self.notice = self.reload_fault = self.target = ""
        self.keep_place = False
        self.doctor: Doctor | None = None
        self.scan: Scan | None = None

    @property
    def source(self) -> Any:
        return self.contents.source

    def open(self, target: str, window: str | None) -> None:
        """Open a folder with a sequence, or the built-in scene of that name with a rendering `window`, in the
        background."""
        self.failure, self.notice = None, f"opening {target} …"
        self.engine.open_source(partial(make_source, target, window, self.plan, check=self._check))

    def take(self, source: FrameSource) -> None:
        """Take over a source that is open by now."""
        self.contents.open(source)
        self.notice, self.reload_fault, self.target = "", "", source.target
        self.ahead.forget()
        self.close()
        self.doctor, self.scan = None, None if source.live else Scan(source, lambda: self.engine.wake())

    def close(self) -> None:
        """Stop looking at its frames."""
        if self.scan is not None:
            self.scan.close()

    def fail(self, error: str, of_source: bool) -> None:
        """Note a failure of anything but a picture."""
        self.failure, self.notice = error, error if self.source is None else ""
        if of_source and self.keep_place:
            self.reload_fault = error
        self.keep_place = False

    def times(self, count: int) -> list[float] | None:
        """Return the times of `count` rendered frames in seconds; None in a built-in scene."""
        return None if self.source.live else [self.source.time(k) for k in range(count)]

    @property
    def warnings(self) -> list[str]:
        """Warnings about the open source and the displayed frame."""
        result = self.contents.result
        return [*self.source.suspicions, *(result.warnings if result is not None else ())] if self.source else []

    @property
    def marks(self) -> dict[int, str]:
        """Rendered frames with findings of the doctor."""
        return self.doctor.marks if self.doctor is not None else {}

    @property
    def faults(self) -> dict[int, dict[str, str]]:
        """Rendered frames that are marked on the timeline, in order: by kind, what is said of them."""
        found = {k: dict(kinds) for k, kinds in (self.scan.marks if self.scan is not None else {}).items()}
        resets = {} if self.source is None else self.contents.resets
        for kind, marks in ((START, resets), (MISPLACED, self.marks)):
            for k, text in marks.items():
                found.setdefault(k, {})[kind] = text
        return dict(sorted(found.items()))

    def states(self, build: str) -> list[str]:
        """Return what keeps the picture from being that of the files on disk, as long as it does; `build`: the kernels
        in use."""
        found = []
        if self.engine.build_error:
            found.append(f"kernels on disk do not build: build {build} is shown")
        if self.reload_fault:
            found.append(f"reading it again failed: {self.reload_fault}. The earlier version is shown")
        if self.source is not None and self.source.changed_on_disk:
            found.append("files on disk have changed: Ctrl+R reads them again")
        return found


_STILL = 0.3  # seconds that a still picture must have stood
_PLANNED = 16  # slots that are wanted ahead at once


class Ahead:
    """Slots that are made for the cache while nothing else is to be done.

    Attributes
    ----------
    cached : frozenset of int
        The slots that are there as the picture needs them.
    waits : bool
        For the picture to have stood long enough.
    """

    def __init__(self, store: Store, playback: Playback):
        self._store, self._playback = store, playback
        self.cached: frozenset[int] = frozenset()
        self._seen = self._planned = None
        self._since, self.waits = 0.0, False
        self._wants: list[Want] = []

    def forget(self) -> None:
        """Drop everything after a change of the source."""
        self.cached, self._seen, self._planned, self._wants = frozenset(), None, None, []

    def wants(self, now: float, picture: Want, others: set[Recipe], nbytes: int, may_run: bool) -> list[Want]:
        """Return the slots to make in advance, the next one first. Call once per frame of the interface. `picture`: the
        one on screen, whose slots take `nbytes` each; `others`: recipes of what else is on screen; `may_run`: whether
        computation in advance is allowed."""
        store, playback, recipe = self._store, self._playback, picture.key.recipe
        if not store.most:
            return []
        playhead = Playhead(picture.key.slot, playback.first, playback.last)
        seen = recipe, picture.layers, playhead, frozenset(others)
        if seen != self._seen:
            store.use({recipe, *others}, playhead)
            self._seen, self._since, self._planned = seen, now, None
        due = may_run and (playback.playing or now - self._since > _STILL)
        self.waits = may_run and not due
        if (store.changes, due) != self._planned:
            self._planned = store.changes, due
            self.cached = store.slots(recipe, picture.layers)
            self._wants = self._plan(picture, playhead, nbytes) if due else []
        return self._wants

    def _plan(self, picture: Want, playhead: Playhead, nbytes: int) -> list[Want]:
        length = playhead.last - playhead.first + 1
        start = min(max(playhead.slot, playhead.first), playhead.last) - playhead.first
        ahead = (playhead.first + (start + i) % length for i in range(min(length, self._store.room(nbytes))))
        missing = islice((slot for slot in ahead if slot not in self.cached), _PLANNED)
        return [Want(Key(picture.key.recipe, slot), picture.layers, hold=False) for slot in missing]
