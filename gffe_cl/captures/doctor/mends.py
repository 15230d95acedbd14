"""Mends: faults that another order of buffers or other jitter explains. A mended clip is examined again, as if it had
been recorded so."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from typing import Protocol

import numpy as np

from gffe_cl.captures.doctor.findings import JITTER, NO_JITTER, Finding, finding, finding_id
from gffe_cl.captures.doctor.hypotheses.camera_jitter import (
    INVERSE,
    NONE,
    OTHERS,
    SAME,
    JitterChange,
    jitter_center,
    jitter_of_colors,
    jitter_of_vectors,
)
from gffe_cl.captures.doctor.hypotheses.edges import edge_agreement
from gffe_cl.captures.doctor.hypotheses.sampling import BUFFERS, NEXT, PREVIOUS, Clip, Look, relinked, with_rows
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search, Verdict
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_KEPT = 4  # frames in memory as they are given
_FIELDS = {"camera": ("camera",), "depth": ("depth", "deep"), "color": ("color", "contrast", "image")}
_WHEN = {NEXT: "one frame late", PREVIOUS: "one frame early"}
_MARGIN = 0.06  # of the sum of scores, by which buffers of another frame must fit better
_FITS = 0.5  # agreement of buffers that fit
_MOST = 0.6  # of the frames that must fit better
_OWN = {"camera": 0.06, "depth": 0.02, "color": 0.02}  # of the agreement, or of color scores
_APART = 0.03  # of the sum of scores: mends that differ by less are not told apart
_FAR_APART, _COLORS = 0.15, 0.0025  # of the sum of scores, and of color scores, where vectors are an alternative
_FEWEST_COLORS = 2  # frames that tell whether colors are another frame's
_STEADY = 0.04  # of agreements, by which vectors and cameras of another frame fit worse where nothing accelerates


class Mend(Protocol):
    """Change of a clip that explains a fault: of the list of frames, and of each frame."""

    @property
    def finding(self) -> Finding: ...

    @property
    def changes_geometry(self) -> bool:
        """Whether it changes depth, motion vectors or cameras."""
        ...

    def entry(self, entries: list[FrameEntry], k: int) -> FrameEntry | None:
        """Return the entry of frame `k`, changed; None if the frame is lost."""
        ...

    def frame(self, frame: RenderedFrame, read, k: int) -> RenderedFrame:
        """Return frame `k`, changed; `read` returns a frame as it was given by its number."""
        ...


@dataclass(frozen=True)
class OtherFrame:
    """The `buffer`, or the camera, of each frame is in the file of another one, `by` frames after it."""

    buffer: str
    by: int

    @property
    def changes_geometry(self) -> bool:
        return self.buffer != "color"

    @property
    def finding(self) -> Finding:
        return finding(f"{self.buffer}: {_WHEN[self.by]}")

    def entry(self, entries: list[FrameEntry], k: int) -> FrameEntry | None:
        at = k + self.by
        if not 0 <= at < len(entries) or entries[max(k, at)].reset:
            return None
        first = k == 0 or self.entry(entries, k - 1) is None
        made = replace(entries[k], reset=entries[k].reset or first)
        if self.buffer != "camera":
            return made
        return replace(made, render_camera=entries[at].render_camera, display_camera=entries[at].display_camera)

    def frame(self, frame: RenderedFrame, read, k: int) -> RenderedFrame:
        other = read(k + self.by)
        if self.buffer == "camera":
            return replace(frame, camera=other.camera, display_camera=other.display_camera)
        image = getattr(other, self.buffer)
        return replace(frame, **{self.buffer: image}) if np.shape(image)[:2] == np.shape(frame.depth) else frame


@dataclass(frozen=True)
class JitterMend:
    """Jitter of the cameras that motion vectors have not, or otherwise: `finding`, and the `change` that mends it."""

    finding: Finding
    change: JitterChange
    changes_geometry: bool = True

    def entry(self, entries: list[FrameEntry], k: int) -> FrameEntry | None:
        camera, shown = entries[k].render_camera, entries[k].display_camera
        changed = camera and self.change.changed(camera)
        return replace(entries[k], render_camera=changed, display_camera=changed if shown == camera else shown)

    def frame(self, frame: RenderedFrame, read, k: int) -> RenderedFrame:
        motion, camera = frame.motion, self.change.changed(frame.camera)
        if k and not frame.reset and motion is not None:
            motion = (motion + self.change.added(frame.camera, read(k - 1).camera)).astype(np.float32)
        shown = camera if frame.display_camera == frame.camera else frame.display_camera
        return replace(frame, motion=motion, camera=camera, display_camera=shown)


@dataclass
class Mends:
    """Result of `find_mend`. `mend`: the change that explains the looks clearly better; `findings`: what cannot be told
    of buffers of another frame; `steady`: NEXT and PREVIOUS, as far as cameras or vectors that are
    late or early by a frame would fit about as well, because everything moves steadily; `open`: the id of a fault of
    vectors that cannot be told from one of the `findings`, "" for none."""

    mend: Mend | None = None
    findings: list[Finding] = field(default_factory=list)
    steady: set[int] = field(default_factory=set)
    open: str = ""


def find_mend(looks: dict[int, Look], deep: list[int], entries: list[FrameEntry], step: float) -> Mends:
    """Return the mend that explains `looks` clearly better than as they are given. `deep`: numbers of looks that are
    evidence; `entries`: of all rendered frames; `step`: of quantized vectors, pixels."""
    deep = [k for k in deep if PREVIOUS in looks[k].neighbors]
    if not deep:
        return Mends()
    found = _other_frame(looks, deep, step)
    center = jitter_center(entries, looks[deep[0]].size)
    if found.mend is None and center is not None:
        found.mend = _jitter(looks, deep, center, step)
    return found


def _other_frame(looks: dict[int, Look], deep: list[int], step: float) -> Mends:
    """Return the buffer that fits clearly better as that of another frame, better also than vectors of another frame
    and than any buffer upside down."""
    found = Mends()

    @cache
    def given(compared: tuple[int, ...]) -> Verdict:
        return _verdict([looks[k] for k in compared], step)

    def gain_of(made: dict[int, Look], compared: list[int]) -> _Gain | None:
        there = (k for k in compared if all(k in some and PREVIOUS in some[k].neighbors for some in (looks, made)))
        return _Gain.of(given, made, tuple(there), step)

    vectors: dict[str, _Gain] = {}  # of another frame, by when
    gains: dict[OtherFrame, _Gain] = {}
    for buffer in (*_FIELDS, "motion"):
        for by, compared in ((NEXT, deep), (PREVIOUS, [k + 1 for k in deep])):
            if buffer == "color" and len(compared) < _FEWEST_COLORS:
                continue
            gain = gain_of(_from_other_frames(looks, buffer, by), compared)
            if gain is None:
                continue
            if buffer in ("camera", "motion") and gain.agreement > -_STEADY:
                found.steady.add(by)
            if buffer == "motion":
                vectors[_WHEN[by]] = gain
            elif gain.is_clear and gain.own(buffer) >= _OWN[buffer]:
                gains[OtherFrame(buffer, by)] = gain
    first, *others = sorted(gains, key=lambda mend: gains[mend].total, reverse=True) if gains else (None,)
    if first is None:
        return found
    upside_down = [gain_of(with_rows(looks, (buffer,)), deep) for buffer in BUFFERS]
    if any(gain is not None and gain.against(gains[first]) >= 0 for gain in upside_down):
        return found
    against = {when: gain.against(gains[first]) for when, gain in vectors.items()}
    if 1 in against.values():
        return found
    if 0 in against.values():
        when = next(when for when, better in against.items() if better == 0)
        found.open = finding_id("motion", when)
        buffer = first.finding.sentence.partition(":")[0]
        found.findings.append(finding("frames: of another frame/vectors", buffer=buffer, when=when))
    elif others and gains[others[0]].total > gains[first].total - _APART:
        either = " or ".join(f"{mend.buffer} {mend.finding.name}" for mend in (first, others[0]))
        found.findings.append(finding("frames: of another frame", either=either))
    else:
        found.mend = first
    return found


@dataclass
class _Gain:
    """Gain of scores by which changed looks are better than as given: in `total`, in `agreement`, and in `color`s.
    `is_clear`: whether the looks fit now, clearly better, and most of them do so alone."""

    total: float
    agreement: float
    color: float
    is_clear: bool

    @classmethod
    def of(cls, given, made: dict[int, Look], compared: tuple[int, ...], step: float) -> _Gain | None:
        """Compare the looks `compared` of `made`; return None if there are none. `given` returns the verdict on looks
        as they are given."""
        if not compared:
            return None
        before, after = given(compared), _verdict([made[k] for k in compared], step)
        total = after.total - before.total
        clear = after.agreement >= _FITS and total >= _MARGIN
        if clear:
            each = [_verdict([made[k]], step).total > given((k,)).total for k in compared]
            clear = np.mean(each) > _MOST
        color = (after.colors - after.edges) - (before.colors - before.edges)
        agreement = float(np.nan_to_num(after.agreement) - np.nan_to_num(before.agreement))
        return cls(total, agreement, color, bool(clear))

    def against(self, other: _Gain) -> int:
        """Return 1 if this explains the looks better than `other`, −1 if it does not, and 0 if colors do not tell. They
        follow right vectors, and cameras of another frame may fit wrong ones."""
        if not self.is_clear or self.total < other.total - _FAR_APART:
            return -1
        if self.total > other.total + _FAR_APART or self.color > other.color + _COLORS:
            return 1
        return 0 if self.color > other.color - _COLORS else -1

    def own(self, buffer: str) -> float:
        """Return the part that this buffer must improve for itself."""
        return self.color if buffer == "color" else self.agreement


def _verdict(looks: list[Look], step: float) -> Verdict:
    return Search(looks, step, edges=edge_agreement(looks)).verdict(Reading())


def _jitter(looks: dict[int, Look], deep: list[int], center: np.ndarray, step: float) -> Mend | None:
    """Return the mend of jitter that cameras, vectors and colors do not share."""
    vectors = jitter_of_vectors(looks, deep, center, step)
    colors = jitter_of_colors(looks, deep, center, vectors)
    middle = float(center[0]), float(center[1])
    if vectors == SAME:
        if colors != NONE:
            return None
        fault = finding("camera: jitter not removed/color")
        return JitterMend(fault, JitterChange(middle, camera=NONE, motion=(-1.0, -1.0)))
    difference = OTHERS[vectors]
    if colors == SAME:
        fault = finding(f"motion: {NO_JITTER if vectors == NONE else f'jitter {difference}'}")
        return JitterMend(fault, JitterChange(middle, motion=(1 - vectors[0], 1 - vectors[1])))
    if colors == vectors:
        fault = finding(f"camera: {JITTER if vectors == NONE else f'jitter {INVERSE[difference]}'}")
    else:
        known = "colors are not jittered" if colors == NONE else "colors do not tell which of them is right"
        fault = finding("camera: jitter differs/known", change=difference, colors=known)
    return JitterMend(fault, JitterChange(middle, camera=vectors))


def _from_other_frames(looks: dict[int, Look], buffer: str, by: int) -> dict[int, Look]:
    """Return `looks` with the `buffer` of the look `by` after each; those that have none are left out."""
    made = {}
    for k, look in looks.items():
        other = look.neighbors.get(by)
        if other is not None and len(other.px) == len(look.px):
            fields = _FIELDS.get(buffer, (buffer,))
            made[k] = replace(look, neighbors={}, **{name: getattr(other, name) for name in fields})
    return relinked(made)


class MendedClip:
    """Clip with a mend applied."""

    def __init__(self, clip: Clip, mend: Mend):
        entries = clip.rendered
        self._mend = mend
        self._numbers = {entry.file: k for k, entry in enumerate(entries)}
        self._read = lru_cache(_KEPT)(lambda k: clip.read(entries[k]))
        self.settings = getattr(clip, "settings", None)
        made = [mend.entry(entries, k) for k in range(len(entries))]
        self.rendered = [entry for entry in made if entry is not None]

    def read(self, entry: FrameEntry) -> RenderedFrame:
        k = self._numbers[entry.file]
        return replace(self._mend.frame(self._read(k), self._read, k), reset=entry.reset)


def mended(clip: Clip, mends: Iterable[Mend]) -> Clip:
    """Return `clip` with `mends` applied, the first one first."""
    for mend in mends:
        clip = MendedClip(clip, mend)
    return clip
