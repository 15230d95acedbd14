"""Frames that were recorded twice, and worlds whose origin was shifted, are no cuts."""

from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import COUNT, assert_restored, clip, names, written

from gffe_cl import open_sequence
from gffe_cl.captures.doctor import Repair, examine, selected, warning_of, write_repaired
from gffe_cl.lab.fault_injection import Kept


def moved(x, y, z, turn=0.0):
    """The space that follows another one, (4, 4): turned about y by degrees, and moved."""
    angle, made = np.radians(turn), np.eye(4)
    made[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    made[:3, 3] = x, y, z
    return made


def shifted(spaces):
    """The exact clip whose world has another origin from some frames on."""
    frames = []
    for k, frame in enumerate(clip().images):
        matrix = frame.camera.world_to_view
        for start, space in spaces.items():
            matrix = matrix @ np.linalg.inv(space) if k >= start else matrix
        frames.append(replace(frame, camera=replace(frame.camera, world_to_view=matrix), display_camera=None))
    return Kept(frames)


@pytest.mark.long
@pytest.mark.parametrize(
    ("spaces", "said"),
    [
        ({4: moved(-1000, 3, 0.5)}, ["from frame 4 (frame_000004.exr) on all cameras are moved by (-1000, 3, 0.5): "]),
        ({3: moved(0, 0, -4096)}, ["from frame 3 (frame_000003.exr) on all cameras are moved by (0, 0, -4096): "]),
        ({2: moved(7, 0, 7), 6: moved(-7, 0, -7)}, ["are moved by (7, 0, 7)", "are moved by (-7, 0, -7)"]),
        ({5: moved(1, 0, 2, turn=90)}, ["turned by 90° and moved by (1, 0, 2)"]),
    ],
    ids=["floating origin", "rebased", "there and back", "recentered"],
)
def test_a_shift_of_the_worlds_origin_is_no_cut(spaces, said):
    diagnosis = examine(shifted(spaces))
    assert names(diagnosis) == ["camera: origin shifted"] * len(spaces)
    assert all(words in fault.sentence for words, fault in zip(said, diagnosis.faults, strict=True))
    frames = [frame for _, frame in Repair(shifted(spaces), diagnosis).frames()]
    assert_restored(frames)
    assert not any(frame.reset for frame in frames[1:])
    for made, true in zip(frames, clip().images, strict=True):
        np.testing.assert_allclose(made.camera.world_to_view, true.camera.world_to_view, atol=1e-5)


def test_cameras_that_are_off_in_some_frames_are_named_in_the_warning():
    """The median residual is that of the other frames, 0 px, and would not explain the warning."""
    off = list(clip().images)
    off[4] = replace(off[4], camera=off[3].camera, display_camera=None)
    for frames, said in ((shifted({3: moved(0, 0, -4096)}), "origin of the world was shifted"), (Kept(off), "frame 4")):
        diagnosis = examine(frames)
        assert warning_of(diagnosis) == str(diagnosis.faults[0])
        assert said in warning_of(diagnosis)


@pytest.mark.long
def test_one_camera_that_is_off_is_no_shift_of_the_world():
    frames = list(clip().images)
    frames[4] = replace(frames[4], camera=frames[3].camera, display_camera=None)
    diagnosis = examine(Kept(frames))
    assert names(diagnosis) == ["camera: off in one frame"]
    assert "the camera of frame 4 (frame_000004.exr) is that of the frame before" in diagnosis.faults[0].sentence
    repair = Repair(Kept(frames), diagnosis)
    assert_restored([frame for _, frame in repair.frames()])
    between = clip().images[5].camera  # of another time, as that of ground truth
    assert repair.camera(between, 4.5 / 30).world_to_view.tolist() == between.world_to_view.tolist()


def twice(which):
    """The exact clip with some frames recorded twice."""
    frames = [frame for k, frame in enumerate(clip().images) for _ in range(1 + (k in which))]
    return Kept([replace(frame, time=k / 30, reset=k == 0) for k, frame in enumerate(frames)])


@pytest.mark.parametrize(("which", "said"), [((4,), "frame 5 is the same"), ((2, 6), "frames 3, 8 are the same")])
def test_frames_recorded_twice_are_left_out(tmp_path, which, said):
    bad = open_sequence(written(tmp_path / "bad", twice(which)))
    diagnosis = examine(bad)
    assert names(diagnosis) == ["frames: recorded twice"] and said in diagnosis.faults[0].sentence
    assert write_repaired(bad, selected(diagnosis), tmp_path / "fixed") == COUNT
    fixed = open_sequence(tmp_path / "fixed")
    assert examine(fixed).findings == []
    assert_restored([fixed.read(entry) for entry in fixed.rendered])
    assert [entry.time for entry in fixed.rendered] == sorted({e.time for e in bad.rendered} - {
        e.time for k, e in enumerate(bad.rendered) if k in diagnosis.faults[0].figures["frames"]
    })  # fmt: skip


def test_a_color_that_was_recorded_twice_is_named():
    frames = clip().images
    late = [replace(frame, color=frames[k - (k in (3, 7))].color) for k, frame in enumerate(frames)]
    (fault,) = examine(Kept(late)).findings
    assert fault.id == "color-repeated" and fault.sentence.startswith("frames 3, 7 have the color of the frame before")


def test_frames_at_rest_are_not_recorded_twice():
    assert names(examine(clip(False, False))) == []
