"""The doctor's diagnosis in three passes (`gffe check`): facts of frames, changes of conventions, order of frames; and
its quick form, one sentence on frames in memory or on the first frames of a sequence."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gffe_cl.captures.doctor.facts import (
    LEADS_OUT,
    color_rows,
    dilation,
    display_values,
    facts_of_samples,
    precision,
    quantization,
    repeated_pixels,
)
from gffe_cl.captures.doctor.findings import (
    FAULT,
    NOTE,
    UNKNOWN,
    AtFrame,
    Finding,
    FormatChange,
    InvalidPixels,
    NeverWritten,
    NothingBefore,
    NothingUsable,
    RepeatedFrames,
    StillCamera,
)
from gffe_cl.captures.doctor.found_format import FoundFormat
from gffe_cl.captures.doctor.order import (
    breaks,
    color_of_another_frame,
    needless_resets,
    repeated_frames,
    truth_of_another_time,
    uneven_times,
)
from gffe_cl.captures.doctor.readings import GIVEN, PREVIOUS, Clip, Look, Reading, take_looks
from gffe_cl.captures.doctor.search import Outcome, Search, Verdict
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.engine_form import described_frame
from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.core.validation import QUIETLY, require_array, require_exposure, require_kind, require_list
from gffe_cl.engine.frame.frame_format import FrameFormat, jitter_in_color, require_render_size
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, described_arrays, host_arrays, require_consecutive

_DEEP = 5  # frames that are looked at closely, with those before and after them
_MOVES, _JUMPS = 0.1, 10.0  # of the camera's usual movement: frames with less are still, with more they are cuts
_SAMPLES = 2500  # of each frame
_MOST_READ, _MOST_PIXELS = 40, 80_000_000  # frames and pixels that are read, whichever is more
_LOOKED_AT = 3  # whole frames
_VISIBLE = 0.3  # least motion by the camera's rotation and by its translation, pixels


@dataclass
class Diagnosis:
    """Result of a diagnosis.

    `findings`: faults, notes, and what cannot be told; `found`: the format to paste, None unless all faults are changes
    that it undoes; `given`, `read`: verdicts on the frames as given and as read with that format, None where nothing
    was compared; `frames`: number of examined frames.
    """

    findings: list[Finding]
    found: FoundFormat | None = None
    given: Verdict | None = None
    read: Verdict | None = None
    frames: int = 0
    looks: dict[int, Look] = field(default_factory=dict, repr=False)

    @property
    def faults(self) -> list[Finding]:
        return [one for one in self.findings if one.kind == FAULT]

    @property
    def verdict(self) -> str:
        """Verdict in one word: "faults", "fits", or "unknown" where nothing was compared."""
        return "faults" if self.faults else "fits" if self.given is not None and self.given.fits else "unknown"

    def as_json(self) -> dict:
        """Return all results for programs."""
        residuals = {}
        for name, one in (("given", self.given), ("read", self.read)):
            if one is not None:
                residuals[name] = {"median": one.median, "share": one.share, "agreement": one.agreement}
        return {
            "verdict": self.verdict,
            "findings": [one.as_json() for one in self.findings],
            "format": self.found and self.found.to_json(),
            "residuals": residuals,
            "frames": self.frames,
        }


@QUIETLY
def examine(clip: Clip, exposure: float = 1.0) -> Diagnosis:
    """Examine the rendered frames of `clip` and return the diagnosis. Raises GffeError if it has none, or if a file
    cannot be read."""
    diagnosis = _examine(clip, exposure)
    diagnosis.findings += uneven_times(clip, {one.frame for one in diagnosis.findings if isinstance(one, AtFrame)})
    declared = clip.format or FrameFormat()
    diagnosis.findings = [one.within(declared) for one in diagnosis.findings]
    diagnosis.findings.sort(key=lambda one: (one.kind != FAULT, one.kind == UNKNOWN))
    changes = [one for one in diagnosis.findings if one.is_a_change]
    if changes and all(fault in changes for fault in diagnosis.faults):
        diagnosis.found = FoundFormat.of(changes, declared)
    return diagnosis


def _examine(clip: Clip, exposure: float) -> Diagnosis:
    entries = clip.rendered
    count, deep = len(entries), _deep_frames(entries)
    beside = {k for index in deep for k in (index - 1, index, index + 1) if 0 <= k < count}
    looks = take_looks(clip, beside | set(_spread(clip)), _SAMPLES, beside, exposure)
    facts = facts_of_samples(list(looks.values()), clip.format or FrameFormat())
    found = Diagnosis(facts, frames=len(looks), looks=looks)
    if found.faults:
        return found
    repeated = repeated_frames(looks)
    found.findings += [*needless_resets(looks), *repeated]
    twice = {k for one in repeated if isinstance(one, RepeatedFrames) for k in one.frames}
    deep = [k for k in deep if PREVIOUS in looks[k].neighbors and k not in twice]
    if not deep:
        found.findings += [] if found.faults else [NothingBefore()]
        return found
    closely = [looks[k] for k in deep]
    step = quantization(closely)
    undilated = clip.format is not None and clip.format.motion_dilated
    search = Search(looks, deep, step, undilated)
    outcome = search.explain()
    if not step and outcome.findings and (step := quantization(closely, 2)):
        search = Search(looks, deep, step, undilated)
        given = search.verdict(GIVEN)
        step, outcome = (step, Outcome([], GIVEN, given, given)) if given.fits else (0.0, outcome)
    lost = next((one for one in found.findings if isinstance(one, NeverWritten) and one.is_most), None)
    if lost:  # its vectors were taken for zero
        if outcome.reading.motion.camera != "movers_only":
            return Diagnosis([*found.findings, NothingUsable("motion", 1 - lost.share, LEADS_OUT)], frames=len(looks))
        found.findings.remove(lost)
        outcome.findings = [FormatChange("camera_motion", {"camera_motion": "movers_only"} | lost.fields)]
    found.findings += precision(closely, exposure, step)
    found.findings += outcome.findings
    found.given, found.read = outcome.given, outcome.read
    if outcome.reading.motion.camera != "included":  # by colors, not by residuals
        found.read = found.given
    if outcome.reading.depth != GIVEN.depth:
        found.findings = _without_depth(found.findings)
    is_read = not any(one.kind == FAULT and not one.is_a_change for one in outcome.findings)
    if is_read:
        if not outcome.reading.offset[1] and not twice:
            found.findings += color_of_another_frame(search, outcome.read)
        found.findings += breaks(clip, looks, outcome.reading, step, twice, exposure, _SAMPLES)
        found.findings += _unknown(search, outcome.reading)
        if outcome.reading.motion == GIVEN.motion:
            blamed = {k for one in found.findings for k in getattr(one, "frames", ())}
            blamed |= {one.frame for one in found.findings if isinstance(one, AtFrame)}
            found.findings += truth_of_another_time(clip, looks, blamed)
    found.findings += [*color_rows(closely), *display_values(closely)]
    whole = [clip.read(entries[k]) for k in deep[:_LOOKED_AT]]
    found.findings += repeated_pixels(whole)
    if not outcome.findings and outcome.given.fits:
        found.findings += dilation(whole)
    return found


def _without_depth(findings: list[Finding]) -> list[Finding]:
    """Return `findings` without invalid depths, which are valid by another law."""
    made = [
        replace(one, counts=replace(one.counts, depth=0)) if isinstance(one, InvalidPixels) else one for one in findings
    ]
    return [one for one in made if not isinstance(one, InvalidPixels) or one.counts]


def _unknown(search: Search, reading: Reading) -> list[Finding]:
    """Return what a static or only turning camera leaves open."""
    bench = search.bench(reading.rows, reading.offset)
    reach = bench.reach(reading.cameras, PREVIOUS)
    turns = reach.pixels(np.zeros(len(bench.px))) - bench.px
    with np.errstate(invalid="ignore"):
        moved = np.linalg.norm(bench.static(reading.cameras, reading.depth) - turns, axis=-1)
    turned = np.linalg.norm(turns, axis=-1)
    use = bench.solid & np.isfinite(moved) & np.isfinite(turned)
    if not use.any() or np.quantile(moved[use], 0.9) >= _VISIBLE:
        return []
    return [StillCamera(bool(np.quantile(turned[use], 0.9) >= _VISIBLE))]


def _deep_frames(entries: list[FrameEntry]) -> list[int]:
    """Return frames that can be evidence, evenly spread: the camera moves before them, and it does not jump."""
    if len(entries) < 3:
        return list(range(len(entries)))
    inner = [k for k in range(1, len(entries) - 1) if not entries[k].reset] or [1]
    telling = [k for k, moves in zip(inner, _camera_moves(entries, inner), strict=True) if moves]
    chosen = _some(telling, _DEEP)
    return sorted(chosen + _some([k for k in inner if k not in telling], _DEEP - len(chosen)))


def _some(indices: list[int], most: int) -> list[int]:
    if len(indices) <= most:
        return indices
    return [indices[k - 1] for k in sorted(set(np.linspace(1, len(indices), most).round().astype(int).tolist()))]


def _camera_moves(entries: list[FrameEntry], indices: list[int]) -> np.ndarray:
    """Return (indices,) bool: whether the camera moves before the frame, and not so far that it must be a cut."""
    moved = np.zeros((len(indices), 2))  # how far it turns, and how far it goes
    for row, k in enumerate(indices):
        before, here = entries[k - 1].render_camera, entries[k].render_camera
        if before is not None and here is not None:
            step = here.world_to_view @ np.linalg.inv(before.world_to_view)
            moved[row] = np.linalg.norm(step[:3, :3] - np.eye(3)), np.linalg.norm(step[:3, 3])
    usual = [np.quantile(part[part > 0], 0.9, method="lower") if part.any() else np.inf for part in moved.T]
    least, most = np.multiply(_MOVES, usual), np.multiply(_JUMPS, usual)
    return np.logical_and((moved >= least).any(-1), (moved <= most).all(-1))


def _spread(clip: Clip) -> list[int]:
    """Return the numbers of all frames, or of runs of frames in long sequences."""
    entries = clip.rendered
    count = len(entries)
    pixels = int(np.size(clip.read(entries[0]).depth)) if entries else 1
    if count <= max(_MOST_READ, _MOST_PIXELS // pixels):
        return list(range(count))
    starts = np.linspace(0, count - 4, _MOST_READ // 4).astype(int)
    return sorted({int(start) + k for start in starts for k in range(4)})


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
