"""Mends: faults that another order of buffers or other jitter explains. A mended clip is examined again, as if it had
been recorded so."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from gffe_cl.captures.doctor.findings import FAULT, JITTER, JITTER_DIFFERS, JITTERED, NO_JITTER, NOTE, Finding
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
_WHAT = {"camera": "cameras are", "depth": "depth is", "color": "color is"}
_WHEN = {NEXT: ("late", "before"), PREVIOUS: ("early", "after")}
_MARGIN = 0.06  # of the sum of scores, by which buffers of another frame must fit better
_FITS = 0.5  # agreement of buffers that fit
_MOST = 0.6  # of the frames that must fit better


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
        when, side = _WHEN[self.by]
        sentence = f"{_WHAT[self.buffer]} one frame {when}: each frame has that of the frame {side} it"
        lost = {NEXT: "the last frame, whose own one was not recorded, is", PREVIOUS: "the first frame is"}[self.by]
        fix = f"{self.buffer} is taken from the frame {_WHEN[-self.by][1]}; {lost} left out"
        return Finding(FAULT, self.buffer, f"one frame {when}", sentence, fix)

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
class Jitter:
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


def find_mend(
    looks: dict[int, Look], deep: list[int], entries: list[FrameEntry], step: float
) -> tuple[Mend | None, list[Finding]]:
    """Return the mend that explains `looks` clearly better than as they are given, None if there is none; and notes on
    jitter. `deep`: numbers of looks that are evidence; `entries`: of all rendered frames; `step`: of quantized vectors,
    pixels."""
    deep = [k for k in deep if PREVIOUS in looks[k].neighbors]
    mend = _other_frame(looks, deep, step)
    if mend is not None or not deep:
        return mend, []
    center = jitter_center(entries, looks[deep[0]].size)
    return (None, []) if center is None else _jitter(looks, deep, center, step)


def _other_frame(looks: dict[int, Look], deep: list[int], step: float) -> Mend | None:
    """Return the buffer that fits clearly better as that of another frame, better also than vectors of another frame
    and than any buffer upside down."""
    gains: dict[OtherFrame | None, float] = {None: _MARGIN}
    for buffer in (*_FIELDS, "motion"):
        for by, compared in ((NEXT, deep), (PREVIOUS, [k + 1 for k in deep])):
            gain = _gain(looks, _from_other_frames(looks, buffer, by), compared, step)
            mend = OtherFrame(buffer, by) if buffer in _FIELDS else None
            gains[mend] = max(gains.get(mend, 0.0), gain)
    for buffer in BUFFERS:
        gains[None] = max(gains[None], _gain(looks, with_rows(looks, (buffer,)), deep, step))
    return max(gains, key=gains.__getitem__)


def _gain(given: dict[int, Look], made: dict[int, Look], compared: list[int], step: float) -> float:
    """Return by how much the total score of the `compared` looks `made` is better than as `given`; 0 if that does not
    hold for most of them, or if they do not fit."""
    compared = [k for k in compared if all(k in looks and PREVIOUS in looks[k].neighbors for looks in (given, made))]
    if not compared:
        return 0.0
    before, after = (_verdict([looks[k] for k in compared], step) for looks in (given, made))
    gain = after.total - before.total
    if not after.agreement >= _FITS or gain < _MARGIN:
        return 0.0
    better = [_verdict([made[k]], step).total > _verdict([given[k]], step).total for k in compared]
    return gain if np.mean(better) > _MOST else 0.0


def _verdict(looks: list[Look], step: float) -> Verdict:
    return Search(looks, step, edges=edge_agreement(looks)).verdict(Reading())


def _jitter(
    looks: dict[int, Look], deep: list[int], center: np.ndarray, step: float
) -> tuple[Mend | None, list[Finding]]:
    """Return the mend of jitter that cameras, vectors and colors do not share, and a note where only colors lack it."""
    vectors = jitter_of_vectors(looks, deep, center, step)
    colors = jitter_of_colors(looks, deep, center, vectors)
    if vectors == SAME:
        sentence = (
            "jittered, as cameras and motion vectors are, and color is not: it was antialiased over time (the jitter"
            " belongs out of the cameras and the vectors and into RenderedFrame.geometry_jitter)"
        )
        return None, [Finding(NOTE, "depth", JITTERED, sentence)] if colors == NONE else []
    middle, difference = (float(center[0]), float(center[1])), OTHERS[vectors]
    if colors == SAME:
        name, has = NO_JITTER, "lack the jitter that cameras and colors have"
        if vectors != NONE:
            name, has = f"jitter {difference}", f"have jitter {difference}, compared with that of cameras and colors"
        finding = Finding(FAULT, "motion", name, f"motion vectors {has}", "the cameras' jitter is added")
        return Jitter(finding, JitterChange(middle, motion=(1 - vectors[0], 1 - vectors[1]))), []
    if colors == vectors:
        name, has = JITTER, "are jittered, but neither motion vectors nor colors are"
        if vectors != NONE:
            difference = INVERSE[difference]
            name, has = f"jitter {difference}", f"have jitter {difference}, compared with that of vectors and colors"
        finding = Finding(FAULT, "camera", name, f"the cameras {has}", "principal points are moved")
    else:
        known = "colors are not jittered" if colors == NONE else "colors do not tell which of them is right"
        sentence = f"the jitter of motion vectors is {difference}, compared with that of the cameras; {known}"
        finding = Finding(FAULT, "camera", JITTER_DIFFERS, sentence)
    return Jitter(finding, JitterChange(middle, camera=vectors)), []


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
