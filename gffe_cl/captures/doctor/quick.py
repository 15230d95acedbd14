"""Quick form of the doctor: whether the first frames fit at all, before they are extrapolated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gffe_cl.captures.doctor.dilation import dilation_notes
from gffe_cl.captures.doctor.evidence import set_aside_unwritten, too_few_usable
from gffe_cl.captures.doctor.findings import FAULT, faults_of
from gffe_cl.captures.doctor.hypotheses.cameras import camera_readings
from gffe_cl.captures.doctor.hypotheses.edges import edge_agreement
from gffe_cl.captures.doctor.hypotheses.motions import motion_readings
from gffe_cl.captures.doctor.hypotheses.sampling import BUFFERS, PREVIOUS, Clip, Look, take_looks, with_rows
from gffe_cl.captures.doctor.hypotheses.scoring import Bench, frame_offsets, mostly_nothing, moving, trimmed
from gffe_cl.captures.doctor.hypotheses.search import EDIT, Reading, Search
from gffe_cl.captures.doctor.quantization import largest_step, motion_steps
from gffe_cl.captures.doctor.user_interface import user_interface_notes
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.described import described_frame
from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.core.validation import QUIETLY, require_array, require_exposure, require_kind, require_list
from gffe_cl.engine.frame.frame_format import FrameFormat, jitter_in_color, require_render_size
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, checked_frame, described_arrays, host_arrays

_FRAMES = 3
_SAMPLES = 800  # of each frame
_FITS = 0.45  # share of samples that agree: movers may be the rest
_AGREES = 0.1  # of the motion's length
_LEAST = 0.75  # pixels: residuals that do no harm
_COLORS = 0.1  # of color scores, by which no motion at all must fit better
_TURNED = 0.15  # of the share of samples and the color score, by which buffers must fit better upside down
_FEWEST = 64  # least number of samples with distinctive colors
_LIKELY, _LIKELIER = 0.5, 0.2  # least agreement of a cause that is named, and by how much it must be better
_JITTER = 0.15, 1.6  # pixels: least and largest common offset of a frame's vectors that is jitter
_ALIKE = 0.1  # of scores: a likely cause with about the score of turned buffers is the simpler explanation
_GIVEN = Reading()
_JITTERED = "motion vectors are off by another part of a pixel in every frame"
_STEADY = 0.25  # of that offset: most that other residuals are
_UPSIDE_DOWN = {(buffer,): f"{buffer} is upside down against the other buffers" for buffer in BUFFERS} | {
    BUFFERS: "y of motion vectors and cameras does not fit the rows of the buffers",
}


@dataclass
class _Fit:
    """Fit of a reading. `off` (N,): residuals in pixels; `share` of those that agree; `along`, `still`: color scores
    along the vectors and without any motion, NaN without evidence; `edges`: agreement of colors with depth at
    silhouettes."""

    off: np.ndarray
    share: float
    along: float
    still: float
    edges: float

    @property
    def score(self) -> float:
        return self.share + float(np.nan_to_num(self.along)) + self.edges


@QUIETLY
def check(frames: list[RenderedFrame], exposure: float = 1.0, format: FrameFormat | None = None) -> str | None:
    """Return a sentence if rendered frames in memory do not fit, else None: motion vectors and depth with cameras,
    motion vectors and colors, camera jitter in the vectors, or a buffer that is upside down; or if the color contains a
    user interface, or motion vectors are dilated. It names the likely cause where a single buffer is misread. This is
    the quick form of `gffe check`: only the first three frames are examined.

        assert gffe.check([first, second, third]) is None

    `frames` are in order of time, with NumPy arrays. `exposure` is the factor on colors before display. `format`
    describes the arrays where they differ from our conventions. Raises GffeError for anything that is no such frame.
    """
    frames = require_list(frames, RenderedFrame, "check: frames", "a list of RenderedFrame")[:_FRAMES]
    if format is not None:
        require_kind(format, FrameFormat, "check: format", "a FrameFormat or None")
    if format is not None or any(frame.geometry_size for frame in frames):
        frames = _converted(frames, format or FrameFormat())
    warning = quick_warning(_InMemory(frames), require_exposure(exposure))
    return warning and f"{warning}; `gffe check FOLDER` tells more, of frames stored with gffe.SequenceWriter"


def _converted(frames: list[RenderedFrame], format: FrameFormat) -> list[RenderedFrame]:
    """Return the frames in our conventions. Raises GffeError for arrays that cannot be described."""
    made, before, jitter = [], None, (0.0, 0.0)  # the jitter of the frame before, in pixels of color
    for frame in frames:
        frame = checked_frame(frame)
        height, width = require_array(frame.color, "frame: color", None, None, (3, 4)).shape[:2]
        size = width, height
        geometry = require_render_size(format, size, frame.geometry_size)
        arrays = described_arrays(frame, size, geometry)
        stored = replace(frame, color=arrays.color[..., :3], depth=arrays.depth, motion=arrays.motion)
        previous = None if frame.reset else before
        made.append(described_frame(stored, format, previous and previous.camera, jitter if previous else (0.0, 0.0)))
        before, jitter = frame, jitter_in_color(frame.geometry_jitter, size, geometry)
    return made


class _InMemory:
    """Clip of frames in memory."""

    def __init__(self, frames: list[RenderedFrame]):
        for frame in frames:
            host_arrays(frame)
        self._frames = {f"frame {k}": frame for k, frame in enumerate(frames)}
        self.rendered = [FrameEntry(name, frame.time, reset=frame.reset) for name, frame in self._frames.items()]

    def read(self, entry: FrameEntry) -> RenderedFrame:
        return self._frames[entry.file]


@QUIETLY
def quick_warning(clip: Clip, exposure: float = 1.0) -> str | None:
    """Return a sentence if the first rendered frames of `clip` do not fit, else None: motion vectors and depth with
    cameras, motion vectors and colors, or a buffer that is upside down; or if the color contains a user interface, or
    motion vectors are dilated. Raises GffeError if a frame cannot be read."""
    count = min(_FRAMES, len(clip.rendered))
    if not count:
        return None
    looks = take_looks(clip, range(count), _SAMPLES, set(range(count - 1)), exposure)
    set_aside_unwritten(looks.values())
    for finding in too_few_usable(looks.values()):
        if finding.kind == FAULT:
            return str(finding)
    if count < 2:
        return None
    edges = edge_agreement([looks[0]])
    given = _fit(looks, edges)
    if given is None:
        return None
    turned = {}
    for rows in _UPSIDE_DOWN:
        fit = _fit(with_rows(looks, rows), edges if len(rows) > 1 or "motion" in rows else -edges)
        assert fit is not None  # as there is one of the same frames as given
        turned[rows] = fit.score
    best = max(turned, key=turned.__getitem__)
    is_turned = turned[best] > given.score + _TURNED
    cause, score = _likely_cause(looks, edges) if is_turned or given.share < _FITS else ("", 0.0)
    if is_turned and not (cause and score > turned[best] - _ALIKE):
        return _UPSIDE_DOWN[best]
    if is_turned or given.share < _FITS:
        likely = f", most likely {cause}" if cause else ""
        return f"motion vectors do not fit depth and cameras (median {np.median(given.off):.3g} px){likely}"
    if _has_jitter(looks):
        return f"{_JITTERED}: camera jitter is in them, or in the cameras, alone"
    if given.still > given.along + _COLORS:
        return "motion vectors do not fit the colors"
    notes = user_interface_notes(clip, [1], exposure)
    if notes:
        return notes[0].sentence
    return next((f"motion vectors are {note.sentence}" for note in dilation_notes(clip, [*range(1, count)])), None)


def _likely_cause(looks: dict[int, Look], edges: float) -> tuple[str, float]:
    """Return the findings of the simplest reading of one buffer with which vectors, depth and cameras agree, and its
    score. If there is none, return with score 0 that vectors lack the camera's part, or ""."""
    search = Search([look for look in looks.values() if look.neighbors])
    bench = search.full

    def agreement(reading: Reading) -> float:
        motion, static = search.motions(replace(reading, jitter=""), bench)
        agrees = search.agreement(bench, motion, static, reading.jitter)
        return float(np.nan_to_num(agrees)) - EDIT * reading.edits

    best = max(_single_causes(search), key=agreement)
    if not agreement(best) > max(_LIKELY, agreement(Reading()) + _LIKELIER):
        motion, static = (np.linalg.norm(np.nan_to_num(part), axis=-1) for part in search.motions(Reading(), bench))
        seen = bench.solid & (static > _LEAST)
        if not seen.any() or not mostly_nothing(motion[seen]):
            return "", 0.0
        return ("motion without the camera" if motion.any() else "motion zero"), 0.0
    found, fit = faults_of(best, bench.stored[bench.solid]), _fit(looks, edges, best)
    words = f"{found[0].about} {', '.join(finding.name for finding in found)}" if found else ""
    return printable(words), fit.score if fit else 0.0


def _single_causes(search: Search) -> Iterator[Reading]:
    """Yield readings that differ from the given one in motion vectors, in cameras, or in depth."""
    yield from (Reading(motion) for motion in motion_readings())
    yield Reading(jitter="motion")
    for camera in camera_readings():
        yield from (Reading(camera=one) for one in (camera, camera.opposite()))
    yield from (one for one in search.fitted(search.full, Reading()) if one.depth.has_meaning)


def _has_jitter(looks: dict[int, Look]) -> bool:
    """Return whether the vectors of every frame are off by a constant of its own, and by hardly anything else."""
    pairs = [look for look in looks.values() if PREVIOUS in look.neighbors and look.motion is not None]
    bench, least = Bench(pairs), max(_JITTER[0], largest_step(motion_steps(pairs)))
    motion, static = Search.motions(Reading(), bench)
    off = motion - static
    offsets = frame_offsets(bench, off, bench.solid)
    size, rest = np.linalg.norm(offsets, axis=-1), np.linalg.norm(off - offsets[bench.frame], axis=-1)
    medians = [np.nanmedian(rest[part]) if part.any() else np.inf for part in bench.parts(bench.solid)]
    apart = len(size) > 1 and np.linalg.norm(offsets[0] - offsets[1]) > least
    return bool(apart and (size > least).all() and (size < _JITTER[1]).all() and (medians < _STEADY * size).all())


def _fit(looks: dict[int, Look], edges: float, reading: Reading = _GIVEN) -> _Fit | None:
    """Return the fit of `reading`, None if there is nothing to compare."""
    step_to = reading.motion.step
    pairs = [look for look in looks.values() if step_to in look.neighbors and look.motion is not None]
    if not pairs:
        return None
    bench = Bench(pairs)
    motion, static = Search.motions(reading, bench)
    use = bench.solid & np.isfinite(motion).all(-1)
    off = np.nan_to_num(np.linalg.norm(motion - static, axis=-1)[use], nan=np.inf)
    if len(off) < 16:
        return None
    length, step = float(np.median(np.linalg.norm(motion[use], axis=-1))), largest_step(motion_steps(pairs))
    near = max(_AGREES * length, _LEAST, step)
    scores = bench.color_scores(np.stack([motion, np.zeros_like(motion)]), step_to)
    telling = np.isfinite(scores).all(0) & moving(motion) & (np.linalg.norm(np.nan_to_num(motion), axis=-1) > 1)
    along = still = float("nan")
    if telling.sum() >= _FEWEST:
        along, still = (trimmed(bench.by_frame(score, telling)) for score in scores)
    return _Fit(off, float((off <= near).mean()), along, still, edges)
