"""The doctor on short exact clips: harmless properties, what it cannot tell, the command, and the quick form."""

import json
from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import H, W, clip, frames_of, made_world, view_at, written
from fault_injection import HARMLESS, Kept, broken
from mistakes import MISTAKES, views_of_one_scene
from synthetic import camera

import gffe_cl as gffe_api
from gffe_cl.captures.doctor import FoundFormat, examine, with_format
from gffe_cl.captures.sequence import FrameEntry, open_sequence
from gffe_cl.captures.sequence.engine_form import static_motion
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.frame_format import FrameFormat


def names(diagnosis):
    return [one.name for one in diagnosis.findings]


@pytest.mark.parametrize("change", HARMLESS)
def test_good_sequences_raise_no_alarm(change):
    found = examine(broken(clip(), [change]))
    assert not found.faults and found.verdict == "fits" and found.given.fits


@pytest.mark.parametrize(("moves", "turns"), [(False, True), (False, False)])
def test_it_says_what_it_cannot_tell(moves, turns):
    found = examine(clip(moves, turns))
    (doubt,) = found.findings
    assert doubt.name == "still-camera" and doubt.turns == turns and doubt.kind == "cannot tell"


EMPTY = {
    "depth": lambda f: replace(f, depth=np.full_like(f.depth, np.inf)),
    "motion": lambda f: replace(f, motion=np.full_like(f.motion, np.nan)),
    "color": lambda f: replace(f, color=np.full_like(f.color, np.nan)),
}


@pytest.mark.parametrize("buffer", EMPTY)
def test_nothing_to_compare_is_a_fault(buffer):
    found = examine(Kept([EMPTY[buffer](frame) for frame in clip().images]))
    assert [one.buffer for one in found.faults] == [buffer] and found.verdict == "faults" and found.given is None


def test_bad_pixels_are_a_note_that_says_where():
    frames = list(clip().images)
    color = np.array(frames[3].color)
    color[5, 7] = np.nan
    found = examine(Kept([*frames[:3], replace(frames[3], color=color), *frames[4:]]))
    (note,) = found.findings
    assert note.places == {"color": (3, 7, 5)} and "color in frame_000003.exr at 7, 5" in str(note)


class WithTruth(Kept):
    """The clip, or a slower one, with ground truth half way between its frames, of which some show another time."""

    def __init__(self, shown, speed=1.0):
        super().__init__(list(clip().images) if speed == 1 else frames_of(lambda k: view_at(speed * k)))
        self._speed = speed
        self._shown = [shown(k) for k in range(len(self.frames) - 1)]
        self.ground_truth = [
            FrameEntry(f"truth_{k}.exr", (k + 0.5) / 30, "ground_truth", display_camera=view_at(speed * (k + 0.5)))
            for k in range(len(self._shown))
        ]

    def read_color(self, entry):
        at = self._shown[self.ground_truth.index(entry)] + 0.5
        return made_world().frame(view_at(self._speed * at), at / 30, W, H, None, reset=True, samples=2).color


@pytest.mark.parametrize(("shown", "found"), [
    (lambda k: k, {}),
    (lambda k: {3: 5, 5: 3}.get(k, k), {2.0: (3,), -2.0: (5,)}),
    (lambda k: min(k + 1, 7), {1.0: tuple(range(7))}),
])  # fmt: skip
def test_ground_truth_of_another_time_is_named(shown, found):
    notes = [one for one in examine(WithTruth(shown)).findings if one.name == "truth-of-another-time"]
    assert {one.by: one.frames for one in notes} == found and all("truth_3.exr" in str(one) for one in notes[:1])
    assert all("better 1 interval later, along" in str(one) for one in notes if one.by == 1)


def test_ground_truth_is_not_blamed_for_slow_motion_or_for_other_faults():
    """A quarter of a pixel is not told from the blur of what is sampled between pixels."""
    assert "truth-of-another-time" not in names(examine(WithTruth(lambda k: k + 0.5, speed=0.2)))
    stale = WithTruth(lambda k: k)
    stale.images[4] = replace(stale.images[4], color=stale.images[3].color)
    assert names(examine(stale)) == ["repeated-color"]


def test_a_camera_of_the_frame_before_is_one_fault():
    frames = list(clip().images)
    frames[4] = replace(frames[4], camera=frames[3].camera)
    (fault,) = examine(Kept(frames)).faults
    assert (fault.name, fault.frame) == ("unexplained-frame", 4) and "has the camera of the frame before" in str(fault)


def test_uneven_times_are_a_note():
    frames = [replace(frame, time=frame.time + 0.01 * (k >= 5)) for k, frame in enumerate(clip().images)]
    (note,) = examine(Kept(frames)).findings
    assert (note.name, note.kind, note.frames) == ("uneven-times", "note", (5,))
    assert str(note) == "frames: times are not even: frame 5 comes 43.3 ms after the one before, others 33.3 ms"


def test_a_camera_that_mirrors_the_picture_is_not_told_without_a_sky():
    """A world without sky or ground: y-up cameras and rows from below with y-up vectors are the same evidence."""
    found = examine(Kept(MISTAKES["y-up axes"].change(clip().images)))
    (doubt,) = found.findings
    assert doubt.name == "ambiguous" and found.found is None
    assert 'convention="direct3d"' in doubt.causes and 'rows="up" with motion_y="up"' in doubt.causes


def test_it_names_the_half_that_shows_another_view():
    (fault,) = examine(Kept(views_of_one_scene(clip().images))).faults
    assert fault.name == "unexplained" and fault.where == " in the right half of the picture"


def test_steady_motion_does_not_tell_late_cameras_from_a_missing_frame():
    frames = frames_of(lambda k: camera(W, H, (0.1 * k, 0, 0)), 8)
    late = MISTAKES["camera of the frame before"].change(frames)
    found = examine(Kept(late))
    assert names(found) == ["misfit-at-end"] and found.findings[0].frame == 1
    assert "nothing tells whether a frame is missing" in gffe_api.check(late) and found.verdict == "faults"


def test_the_command_finds_a_format_and_import_converts_by_it(gffe, tmp_path):
    good = written(tmp_path / "good", clip())
    code, text, err = gffe("check", good, "--json", tmp_path / "good.json")
    assert (code, err) == (0, "") and json.loads((tmp_path / "good.json").read_text())["verdict"] == "fits"
    bad = written(tmp_path / "bad", broken(clip(), ["motion negated", "depth in centimeters"]))
    found = tmp_path / "found.json"
    code, text, _ = gffe("check", bad, "--format-out", found, "--json", tmp_path / "bad.json")
    assert code == 1 and 'motion_direction="from_previous"' in text and "depth_scale=0.01" in text
    document = json.loads((tmp_path / "bad.json").read_text())
    assert document["verdict"] == "faults" and document["format"] == json.loads(found.read_text())
    assert document["format"] == {"frame_format": {"motion_direction": "from_previous", "depth_scale": 0.01}}
    assert [one["id"] for one in document["findings"]] == ["motion-direction", "depth-scale"]
    assert document["residuals"]["given"]["median"] > 1 > 0.05 > document["residuals"]["read"]["median"]
    code, _, _ = gffe("import", bad, tmp_path / "made", "--format", found)
    assert code == 0 and gffe("check", tmp_path / "made")[0] == 0
    for one, other in zip(open_sequence(tmp_path / "made"), open_sequence(good), strict=True):
        assert np.array_equal(one.motion, other.motion)
        np.testing.assert_allclose(one.depth, other.depth, rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "no JSON"),
        ('{"depth": 1}', 'format: unknown key "depth" (expected some of frame_format, files, cameras)'),
        ('{"cameras": {"convention": "blender"}}', "format: cameras, convention must be one of gffe, opengl, direct3d"),
        ('{"files": {"motion": {"frame_offset": 0.5}}}', "format: motion, frame_offset"),
        ('{"files": {"motion": {"frame_offset": 9}}}', "no rendered frame is left with these frame offsets"),
    ],
)
def test_a_wrong_format_is_refused(gffe, tmp_path, text, message):
    (tmp_path / "found.json").write_text(text)
    code, _, error = gffe(
        "import", written(tmp_path / "in", clip()), tmp_path / "out", "--format", tmp_path / "found.json"
    )
    assert code == 2 and message in " ".join(error.split())


def test_fields_of_a_given_format_are_replaced():
    """Frames that were read with a wrong format: the finding has the right values of its fields."""
    declared = FrameFormat(motion_direction="from_previous", motion_y="up", motion_unit="uv", depth_scale=100)
    frames = [replace(f, motion=f.motion * np.float32((1 / W, -1 / H)), depth=f.depth / 50) for f in clip().images]
    said = gffe_api.check(frames, format=declared)
    assert 'motion: motion_direction="to_previous"' in said and "depth: depth_scale=50" in said
    assert gffe_api.check(frames, format=replace(declared, motion_direction="to_previous", depth_scale=50)) is None


def test_jitter_that_a_conversion_adds_is_not_judged_with_the_vectors():
    """Wrong vectors of a jittered geometry have one fault."""
    jitters = [(0.25 * (-1) ** k, 0.4 * np.sin(2.3 * k)) for k in range(len(clip().images))]
    declared, frames = FrameFormat(motion_jittered=True), []
    for k, frame in enumerate(clip().images):
        moved = np.subtract(jitters[k], jitters[max(k - 1, 0)])
        frames.append(replace(frame, motion=moved.astype(np.float32) - frame.motion, geometry_jitter=jitters[k]))
    said = gffe_api.check(frames, format=declared)
    assert said.startswith('motion: motion_direction="from_previous"; `gffe check')
    assert gffe_api.check(frames, format=replace(declared, motion_direction="from_previous")) is None


def test_vectors_of_movers_alone_in_a_code_around_the_middle():
    """As Unreal stores them: 0, which is no code of a vector, where the camera's motion is meant."""
    frames = []
    for before, frame in zip([clip().images[0], *clip().images], clip().images, strict=False):
        still = static_motion(frame.depth.astype(np.float64), frame.camera, before.camera)[0]
        moves = np.linalg.norm(frame.motion - still, axis=-1, keepdims=True) > 0.05
        code = np.round((frame.motion / (W / 2, -H / 2) * 0.2495 + 0.5) * 65535) / 65535
        frames.append(replace(frame, motion=np.where(moves, code, 0).astype(np.float32)))
    scale = {"motion_scale": (1 / 0.2495,) * 2, "motion_offset": (-0.5 / 0.2495,) * 2}
    declared = FrameFormat(motion_unit="ndc", motion_y="up", **scale)
    assert gffe_api.check(frames, format=declared).startswith('motion: camera_motion="movers_only", motion_invalid=0;')
    assert gffe_api.check(frames, format=replace(declared, camera_motion="movers_only", motion_invalid=0.0)) is None


def test_frame_offsets_reset_after_frames_that_are_left_out(tmp_path):
    frames = [replace(frame, reset=k in (0, 4)) for k, frame in enumerate(clip().images)]
    opened = open_sequence(written(tmp_path / "in", Kept(frames)))
    made = with_format(opened, FoundFormat(frame_offset={"depth": 1}))
    assert [entry.time for entry in made.rendered] == [frames[k].time for k in (0, 1, 2, 4, 5, 6, 7)]
    assert [entry.reset for entry in made.rendered] == [True, False, False, True, False, False, False]
    assert np.array_equal(made.read(made.rendered[1]).depth, frames[2].depth)


def test_frames_in_memory_are_examined_as_a_sequence_is(gffe, tmp_path):
    bad = Kept(MISTAKES["from previous"].change(clip().images))
    assert gffe_api.check(clip().images) is None and gffe_api.check([]) is None
    said = gffe_api.check(bad.images)
    assert said.startswith('motion: motion_direction="from_previous"; `gffe check FOLDER` tells more')
    code, text, _ = gffe("check", written(tmp_path / "in", bad))
    assert code == 1 and said.partition(";")[0] in text and text.count("fault ") == 1
    alone = gffe_api.check(clip().images[:1])
    assert alone.startswith("cannot tell whether the frames fit: no rendered frame of 8 pixels or more has one before")


def test_a_run_warns_of_what_does_not_fit(gffe, tmp_path):
    bad = written(tmp_path / "bad", broken(clip(), ["motion negated"]))
    code, _, error = gffe("run", bad, tmp_path / "out", "--no-scn", checked=True)
    assert code == 0 and 'motion_direction="from_previous"' in error and "`gffe check" in error


def test_what_cannot_be_opened_keeps_its_own_message(gffe, tmp_path):
    code, _, error = gffe("check", tmp_path / "none")
    assert code == 2 and "no such folder" in error


def test_an_unknown_key_of_a_format_is_an_error():
    with pytest.raises(GffeError, match="unknown field 'depht'"):
        FoundFormat.from_json({"frame_format": {"depht": 1}})


def with_interface():
    """The clip with a panel and a frame over its color."""
    frames = []
    for frame in clip().images:
        color = frame.color.copy()
        color[6:26, 8:40], color[44:60, 70:112] = (0.9, 0.7, 0.1), (0.05, 0.2, 0.6)
        frames.append(replace(frame, color=color))
    return Kept(frames)


def test_a_run_detects_a_user_interface(gffe, tmp_path):
    """... unless it may not; and not where there is none."""
    hud, plain = written(tmp_path / "hud", with_interface()), written(tmp_path / "good", clip())
    made = {}
    for name, folder, options in (
        ("auto", hud, ()),
        ("off", hud, ("--ui-detection", "off")),
        ("plain", plain, ()),
    ):
        code, text, error = gffe("run", folder, tmp_path / name, "--no-scn", *options, checked=True)
        assert code == 0, error
        assert ("user interface detection is on" in text) == (name == "auto")
        sequence = open_sequence(tmp_path / name)
        made[name] = [sequence.read_color(entry) for entry in sequence.frames if entry.kind == "extrapolated"]

    def alike(one, other):
        return all(np.array_equal(a, b) for a, b in zip(made[one], made[other], strict=True))

    assert not alike("auto", "off")
    code, _, error = gffe("run", hud, tmp_path / "wrong", "--ui-detection", "maybe")
    assert code == 2 and "--ui-detection must be one of auto, on, off" in " ".join(error.split())
