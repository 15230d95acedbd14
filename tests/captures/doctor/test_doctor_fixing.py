"""Repairs of `gffe check --fix`, their choice and messages; keys of a `gffe-folder` that repair a capture."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import H, W, as_folder, assert_restored, clip, follow_advice, names, tiled, written

from gffe_cl import open_capture
from gffe_cl.captures.doctor import Finding, Repair, examine, selected
from gffe_cl.captures.doctor.findings import ENTRIES
from gffe_cl.captures.doctor.format_keys import tell_keys
from gffe_cl.captures.doctor.hypotheses.camera_jitter import INVERSE
from gffe_cl.captures.doctor.hypotheses.cameras import CAMERA_AS_GIVEN, camera_readings
from gffe_cl.captures.doctor.hypotheses.motions import MOTION_AS_GIVEN, motion_readings
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.fault_injection import Kept, broken


def test_the_command(gffe, tmp_path):
    good, bad = (
        written(tmp_path / name, kept) for name, kept in (("good", clip()), ("bad", broken(clip(), ["motion negated"])))
    )
    code, text, err = gffe("check", good, "--json", tmp_path / "good.json")
    assert (code, err) == (0, "") and json.loads((tmp_path / "good.json").read_text())["verdict"] == "fits"
    code, text, err = gffe("check", bad, "--fix", tmp_path / "fixed", "--json", tmp_path / "bad.json")
    document = json.loads((tmp_path / "bad.json").read_text())
    assert code == 1 and "negated" in text and "it fits now" in text
    assert [finding["name"] for finding in document["findings"] if finding["kind"] == "fault"] == ["negated"]
    assert document["residuals"]["given_median"] > 1 > 0.05 > document["residuals"]["read_median"]
    fixed = open_sequence(tmp_path / "fixed")
    assert_restored([fixed.read(entry) for entry in fixed.rendered])


def test_findings_are_repaired_or_left_as_they_are_named(gffe, tmp_path):
    bad = written(tmp_path / "bad", broken(clip(), ["motion negated", "depth in centimeters"]))
    out = tmp_path / "fixed"
    code, text, err = gffe("check", bad, "--fix", out, "--except", "depth-units", "--json", tmp_path / "said.json")
    said = json.loads((tmp_path / "said.json").read_text())
    assert code == 1 and (said["changed"], said["left"]) == (["motion-negated"], ["depth-units"])
    assert "to change: motion-negated: " in text and "left as given: depth-units" in text
    x, y, *_ = map(float, re.search(r"motion vector \((.+), (.+)\) → \((.+), (.+)\) px", text).groups())
    assert f"→ ({-x:g}, {-y:g}) px" in text
    assert "checked again, still with faults: depth-units" in text
    code, _, err = gffe("check", bad, "--fix", tmp_path / "none", "--only", "motion-upside")
    assert code == 2 and "expected one of color-display-values, " in " ".join(err.split())
    assert gffe("check", bad, "--only", "motion-negated")[0] == 2  # nothing is to be repaired
    with pytest.raises(GffeError, match=r"--only depth-device: not found in this sequence \(expected one of motion"):
        selected(examine(open_sequence(bad)), ["depth-device"])


def test_colors_are_made_linear_only_where_the_user_names_them():
    shown = broken(tiled(3), ["color tone-mapped"])
    diagnosis = examine(shown)
    for only, expected in (((), shown), (("color-display-values",), tiled(3))):
        (_, first), *_ = Repair(shown, selected(diagnosis, only)).frames()
        np.testing.assert_allclose(first.color, expected.images[0].color, atol=0.002)


def test_parts_of_readings_can_be_left_and_are_in_the_table():
    differences = [difference for difference in INVERSE if difference != "absent"]
    assert all(f"{about}: jitter {one}" in ENTRIES for about in ("motion", "camera") for one in differences)
    for reading in motion_readings():
        assert all(f"motion: {part}" in ENTRIES for part in reading.parts)
        assert reading.keeping(reading.parts) == reading and reading.keeping(()) == MOTION_AS_GIVEN
        assert reading.mirrored().mirrored() == reading
    for reading in camera_readings():
        assert all(f"camera: {part}" in ENTRIES for part in (*reading.parts, *reading.opposite().parts))
        assert reading.keeping(reading.parts) == reading and reading.keeping(()) == CAMERA_AS_GIVEN


def test_of_a_folder_the_keys_to_change_are_named_and_right(tmp_path):
    folder = as_folder(tmp_path / "a", broken(clip(), ["motion negated", "color rows"]))
    faults = examine(open_capture(folder)).faults
    said = {'motion: "direction": "from_previous"', 'color: "origin": "bottom-left"'}
    assert {fault.change for fault in faults} == said and "from_previous" in str(faults[1])
    follow_advice(folder, faults)
    assert names(examine(open_capture(folder))) == []


KEYS = {
    ("color", "display values"): {"encoding": "srgb"},
    ("depth", "bottom-up"): {"origin": "bottom-left"},
    ("motion", "y flipped"): {"y": "up"},
    ("motion", "x flipped"): {"scale": [-1.0, 1.0]},
    ("motion", "x and y swapped"): {"channels": ["G", "R"]},
    ("motion", "in NDC"): {"unit": "ndc"},
    ("motion", "half as long as they are"): {"scale": [2.0, 2.0]},
    ("motion", "to the next frame"): {"direction": "to_next"},
    ("motion", "jitter not removed"): {"jitter": "removed"},
    ("depth", "along rays"): {"encoding": "distance"},
    ("depth", "reversed"): {"encoding": "device", "near": 0.1, "far": "infinite", "reversed": True},
    ("depth", "units"): {"scale": [0.01]},
    ("camera", "inverted"): {"matrix": "view_to_world"},
    ("camera", "OpenGL axes"): {"convention": "opengl"},
    ("camera", "y up"): {"convention": "direct3d"},
    ("frames", "cut"): {"reset": True},
    ("camera", "field of view"): None,
}


def test_each_finding_has_its_key(tmp_path):
    settings = open_capture(as_folder(tmp_path / "a", clip())).settings
    figures = {"near": 0.1, "far": np.inf, "reversed": True, "unit": 0.01}
    for (about, name), change in KEYS.items():
        finding = Finding("fault", about, name, "", figures=figures)
        tell_keys([finding], settings)
        part, _, keys = finding.change.partition(": ")
        assert (json.loads("{" + keys + "}") or None) == change
        assert change is None or part == about.replace("frames", "frame")


def test_a_depth_range_that_is_misread_is_named_with_its_key(tmp_path):
    near, far = 0.1, 100.0
    views = []
    for frame in clip().images:
        c = frame.camera
        projection = np.diag([2 * c.fx / W, 2 * c.fy / H, far / (far - near), 0])
        projection[2, 3], projection[3, 2] = -far * near / (far - near), 1
        views.append({"view": c.world_to_view.tolist(), "projection": projection.tolist()})
    device = [replace(f, depth=far / (far - near) * (1 - near / f.depth.astype(float))) for f in clip().images]
    said = {"camera": {"convention": "vulkan", "list": views}}
    said["depth"] = {"file": "depth_%d.npy", "encoding": "device", "opengl_buffer": True}
    folder = as_folder(tmp_path / "a", Kept(device), **said)
    (fault,) = examine(open_capture(folder)).faults
    assert (fault.id, fault.change) == ("depth-range", 'depth: "opengl_buffer": false')
    follow_advice(folder, [fault])
    assert names(examine(open_capture(folder))) == []
