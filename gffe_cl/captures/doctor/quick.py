"""Quick form of the doctor: one sentence on frames in memory, or on the first frames of a sequence."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

from gffe_cl.captures.doctor.diagnose import Diagnosis, examine
from gffe_cl.captures.doctor.findings import (
    BOTTOM_UP,
    DILATED,
    INTERFACE,
    JITTER,
    NO_JITTER,
    NOTE,
    OTHER_FRAME,
    REPEATED,
    UNEXPLAINED,
    UNKNOWN,
    WARNING,
    Finding,
)
from gffe_cl.captures.doctor.hypotheses.sampling import Clip
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.engine_form import described_frame
from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.core.validation import QUIETLY, require_array, require_exposure, require_kind, require_list
from gffe_cl.engine.frame.frame_format import FrameFormat, jitter_in_color, require_render_size
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, described_arrays, host_arrays

_FRAMES = 5  # of a sequence, before it is extrapolated
_TOLD = ("cut off", INTERFACE, REPEATED, DILATED)  # notes that this form names, too
_DOUBTS = ("misfit at the end", "of another frame")  # the same, of what cannot be told
_SUBJECTS = {"motion": "motion vectors are ", "depth": "depth is "}
_UNKNOWN = "cannot tell whether the frames fit"
_ALL_ROWS = "y of motion vectors and cameras does not fit the rows of the buffers"
_JITTERED = "motion vectors are off by another part of a pixel in every frame: camera jitter"
_ALONE, _DIFFERS = "is in them, or in the cameras, alone", "in them and in the cameras differs"


@QUIETLY
def check(frames: list[RenderedFrame], exposure: float = 1.0, format: FrameFormat | None = None) -> str | None:
    """Return a sentence if rendered frames in memory do not fit, or cannot be compared, else None: motion vectors and
    depth with cameras, motion vectors and colors, jitter, or a buffer that is upside down; or if the color contains a
    user interface, motion vectors are dilated, or geometry is repeated. It examines the frames as
    `gffe check` does and names the same causes.

        assert gffe.check([first, second, third]) is None

    `frames` are in order of time, with NumPy arrays. `exposure` is the factor on colors before display. `format`
    describes the arrays where they differ from our conventions. Raises GffeError for anything that is no such frame.
    """
    frames = require_list(frames, RenderedFrame, "check: frames", "a list of RenderedFrame")
    if format is not None:
        require_kind(format, FrameFormat, "check: format", "a FrameFormat or None")
    if format is not None or any(frame.geometry_size for frame in frames):
        frames = _converted(frames, format or FrameFormat())
    exposure = require_exposure(exposure)
    if not frames:
        return None
    diagnosis = examine(_InMemory(frames), exposure)
    warning = warning_of(diagnosis) or _why_not_compared(diagnosis)
    return warning and f"{warning}; `gffe check FOLDER` tells more, of frames stored with gffe.SequenceWriter"


def _converted(frames: list[RenderedFrame], format: FrameFormat) -> list[RenderedFrame]:
    """Return the frames in our conventions. Raises GffeError for arrays that cannot be described."""
    made, before, jitter = [], None, (0.0, 0.0)  # the jitter of the frame before, in pixels of color
    for frame in frames:
        require_kind(frame, RenderedFrame, "frame")
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
        self.rendered = [
            FrameEntry(name, frame.time, "rendered", frame.reset, None, frame.camera, frame.display_camera)
            for name, frame in self._frames.items()
        ]

    def read(self, entry: FrameEntry) -> RenderedFrame:
        return self._frames[entry.file]


class _First:
    """The first frames of `clip`."""

    def __init__(self, clip: Clip):
        self.rendered, self.read = clip.rendered[:_FRAMES], clip.read


def first_diagnosis(clip: Clip, exposure: float = 1.0) -> Diagnosis:
    """Examine the first rendered frames of `clip` and return the diagnosis. Raises GffeError if there are none, or if
    one cannot be read."""
    return examine(_First(clip), exposure)


def quick_warning(clip: Clip, exposure: float = 1.0) -> str | None:
    """Return a sentence if the first rendered frames of `clip` do not fit, else None: their faults as `gffe check`
    names them, or the first of its warnings. Raises GffeError if a frame cannot be read."""
    return warning_of(first_diagnosis(clip, exposure)) if clip.rendered else None


def has_interface(diagnosis: Diagnosis) -> bool:
    """Return whether `diagnosis` has found a user interface in the color."""
    return any(finding.name == INTERFACE for finding in diagnosis.findings)


def warning_of(diagnosis: Diagnosis) -> str | None:
    """Return the faults of `diagnosis` in a sentence, or else the first of the warnings and notes about what games do
    to frames; None if there is neither."""
    faults = diagnosis.faults
    if not faults:
        told = diagnosis.of_kind(WARNING)
        told += [note for note in diagnosis.of_kind(NOTE) if note.name in _TOLD]
        doubts = [doubt for doubt in diagnosis.of_kind(UNKNOWN) if doubt.name in _DOUBTS]
        if told or not doubts:
            return _whole_sentence(told[0]) if told else None
        return f"{_UNKNOWN}: {doubts[0].sentence}"
    turned = [fault.about for fault in faults if fault.name == BOTTOM_UP]
    if len(turned) == len(faults):
        return _ALL_ROWS if len(turned) > 1 else f"{turned[0]} is upside down against the other buffers"
    causes = [fault for fault in faults if fault.about != "frames"]
    if not diagnosis.compared or not (causes or faults[0].name == UNEXPLAINED):
        return str(faults[0])
    if len(faults) == 1 and faults[0].name in OTHER_FRAME:
        return faults[0].sentence
    likely = f", most likely {_names(causes)}" if causes else ""
    if causes and all(fault.is_of_jitter for fault in causes):
        return f"{_JITTERED} {_ALONE if causes[0].name in (JITTER, NO_JITTER) else _DIFFERS}{likely}"
    # Vectors, depth and cameras are right here: the median is small.
    if causes and all(fault.about == "color" for fault in causes):
        return str(causes[0])
    median = diagnosis.residuals["given_median"]
    return f"motion vectors do not fit depth and cameras (median {median:.3g} px){likely}"


def _whole_sentence(note: Finding) -> str:
    """Return what a note says. Notes on repeated or dilated buffers leave out which buffer it is."""
    subject = _SUBJECTS.get(note.about, "") if note.name in (REPEATED, DILATED) else ""
    return f"{subject}{note.sentence}"


def _names(faults: list[Finding]) -> str:
    """Return the names of `faults` with what they are about: "motion negated, y flipped and depth device"."""
    groups = groupby(faults, key=lambda fault: fault.about)
    return printable(" and ".join(f"{about} {', '.join(fault.name for fault in group)}" for about, group in groups))


def _why_not_compared(diagnosis: Diagnosis) -> str | None:
    """Return why nothing was compared; None if something was."""
    if diagnosis.compared:
        return None
    return f"{_UNKNOWN}: {diagnosis.of_kind(UNKNOWN)[0].sentence}"
