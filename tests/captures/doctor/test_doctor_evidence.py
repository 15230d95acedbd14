"""Captures in which there is nothing to compare are faults, and vectors that were never written are no evidence."""

import json
from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import H, W, clip, names, written
from parameters import few

from gffe_cl import check
from gffe_cl.captures.doctor import examine, quick_warning
from gffe_cl.lab.fault_injection import Kept

EMPTY = {
    "infinite depth": ("depth", lambda frame: replace(frame, depth=np.full((H, W), np.inf, np.float32)), "sky"),
    "NaN depth": ("depth", lambda frame: replace(frame, depth=np.full((H, W), np.nan, np.float32)), "NaN"),
    "zero depth": ("depth", lambda frame: replace(frame, depth=np.zeros((H, W), np.float32)), "zero"),
    "a speck of depth": ("depth", lambda frame: replace(frame, depth=speck(frame.depth)), "sky"),
    "denormal depth": ("depth", lambda frame: replace(frame, depth=np.full_like(frame.depth, 1e-40)), "denormal"),
    "NaN motion": ("motion", lambda frame: replace(frame, motion=np.full((H, W, 2), np.nan, np.float32)), "NaN"),
    "long motion": ("motion", lambda frame: replace(frame, motion=np.full((H, W, 2), 65504, np.float32)), "diagonal"),
    "little motion": ("motion", lambda frame: replace(frame, motion=mostly(frame.motion, np.nan, 0.98)), "NaN"),
    "NaN color": ("color", lambda frame: replace(frame, color=np.full((H, W, 3), np.nan, np.float32)), "NaN"),
}


def speck(depth):
    made = np.full_like(depth, np.inf)
    made[H // 2, W // 2] = 5
    return made


def mostly(motion, value, share=0.4, seed=1):
    made = np.zeros((H, W, 2), np.float32) if motion is None else motion.copy()
    made[np.random.default_rng(seed).random((H, W)) < share] = value
    return made


def changed(change):
    """The clip of test_doctor.py with every frame changed."""
    return Kept([change(frame) for frame in clip().images])


@pytest.mark.parametrize("kind", EMPTY)
def test_nothing_to_compare_is_a_fault(kind):
    about, change, reason = EMPTY[kind]
    empty = changed(change)
    found = examine(empty)
    assert [(fault.about, fault.name) for fault in found.faults] == [(about, "nothing usable")]
    assert found.verdict == "faults" and not found.compared and reason in found.faults[0].sentence
    assert (quick_warning(empty) or "").startswith(f"{about}: ")
    assert (check(empty.images[:3]) or "").startswith(f"{about}: ")


def test_depth_of_the_first_frame_alone_is_nothing_to_compare():
    frames = [replace(f, depth=np.full_like(f.depth, np.inf)) if k else f for k, f in enumerate(clip().images)]
    assert names(examine(Kept(frames))) == ["depth: nothing usable"] and quick_warning(Kept(frames))


def test_frames_that_are_looked_at_closely_may_be_empty():
    """Five of many are; others have depth and vectors."""
    from gffe_cl.captures.doctor.diagnose import _deep_frames

    deep = _deep_frames(clip().rendered)
    frames = [replace(f, depth=np.full_like(f.depth, np.inf)) if k in deep else f for k, f in enumerate(clip().images)]
    found = examine(Kept(frames))
    assert found.verdict == "faults" and not found.compared


def test_the_command_never_says_that_it_fits(gffe, tmp_path):
    empty = written(tmp_path / "in", changed(EMPTY["infinite depth"][1]))
    code, text, _ = gffe("check", empty, "--json", tmp_path / "said.json", "--fix", tmp_path / "out")
    assert code == 1 and "fault depth: no pixel has a usable depth (all are sky)" in text
    assert "nan" not in text and "fits" not in text
    assert json.loads((tmp_path / "said.json").read_text())["verdict"] == "faults"
    single = written(tmp_path / "single", Kept(clip().images[:1]))
    code, text, _ = gffe("check", single, "--json", tmp_path / "said.json", "--fix", tmp_path / "out")
    assert code == 0 and "nothing could be compared" in text and "fits" not in text
    assert json.loads((tmp_path / "said.json").read_text())["verdict"] == "unknown"


def test_a_picture_of_little_but_sky_can_be_compared():
    def far(frame):
        depth = np.full((H, W), np.inf, np.float32)
        depth[H // 2 :, : W // 8] = frame.depth[H // 2 :, : W // 8]
        return replace(frame, depth=depth)

    assert examine(changed(far)).compared


def test_frames_without_anything_usable_are_named():
    frames = [
        replace(f, depth=np.full((H, W), np.nan, np.float32)) if k == 3 else f for k, f in enumerate(clip().images)
    ]
    found = examine(Kept(frames))
    notes = [finding.sentence for finding in found.findings if finding.name == "nothing usable in some frames"]
    assert notes == ["no pixel of frame_000003.exr has a usable depth"] and not names(found)


@pytest.mark.parametrize(
    ("value", "share"),
    few(
        [(65504, 0.002), ((-3e4, 0), 0.4), ((-W, -H), 0.02), ((-W / 2, -H / 2), 0.4)], (65504, 0.002), ((-W, -H), 0.02)
    ),
    ids=str,
)
def test_vectors_that_were_never_written_are_no_evidence(value, share):
    """... neither for a fault, nor against a fault that there is."""
    found = examine(changed(lambda frame: replace(frame, motion=mostly(frame.motion, value, share, 7))))
    assert not names(found) and found.residuals["given_inliers"] > 0.8  # the others are movers
    (note,) = [finding for finding in found.findings if finding.name == "never written"]
    assert note.kind == "note" and note.figures["share"] == pytest.approx(share, rel=0.6)
    assert share < 0.01 or note.figures["value"] == np.broadcast_to(value, 2).tolist()
    negated = changed(lambda frame: replace(frame, motion=mostly(-frame.motion, value, share, 7)))
    assert names(examine(negated)) == ["motion: negated"]
    assert quick_warning(negated)


def test_a_common_motion_inside_the_image_is_motion():
    """Sky under a camera that turns has one vector nearly everywhere."""
    found = examine(changed(lambda frame: replace(frame, motion=mostly(frame.motion, (2.5, 0.5), 0.2))))
    assert not [finding for finding in found.findings if finding.name == "never written"]
