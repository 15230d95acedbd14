"""Unreal's Movie Render Queue: a built-in scene written in its form, and read back."""

import numpy as np
import pytest
from folder_captures import rendered
from foreign import write_exr
from foreign_sets import write_unreal

from gffe_cl import GffeError, open_capture
from gffe_cl.captures.sequence.engine_form import static_motion


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
