"""Mistakes of live integrations are named rightly or not at all, by `gffe.check` as by `gffe check`."""

import functools

import numpy as np
import pytest
from doctor_clips import H, W, written
from mistakes import FPS, JITTERED, MISTAKES, good_frames
from parameters import few

import gffe_cl as gffe_api
from gffe_cl.captures.doctor import Repair, examine, warning_of
from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.engine.frame.window import Jitter
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.lab.fault_injection import Kept

TABLE = {
    name: (lambda plain, jittered, change=change: change(plain), fault) for name, (change, fault) in MISTAKES.items()
}
TABLE |= JITTERED
_IN_MEMORY = "; `gffe check FOLDER` tells more, of frames stored with gffe.SequenceWriter"


@functools.cache
def examined(mistake):
    """Frames with the mistake, and the diagnosis, which several tests ask for."""
    bad = Kept(TABLE[mistake][0](*good_frames()))
    return bad, examine(bad)


def faults(diagnosis):
    return [finding.id for finding in diagnosis.faults]


# By what the name is found: cameras, depth, colors, vectors, jitter, a scale, and none.
SEEN = ["camera of the frame before", "depth of the frame after", "color of the frame before", "vectors negated"]
SEEN += ["cameras jittered, color antialiased", "vectors without jitter", "jitter of cameras with y up"]
SEEN += ["vertical angle for horizontal", "near plane mistaken", "frame dropped", "red for blue"]


@pytest.mark.parametrize("mistake", few(TABLE, *SEEN))
def test_a_mistake_has_its_name(mistake):
    (_, fault), (_, found) = TABLE[mistake], examined(mistake)
    assert faults(found) == ([fault] if fault else [])
    said = warning_of(found)
    assert (said is None) == (not fault)
    _, _, name = fault.partition("-")
    assert not fault or name.replace("-", " ") in said.lower().replace("-", " ") or fault == "frames-gap"
    assert "jitter" not in fault or ("or in the cameras, alone" in said) == ("sign" not in fault)


@pytest.mark.parametrize("is_jittered", [False, True])
def test_frames_without_a_mistake_have_no_name(is_jittered):
    frames = good_frames()[is_jittered]
    assert examine(Kept(frames)).findings == [] and gffe_api.check(frames) is None


def test_frames_in_memory_are_examined_as_a_sequence_is(gffe, tmp_path):
    mistake = "camera of the frame before"
    bad, diagnosis = examined(mistake)
    assert gffe_api.check(bad.images) == warning_of(diagnosis) + _IN_MEMORY
    code, text, _ = gffe("check", written(tmp_path / "in", bad))
    assert code == 1 and TABLE[mistake][1] in text and text.count("fault ") == 1


def test_one_frame_is_not_said_to_fit():
    said = gffe_api.check(good_frames()[0][:1])
    assert said.startswith(
        "cannot tell whether the frames fit: no rendered frame of 8 pixels or more has one before it"
    )
    assert gffe_api.check([]) is None


def close(made, true):
    return (np.linalg.norm(made - true, axis=-1) < 0.1).mean() > 0.95


OTHER_FRAMES = [
    f"{buffer} of the frame {side}" for buffer in ("camera", "depth", "color") for side in ("before", "after")
]


@pytest.mark.parametrize("name", few(OTHER_FRAMES, *set(SEEN) & set(OTHER_FRAMES)))
def test_buffers_of_another_frame_go_back(name):
    good = good_frames()[0]
    repair = Repair(*examined(name))
    made = [frame for _, frame in repair.frames()]
    repair.refuse_harm()
    left = good[:-1] if name.endswith("before") else good[1:]
    assert [frame.time for frame in made] == [frame.time for frame in left]
    assert [frame.reset for frame in made] == [True] + [False] * (len(left) - 1)
    for frame, true in zip(made, left, strict=True):
        assert all((getattr(frame, part) == getattr(true, part)).all() for part in ("color", "depth"))
        assert frame.camera == true.camera


@pytest.mark.parametrize("mistake", few(JITTERED, *set(SEEN) & set(JITTERED)))
def test_jitter_is_repaired(mistake):
    """Where color is antialiased all jitter goes, else it comes back."""
    plain, jittered = good_frames()
    made = [frame for _, frame in Repair(*examined(mistake)).frames()]
    good = plain if "antialiased" in mistake or "alone" in mistake else jittered
    for frame, true in zip(made[1:], good[1:], strict=True):
        assert close(frame.motion, true.motion)
    shifts = [(a.camera.cx - b.camera.cx, a.camera.cy - b.camera.cy) for a, b in zip(made, good, strict=True)]
    assert np.ptp(shifts, axis=0).max() < 0.05


def test_a_late_camera_is_repaired_on_disk(gffe, tmp_path):
    bad = written(tmp_path / "in", Kept(MISTAKES["camera of the frame before"][0](good_frames()[0])))
    code, text, _ = gffe("check", bad, "--fix", tmp_path / "out")
    assert code == 1 and "it fits now" in text
    made = open_sequence(tmp_path / "out").rendered
    assert [entry.render_camera for entry in made] == [frame.camera for frame in good_frames()[0][:-1]]
    code, _, _ = gffe("check", bad, "--fix", tmp_path / "other", "--except", "camera-one-frame-late")
    assert (tmp_path / "other").exists() and code == 1


def test_steady_motion_does_not_tell_late_cameras_from_a_missing_frame():
    """... and nothing is claimed. The camera moves evenly: only the first frame does not fit."""
    from doctor_clips import made_world
    from synthetic import camera

    frames, before = [], None
    for k in range(8):
        view = camera(W, H, (0.1 * k, 0, 0))
        frames.append(made_world().frame(view, k / 30, W, H, before, reset=k == 0, samples=2))
        before = view, k / 30
    late = MISTAKES["camera of the frame before"][0](frames)
    found = examine(Kept(late))
    assert faults(found) == []
    (doubt,) = [finding for finding in found.findings if finding.name == "misfit at the end"]
    assert doubt.kind == "cannot tell" and "one frame late" in doubt.sentence
    assert gffe_api.check(late).startswith("cannot tell whether the frames fit: why frame 1")


@pytest.mark.long
@pytest.mark.parametrize(("scene", "seed"), [("gallery", 6), ("street", 5), ("factory", 5), ("courtyard", 6)])
def test_no_mistake_has_a_wrong_name(scene, seed):
    """Scenes that served for no threshold: a mistake is named rightly, or it cannot be told."""
    loaded, size, device = load_scene(scene, seed), (240, 136), open_device()
    both = [
        list(SceneFrames(SceneRenderer(device, loaded, *size), jitter=jitter).sequence(9, FPS))
        for jitter in (None, Jitter(8))
    ]
    wrong, named = {}, 0
    for mistake, (change, fault) in TABLE.items():
        found = faults(examine(Kept(change(*both), loaded.exposure), loaded.exposure))
        named += found == [fault]
        if found and found != [fault]:
            wrong[mistake] = found
    assert wrong == {} and named > 0.7 * len(TABLE)
