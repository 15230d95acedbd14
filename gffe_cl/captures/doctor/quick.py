"""Quick form of the doctor: one sentence on frames in memory, or on the first frames of a sequence."""

from __future__ import annotations

from dataclasses import replace

from gffe_cl.captures.doctor.diagnose import Diagnosis, examine
from gffe_cl.captures.doctor.findings import NOTE, UNKNOWN
from gffe_cl.captures.doctor.samples import Clip
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.engine_form import described_frame
from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.core.validation import QUIETLY, require_array, require_exposure, require_kind, require_list
from gffe_cl.engine.frame.frame_format import FrameFormat, jitter_in_color, require_render_size
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, described_arrays, host_arrays, require_consecutive

_FRAMES = 5  # of a sequence, before it is extrapolated
_TOLD = ("motion-dilated", "repeated-pixels")  # notes that this form names, too


@QUIETLY
def check(frames: list[RenderedFrame], exposure: float = 1.0, format: FrameFormat | None = None) -> str | None:
    """Return a sentence if rendered frames in memory do not fit, or cannot be compared, else None: motion vectors with
    depth and cameras, and both with colors. It names the fields of `FrameFormat` to change, also where motion vectors
    are dilated or geometry is repeated, and examines the frames as `gffe check` does.

        assert gffe.check([first, second, third]) is None

    `frames` are in order of time, with NumPy arrays. `exposure` is the factor on colors before display. `format`
    describes the arrays where they differ from our conventions. Raises GffeError for anything that is no such frame.
    """
    frames = require_list(frames, RenderedFrame, "check: frames", "a list of RenderedFrame")
    require_consecutive(frames)
    if format is not None:
        require_kind(format, FrameFormat, "check: format", "a FrameFormat or None")
    given = frames
    if format is not None or any(frame.geometry_size for frame in frames):
        frames = _converted(frames, format or FrameFormat())
    exposure = require_exposure(exposure)
    if not frames:
        return None
    diagnosis = examine(_InMemory(frames, given, format), exposure)
    if warning := warning_of(diagnosis):
        return f"{warning}; `gffe check FOLDER` tells more, of frames stored with gffe.SequenceWriter"
    return None


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
    """Clip of frames in memory, converted from those that were `given`."""

    def __init__(self, frames: list[RenderedFrame], given: list[RenderedFrame], format: FrameFormat | None):
        for frame in frames:
            host_arrays(frame)
        self._frames, self.format = {f"frame {k}": frame for k, frame in enumerate(frames)}, format
        self.rendered = [
            FrameEntry(
                name,
                frame.time,
                reset=frame.reset,
                render_camera=frame.camera,
                display_camera=frame.display_camera,
                geometry_jitter=frame.geometry_jitter,
                geometry_size=frame.geometry_size,
            )
            for name, frame in zip(self._frames, given, strict=True)
        ]

    def read(self, entry: FrameEntry) -> RenderedFrame:
        return self._frames[entry.file]


class _First:
    """The first frames of `clip`."""

    def __init__(self, clip: Clip):
        self.rendered, self.read, self.format = clip.rendered[:_FRAMES], clip.read, clip.format


def quick_warning(clip: Clip, exposure: float = 1.0) -> str | None:
    """Return a sentence if the first rendered frames of `clip` do not fit, else None: their faults as `gffe check`
    names them, or the first of some of its notes. Raises GffeError if a frame cannot be read."""
    if not clip.rendered:
        return None
    diagnosis = examine(_First(clip), exposure)
    return warning_of(diagnosis) if diagnosis.given is not None or diagnosis.faults else None


def warning_of(diagnosis: Diagnosis) -> str | None:
    """Return the faults of `diagnosis` in a sentence, or else the first of some notes, or why nothing was compared;
    None if there is nothing to say."""
    faults = [str(one) for one in diagnosis.faults]
    if faults:
        return printable("; ".join(faults))
    told = [one for one in diagnosis.findings if one.kind == NOTE and one.name in _TOLD]
    if told:
        return str(told[0])
    doubts = [one for one in diagnosis.findings if one.kind == UNKNOWN]
    if diagnosis.given is None:
        return f"cannot tell whether the frames fit: {doubts[0].words()}" if doubts else None
    return None
