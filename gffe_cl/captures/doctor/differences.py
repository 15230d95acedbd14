"""Differences between a reading and the sequence as given, as faults."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.findings import BOTTOM_UP, JITTER, NO_JITTER, Finding, finding, finding_id
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

_JITTER_OF = {"motion": JITTER, "camera": NO_JITTER}  # the part whose jitter is not removed, or missing
_UNITS = {100.0: "centimeters", 1000.0: "millimeters"}
_UNIT_SLACK = 0.03


def jitter_id(part: str) -> str:
    """Return the id of the finding that the jitter of a `part` of a reading is missing or not removed; "" for none."""
    return finding_id(part, _JITTER_OF[part]) if part else ""


def faults_of(reading: Reading, stored: np.ndarray) -> list[Finding]:
    """Return one finding for every difference between `reading` and the sequence as given. `stored`: sampled depths."""
    found = [finding(f"{buffer}: {BOTTOM_UP}") for buffer in reading.rows]
    found += [finding(f"motion: {part}") for part in reading.motion.parts]
    found += _camera_faults(reading.camera)
    if reading.depth != AS_GIVEN:
        found.append(_depth_fault(reading.depth, stored))
    if reading.jitter:
        found.append(finding(f"{reading.jitter}: {_JITTER_OF[reading.jitter]}"))
    return found


def _camera_faults(camera: CameraReading) -> list[Finding]:
    axes = axes_in_words(camera.axes if camera.axes_before is None else camera.axes_before)
    found = [finding(f"camera: {part}", axes=axes) for part in camera.parts]
    if camera.focal != 1:
        percent, long = 100 * abs(camera.focal - 1), "long" if camera.focal > 1 else "short"
        found.append(finding("camera: field of view", {"focal": camera.focal}, percent=percent, long=long))
    return found


def _depth_fault(depth: DepthReading, stored: np.ndarray) -> Finding:
    c = depth.coefficients
    stretched = misread_range(c[-1]) if depth.model in (RANGE, PLANAR) else None
    if stretched:
        figures = {"factor": stretched, "offset": c[0] if depth.model is RANGE else 0.0}
        return finding("depth: range" if stretched == 2 else "depth: range/OpenGL", figures)
    if depth.model is DEVICE:
        return _device_fault(depth, stored)
    if depth.model.added is not None:
        return _logarithmic_fault(depth, stored)
    unit = 1 / c[0] if c[0] else np.inf
    if depth.model in FLOAT_BITS:
        return finding("depth: bits of floats", {"unit": unit}, bits=depth.model.name)
    if depth.model is PLANAR:
        return _unit_fault(unit)
    also = "" if abs(c[0] - 1) < _UNIT_SLACK else f", and in units of {unit:.4g} of the cameras'"
    return finding("depth: along rays", {"unit": unit}, units=also)


def _logarithmic_fault(depth: DepthReading, stored: np.ndarray) -> Finding:
    added, planes = depth.model.added, ""
    figures = {"added": added, "coefficients": depth.coefficients, "unit": is_from_0_to_1(stored)}
    if not depth.model.is_of_device and figures["unit"]:
        near, far = sorted(np.exp((depth.coefficients[0], sum(depth.coefficients))) - added)
        planes = f": far {far:.4g}" if added else f": near {near:.4g}, far {far:.4g}"
    expected = "device depth" if depth.model.is_of_device else "linear"
    return finding("depth: logarithmic", figures, law="1 + z" if added else "z", expected=expected, planes=planes)


def no_law_fault(reading: Reading, stored: np.ndarray, misfit: Misfit) -> Finding:
    """Return the fault of depths that no law explains, not even that of `reading`, the best one, which leaves
    `misfit`."""
    nearest = "; ".join(fault.sentence for fault in faults_of(reading, stored))
    return finding("depth: no known law", misfit._asdict(), nearest=nearest, **misfit._asdict())


def _unit_fault(unit: float) -> Finding:
    """Return the finding about the unit of depth. `unit`: factor from stored depths to the unit of the cameras."""
    figures = {"unit": unit}
    if unit < 0:
        return finding("depth: negative", figures)
    both = "depths", "camera positions"
    for factor, name in _UNITS.items():
        for ratio, (first, second) in ((factor, both), (1 / factor, both[::-1])):
            if abs(np.log(unit * ratio)) < _UNIT_SLACK:
                return finding("depth: units/metric", figures, first=first, second=second, unit=name)
    return finding("depth: units", figures, unit=unit)


def _device_fault(depth: DepthReading, stored: np.ndarray) -> Finding:
    planes = Planes.of(depth, stored)
    figures = {"near": planes.near, "far": planes.far, "reversed": planes.reverse}
    far = "infinity" if np.isinf(planes.far) else f"{planes.far:.4g}"
    return finding("depth: reversed" if planes.reverse else "depth: device", figures, near=planes.near, far=far)
