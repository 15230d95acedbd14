"""Findings of the doctor: the table of all that it can report, with sentences and repairs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from gffe_cl.captures.doctor.hypotheses.camera_jitter import OTHERS
from gffe_cl.engine.core.errors import printable

FAULT, WARNING, NOTE, UNKNOWN = "fault", "warning", "note", "cannot tell"
DISPLAY_VALUES, BOTTOM_UP, RANGE_MISREAD, LOGARITHMIC = "display values", "bottom-up", "range", "logarithmic"
NEVER_WRITTEN, UNEXPLAINED, NO_LAW = "never written", "unexplained", "no known law"
DILATED, INTERFACE, REPEATED = "dilated", "user interface", "repeated"
TWICE = "recorded twice"
JITTER, NO_JITTER = "jitter not removed", "jitter missing"
OTHER_FRAME = "one frame late", "one frame early"  # buffers, and cameras
_MOST_NAMED = 12


@dataclass
class Finding:
    """One finding. `kind`: fault (breaks results), warning (costs more than 1 dB, which the sentence says), note (hurts
    little), or undecidable; `about`: motion, depth, camera,
    frames or color; `name`: short; `sentence`: the fault in words; `fix`: the repair by `gffe check --fix`, "" if none;
    `change`: the correction of the capture's own description, if possible; `places`: examples by name, each a frame
    and a pixel (x, y) of its rendered image."""

    kind: str
    about: str
    name: str
    sentence: str
    fix: str = ""
    figures: dict = field(default_factory=dict)
    change: str = ""
    places: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    @property
    def id(self) -> str:
        """Stable name for `--only` and `--except`: `motion-y-flipped`."""
        return finding_id(self.about, self.name)

    @property
    def is_of_jitter(self) -> bool:
        """Whether jitter of cameras or motion vectors is wrong."""
        return self.name.startswith("jitter ")

    def __str__(self) -> str:
        change = f"; in the capture's sequence.json, {self.change}" if self.change else ""
        return printable(f"{self.about}: {self.sentence}{change}")


def finding_id(about: str, name: str) -> str:
    return f"{about} {name}".lower().replace(" ", "-")


_CHANGES_OF_JITTER = [change for change in OTHERS.values() if change != "absent"]
_LATE = "one frame late: each frame has that of the frame before it"
_EARLY = "one frame early: each frame has that of the frame after it"
_AFTER = "is taken from the frame after; the last frame, whose own one was not recorded, is left out"
_BEFORE = "is taken from the frame before; the first frame is left out"
# For each kind of finding and its repair ("" for none): sentences by buffer and name, with places for values. What
# follows a slash tells wordings of one finding apart.
_TABLE: dict[tuple[str, str], dict[str, str]] = {
    (FAULT, "colors are made linear"): {
        "color: display values": "colors are display values (sRGB), not linear: {share:.0%} of {telling}"
        " antialiased silhouettes are evidence of it",
    },
    (NOTE, "colors are made linear"): {
        "color: display values/perhaps": "colors may be display values (sRGB): {share:.0%} of {telling} antialiased"
        " silhouettes are evidence of it",
    },
    (FAULT, "rows are turned upside down"): {
        f"{about}: bottom-up": f"rows of the {about} are stored from the bottom up"
        for about in ("color", "depth", "motion")
    },
    (FAULT, f"color {_AFTER}"): {"color: one frame late": f"color is {_LATE}"},
    (FAULT, f"color {_BEFORE}"): {"color: one frame early": f"color is {_EARLY}"},
    (FAULT, f"depth {_AFTER}"): {"depth: one frame late": f"depth is {_LATE}"},
    (FAULT, f"depth {_BEFORE}"): {"depth: one frame early": f"depth is {_EARLY}"},
    (FAULT, f"camera {_AFTER}"): {"camera: one frame late": f"cameras are {_LATE}"},
    (FAULT, f"camera {_BEFORE}"): {"camera: one frame early": f"cameras are {_EARLY}"},
    (FAULT, "motion vectors are converted"): {
        "motion: negated": "motion vectors are negated: they point from the previous position to here (current −"
        " previous)",
        "motion: y flipped": "the y of motion vectors is flipped: they count upwards",
        "motion: x flipped": "the x of motion vectors is flipped: they count leftwards",
        "motion: x and y swapped": "x and y of motion vectors are swapped",
        "motion: in UV": "motion vectors are in UV (shares of the image), not in pixels",
        "motion: in NDC": "motion vectors are in normalized device coordinates (−1 … 1), not in pixels",
        "motion: twice too long": "motion vectors are twice too long",
        "motion: half as long as they are": "motion vectors are half as long as the motion is",
        "motion: to the next frame": "motion vectors point to the next frame, not to the previous one",
        "motion: one frame late": "motion vectors are one frame late: each frame holds those of the frame before it",
        "motion: one frame early": "motion vectors are one frame early: each frame holds those of the frame after it",
        "motion: without the camera": "motion vectors contain only the movement of objects: the camera's part is"
        " missing",
        "motion: zero": "motion vectors are zero everywhere although the camera moves",
    },
    (FAULT, "a constant per frame is taken off"): {
        "motion: jitter not removed": "motion vectors are off by another part of a pixel in every frame: camera"
        " jitter is not removed",
        "camera: jitter missing": "the cameras lack the jitter that motion vectors and colors have",
    },
    (FAULT, "the cameras' jitter is added"): {
        "motion: jitter missing": "motion vectors lack the jitter that cameras and colors have",
        **{
            f"motion: jitter {change}": f"motion vectors have jitter {change}, compared with that of cameras and colors"
            for change in _CHANGES_OF_JITTER
        },
    },
    (FAULT, "jitter is taken off cameras and vectors"): {
        "camera: jitter not removed/color": "cameras and motion vectors are jittered, and color is not: it was"
        " antialiased over time (if depth is jittered, its jitter belongs into RenderedFrame.geometry_jitter)",
    },
    (FAULT, "principal points are moved"): {
        "camera: jitter not removed": "the cameras are jittered, but neither motion vectors nor colors are",
        **{
            f"camera: jitter {change}": f"the cameras have jitter {change}, compared with that of vectors and colors"
            for change in _CHANGES_OF_JITTER
        },
    },
    (FAULT, "depths are made linear"): {
        "depth: device": "depth is device depth, not linear: near {near:.4g}, far {far}",
        "depth: reversed": "depth is reversed device depth, not linear: near {near:.4g}, far {far}",
        "depth: logarithmic": "depth is the logarithm of {law}, not {expected}{planes}",
    },
    (FAULT, "depths are converted to linear again"): {
        "depth: range": "depth from 0 … 1 was taken for −1 … 1 when it was made linear (a buffer of OpenGL needs 2d − 1"
        " first)",
        "depth: range/OpenGL": "depth was taken for a buffer of OpenGL from 0 … 1 (2d − 1) when it was made linear,"
        " which it is not",
    },
    (FAULT, "bits are read as floats"): {
        "depth: bits of floats": "the numbers are the {bits}, read as integers (expected an array of floats)",
    },
    (FAULT, "depths are divided by their rays' lengths"): {
        "depth: along rays": "depth is the distance along rays, not along the view axis{units}",
    },
    (FAULT, "depths change their sign"): {"depth: negative": "depths are negative"},
    (FAULT, "depths or positions are scaled"): {
        "depth: units": "depths and camera positions have different units: {unit:.4g} of the cameras' is one of the"
        " depths'",
        "depth: units/metric": "{first} are in {unit}, {second} in meters",
    },
    (FAULT, "matrices are converted"): {
        "camera: inverted": "camera matrices are inverted: they are view to world",
        "camera: rotation transposed": "the rotations of the camera matrices are transposed",
        "camera: position instead of translation": "camera matrices hold the camera's position where the translation"
        " should be",
        "camera: OpenGL axes": "camera axes are OpenGL's (x right, y up, z backward), not x right, y down, z forward",
        "camera: y up": "camera axes are Direct3D's (x right, y up, z forward), not x right, y down, z forward",
        "camera: z backward": "camera axes are left-handed (x right, y down, z backward), not x right, y down, z"
        " forward",
        "camera: x left": "camera axes are left-handed (x left, y down, z forward), not x right, y down, z forward",
        "camera: axes": "camera axes are {axes}, not x right, y down, z forward",
    },
    (FAULT, "focal lengths are divided"): {
        "camera: field of view": "the field of view is off: focal lengths are {percent:.1f}% too {long}",
    },
    (FAULT, "matrices are transposed"): {
        "camera: transposed": "camera matrices are transposed: they are for row vectors, the translation is in the last"
        " row",
    },
    (FAULT, "matrices are divided by it"): {"camera: scaled": "camera matrices hold a scale of {scale:.4g}"},
    (FAULT, "frames change places"): {"frames: out of order": "frames are out of order: {frames}"},
    (FAULT, "they are left out"): {
        "frames: recorded twice": "{frames_are} the same to the bit as the frame before, although vectors move",
    },
    (FAULT, "the frame is marked as a reset"): {
        "frames: cut": "cut at frame {frame} ({file}): it does not follow the frame before, and is no reset",
        "frames: gap": "gap before frame {frame} ({file}): it shows what the frame before shows, but its vectors do not"
        " lead there{length}{doubt}",
    },
    (FAULT, ""): {
        "color: repeated": "{frames_have} the color of the frame before, to the bit, although vectors move",
        "motion: jitter differs": "motion vectors and cameras differ by another part of a pixel in every frame:"
        " jitter is in one of them alone, and colors do not tell which of them is right",
        "camera: jitter differs": "motion vectors and cameras differ by another part of a pixel in every frame:"
        " jitter is in one of them alone, and colors do not tell which of them is right",
        "camera: jitter differs/known": "the jitter of motion vectors is {change}, compared with that of the cameras;"
        " {colors}",
        "depth: no known law": 'no known law explains it (the nearest, "{nearest}", leaves {share:.0%} and'
        " {pixels:.2g} px)",
        "frames: unexplained": "motion vectors do not fit depth and cameras, and none of the known faults explains it",
        "frames: nothing usable": "no pixel of the frames that were compared has a usable depth and a usable motion"
        " vector",
        **{
            f"{about}: nothing usable": f"{{pixels}} a usable {about} ({{why}}): nothing can be compared"
            for about in ("color", "depth", "motion")
        },
    },
    (WARNING, ""): {
        "color: user interface": "user interface in the color: {share:.1%} of the pixels stay in place although vectors"
        " move them: warped with the scene it costs 2 to 3 dB, most of which `--ui-detection on` gets back (better:"
        " give color without it and the interface as Overlays.ui, or mark it in Overlays.fixed_mask)",
    },
    (NOTE, "sky gets the camera's motion"): {
        "motion: sky without motion": "the sky has no motion although the camera turns: harmless, it is taken from the"
        " camera",
    },
    (NOTE, ""): {
        "frames: of the reader": "{note}",
        "frames: bad pixels": "{counts}; first: {first}",
        "frames: reset": "{frames_are}: what leads across is left out",
        "frames: late": "frame {frame} ({file}) comes {intervals:.3g} intervals after the frame before: if one is"
        " missing, its vectors lead there, and it must be a reset",
        "motion: quantized": "vectors are quantized in steps of {grid}, {x} distinct values in x and {y} in y{code}"
        "{added}: slow objects shake a little",
        "motion: never written": "{share} of the motion vectors {what}{value}: they count as unknown",
        "motion: dilated": "dilated: {share:.0%} of the pixels beside a nearer surface have its vector (describe that"
        " by FrameFormat.motion_dilated, which undoes it)",
        "motion: cut off": "{axes}, the largest number, and depth and cameras say that most of these are longer: they"
        " were cut off (expected a larger range)",
        "depth: cut off": "{share:.0%} of the depths are {limit:.6g}, the largest number, and vectors say that most of"
        ' these are farther: what is farther is taken for a wall there (expected "sky_from": {limit:.6g} for sky,'
        " or a larger range)",
        "depth: cut off/near": "{share:.0%} of the depths are {limit:.6g}, the smallest number, and vectors say that"
        " most of these are nearer: what is nearer is taken to be there",
        "depth: half floats": "depth went through half floats: it is off by up to 1/2048 of itself",
        "depth: jittered": "jittered against color: its edges move by {size:.2g} px (standard deviation) from frame to"
        " frame, those of color do not (color was antialiased over time: the jitter belongs {where}"
        " RenderedFrame.geometry_jitter)",
        "color: 8 bits": "colors have 8 bits: gradients show bands",
        "color: 8 bits linear": "colors are 8-bit numbers that are read as linear light; such files usually hold"
        " display"
        ' values (of a gffe-folder expected "encoding": "srgb")',
        **{
            f"{about}: repeated": f"repeated: {{width}}×{{height}} different pixels of {words} fill {{all}} (give"
            " them in the size they were rendered in, by geometry_size of a FrameFormat or a RenderedFrame: about 0.8"
            " dB)"
            for about, words in (("depth", "depth"), ("motion", "motion vectors"))
        },
        **{
            f"{about}: nothing usable in some frames": f"no pixel of {{files}} has a usable {about}"
            for about in ("depth", "motion")
        },
    },
    (UNKNOWN, ""): {
        "frames: single frames": "no rendered frame of 8 pixels or more has one before it",
        "frames: upside down": "which way up the picture is: {instead} would explain the buffers as well, as a mirror"
        " image",
        "frames: misfit at the end": "why frame {frame} ({file}) does not follow the frame before: a frame may be"
        " missing, or vectors or cameras are one frame {when}",
        "frames: of another frame": "a buffer fits better as that of another frame, but which one is open: {either}",
        "frames: of another frame/vectors": "{buffer}, or motion vectors are {when}: colors do not tell which",
        "color: of another frame": "{frames_have} the color of the frame before, to the bit, although vectors move,"
        " or all colors are those of another frame",
        "camera: still camera": "the camera stands still: cameras and depth cannot be checked, and motion only on"
        " movers",
        "depth: rotation only": "the camera only turns: depth and the cameras' positions cannot be checked",
        "depth: jittered/unclear": "whether color is jittered as depth is: too few clear edges",
    },
}
_ALWAYS_FIXED = "camera: transposed", "camera: scaled"  # without that nothing can be opened
ENTRIES = {name: (kind, fix, sentence) for (kind, fix), group in _TABLE.items() for name, sentence in group.items()}
FIXABLE = list(
    dict.fromkeys(
        finding_id(*name.partition("/")[0].split(": "))
        for name, (_, fix, _) in ENTRIES.items()
        if fix and name not in _ALWAYS_FIXED
    )
)


def finding(entry: str, figures: dict | None = None, **values) -> Finding:
    """Return the finding of that `entry` of the table, such as "motion: y flipped", with `values` in its sentence."""
    kind, fix, sentence = ENTRIES[entry]
    about, name = entry.partition("/")[0].split(": ")
    return Finding(kind, about, name, sentence.format(**values), fix, figures or {})


def listed(names: Iterable) -> str:
    """Return `names` with commas, the first twelve of them."""
    names = [str(name) for name in names]
    return ", ".join(names[:_MOST_NAMED]) + (" …" if len(names) > _MOST_NAMED else "")


def frames_in_words(numbers: list[int], one: str, many: str) -> str:
    """Return "frame 3 is" or "frames 3, 4 are", with the words for one or many of them."""
    return f"frames {listed(numbers)} {many}" if len(numbers) > 1 else f"frame {numbers[0]} {one}"
