"""`gffe import` and `gffe formats`, and the motion that has to be made for them."""

import json

import numpy as np
import pytest
import tiny_sequence
from foreign import FPS, H, W, shots, write_blender
from synthetic import Rect, Rects, camera

from gffe_cl import Camera, GffeError, SequenceWriter, named_channels, open_capture, open_sequence
from gffe_cl.captures.formats import FORMATS
from gffe_cl.captures.formats.flow import composed, inverted_flow, sampled
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.captures.sequence.engine_form import static_motion
from gffe_cl.cli import commands

SIZE = (64, 48)
SCENE = Rects([Rect((0, 0, 9)), Rect((-0.6, 0.1, 4), (0.7, 0.6), velocity=(12, -4, 3))])


def moving(time, previous=None):
    """A frame of a rectangle that moves before a wall, the camera moving too."""
    seen = [camera(*SIZE, position=(3 * t, 0.5 * t, t), yaw=0.6 * t) for t in (time, previous or 0.0)]
    return SCENE.frame(seen[0], time, *SIZE, previous=None if previous is None else (seen[1], previous))


def test_import_keeps_everything(tmp_path):
    write_blender(tmp_path / "in", shots())
    assert commands.invoke(["import", str(tmp_path / "in"), str(tmp_path / "out"), "--json", str(tmp_path / "j")]) == 0
    source, made = open_capture(tmp_path / "in"), open_sequence(tmp_path / "out")
    assert (made.width, made.height, made.fps) == (W, H, FPS)
    assert [(e.file, e.time, e.kind, e.reset) for e in made.frames] == [
        (e.file, e.time, e.kind, e.reset) for e in source.frames
    ]
    for a, b in zip(source.rendered, made.rendered, strict=True):
        one, other = source.read(a), made.read(b)
        for name in ("color", "depth", "motion"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert one.camera == other.camera
    for a, b in zip(source.ground_truth, made.ground_truth, strict=True):
        np.testing.assert_array_equal(source.read_color(a), made.read_color(b))
        assert a.display_camera == b.display_camera
    assert json.loads((tmp_path / "j").read_text())["rendered"] == 3


@pytest.mark.parametrize("every", [2, 3])
def test_every_second_frame(tmp_path, every):
    """Motion over the skipped frames is as if they had not been rendered, where the surface is seen in all of them."""
    step, count = 1 / 60, 7
    with SequenceWriter(tmp_path / "in", *SIZE, 60) as writer:
        for k in range(count):
            frame = moving(k * step, (k - 1) * step if k else None)
            entry = FrameEntry(f"frame_{k:04d}.exr", k * step, reset=k == 0, render_camera=frame.camera)
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion if k else None))
    words = ["import", str(tmp_path / "in"), str(tmp_path / "out"), "--every", str(every)]
    assert commands.invoke(words) == 0
    made = open_sequence(tmp_path / "out")
    kept = list(range(0, count, every))
    assert [entry.file for entry in made.rendered] == [f"frame_{k:04d}.exr" for k in kept] and made.fps == 60 / every
    skipped = [k for k in range(count) if k not in kept]
    assert [entry.file for entry in made.ground_truth] == [f"truth_{k:04d}.exr" for k in skipped]
    np.testing.assert_array_equal(made.read_color(made.ground_truth[0]), moving(skipped[0] * step).color)
    for k, entry in list(zip(kept, made.rendered, strict=True))[1:]:
        direct, frame = moving(k * step, (k - every) * step), made.read(entry)
        np.testing.assert_array_equal(frame.depth, direct.depth)
        off = np.linalg.norm(frame.motion - direct.motion, axis=-1)
        assert np.percentile(off, 97) < 0.02 and off.max() < 0.5 and np.abs(direct.motion).max() > 2


def test_every_starts_anew_at_resets(tmp_path):
    def change(document):
        document["frames"][6]["reset"] = True

    folder = tiny_sequence.write(tmp_path / "in", frames=5)
    tiny_sequence.edit(folder, change)
    commands.invoke(["import", str(folder), str(tmp_path / "out"), "--every", "2"])
    made = open_sequence(tmp_path / "out")
    assert [entry.file for entry in made.rendered] == ["frame_0.exr", "frame_2.exr", "frame_3.exr"]
    assert [entry.reset for entry in made.rendered] == [True, False, True]
    assert len(made.ground_truth) == 5 + 2  # the names of the truth that was there are not taken
    assert len({entry.file for entry in made.frames}) == 10


@pytest.mark.parametrize(
    ("words", "message"), [(["--every", "0"], "1 to 16"), (["--compression", "tar"], "must be one of")]
)
def test_what_cannot_be_imported(tmp_path, words, message):
    folder = tiny_sequence.write(tmp_path / "in")
    with pytest.raises(GffeError, match=message):
        commands.invoke(["import", str(folder), str(tmp_path / "out"), *words])
    with pytest.raises(GffeError, match="overwrite its input"):
        commands.invoke(["import", str(folder), str(folder)])
    assert not (tmp_path / "out").exists()


def test_formats_are_listed(tmp_path, capsys):
    assert commands.invoke(["formats", "--json", str(tmp_path / "j")]) == 0
    printed, listed = capsys.readouterr().out, json.loads((tmp_path / "j").read_text())["formats"]
    assert [one["name"] for one in listed] == list(FORMATS) and all(name in printed for name in FORMATS)
    assert all(one["example"] and one["sentence"] for one in listed)


def test_folders_of_no_known_form(tmp_path):
    for path, words in ((tmp_path, "no sequence.json"), (tmp_path / "nothing", "no such folder")):
        with pytest.raises(GffeError, match=words):
            open_capture(path)


# Motion that is made


def test_static_motion():
    a, b = camera(*SIZE), camera(*SIZE, position=(0.3, -0.1, 0.4), yaw=0.05, roll=0.02)
    frame = Rects([Rect((0, 0, 5)), Rect((1, 0, 3), (0.8, 0.9))]).frame(a, 0.0, *SIZE, previous=(b, 0.0))
    motion, depth = static_motion(frame.depth, a, b)
    np.testing.assert_allclose(motion, frame.motion, atol=1e-4)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    np.testing.assert_allclose(depth, b.project(a.unproject(np.stack([x, y], -1), frame.depth))[1], rtol=1e-6)
    sky, far = static_motion(np.full((48, 64), np.inf), a, b)
    turned = Camera(b.moved(-b.position).world_to_view, *b.intrinsics)
    expected = turned.project(camera(*SIZE).unproject(np.stack([x, y], -1), np.ones((48, 64))))[0]
    np.testing.assert_allclose(sky + np.stack([x, y], -1), expected, atol=1e-9)
    assert np.isinf(far).all()


def test_forward_flow_inverted():
    """Of the frame before, where its pixels go: exact from the scene. Seen in both, its inverse is our motion."""
    step = 1 / 30
    before, now = moving(step), moving(2 * step, step)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    world = before.camera.unproject(np.stack([x, y], -1), before.depth)
    is_mover = np.abs(world[..., 2] - 9) > 1
    world = world + is_mover[..., None] * np.array(SCENE.rects[1].velocity) * step
    flow = now.camera.project(world)[0] - np.stack([x, y], -1)
    made = inverted_flow(flow, before.depth, before.camera, now.depth, now.camera)
    off = np.linalg.norm(made - now.motion, axis=-1)
    assert np.percentile(off, 95) < 0.05 and off.max() < 6
    mover = np.abs(now.camera.unproject(np.stack([x, y], -1), now.depth)[..., 2] - 9) > 1
    assert mover.mean() > 0.03 and np.percentile(off[mover], 90) < 0.1
    still = np.linalg.norm(static_motion(now.depth, now.camera, before.camera)[0] - now.motion, axis=-1)
    assert np.median(still[mover]) > 3  # which nothing but the flow can tell


def test_what_was_hidden_in_between():
    """A pixel of the wall that the mover covered in the frame between goes on with the camera."""
    step = 1 / 30
    between, now, whole = moving(step, 0.0), moving(2 * step, step), moving(2 * step, 0.0)
    first = camera(*SIZE)
    made = composed(now.motion, now.depth, now.camera, between.motion, between.depth, between.camera, first)
    _, expected = static_motion(now.depth, now.camera, between.camera)
    _, seen = sampled(between.motion, between.depth, now.motion, expected)
    assert 10 < (~seen).sum() < 600
    np.testing.assert_allclose(made[~seen], whole.motion[~seen], atol=0.02)
