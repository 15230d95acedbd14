"""The doctor does no harm: cameras that rest, gaps and cuts raise no false alarm, and a
repair that makes a frame worse is refused."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from doctor_clips import H, W, clip, made_world, motion_of, names, written
from synthetic import camera

import gffe_cl as gffe_api
from gffe_cl.captures.doctor import Repair, examine, quick_warning
from gffe_cl.captures.doctor.hypotheses.depths import RANGE, DepthReading
from gffe_cl.captures.doctor.hypotheses.motions import MotionReading
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.fault_injection import Kept, broken

RESTS = (0, 0, 0, 1, 1, 1, 1, 1, 2, 3, 3, 3)  # for each frame: how far the camera is


@cache
def resting():
    """Frames of a moving rectangle; the camera moves before three of them."""
    world, frames, before = made_world(), [], None
    for k, at in enumerate(RESTS):
        view = camera(W, H, (0.09 * at, 0.03 * at, 0.06 * at), yaw=0.012 * at)
        frames.append(world.frame(view, k / 30, W, H, before, reset=k == 0, samples=2))
        before = view, k / 30
    return Kept(frames)


def repaired(bad):
    diagnosis = examine(bad)
    repair = Repair(bad, diagnosis)
    frames = [frame for _, frame in repair.frames()]
    repair.refuse_harm()
    return diagnosis, frames


def test_a_camera_that_mostly_rests_raises_no_alarm():
    findings = examine(resting()).findings
    assert not {"fault", "note"} & {finding.kind for finding in findings}, findings
    assert quick_warning(resting()) is None


@pytest.mark.parametrize(
    ("fault", "name"),
    [("motion negated", "motion: negated"), ("motion without the camera", "motion: without the camera")],
)
def test_of_a_camera_that_mostly_rests_faults_are_found_where_it_moves(fault, name):
    diagnosis, frames = repaired(broken(resting(), [fault]))
    assert names(diagnosis) == [name]
    np.testing.assert_allclose(motion_of(frames), motion_of(resting().images), atol=0.1)


def test_a_dropped_frame_is_a_gap_and_no_cut():
    diagnosis, frames = repaired(broken(clip(), ["frame dropped", "motion negated"]))
    assert names(diagnosis) == ["motion: negated", "frames: gap"]
    assert diagnosis.faults[1].figures["frame"] == 4
    assert [frame.reset for frame in frames] == [k in (0, 4) for k in range(8)]


@pytest.mark.parametrize(("rest", "late"), [(5, True), (8, False)])
def test_a_frame_dropped_while_the_camera_rests_is_late(rest, late):
    """Movers alone could tell it: it is a note, for times that are regular otherwise."""
    frames = [frame for k, frame in enumerate(resting().images) if k != rest]
    diagnosis = examine(Kept(frames))
    notes = {finding.id: finding for finding in diagnosis.findings if finding.kind == "note"}
    assert ("frames-late" in notes) == late
    if late:
        assert names(diagnosis) == [] and notes["frames-late"].figures["frame"] == rest
        assert "comes 2 intervals after the frame before" in notes["frames-late"].sentence
        marked = [replace(frame, reset=frame.reset or k == rest) for k, frame in enumerate(frames)]
        assert "frames-late" not in {finding.id for finding in examine(Kept(marked)).findings}


def test_a_marked_cut_is_named_and_left_out():
    frames = list(clip().images)
    frames[4] = replace(frames[4], motion=np.full((H, W, 2), 50, np.float32), reset=True)
    diagnosis = examine(Kept(frames))
    assert [(finding.kind, finding.id) for finding in diagnosis.findings] == [("note", "frames-reset")]
    assert "frame 4 is a reset" in diagnosis.findings[0].sentence


def mostly_without_camera():
    """One frame has the right vectors."""
    frames = list(broken(clip(), ["motion without the camera"]).images)
    frames[6] = clip().images[6]
    return Kept(frames)


def test_a_repair_that_makes_one_frame_worse_is_refused(gffe, tmp_path):
    bad = written(tmp_path / "bad", mostly_without_camera())
    given = {path.name: path.read_bytes() for path in bad.iterdir()}
    code, text, err = gffe("check", bad, "--fix", tmp_path / "fixed")
    said = " ".join(err.split())
    assert code == 2 and "motion-without-the-camera" in text and "the repair would make frame_000006.exr worse" in said
    assert not (tmp_path / "fixed").exists()
    assert given == {path.name: path.read_bytes() for path in bad.iterdir()}


def test_a_repair_that_explains_nothing_better_is_refused():
    """A diagnosis that is wrong in all frames, and one that changes nothing that could be seen."""
    diagnosis = examine(clip())
    for reading, words in (
        (Reading(MotionReading(("without the camera",), adds_camera=True)), "worse"),
        (Reading(MotionReading(("twice too long",), factor=1.0)), "not clearly better: only 0 of the 8 frames"),
    ):
        wrong = replace(diagnosis, reading=reading, best=replace(diagnosis.best, reading=reading))
        repair = Repair(clip(), wrong)
        assert len(list(repair.frames())) == len(clip().images)
        with pytest.raises(GffeError, match=words):
            repair.refuse_harm()


@pytest.mark.parametrize("more", [(), ("in UV",)])
def test_combinations_are_named_as_people_say_them(more):
    scale = (1 / W, 1 / H) if more else (1, 1)
    bad = Kept([replace(f, motion=f.motion * np.float32((-scale[0], scale[1]))) for f in clip().images])
    expected = ["negated", "y flipped", *more]
    assert names(examine(bad)) == [f"motion: {name}" for name in expected]
    said = gffe_api.check(bad.images)
    assert f"most likely motion {', '.join(expected)}; `gffe check FOLDER` tells more" in said


def test_depths_that_no_depth_buffer_has_are_no_explanation(monkeypatch):
    """Their repair would be that of another finding."""
    search = Search(list(examine(clip()).looks))
    made = [Reading(depth=DepthReading(RANGE, (0.3, factor))) for factor in (2.0, -2.0)]
    monkeypatch.setattr(search, "_joint", lambda *_: made)
    found = [verdict.reading.depth.coefficients for verdict in search.candidates()]
    assert (0.3, 2.0) in found and (0.3, -2.0) not in found


def test_the_order_of_repairs_in_the_report(gffe, tmp_path):
    """A gap can be named to --only, like all that is repaired."""
    bad = written(tmp_path / "bad", broken(clip(), ["frame dropped"]))
    out = tmp_path / "fixed"
    code, text, _ = gffe("check", bad, "--fix", out, "--only", "frames-gap", "--json", tmp_path / "said.json")
    assert code == 1 and "it fits now" in text
    assert json.loads((tmp_path / "said.json").read_text())["changed"] == ["frames-gap"]
    assert [entry.reset for entry in open_sequence(out).rendered] == [k in (0, 4) for k in range(8)]


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_vectors_of_single_frames_that_are_multiples(factor):
    """The sentence says how long they are, and of short ones that a frame may be missing."""
    frames = list(clip().images)
    frames[4] = replace(frames[4], motion=frames[4].motion * np.float32(factor))
    (finding,) = [one for one in examine(Kept(frames)).findings if one.id == "frames-gap"]
    assert f"they are {factor:.2f} times as long as by depth and cameras" in str(finding)
    assert ("missing" in str(finding)) == (factor < 1)
