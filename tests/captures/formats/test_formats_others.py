"""Unreal's Movie Render Queue: a built-in scene written in its form, and read back."""

import numpy as np
import pytest
from folder_captures import rendered
from foreign import H, W, write_exr

from gffe_cl import Camera, GffeError, open_capture
from gffe_cl.captures.formats.motion_conversion import static_motion

HERE = np.stack(np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5), -1)


def same_pose(camera, expected, atol=1e-5):
    np.testing.assert_allclose(camera.world_to_view, expected.world_to_view, atol=atol)
    np.testing.assert_allclose(camera.intrinsics, expected.intrinsics, rtol=1e-5)


def unreal_camera(shot, pitch, yaw, roll):
    """Location and rotation, from rotations about axes one after another: yaw about z, pitch about y, roll about x."""
    p, y, r = np.radians([pitch, yaw, roll])
    about_z = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(p), 0, -np.sin(p)], [0, 1, 0], [np.sin(p), 0, np.cos(p)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(r), np.sin(r)], [0, -np.sin(r), np.cos(r)]])
    return about_z @ about_y @ about_x  # columns: forward, right, up


def unreal_shots():
    """The scene's frames as an Unreal camera would have seen them: its poses in centimeters, in a left-handed world."""
    fov = 2 * np.degrees(np.arctan(W / 2 / 70.0))
    made = []
    for k, shot in enumerate(rendered()):
        angles, location = (3 - k, 20 + 2.0 * k, 1.5 * k), np.array([100 + 9 * k, -50 + 5 * k, 170 - 3 * k])
        axes = unreal_camera(shot, *angles)
        view = np.eye(4)
        view[:3, :3] = (axes[:, 1], -axes[:, 2], axes[:, 0])
        view[:3, 3] = -view[:3, :3] @ location
        camera = Camera(view, 70, 70, W / 2, H / 2)
        made.append((shot, angles, location, fov, camera, shot.depth * 100))
    return made


def write_unreal(folder, scale=2.0, along_rays=False, prefix="unreal/camera/", layers="", half=False, still=False):
    frames = unreal_shots()
    if still:
        frames = [frames[0]] * 3
    for k, (shot, angles, location, fov, camera, depth) in enumerate(frames):
        texts = dict(zip(("curRot/pitch", "curRot/yaw", "curRot/roll"), angles, strict=True))
        texts |= dict(zip(("curPos/x", "curPos/y", "curPos/z"), location, strict=True))
        header = {prefix + name: f"{value:.9f}" for name, value in texts.items()}
        header[f"{prefix}FinalImage/fov" if "camera" in prefix else f"{prefix}fov"] = f"{fov:.9f}"
        motion = np.zeros((H, W, 2))
        if k:
            motion = np.nan_to_num(static_motion(depth, camera, frames[k - 1][4])[0])
        stretch = np.linalg.norm(np.concatenate([(HERE - (W / 2, H / 2)) / 70, np.ones((H, W, 1))], -1), axis=-1)
        depth = np.where(np.isinf(depth), 1e8, depth) * (stretch if along_rays else 1)
        kind = np.float16 if half else np.float32
        channels = {f"{layers}{c}": shot.color[..., i] for i, c in enumerate("RGB")} | {
            f"{layers}A": shot.color[..., 0]
        }
        for c in "RGB":
            channels[f"FinalImageMovieRenderQueue_WorldDepth.{c}"] = np.minimum(depth, 65504 if half else 1e9).astype(
                kind
            )
        channels["FinalImageMovieRenderQueue_MotionVectors.R"] = (0.5 - motion[..., 0] / scale / W).astype(np.float32)
        channels["FinalImageMovieRenderQueue_MotionVectors.G"] = (0.5 + motion[..., 1] / scale / H).astype(np.float32)
        channels["FinalImageMovieRenderQueue_MotionVectors.B"] = np.zeros((H, W), np.float32)
        write_exr(folder / f"Shot.{k + 17:04d}.exr", channels, **header)
    return frames


@pytest.mark.parametrize("prefix", ["unreal/camera/", "unreal/layerData/rgba/"])
@pytest.mark.parametrize("along_rays", [False, True])
@pytest.mark.parametrize("scale", [2.0, 1.0])
def test_unreal(tmp_path, scale, along_rays, prefix):
    """Whatever the factor of the motion vectors, and whatever depth is: what stands still tells."""
    frames = write_unreal(tmp_path, scale, along_rays, prefix, "" if along_rays else "FinalImage.")
    sequence = open_capture(tmp_path)
    assert len(sequence.rendered) == 3 and sequence.rendered[1].file == "Shot.0018.exr"
    assert any("scale of 1" in text for text in sequence.warnings()) == (scale == 1)
    assert any("along the rays" in text for text in sequence.warnings()) == along_rays
    assert any("no frame rate" in text for text in sequence.warnings())
    for k, (entry, (shot, _, _, _, camera, depth)) in enumerate(zip(sequence.rendered, frames, strict=True)):
        frame = sequence.read(entry)
        same_pose(frame.camera, camera)
        np.testing.assert_array_equal(frame.color, shot.color)
        np.testing.assert_allclose(frame.depth, depth, rtol=1e-5)
        if k:
            expected = static_motion(depth, camera, frames[k - 1][4])[0]
            np.testing.assert_allclose(frame.motion, expected, atol=1e-3)
            assert np.linalg.norm(expected, axis=-1).max() > 2


def test_unreal_in_half_without_motion_and_with_gaps(tmp_path):
    write_unreal(tmp_path, half=True, still=True)
    (tmp_path / "Shot.0018.exr").rename(tmp_path / "Shot.0021.exr")
    sequence = open_capture(tmp_path)
    assert [entry.reset for entry in sequence.rendered] == [True, True, True]
    assert any("moves too little" in text for text in sequence.warnings())
    depth = sequence.read(sequence.rendered[0]).depth
    np.testing.assert_array_equal(np.isinf(depth), np.isinf(rendered()[0].depth))


def test_unreal_faults(tmp_path):
    write_unreal(tmp_path)
    (tmp_path / "Other.0001.exr").write_bytes((tmp_path / "Shot.0017.exr").read_bytes())
    with pytest.raises(GffeError, match="several shots"):
        open_capture(tmp_path)
    (tmp_path / "Other.0001.exr").unlink()
    color = dict(zip("RGB", np.moveaxis(rendered()[0].color, -1, 0), strict=True))
    write_exr(tmp_path / "Shot.0018.exr", color, **{"unreal/camera/curPos/x": "1"})
    with pytest.raises(GffeError, match=r"Shot\.0018\.exr: no layer of WorldDepth"):
        open_capture(tmp_path)


@pytest.mark.parametrize("names", [("9", "10", "11"), ("-1", "0", "1"), ("-0001", "0000", "0001")])
def test_unreal_is_sorted_by_number(tmp_path, names):
    frames = write_unreal(tmp_path)
    for number, name in zip((17, 18, 19), names, strict=True):
        (tmp_path / f"Shot.{number:04d}.exr").rename(tmp_path / f"Shot.{name}.EXR")
    (tmp_path / "._Shot.0001.exr").write_bytes(b"of another system")
    sequence = open_capture(tmp_path)
    assert [entry.file for entry in sequence.rendered] == [f"Shot.{name}.EXR" for name in names]
    assert [entry.reset for entry in sequence.rendered] == [True, False, False]
    for entry, frame in zip(sequence.rendered, frames, strict=True):
        same_pose(entry.render_camera, frame[4])
    (tmp_path / f"Shot.{names[1]}.EXR").unlink()
    sequence = open_capture(tmp_path)
    assert [entry.reset for entry in sequence.rendered] == [True, True]
    assert any(f"frame {int(names[1])} is missing" in text for text in sequence.notes)
