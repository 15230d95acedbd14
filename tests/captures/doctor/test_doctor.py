"""The doctor names what is wrong and repairs it; good sequences raise no alarm."""

from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import COUNT, H, W, assert_restored, clip, made_world, names, tiled, written
from parameters import few
from synthetic import Rect, Rects, camera

from gffe_cl.captures.doctor import Repair, examine, quick_warning
from gffe_cl.captures.doctor.hypotheses.sampling import grid
from gffe_cl.captures.doctor.hypotheses.transfer_function import Votes
from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.lab.fault_injection import BREAKS, HARMLESS, Kept, broken


def repaired(names_of_faults):
    bad = broken(clip(), names_of_faults)
    diagnosis = examine(bad)
    return diagnosis, [frame for _, frame in Repair(bad, diagnosis).frames()]


@pytest.mark.parametrize("change", HARMLESS)
def test_good_sequences_raise_no_alarm(change):
    changed = broken(clip(), [change])
    diagnosis = examine(changed)
    assert names(diagnosis) == [] and quick_warning(changed) is None
    assert change != "as it is" or diagnosis.findings == []


def encoded(text):
    encoding, frames = Encoding.parse(text), clip().images
    return Kept([encoding.frame(frame) for frame in frames])


CODES = {
    "half-uv": ((1.875, 0.9375, 1.0547, 0.5273), "half floats of 0.5 + 0.5 · uv at 1920×1080"),
    "unorm16": ((0.0586, 0.0586, 0.0330, 0.0330), "16 bits of 0.5 + 0.5 · uv at 1920×1080"),
    "rounded": ((1, 1, 1, 1), ""),
}


@pytest.mark.parametrize("code", CODES)
def test_it_names_how_motion_was_quantized(code):
    steps, name = CODES[code]
    (note,) = examine(encoded(code)).of_kind("note")
    found = [note.figures.get(key, np.nan) for key in ("x", "negative x", "y", "negative y")]
    known = np.isfinite(found)
    assert known.any() and np.allclose(np.array(found)[known], np.array(steps)[known], rtol=0.01)
    assert note.id == "motion-quantized" and note.figures["code"] == name and not note.figures["added"]


def test_it_names_sums_of_quantized_motion():
    encoding, frames = Encoding.parse("rounded"), clip().images
    sums = [replace(frame, motion=encoding.looked_up([frame.motion / 2] * 2)) for frame in frames]
    (note,) = examine(Kept(sums)).of_kind("note")
    assert note.id == "motion-quantized" and note.figures["added"] and "sums of two" in note.sentence


@pytest.mark.parametrize(("part", "found"), [("half-depth", "depth-half-floats"), ("8bit-color", "color-8-bits")])
def test_it_names_other_encodings(part, found):
    assert [finding.id for finding in examine(encoded(part)).findings] == [found]


def test_it_names_display_values_of_8_bits_that_are_read_as_linear():
    frames = [replace(f, color=(np.round(255 * f.color.clip(0, 1)) / 255).astype(np.float32)) for f in clip().images]
    (note,) = examine(Kept(frames)).findings
    assert note.id == "color-8-bits-linear" and '"encoding": "srgb"' in note.sentence


def test_movers_decide_nothing_where_the_exposure_changes():
    assert names(examine(broken(clip(False, False), ["exposure fades in"]))) == []


@pytest.mark.parametrize(("moves", "turns", "about"), [(False, True, "rotation only"), (False, False, "still camera")])
def test_it_says_what_it_cannot_tell(moves, turns, about):
    diagnosis = examine(clip(moves, turns))
    assert names(diagnosis) == []
    assert about in [finding.name for finding in diagnosis.of_kind("cannot tell")]


NAMED = {
    "motion negated": "motion: negated",
    "motion in NDC": "motion: in NDC",
    "motion to the next frame": "motion: to the next frame",
    "motion jitter not removed": "motion: jitter not removed",
    "motion without the camera": "motion: without the camera",
    "depth reversed": "depth: reversed",
    "depth along rays": "depth: along rays",
    "camera transposed": "camera: rotation transposed",
    "camera in centimeters": "depth: units",
    "camera field of view": "camera: field of view",
    "two frames swapped": "frames: out of order",
    "depth range misread": "depth: range",
    "color rows": "color: bottom-up",
    "depth rows": "depth: bottom-up",
    "motion rows": "motion: bottom-up",
}


SEEN = ("motion negated", "motion to the next frame", "depth reversed", "camera transposed", "two frames swapped")


@pytest.mark.parametrize("fault", few(NAMED, *SEEN, "motion rows"))
def test_a_fault_is_named_and_repaired(fault):
    diagnosis, frames = repaired([fault])
    assert names(diagnosis) == [NAMED[fault]]
    assert_restored(frames)


def test_a_camera_that_moves_sideways_has_no_second_fault():
    """Its axes could be OpenGL's as well, which is no reason to change them."""
    rng, frames, before = np.random.default_rng(5), [], None
    rects = [Rect((0, 8, 24), (40, 14), frequency=0.35)]  # far surfaces are higher in the picture
    for _ in range(8):
        tint = tuple(rng.uniform(0.2, 0.8, 3))
        rects.append(
            Rect((rng.uniform(-4, 4), -rng.uniform(0.5, 2.5), rng.uniform(4, 9)), (1.0, 0.8), frequency=0.6, tint=tint)
        )
    for k in range(COUNT):
        view = camera(W, H, (0.12 * k + 0.015 * k * k, 0, 0))
        frames.append(Rects(rects).frame(view, k / 30, W, H, before, reset=k == 0, samples=2))
        before = view, k / 30
    assert not examine(Kept(frames)).faults
    assert names(examine(broken(Kept(frames), ["motion negated"]))) == ["motion: negated"]


PAIRS = [("motion y flipped", "camera OpenGL axes"), ("motion in UV", "depth device")]


@pytest.mark.parametrize("pair", PAIRS, ids=" + ".join)
def test_two_faults_at_once_are_repaired(pair):
    diagnosis, frames = repaired(pair)
    assert len(diagnosis.faults) == 2
    assert_restored(frames)


ALL_ROWS = ["color: bottom-up", "depth: bottom-up", "motion: bottom-up"]


def test_buffers_from_the_bottom_up_are_turned_and_not_explained_by_axes():
    """The world's y is down and there is no sky: that the mirror image fits as well is said, too."""
    diagnosis, frames = repaired(["all rows"])
    assert names(diagnosis) == ALL_ROWS
    assert_restored(frames)
    (doubt,) = diagnosis.of_kind("cannot tell")
    assert doubt.name == "upside down" and "motion-y-flipped, camera-y-up" in doubt.sentence


def with_y_up(kept):
    """The same pictures of a world whose y is up."""
    turn = np.diag([1.0, -1, -1, 1])
    cameras = [replace(f.camera, world_to_view=f.camera.world_to_view @ turn) for f in kept.images]
    return Kept([replace(f, camera=c) for f, c in zip(kept.images, cameras, strict=True)])


def test_the_world_tells_rows_from_the_bottom_up_from_y_up():
    good = with_y_up(clip())
    for faults, expected in (
        (["all rows"], ALL_ROWS),
        (["all rows", "motion y flipped"], [*ALL_ROWS, "motion: y flipped"]),
        (["motion y flipped", "camera y up"], ["motion: y flipped", "camera: y up"]),
    ):
        diagnosis = examine(broken(good, faults))
        assert names(diagnosis) == expected and diagnosis.of_kind("cannot tell") == []


@pytest.mark.long
@pytest.mark.parametrize("fault", sorted(set(BREAKS) - {*NAMED, "color tone-mapped", "all rows"}))
def test_every_other_fault_is_repaired(fault):
    diagnosis, frames = repaired([fault])
    assert len(diagnosis.faults) == 1
    if fault == "motion zero":  # what moved by itself is lost
        assert names(diagnosis) == ["motion: zero"]
        return
    assert_restored(frames)


def test_near_and_far_are_found():
    (fault,) = examine(broken(clip(), ["depth device"])).faults
    assert fault.figures["near"] == pytest.approx(0.1, rel=1e-2) and not fault.figures["reversed"]


def test_a_cut_is_found():
    frames = list(clip().images)
    away = [camera(W, H, (9, 1, -6), yaw=0.4 + 0.03 * k) for k in range(COUNT)]
    before = None
    for k in range(5, COUNT):
        made = made_world().frame(away[k], frames[k].time, W, H, before, samples=2)
        made.motion = np.roll(frames[k].motion, 9, axis=1) if before is None else made.motion
        before = away[k], frames[k].time
        frames[k] = made
    diagnosis = examine(Kept(frames))
    assert names(diagnosis) == ["frames: cut"] and diagnosis.faults[0].figures["frame"] == 5


def test_bad_pixels_are_a_note_that_says_where():
    frames = list(clip().images)
    color = frames[4].color.copy()
    color[7, 11] = np.nan
    frames[4] = type(frames[4])(color, frames[4].depth, frames[4].motion, frames[4].camera, frames[4].time)
    diagnosis = examine(Kept(frames))
    assert names(diagnosis) == []
    assert any("color in frame_000004.exr at 11, 7" in finding.sentence for finding in diagnosis.findings)


def said_of_color(kept):
    return [(finding.kind, finding.name) for finding in examine(kept).findings if finding.about == "color"]


def test_display_values_are_told_by_silhouettes_alone():
    """Textures that are filtered before they are made linear look like display values, silhouettes do not."""
    assert said_of_color(tiled(1)) == []
    antialiased = tiled(3)
    assert said_of_color(antialiased) == []
    assert said_of_color(broken(antialiased, ["color tone-mapped"])) == [("fault", "display values")]


VOTES = [((90, 100, 150, 300), "display values"), ((60, 100, 150, 300), "doubtful")]
VOTES += [((40, 100, 150, 300), ""), ((90, 100, 150, 900), ""), ((30, 30, 50, 100), "")]


@pytest.mark.parametrize(("votes", "verdict"), VOTES)
def test_an_inconclusive_share_is_doubtful_and_without_antialiasing_nothing_is_said(votes, verdict):
    assert Votes(*votes).verdict == verdict


@pytest.mark.parametrize("size", [(1, 1), (7, 300), (120, 68), (1920, 1080)])
def test_the_grid_stays_inside(size):
    x, y = grid(size, 500)
    assert len(x) and x.min() >= 0 and y.min() >= 0 and x.max() < size[0] and y.max() < size[1]


def test_what_cannot_be_opened_keeps_its_own_message(gffe, tmp_path):
    code, text, err = gffe("check", tmp_path / "nowhere")
    assert code == 2 and "no such folder" in err and text == ""


def test_a_run_warns_of_what_does_not_fit(gffe, tmp_path):
    bad = written(tmp_path / "bad", broken(clip(), ["motion negated"]))
    code, _, err = gffe("run", bad, tmp_path / "a", "--no-scn", checked=True)
    said = " ".join(err.split())
    assert code == 0 and "warning: motion vectors do not fit depth and cameras (median" in said
    assert f"`gffe check {bad}` has details" in said
    code, _, err = gffe("run", bad, tmp_path / "b", "--no-scn", "--no-check", checked=True)
    assert code == 0 and "do not fit" not in err


def test_the_quick_form_warns():
    warning = quick_warning(broken(clip(), ["motion negated"]))
    assert warning and "do not fit depth and cameras (median" in warning
    assert quick_warning(broken(clip(), ["camera inverted"]))
    for buffer in ("color", "depth", "motion"):
        assert quick_warning(broken(clip(), [f"{buffer} rows"])) == f"{buffer} is upside down against the other buffers"
    assert "does not fit the rows" in quick_warning(broken(clip(), ["all rows"]))
