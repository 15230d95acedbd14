"""Laws of depth buffers: logarithms and floats read as integers are found and repaired, others are not explained by the
nearest known one."""

import json
from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import as_folder, assert_restored, clip, follow_advice, names
from parameters import few

from gffe_cl import open_capture
from gffe_cl.captures.doctor import Repair, examine, quick_warning
from gffe_cl.lab.fault_injection import Kept


def stored(law):
    """The exact clip with depths by a `law`."""
    frames = [replace(f, depth=np.asarray(law(f.depth.astype(np.float64)), np.float32)) for f in clip().images]
    return Kept(frames)


def device_of(s, near, far):
    """Planar depth of values of a buffer that are taken for device depth."""
    return 1 / (s / far + (1 - s) / near)


LOGARITHMIC = {
    "z": lambda z: np.log(z / 0.03) / np.log(700 / 0.03),
    "z, reversed": lambda z: 1 - np.log(z / 0.5) / np.log(90 / 0.5),
    "1 + z": lambda z: np.log2(1 + z) / np.log2(1 + 400),
    "z, taken for device depth": lambda z: device_of(np.log(z / 0.2) / np.log(5000 / 0.2), 0.2, 5000),
    "1 + z, taken for device depth": lambda z: device_of(np.log2(1 + z) / np.log2(1 + 90), 0.02, 90),
}


@pytest.mark.parametrize("law", few(LOGARITHMIC, "1 + z", "z, taken for device depth"))
def test_logarithmic_depth_is_found_and_made_linear(law):
    bad = stored(LOGARITHMIC[law])
    diagnosis = examine(bad)
    assert names(diagnosis) == ["depth: logarithmic"]
    (fault,) = diagnosis.faults
    form = law.split(",")[0]
    assert f"the logarithm of {form}, not" in fault.sentence
    planes = {"z": "near 0.03, far 700", "z, reversed": "near 0.5, far 90", "1 + z": "far 400"}
    assert fault.sentence.endswith(planes.get(law, "not device depth"))
    assert_restored([frame for _, frame in Repair(bad, diagnosis).frames()])
    assert "depth logarithmic" in quick_warning(bad)


OTHERS = {
    "square root": lambda z: np.sqrt(z) / 10,
    "inverse square": lambda z: 1 / z**2,
    "cube of the logarithm": lambda z: (np.log(z / 0.1) / np.log(1000 / 0.1)) ** 3,
}


@pytest.mark.parametrize("law", few(OTHERS, "square root"))
def test_what_no_known_law_explains_is_not_repaired(law):
    diagnosis = examine(stored(OTHERS[law]))
    about = [fault for fault in diagnosis.faults if fault.about == "depth"]
    assert diagnosis.verdict == "faults" and not any(fault.fix for fault in about), diagnosis.findings
    assert all(fault.name == "no known law" for fault in about)
    warning = quick_warning(stored(OTHERS[law]))
    assert "do not fit" in warning and not any(name in warning for name in ("device", "reversed", "logarithmic"))


BITS = {
    "32-bit": lambda z: z.astype(np.float32).view(np.uint32) / (2**32 - 1),
    "32-bit, raw": lambda z: z.astype(np.float32).view(np.uint32),
    "16-bit": lambda z: z.astype(np.float16).view(np.uint16) / (2**16 - 1),
    "16-bit, raw": lambda z: z.astype(np.float16).view(np.uint16),
}


@pytest.mark.parametrize("kind", BITS)
def test_floats_read_as_integers_are_named(kind):
    bad = stored(BITS[kind])
    diagnosis = examine(bad)
    if kind == "32-bit, raw":  # beyond any distance
        assert names(diagnosis) == ["depth: nothing usable"]
        assert "the bits of 32-bit floats" in diagnosis.faults[0].sentence
        return
    assert names(diagnosis) == ["depth: bits of floats"]
    assert f"the bits of {kind[:6]} floats" in diagnosis.faults[0].sentence
    assert_restored([frame for _, frame in Repair(bad, diagnosis).frames()])


def test_a_folder_gets_the_keys_of_logarithmic_depth(tmp_path):
    """Logarithms described as device depth, of another scene, near and far than above."""
    near, far = 0.02, 250.0
    values = [replace(f, depth=1 - np.log(f.depth / near) / np.log(far / near)) for f in clip().images]
    said = {"file": "depth_%d.npy", "encoding": "device", "near": 0.5, "far": 100, "reversed": True}
    folder = as_folder(tmp_path / "in", Kept(values), depth=said)
    (fault,) = examine(open_capture(folder)).faults
    keys = {"encoding": "logarithmic", "near": near, "far": far, "reversed": True}
    assert json.loads("{" + fault.change.removeprefix("depth: ") + "}") == keys
    follow_advice(folder, [fault])
    fixed = open_capture(folder)
    assert examine(fixed).findings == []
    for entry, frame in zip(fixed.rendered, clip().images, strict=True):
        np.testing.assert_allclose(fixed.read(entry).depth, frame.depth, rtol=1e-4)
