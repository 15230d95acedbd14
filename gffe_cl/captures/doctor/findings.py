"""Findings of the doctor. Each kind is a dataclass; its sentence is made once, by `str`, and no program reads it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from gffe_cl.engine.core.errors import printable
from gffe_cl.engine.frame.conventions import DIRECTIONS
from gffe_cl.engine.frame.frame_format import SCALED_DEPTHS, VERTICALS, FrameFormat
from gffe_cl.engine.frame.rendered_frame import BadPixels

FAULT, NOTE, UNKNOWN = "fault", "note", "cannot tell"
_MOST_NAMED = 12


@dataclass(frozen=True)
class Finding:
    """One finding.

    `name`: stable name in the JSON; `kind`: FAULT (breaks results), NOTE (hurts little) or UNKNOWN; `about`: "color",
    "depth", "motion", "camera" or "frames". `fields` are those of a `FrameFormat`, `camera_keys` those of a found
    format's cameras, and `offsets` its frame offsets by buffer, with which the frames are as the pipeline expects them.
    """

    name: ClassVar[str]
    kind: ClassVar[str] = FAULT
    about: ClassVar[str] = "frames"
    sentence: ClassVar[str] = ""  # of `words`, with the finding's own figures

    @property
    def fields(self) -> dict[str, Any]:
        return {}

    @property
    def camera_keys(self) -> dict[str, Any]:
        return {}

    @property
    def offsets(self) -> dict[str, int]:
        return {}

    @property
    def is_a_change(self) -> bool:
        """Whether a format to paste undoes it."""
        return bool(self.fields or self.camera_keys or self.offsets)

    @property
    def places(self) -> dict[str, tuple[int, int, int]]:
        """Examples by name: a frame and a pixel (x, y) of its rendered image."""
        return {}

    def within(self, declared: FrameFormat) -> Finding:
        """Return this finding about frames that were converted from `declared`, so that its fields replace those."""
        return self

    @property
    def remedy(self) -> str:
        """The change alone: fields and keys with their values."""
        return _shown(self.fields | self.camera_keys | {f"{k} frame_offset": n for k, n in self.offsets.items()})

    def words(self) -> str:
        """Return the sentence without the buffer that it is about."""
        return self.sentence.format(self)

    def __str__(self) -> str:
        return printable(f"{self.about}: {self.words()}")

    def as_json(self) -> dict[str, Any]:
        figures = {key: value for key, value in asdict(self).items() if key != "found"}
        made = {"id": self.name, "kind": self.kind, "about": self.about, "sentence": str(self), "figures": figures}
        return made | {"fields": self.fields, "cameras": self.camera_keys, "frame_offset": self.offsets}


def _shown(fields: dict[str, Any]) -> str:
    return ", ".join(f"{name}={_value(value)}" for name, value in fields.items())


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(_value(one) for one in value)})"
    return f'"{value}"' if isinstance(value, str) else f"{value:.6g}" if isinstance(value, float) else str(value)


def frames_in_words(numbers: tuple[int, ...], one: str, many: str) -> str:
    """Return "frame 3 is" or "frames 3, 4 are", with the words for one or many of them."""
    named = ", ".join(map(str, numbers[:_MOST_NAMED])) + (" …" if len(numbers) > _MOST_NAMED else "")
    return f"frames {named} {many}" if len(numbers) > 1 else f"frame {named} {one}"


@dataclass(frozen=True)
class OfBuffer(Finding):
    """Finding about one `buffer`."""

    buffer: str

    @property
    def about(self) -> str:
        return self.buffer


@dataclass(frozen=True)
class AtFrame(Finding):
    """Finding about the rendered frame number `frame`, in `file`."""

    frame: int
    file: str


# ---- facts of one frame --------------------------------------------------------------------------------


@dataclass(frozen=True)
class NothingUsable(OfBuffer):
    """Too few values of a buffer can be compared: `share` of the pixels, because `why`."""

    name = "nothing-usable"
    sentence = "{0.share:.1%} of the pixels have a usable value ({0.why}): nothing can be compared"
    share: float
    why: str


@dataclass(frozen=True)
class InvalidPixels(Finding):
    """Numbers that no pixel can have; `found`: the first ones by kind."""

    name, kind = "bad-pixels", NOTE
    counts: BadPixels
    found: dict[str, tuple[str, int, int, int]] = field(default_factory=dict)

    @property
    def places(self) -> dict[str, tuple[int, int, int]]:
        return {what: (frame, x, y) for what, (_, frame, x, y) in self.found.items()}

    def words(self) -> str:
        first = "; ".join(f"{what} in {file} at {x}, {y}" for what, (file, _, x, y) in self.found.items())
        return f"{self.counts}; first: {first}"


@dataclass(frozen=True)
class NeverWritten(Finding):
    """Vectors that were never written: `share` of the pixels; `value`: the stored number of both components."""

    name, kind, about = "motion-never-written", NOTE, "motion"
    share: float
    value: float | None

    @property
    def fields(self) -> dict[str, Any]:
        return {} if self.value is None else {"motion_invalid": self.value}

    @property
    def is_most(self) -> bool:
        """Whether they are most vectors: the file may hold those of movers only."""
        return self.share > 0.5 and self.value is not None

    def words(self) -> str:
        what = f"; {_shown(self.fields)}" if self.fields else ""
        return f"{self.share:.2g} of the vectors were never written, they lead out of the image{what}"


@dataclass(frozen=True)
class DisplayValues(Finding):
    """Colors are display values: by `share` of `telling` silhouettes."""

    name, about = "color-encoding", "color"
    share: float
    telling: int

    @property
    def fields(self) -> dict[str, Any]:
        return {"color_encoding": "srgb"}

    def words(self) -> str:
        return f"{_shown(self.fields)}, as {self.share:.0%} of {self.telling} antialiased silhouettes mix sRGB values"


@dataclass(frozen=True)
class ColorUpsideDown(Finding):
    """Rows of the color run the other way than those of depth."""

    name, about = "color-rows", "color"
    sentence = "its rows run the other way than those of depth: one of both is upside down"


@dataclass(frozen=True)
class Quantized(Finding):
    """Vectors are multiples of `step` pixels."""

    name, kind, about = "motion-quantized", NOTE, "motion"
    sentence = "vectors are quantized in steps of {0.step:.3g} px: slow objects shake a little"
    step: float


@dataclass(frozen=True)
class FewBits(OfBuffer):
    """Depth or color of few bits."""

    name, kind = "few-bits", NOTE

    def words(self) -> str:
        half = "half floats, off by up to 1/2048 of itself"
        return half if self.buffer == "depth" else "8 bits, gradients show bands"


@dataclass(frozen=True)
class RepeatedPixels(OfBuffer):
    """A buffer was rendered in the size `width`, `height`, and its pixels repeated."""

    name, kind = "repeated-pixels", NOTE
    sentence = (
        "{0.width}×{0.height} different pixels are repeated (give them in the size they were"
        " rendered in, by geometry_size: about 0.8 dB)"
    )
    width: int
    height: int


@dataclass(frozen=True)
class Dilated(Finding):
    """Pixels beside a nearer surface have its vector: `share` of them."""

    name, kind, about = "motion-dilated", NOTE, "motion"
    share: float

    @property
    def fields(self) -> dict[str, Any]:
        return {"motion_dilated": True}

    def words(self) -> str:
        return f"{_shown(self.fields)}, as {self.share:.0%} of the pixels beside a nearer surface have its vector"


# ---- changes of conventions ----------------------------------------------------------------------------


@dataclass(frozen=True)
class FormatChange(Finding):
    """Fields of `FrameFormat` have other values than the frames were read with; none if no description can say it."""

    change: str
    changed: dict[str, Any]
    why: str = ""

    @property
    def name(self) -> str:
        return self.change.replace("_", "-")

    @property
    def about(self) -> str:
        return self.change.partition("_")[0] if self.change != "camera_motion" else "motion"

    @property
    def fields(self) -> dict[str, Any]:
        return self.changed

    def within(self, declared: FrameFormat) -> Finding:
        return replace(self, changed=_composed(declared, self.changed))

    def words(self) -> str:
        what = _shown(self.changed) or f"another {self.change} than its format says"
        return f"{what}{self.why}"


_TWO = {"motion_direction": tuple(DIRECTIONS), "motion_y": VERTICALS, "rows": VERTICALS}
_TWO["motion_jittered"] = False, True
_UNITS = {("uv", 0.5): "ndc", ("ndc", 2.0): "uv"}  # described unit and a factor that was found: the right one


def _composed(declared: FrameFormat, fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields to replace in `declared`, by which frames were converted before `fields` were found; none if
    there are no such ones."""
    name, value = next(iter(fields.items()))
    given = getattr(declared, name)
    if name in _TWO:
        return {name: _TWO[name][given == _TWO[name][0]]}
    if name == "motion_scale":
        if unit := _UNITS.get((declared.motion_unit, value[0])):
            return {"motion_unit": unit}
        made = {name: tuple(a * b for a, b in zip(given, value, strict=True))}
        offset = tuple(a * b for a, b in zip(declared.motion_offset, value, strict=True))
        return made | ({"motion_offset": offset} if any(offset) else {})
    if name == "depth_scale":
        if declared.depth in SCALED_DEPTHS:
            return {name: short(given * value)}
        planes = {plane: short(getattr(declared, plane) * value) for plane in ("near_z", "far_z")}
        return planes if declared.near_z else {}
    plain = FrameFormat()
    related = {"depth": ("depth", "near_z", "far_z", "depth_range", "depth_scale")}.get(name, tuple(fields))
    return fields if all(getattr(declared, one) == getattr(plain, one) for one in related) else {}


@dataclass(frozen=True)
class MotionToNext(Finding):
    """Vectors lead to the next frame."""

    name, about = "motion-to-next", "motion"
    sentence = (
        'vectors lead to the next frame (expected those to the previous one; "to_next": true of a folder of images'
        " converts them roughly)"
    )


@dataclass(frozen=True)
class CameraKey(Finding):
    """Cameras have another convention: `key` and `value` in the cameras of a found format."""

    name, about = "camera", "camera"
    key: str
    value: Any

    @property
    def camera_keys(self) -> dict[str, Any]:
        return {self.key: self.value}

    def words(self) -> str:
        words = {
            "convention": "the axes of its view are other ones",
            "matrix": "its matrices are inverted",
            "rotation": "its rotations are transposed, as of row vectors",
            "translation": "its matrices hold the position in place of the translation",
            "jitter": "its principal point has the jitter that color has not",
        }
        if self.key == "focal_scale":
            factor = 1 / self.value
            return f"focal_scale={self.value:.6g}, focal lengths are {abs(factor - 1):.1%} too {_long(factor)}"
        return f"{_shown(self.camera_keys)}, {words[self.key]}"


def _long(factor: float) -> str:
    return "long" if factor > 1 else "short"


@dataclass(frozen=True)
class OtherFrame(OfBuffer):
    """A buffer of each frame is in the file of the frame `by` frames after it."""

    name = "other-frame"
    by: int

    @property
    def offsets(self) -> dict[str, int]:
        return {self.buffer: self.by}

    def words(self) -> str:
        late = (
            "late, each frame has that of the frame before" if self.by > 0 else "early, each has that of the next one"
        )
        return f"frame_offset={self.by}, it is one frame {late}"


@dataclass(frozen=True)
class JitterDiffers(Finding):
    """Vectors and cameras differ by another part of a pixel in every frame: by `size` pixels."""

    name, about = "jitter", "camera"
    sentence = (
        "jitter differs between cameras and vectors by {0.size:.2g} px (expected both with the jitter of"
        " the color, or without it and RenderedFrame.geometry_jitter)"
    )
    size: float


@dataclass(frozen=True)
class Unexplained(Finding):
    """Vectors do not fit depth and cameras: their median residual is `pixels`; `share` of the samples agree."""

    name = "unexplained"
    sentence = (
        "motion vectors do not fit depth and cameras{0.where} (median {0.pixels:.3g} px,"
        " {0.share:.0%} agree): no known change explains it"
    )
    pixels: float
    share: float
    where: str = ""


@dataclass(frozen=True)
class Ambiguous(Finding):
    """Vectors do not fit depth and cameras, and several changes have the same evidence."""

    name = "ambiguous"
    pixels: float
    causes: tuple[str, ...]

    def words(self) -> str:
        return (
            f"motion vectors do not fit depth and cameras (median {self.pixels:.3g} px), and nothing tells whether"
            f" {' or '.join(self.causes)} is right"
        )


# ---- order of frames -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cut(AtFrame):
    """Frame `frame` does not follow the one before."""

    name = "cut"
    sentence = "cut at frame {0.frame} ({0.file}): it does not follow the frame before (expected reset)"


@dataclass(frozen=True)
class Gap(AtFrame):
    """Frame `frame` shows what the one before shows, but its vectors lead elsewhere."""

    name = "gap"
    sentence = (
        "gap before frame {0.frame} ({0.file}): vectors do not lead to the frame before, whose"
        " picture continues: a frame may be missing (expected reset)"
    )


@dataclass(frozen=True)
class FlippedInOneFrame(AtFrame):
    """The vectors of frame `frame` fit with one component negated, or both: `axes`."""

    name, about = "flipped-frame", "motion"
    sentence = "the vectors of frame {0.frame} ({0.file}) fit with {0.axes} negated, unlike those of the other frames"
    axes: str


@dataclass(frozen=True)
class OffInOneFrame(AtFrame):
    """Depth and cameras of frame `frame` do not fit, while colors follow its vectors; `why`: as far as it is known."""

    name, about = "unexplained-frame", "camera"
    sentence = "frame {0.frame} ({0.file}) does not fit, while colors follow its vectors: {0.why}"
    why: str = "no known change explains it"


@dataclass(frozen=True)
class RepeatedFrames(Finding):
    """Frames with depth, camera and picture of the frame before, between frames in which the camera moves."""

    name = "repeated-frames"
    frames: tuple[int, ...]

    def words(self) -> str:
        repeat = frames_in_words(self.frames, "repeats", "repeat")
        return f"{repeat} the frame before: recorded more often than rendered (expected each frame once)"


@dataclass(frozen=True)
class NeedlessResets(Finding):
    """Resets although vectors, or depth and cameras, lead to the frame before."""

    name = "needless-resets"
    frames: tuple[int, ...]

    def words(self) -> str:
        resets = frames_in_words(self.frames, "is a reset", "are resets")
        return f"{resets}, although they follow the frame before (expected reset only at cuts)"


@dataclass(frozen=True)
class RepeatedColors(Finding):
    """Frames whose color equals that of the frame before to the bit, although vectors move."""

    name, about = "repeated-color", "color"
    frames: tuple[int, ...]

    def words(self) -> str:
        has = frames_in_words(self.frames, "has", "have")
        return f"{has} the color of the frame before, to the bit, although vectors move"


@dataclass(frozen=True)
class UnevenTimes(Finding):
    """Frames whose interval to the one before is not the `usual` one, seconds, but from `least` to `most`."""

    name, kind = "uneven-times", NOTE
    frames: tuple[int, ...]
    usual: float
    least: float
    most: float

    def words(self) -> str:
        come = frames_in_words(self.frames, "comes", "come")
        other = " to ".join(dict.fromkeys(f"{1e3 * one:.1f}" for one in (self.least, self.most)))
        return f"times are not even: {come} {other} ms after the one before, others {1e3 * self.usual:.1f} ms"


@dataclass(frozen=True)
class TruthOfAnotherTime(Finding):
    """Ground-truth `files` after rendered frames `frames` that fit better `by` intervals after their time."""

    name, kind, about = "truth-of-another-time", NOTE, "color"
    files: tuple[str, ...]
    frames: tuple[int, ...]
    by: float

    def words(self) -> str:
        named = ", ".join(self.files[:_MOST_NAMED]) + (" …" if len(self.files) > _MOST_NAMED else "")
        where = "later" if self.by > 0 else "earlier"
        intervals = f"{abs(self.by):g} interval{'s' * (abs(self.by) != 1)}"
        return f"ground truth {named} fits better {intervals} {where}, along motion vectors"


# ---- what cannot be told -------------------------------------------------------------------------------


@dataclass(frozen=True)
class NothingBefore(Finding):
    """No frame can be compared with one before it."""

    name, kind = "single-frames", UNKNOWN
    sentence = "no rendered frame of 8 pixels or more has one before it"


@dataclass(frozen=True)
class StillCamera(Finding):
    """The camera does not move, or only `turns`."""

    name, kind, about = "still-camera", UNKNOWN, "camera"
    turns: bool

    def words(self) -> str:
        if self.turns:
            return "the camera only turns: depth and the cameras' positions cannot be checked"
        return "the camera stands still: cameras and depth cannot be checked, and motion only on movers"


@dataclass(frozen=True)
class MisfitAtEnd(AtFrame):
    """The first or last pair of frames does not fit: a gap, or buffers of another frame in a steady movement."""

    name = "misfit-at-end"
    sentence = (
        "frame {0.frame} ({0.file}) does not follow the frame before, and nothing tells whether a frame is"
        " missing, or vectors or cameras are of another frame"
    )


def short(value: float) -> float:
    """Return `value` with as few digits as nearly the same has, at most four."""
    for digits, tolerance in ((1, 3e-3), (2, 1e-3), (3, 3e-4)):
        near = float(f"{value:.{digits - 1}e}") if np.isfinite(value) else value
        if near == value or abs(near - value) <= tolerance * abs(value):
            return near
    return float(f"{value:.4g}")
