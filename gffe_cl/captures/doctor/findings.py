"""Findings of the doctor: plain sentences with their evidence."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gffe_cl.captures.doctor.hypotheses import cameras, motions
from gffe_cl.captures.doctor.hypotheses.camera_jitter import INVERSE
from gffe_cl.captures.doctor.hypotheses.cameras import CameraReading, axes_in_words
from gffe_cl.captures.doctor.hypotheses.depths import (
    AS_GIVEN,
    DEVICE,
    FLOAT_BITS,
    PLANAR,
    RANGE,
    DepthReading,
    Planes,
    is_from_0_to_1,
    misread_range,
)
from gffe_cl.captures.doctor.hypotheses.laws import Misfit
from gffe_cl.captures.doctor.hypotheses.search import Reading
from gffe_cl.engine.core.errors import printable

FAULT, WARNING, NOTE, UNKNOWN = "fault", "warning", "note", "cannot tell"
DISPLAY_VALUES, BOTTOM_UP, RANGE_MISREAD, NEVER_WRITTEN = "display values", "bottom-up", "range", "never written"
UNEXPLAINED = "unexplained"
JITTER, NO_JITTER, JITTER_DIFFERS = "jitter not removed", "jitter missing", "jitter differs"
_MENDED_JITTER = (JITTER, NO_JITTER, *(f"jitter {difference}" for difference in INVERSE if difference != "absent"))
JITTERS = (*_MENDED_JITTER, JITTER_DIFFERS)
OTHER_FRAME = ("one frame late", "one frame early")  # buffers, and cameras
CUT_OFF = "cut off"
TWICE, ORIGIN_SHIFTED = "recorded twice", "origin shifted"
SEVERAL_VIEWS, IN_PART = "several views", "partly another convention"
LOGARITHMIC, BITS, NO_LAW = "logarithmic", "bits of floats", "no known law"
DILATED, INTERFACE, JITTERED, REPEATED = "dilated", "user interface", "jittered", "repeated"
EFFECTS = "moves by itself"
MISFIT, SOME_FRAME = "misfit at the end", "of another frame"
TOLD = (CUT_OFF, SEVERAL_VIEWS, INTERFACE, REPEATED, DILATED)  # notes that the quick form names, too
DOUBTS = (MISFIT, SOME_FRAME)  # the same, of what cannot be told
_RANGES = {
    2.0: "depth from 0 … 1 was taken for −1 … 1 when it was made linear (a buffer of OpenGL needs 2d − 1 first)",
    0.5: "depth was taken for a buffer of OpenGL from 0 … 1 (2d − 1) when it was made linear, which it is not",
}
_JITTER_OF = {  # the part whose jitter is missing or not removed: name and sentence
    "motion": (
        JITTER,
        "motion vectors are off by another part of a pixel in every frame: camera jitter is not removed",
    ),
    "camera": (NO_JITTER, "the cameras lack the jitter that motion vectors and colors have"),
}
_UNITS = {100.0: "in centimeters, {0} in meters", 1000.0: "in millimeters, {0} in meters"}
_UNIT_SLACK = 0.03


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

    def __str__(self) -> str:
        change = f"; in the capture's sequence.json, {self.change}" if self.change else ""
        return printable(f"{self.about}: {self.sentence}{change}")


def finding_id(about: str, name: str) -> str:
    return f"{about} {name}".lower().replace(" ", "-")


def fixable_ids() -> list[str]:
    """Return the ids of all findings that `gffe check --fix` can repair or leave."""
    names = {
        "color": (DISPLAY_VALUES, BOTTOM_UP, *OTHER_FRAME),
        "motion": (*motions.SENTENCES, *_MENDED_JITTER, "sky without motion", BOTTOM_UP),
        "depth": (
            "device",
            "reversed",
            "along rays",
            "units",
            "negative",
            RANGE_MISREAD,
            LOGARITHMIC,
            BITS,
            BOTTOM_UP,
            *OTHER_FRAME,
        ),
        "camera": (*cameras.SENTENCES, "field of view", *_MENDED_JITTER, *OTHER_FRAME, ORIGIN_SHIFTED),
        "frames": ("out of order", TWICE, "cut", "gap"),
    }
    return [finding_id(about, name) for about, group in names.items() for name in group]


def jitter_id(part: str) -> str:
    """Return the id of the finding that the jitter of a `part` of a reading is missing or not removed; "" for none."""
    return finding_id(part, _JITTER_OF[part][0]) if part else ""


def faults_of(reading: Reading, stored: np.ndarray) -> list[Finding]:
    """Return one finding for every difference between `reading` and the sequence as given. `stored`: sampled depths."""
    found = [
        Finding(
            FAULT,
            buffer,
            BOTTOM_UP,
            f"rows of the {buffer} are stored from the bottom up",
            "rows are turned upside down",
        )
        for buffer in reading.rows
    ]
    found += [
        Finding(FAULT, "motion", part, motions.SENTENCES[part], "motion vectors are converted")
        for part in reading.motion.parts
    ]
    found += _camera_faults(reading.camera)
    if reading.depth != AS_GIVEN:
        found.append(_depth_fault(reading.depth, stored))
    if reading.jitter:
        name, sentence = _JITTER_OF[reading.jitter]
        found.append(Finding(FAULT, reading.jitter, name, sentence, "a constant per frame is taken off"))
    return found


def _camera_faults(camera: CameraReading) -> list[Finding]:
    found = []
    axes = camera.axes if camera.axes_before is None else camera.axes_before
    for part in camera.parts:
        sentence = cameras.SENTENCES[part].format(axes=axes_in_words(axes))
        found.append(Finding(FAULT, "camera", part, sentence, "matrices are converted"))
    if camera.focal != 1:
        percent = 100 * (camera.focal - 1)
        sentence = (
            f"the field of view is off: focal lengths are {abs(percent):.1f}% too {'long' if percent > 0 else 'short'}"
        )
        found.append(
            Finding(FAULT, "camera", "field of view", sentence, "focal lengths are divided", {"focal": camera.focal})
        )
    return found


def _depth_fault(depth: DepthReading, stored: np.ndarray) -> Finding:
    c = depth.coefficients
    stretched = misread_range(c[-1]) if depth.model in (RANGE, PLANAR) else None
    if stretched:
        figures = {"factor": stretched, "offset": c[0] if depth.model is RANGE else 0.0}
        return Finding(
            FAULT, "depth", RANGE_MISREAD, _RANGES[stretched], "depths are converted to linear again", figures
        )
    if depth.model is DEVICE:
        return _device_fault(depth, stored)
    if depth.model.added is not None:
        return _logarithmic_fault(depth, stored)
    if depth.model in FLOAT_BITS:
        sentence = f"the numbers are the {depth.model.name}, read as integers (expected an array of floats)"
        return Finding(FAULT, "depth", BITS, sentence, "bits are read as floats", {"unit": 1 / c[0]})
    if depth.model is PLANAR:
        return _unit_fault(1 / c[0] if c[0] else np.inf)
    also = "" if abs(c[0] - 1) < _UNIT_SLACK else f", and in units of {1 / c[0]:.4g} of the cameras'"
    sentence = f"depth is the distance along rays, not along the view axis{also}"
    return Finding(
        FAULT, "depth", "along rays", sentence, "depths are divided by their rays' lengths", {"unit": 1 / c[0]}
    )


def _logarithmic_fault(depth: DepthReading, stored: np.ndarray) -> Finding:
    law = "1 + z" if depth.model.added else "z"
    sentence = f"depth is the logarithm of {law}, not {'device depth' if depth.model.is_of_device else 'linear'}"
    figures = {"added": depth.model.added, "coefficients": depth.coefficients, "unit": is_from_0_to_1(stored)}
    if not depth.model.is_of_device and figures["unit"]:
        near, far = sorted(np.exp((depth.coefficients[0], sum(depth.coefficients))) - depth.model.added)
        sentence += f": far {far:.4g}" if depth.model.added else f": near {near:.4g}, far {far:.4g}"
    return Finding(FAULT, "depth", LOGARITHMIC, sentence, "depths are made linear", figures)


def no_law_fault(reading: Reading, stored: np.ndarray, misfit: Misfit) -> Finding:
    """Return the fault of depths that no law explains, not even that of `reading`, the best one, which leaves
    `misfit`."""
    best = "; ".join(fault.sentence for fault in faults_of(reading, stored))
    sentence = f'no known law explains it (the nearest, "{best}", leaves {misfit.share:.0%} and {misfit.pixels:.2g} px)'
    return Finding(FAULT, "depth", NO_LAW, sentence, figures=misfit._asdict())


def _unit_fault(unit: float) -> Finding:
    """Return the finding about the unit of depth. `unit`: factor from stored depths to the unit of the cameras."""
    if unit < 0:
        return Finding(FAULT, "depth", "negative", "depths are negative", "depths change their sign", {"unit": unit})
    for factor, words in _UNITS.items():
        for ratio, first, second in (
            (factor, "depths are", "camera positions"),
            (1 / factor, "camera positions are", "depths"),
        ):
            if abs(np.log(unit * ratio)) < _UNIT_SLACK:
                sentence = f"{first} {words.format(second)}"
                return Finding(FAULT, "depth", "units", sentence, "depths or positions are scaled", {"unit": unit})
    sentence = f"depths and camera positions have different units: {unit:.4g} of the cameras' is one of the depths'"
    return Finding(FAULT, "depth", "units", sentence, "depths or positions are scaled", {"unit": unit})


def _device_fault(depth: DepthReading, stored: np.ndarray) -> Finding:
    planes = Planes.of(depth, stored)
    far = "infinity" if np.isinf(planes.far) else f"{planes.far:.4g}"
    kind = "reversed device depth" if planes.reverse else "device depth"
    sentence = f"depth is {kind}, not linear: near {planes.near:.4g}, far {far}"
    figures = {"near": planes.near, "far": planes.far, "reversed": planes.reverse}
    return Finding(
        FAULT, "depth", "reversed" if planes.reverse else "device", sentence, "depths are made linear", figures
    )
