"""Unreal's Movie Render Queue and public data sets: a built-in scene written in their forms, and read back."""

import struct

import numpy as np
import pytest
from folder_captures import rendered
from foreign import H, W, write_exr
from foreign_sets import write_sintel, write_spring, write_tartanair, write_unreal

from gffe_cl import GffeError, open_capture
from gffe_cl.captures.formats.motion_conversion import static_motion


def same_pose(camera, expected, atol=1e-5):
    np.testing.assert_allclose(camera.world_to_view, expected.world_to_view, atol=atol)
    np.testing.assert_allclose(camera.intrinsics, expected.intrinsics, rtol=1e-5)


# Unreal


@pytest.mark.parametrize("prefix", ["unreal/camera/", "unreal/layerData/rgba/"])
@pytest.mark.parametrize("along_rays", [False, True])
@pytest.mark.parametrize("scale", [2.0, 1.0])
def test_unreal(tmp_path, scale, along_rays, prefix):
    """Whatever the factor of the motion vectors, and whatever depth is: what stands still tells."""
    frames = write_unreal(tmp_path, rendered(), scale, along_rays, prefix, "" if along_rays else "FinalImage.")
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
    write_unreal(tmp_path, [rendered()[0]] * 3, half=True)
    (tmp_path / "Shot.0018.exr").rename(tmp_path / "Shot.0021.exr")
    sequence = open_capture(tmp_path)
    assert [entry.reset for entry in sequence.rendered] == [True, True, True]
    assert any("moves too little" in text for text in sequence.warnings())
    depth = sequence.read(sequence.rendered[0]).depth
    np.testing.assert_array_equal(np.isinf(depth), np.isinf(rendered()[0].depth))


def test_unreal_faults(tmp_path):
    write_unreal(tmp_path, rendered())
    (tmp_path / "Other.0001.exr").write_bytes((tmp_path / "Shot.0017.exr").read_bytes())
    with pytest.raises(GffeError, match="several shots"):
        open_capture(tmp_path)
    (tmp_path / "Other.0001.exr").unlink()
    color = dict(zip("RGB", np.moveaxis(rendered()[0].color, -1, 0), strict=True))
    write_exr(tmp_path / "Shot.0018.exr", color, **{"unreal/camera/curPos/x": "1"})
    with pytest.raises(GffeError, match=r"Shot\.0018\.exr: no layer of WorldDepth"):
        open_capture(tmp_path)


# Data sets


def as_rendered(sequence, frames, cameras):
    """Colors to 8 bits, depth to float32; motion of what stands still and was seen before."""
    assert len(sequence.rendered) == len(frames) and (sequence.width, sequence.height) == (W, H)
    for k, (entry, shot, camera) in enumerate(zip(sequence.rendered, frames, cameras, strict=True)):
        frame = sequence.read(entry)
        same_pose(frame.camera, camera)
        np.testing.assert_allclose(frame.depth, shot.depth, rtol=1e-5)
        np.testing.assert_allclose(frame.color, np.clip(shot.color, 0, 1), atol=0.006)
        if k:
            expected = static_motion(shot.depth, camera, cameras[k - 1])[0]
            off = np.linalg.norm(frame.motion - expected, axis=-1)
            assert np.percentile(off, 97) < 0.05 and np.linalg.norm(expected, axis=-1).max() > 2


def test_sintel(tmp_path):
    sequence = open_capture(write_sintel(tmp_path, rendered()))
    as_rendered(sequence, rendered(), [shot.camera for shot in rendered()])
    assert sequence.fps == 24


def test_sintel_faults(tmp_path):
    folder = write_sintel(tmp_path, rendered())
    cut = tmp_path / "depth" / "alley_1" / "frame_0002.dpt"
    whole = cut.read_bytes()
    for data, words in (
        (whole[:-1], "truncated"),
        (b"PNG " + whole[4:], "not a file of MPI Sintel"),
        (whole[:4] + struct.pack("<ii", -5, 2**31 - 1) + whole[12:], "-5×2147483647 pixels, expected"),
    ):
        cut.write_bytes(data)
        with pytest.raises(GffeError, match=words):
            open_capture(folder)
    cut.write_bytes(whole)
    cut.unlink()
    (tmp_path.parent / f"{tmp_path.name}.dpt").write_bytes(whole)
    cut.symlink_to(tmp_path.parent / f"{tmp_path.name}.dpt")
    open_capture(folder)
    cut.unlink()
    with pytest.raises(GffeError, match=r"frame_0002\.dpt"):
        open_capture(folder)
    cut.write_bytes(whole)
    (tmp_path / "camdata_left" / "alley_1" / "frame_0001.cam").unlink()
    with pytest.raises(GffeError, match=r"frame_0001\.cam: cannot be read"):
        open_capture(folder)


def renumbered(root, names):
    """Give the frames 1, 2 and 3 of write_sintel other numbers, as written in `names`; None removes one."""
    for path in sorted(root.rglob("frame_*")):
        name = names[int(path.stem[6:]) - 1]
        if name is None:
            path.unlink()
        else:
            path.rename(path.with_name(f"renamed_{name}{path.suffix}"))
    for path in sorted(root.rglob("renamed_*")):
        path.rename(path.with_name(path.name.replace("renamed", "frame")))


@pytest.mark.parametrize("names", [("9", "10", "11"), ("-1", "0", "1"), ("-001", "0000", "0001"), ("08", "9", "010")])
def test_sintel_is_sorted_by_number(tmp_path, names):
    folder = write_sintel(tmp_path, rendered())
    renumbered(tmp_path, names)
    sequence = open_capture(folder)
    as_rendered(sequence, rendered(), [shot.camera for shot in rendered()])
    assert [entry.reset for entry in sequence.rendered] == [True, False, False] and not sequence.notes
    assert [round(entry.time * 24) for entry in sequence.rendered] == [0, 1, 2]


def test_sintel_with_a_frame_missing(tmp_path):
    """The flow of the frame before it leads to nothing that is there, and the time goes on."""
    folder = write_sintel(tmp_path, rendered())
    renumbered(tmp_path, ("0004", "0006", "0007"))
    sequence = open_capture(folder)
    assert [entry.reset for entry in sequence.rendered] == [True, True, False]
    assert [round(entry.time * 24) for entry in sequence.rendered] == [0, 2, 3]
    assert sequence.notes == [f"{folder}: frame 5 is missing: the next frame is a reset"]
    assert [entry.file for entry in sequence.rendered] == ["frame_000004.exr", "frame_000006.exr", "frame_000007.exr"]
    renumbered(tmp_path, ("-", "-", "-", None, "-", "0006", "0007"))
    sequence = open_capture(folder)
    assert [entry.reset for entry in sequence.rendered] == [True, False] and not sequence.notes
    same_pose(sequence.rendered[0].render_camera, rendered()[1].camera)


def test_hidden_files_are_no_frames_and_endings_may_be_in_capitals(tmp_path):
    folder = write_sintel(tmp_path, rendered())
    (folder / "._frame_0001.png").write_bytes(b"of another system")
    for place, ending in (
        (folder, "png"),
        (tmp_path / "depth" / "alley_1", "dpt"),
        (tmp_path / "flow" / "alley_1", "flo"),
    ):
        path = place / f"frame_0002.{ending}"
        path.rename(path.with_suffix(path.suffix.upper()))
    as_rendered(open_capture(folder), rendered(), [shot.camera for shot in rendered()])


def test_one_number_twice_is_refused(tmp_path):
    folder = write_sintel(tmp_path, rendered())
    (folder / "frame_1.png").write_bytes((folder / "frame_0001.png").read_bytes())
    with pytest.raises(GffeError, match=r"frame_1.png: frame 1 like frame_0001.png \(expected one file for a frame\)"):
        open_capture(folder)


@pytest.mark.parametrize("names", [("9", "10", "11"), ("-1", "0", "1"), ("-0001", "0000", "0001")])
def test_unreal_is_sorted_by_number(tmp_path, names):
    frames = write_unreal(tmp_path, rendered())
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


def test_tartanair(tmp_path):
    frames, cameras = rendered(), write_tartanair(tmp_path, rendered())
    sequence = open_capture(tmp_path)
    for k, entry in enumerate(sequence.rendered):
        same_pose(entry.render_camera, cameras[k])
        frame = sequence.read(entry)
        np.testing.assert_allclose(frame.depth, frames[k].depth, rtol=1e-6)
        if k:
            off = np.linalg.norm(frame.motion - static_motion(frame.depth, cameras[k], cameras[k - 1])[0], axis=-1)
            assert np.percentile(off, 90) < 0.05
    assert any("flow is the camera's" in text for text in sequence.warnings())
    (tmp_path / "pose_left.txt").write_text("1 2 3\n")
    with pytest.raises(GffeError, match="expected 7 finite numbers for each of 3 frames"):
        open_capture(tmp_path)


def test_poses_of_tartanair_belong_to_numbers(tmp_path):
    cameras = write_tartanair(tmp_path, rendered())
    poses = (tmp_path / "pose_left.txt").read_text()
    for path in (*tmp_path.rglob("000001_left*"), *tmp_path.rglob("000001_000002_flow.npy")):
        path.unlink()
    sequence = open_capture(tmp_path)
    assert [entry.reset for entry in sequence.rendered] == [True, True]
    assert any("frame 1 is missing" in text for text in sequence.notes)
    for entry, camera in zip(sequence.rendered, (cameras[0], cameras[2]), strict=True):
        same_pose(entry.render_camera, camera)
    (tmp_path / "pose_left.txt").write_text("".join(poses.splitlines(keepends=True)[:2]))
    with pytest.raises(GffeError, match=r"pose_left.txt: 2 lines for frames 0 to 2 \(expected a line for each number"):
        open_capture(tmp_path)


def test_poses_of_tartanair_that_were_cut_with_the_images(tmp_path):
    """As many lines as frames, whose numbers do not begin at 0."""
    cameras = write_tartanair(tmp_path, rendered())
    for k in (2, 1, 0):
        for path in (*tmp_path.rglob(f"{k:06d}_left*"), *tmp_path.rglob(f"{k:06d}_0*_flow.npy")):
            name = path.name.replace(f"{k + 1:06d}", f"{k + 101:06d}").replace(f"{k:06d}", f"{k + 100:06d}")
            path.rename(path.with_name(name))
    sequence = open_capture(tmp_path)
    assert [entry.reset for entry in sequence.rendered] == [True, False, False]
    for entry, camera in zip(sequence.rendered, cameras, strict=True):
        same_pose(entry.render_camera, camera)


@pytest.mark.parametrize("inverted", [False, True])
def test_spring(tmp_path, inverted):
    pytest.importorskip("h5py", reason="no h5py")
    frames = rendered()
    write_spring(tmp_path, frames, inverted)
    sequence = open_capture(tmp_path)
    as_rendered(sequence, frames, [shot.camera for shot in frames])
    for folder in ("frame_left", "disp1_left", "flow_BW_left"):
        for path in (tmp_path / folder).glob("*_0002.*"):
            path.unlink()
    sequence = open_capture(tmp_path)
    assert [entry.reset for entry in sequence.rendered] == [True, True]
    assert [round(entry.time * 24) for entry in sequence.rendered] == [0, 2]
    if not inverted:  # the flow tells, and there is none
        same_pose(sequence.rendered[1].render_camera, frames[2].camera)
