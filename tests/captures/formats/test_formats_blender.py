"""Captures from Blender: a built-in scene written as Blender writes, and read back bit for bit."""

import json
from dataclasses import replace

import numpy as np
import pytest
from foreign import FPS, H, W, blender_frame, blender_layers, edit_json, shots, write_blender, write_exr, write_parts

from gffe_cl import GffeError, open_capture, open_sequence
from gffe_cl.cli import commands


def same(sequence, frames):
    """Whether everything is as in `frames`, whose first one is a reset."""
    assert (sequence.width, sequence.height, sequence.fps) == (W, H, FPS)
    rendered = [shot for shot in frames if shot.kind == "rendered"]
    assert len(sequence.rendered) == len(rendered) and sequence.rendered[0].reset
    for entry, shot in zip(sequence.rendered, rendered, strict=True):
        frame = sequence.read(entry)
        np.testing.assert_array_equal(frame.color, shot.color)
        np.testing.assert_array_equal(frame.depth, shot.depth)
        np.testing.assert_array_equal(frame.motion, shot.motion)
        np.testing.assert_allclose(frame.camera.world_to_view, shot.camera.world_to_view, atol=1e-12)
        assert frame.camera.intrinsics == shot.camera.intrinsics and frame.time == shot.time
        assert (frame.color.dtype, frame.depth.dtype, frame.motion.dtype) == (np.float16, np.float32, np.float32)
        np.testing.assert_array_equal(sequence.read_color(entry), shot.color)
        both = sequence.read_channels(entry, ("Z", "motion.y"))
        np.testing.assert_array_equal(both["motion.y"], shot.motion[..., 1])
    truth = [shot for shot in frames if shot.kind == "ground_truth"]
    for entry, shot in zip(sequence.ground_truth, truth, strict=True):
        np.testing.assert_array_equal(sequence.read_color(entry), shot.color)
        assert entry.display_camera.intrinsics == shot.camera.intrinsics and entry.time == shot.time


@pytest.mark.parametrize("multi_part", [True, False])
def test_round_trip(tmp_path, multi_part):
    """As of Blender 5 and 4.5."""
    folder = write_blender(tmp_path, shots(), multi_part)
    same(open_capture(folder), shots())
    same(open_capture(folder / "cameras.json"), shots())
    assert open_capture(folder).warnings() == []


@pytest.mark.parametrize(
    ("layer", "data"), [("Färbung 2", "Färbung 2"), ("Aussen.Tag", "data"), ("View Layer", "Data"), ("Data", "Exact")]
)
def test_view_layers_of_any_name(tmp_path, layer, data):
    same(open_capture(write_blender(tmp_path, shots(), False, layer=layer, data=data)), shots())


def test_one_view_layer_has_all_the_passes_and_another_exact_ones(tmp_path):
    def with_means(layers):
        if "Data.Depth" in layers:
            layers["ViewLayer.Depth"] = {"Z": layers["Data.Depth"]["Z"] + 1}
            layers["ViewLayer.Vector"] = {c: a + 1 for c, a in layers["Data.Vector"].items()}
            layers["Composite.Combined"] = {c: a * 0 for c, a in layers["ViewLayer.Combined"].items()}
        return dict(sorted(layers.items(), reverse=True))

    same(open_capture(write_blender(tmp_path, shots(), True, rename=with_means)), shots())


def test_depth_by_its_newer_name_and_plain_truth(tmp_path):
    def renamed(layers):
        if "Data.Depth" in layers:
            layers["Data.Depth"] = {"V": layers["Data.Depth"]["Z"]}
        return layers

    folder = write_blender(tmp_path, shots(), rename=renamed)
    write_exr(folder / "frame_0001.exr", dict(zip("RGB", np.moveaxis(shots()[1].color, -1, 0), strict=True)))
    same(open_capture(folder), shots())


@pytest.mark.parametrize("cut", ["before the pass", "before the component"])
def test_parts_that_hold_a_part_of_the_name(tmp_path, cut):
    """`ViewLayer` with `Combined.R`, or `ViewLayer.Combined` with `R`: names are unique in a part only."""
    folder = write_blender(tmp_path, shots())
    for number, shot in enumerate(shots()):
        parts = {}
        for layer, passes in blender_layers(shot).items():
            view_layer, _, name = layer.partition(".")
            if cut == "before the pass":
                parts.setdefault(view_layer, {}).update({f"{name}.{c}": a for c, a in passes.items()})
            else:
                parts[layer] = passes
        write_parts(folder / f"frame_{number:04d}.exr", parts)
    same(open_capture(folder), shots())


def test_cameras_without_pictures(tmp_path):
    """Their times have a known camera, and no truth; frames may be listed in any order."""
    folder = write_blender(tmp_path, [shot for shot in shots() if shot.kind == "rendered"])
    between = shots()[1]
    only = blender_frame(9, None, "camera_only", between.time, between.camera)
    edit_json(folder / "cameras.json", lambda d: d["frames"].insert(0, only) or d["frames"].reverse())
    sequence = open_capture(folder)
    assert not sequence.ground_truth and [entry.kind for entry in sequence.frames] == ["rendered"] * 3
    assert sequence.camera_at(between.time).intrinsics == between.camera.intrinsics
    assert sequence.camera_at(shots()[3].time) is None


def test_a_scaled_camera_object(tmp_path):
    """A matrix that Blender's scale of the camera is left in: it stands where it stands."""
    folder = write_blender(tmp_path, shots())

    def scale(document):
        for frame in document["frames"]:
            frame["world_to_camera"] = (np.diag([2.0, 2, 2, 1]) @ frame["world_to_camera"]).tolist()

    edit_json(folder / "cameras.json", scale)
    same(open_capture(folder), shots())


def test_overscan(tmp_path):
    """A data window larger than the display window is a rendering window; truth is cut to what is shown."""
    whole = shots()[:2]
    w, h, left, top = 60, 40, 20, 10
    frames = []
    for index, shot in enumerate(whole):
        layers = blender_layers(shot)
        channels = {f"{layer}.{c}": a for layer, passes in layers.items() for c, a in passes.items()}
        box = lambda x, y, w, h: (np.array([x, y], np.int32), np.array([x + w - 1, y + h - 1], np.int32))  # noqa: E731
        write_exr(
            tmp_path / f"frame_{index:04d}.exr",
            channels,
            windows={"dataWindow": box(-left, -top, W, H), "displayWindow": box(0, 0, w, h)},
        )
        camera = replace(shot.camera, cx=shot.camera.cx - left, cy=shot.camera.cy - top)
        frames.append(blender_frame(index, f"frame_{index:04d}.exr", shot.kind, shot.time, camera))
    (tmp_path / "cameras.json").write_text(json.dumps({"width": w, "height": h, "frames": frames}))
    sequence = open_capture(tmp_path)
    frame = sequence.read(sequence.rendered[0])
    np.testing.assert_array_equal(frame.color, whole[0].color)
    np.testing.assert_allclose(frame.camera.intrinsics, whole[0].camera.intrinsics)
    assert frame.display_camera.cx == pytest.approx(whole[0].camera.cx - left)
    shown = sequence.read_color(sequence.ground_truth[0])
    np.testing.assert_array_equal(shown, whole[1].color[top : top + h, left : left + w])


def frame_1(**changes):
    return lambda d: d["frames"][1].update(changes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(width=96), "expected 96×55"),
        (lambda d: d.update(width=-3), "width must be a whole number"),
        (lambda d: d.update(frames=[]), "frames must be a list"),
        (lambda d: d.update(frames=[3]), "frame 0: must be an object"),
        (frame_1(kind="shown"), "kind must be one of"),
        (frame_1(file="../frame_0001.exr"), "must stay inside"),
        (frame_1(file="frame_0009.exr"), "frame_0009.exr: no such file"),
        (frame_1(file="frame_0000.exr"), "listed twice"),
        (frame_1(time=None), "time must be a finite number"),
        (frame_1(time=0.4), "times must increase"),
        (frame_1(fx=0), "fx must be greater than 0"),
        (frame_1(world_to_camera=[[1, 0], [0, 1]]), r"shape \(4, 4\)"),
        (frame_1(world_to_camera=np.diag([1.0, 1, 0, 1]).tolist()), "not rigid"),
        (frame_1(world_to_camera=None), "no world_to_camera"),
        (lambda d: d["frames"][1].update(kind="rendered"), "frame_0001.exr: no channel Depth.Z"),
    ],
)
def test_faults(tmp_path, change, words):
    folder = write_blender(tmp_path, shots())
    edit_json(folder / "cameras.json", change)
    with pytest.raises(GffeError, match=words):
        open_capture(folder)


def test_files_elsewhere(tmp_path):
    """Links of the file system are followed, names in the JSON are not."""
    folder = write_blender(tmp_path / "in", shots())
    (tmp_path / "beside").mkdir()
    for name in ("frame_0002.exr", "cameras.json"):
        (folder / name).rename(tmp_path / "beside" / name)
        (folder / name).symlink_to(tmp_path / "beside" / name)
    assert open_capture(folder).read(open_capture(folder).rendered[1]).depth.any()
    edit_json(folder / "cameras.json", lambda d: d["frames"][2].update(file="../beside/frame_0002.exr"))
    with pytest.raises(GffeError, match="must stay inside"):
        open_capture(folder)


def test_commands_take_it(tmp_path, monkeypatch):
    """run and compare; the result is a sequence of our own, the rendered frames converted."""
    monkeypatch.chdir(tmp_path)
    write_blender(tmp_path / "in", shots())
    assert commands.invoke(["run", "in", "out", "--no-scn"]) == 0
    made = open_sequence(tmp_path / "out")
    assert len(made.extrapolated) == 3 and [entry.file for entry in made.rendered][1] == "frame_0002.exr"
    np.testing.assert_array_equal(made.read(made.rendered[1]).motion, shots()[2].motion)
    made_for, truth = made.extrapolated[0].display_camera, shots()[1].camera
    np.testing.assert_allclose(made_for.world_to_view, truth.world_to_view, atol=1e-12)
    assert commands.invoke(["compare", "out", "in", "--fail-under", "15"]) == 0
    with pytest.raises(GffeError, match="overwrite its input"):
        commands.invoke(["run", "in", "in"])


def test_a_frame_that_is_missing_is_a_gap(tmp_path):
    """Its number and its time are missing: the vectors of the next one lead to it."""
    folder = write_blender(tmp_path, shots(count=5))
    edit_json(folder / "cameras.json", lambda said: said["frames"].pop(4))
    sequence = open_capture(folder)
    assert [entry.reset for entry in sequence.rendered] == [True, False, True, False]
    assert sequence.notes == [f"{folder}: frame 4 is missing: the next frame is a reset"]
