"""Recipes of the documentation for data sets, run on small files in their forms."""

import runpy
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from synthetic import Rect, Rects, camera

from gffe_cl import open_sequence

RECIPES = Path(__file__).parents[3] / "docs" / "recipes"
W, H = 64, 48
SCENE = Rects([Rect((0, 0, 9)), Rect((-0.2, 0.1, 4), (0.3, 0.2))])
FOV = 2 * np.arctan(W / 2 / 320)  # of TartanAir
CAMERAS = [camera(W, H, position=(0.03 * k, 0.01 * k, 0.05 * k), fov=FOV) for k in range(3)]
TAG = struct.pack("<f", 202021.25)


def frames():
    """A camera that moves and does not turn, before a wall."""
    return [SCENE.frame(c, k / 24, W, H, previous=(CAMERAS[max(k - 1, 0)], 0.0)) for k, c in enumerate(CAMERAS)]


def write(path, data):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data) if isinstance(data, bytes) else np.save(path, data)


def picture(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((H, W, 3), 188, np.uint8)).save(path)  # .5 in linear light


def flow_to(frame, other):
    y, x = np.mgrid[:H, :W] + 0.5
    here = np.stack([x, y], -1)
    return np.float32(other.camera.project(frame.camera.unproject(here, frame.depth))[0] - here)


def sintel(root, shots):
    for k, shot in enumerate(shots):
        picture(root / f"final/alley_1/frame_{k:04d}.png")
        write(root / f"depth/alley_1/frame_{k:04d}.dpt", TAG + bytes(8) + np.float32(shot.depth).tobytes())
        fx, fy, cx, cy = shot.camera.intrinsics
        numbers = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1, *shot.camera.world_to_view[:3].ravel()])
        write(root / f"camdata_left/alley_1/frame_{k:04d}.cam", TAG + numbers.tobytes())
        flow = flow_to(shot, shots[min(k + 1, 2)])
        write(root / f"flow/alley_1/frame_{k:04d}.flo", TAG + bytes(8) + flow.tobytes())
    return root / "final/alley_1"


def tartanair(root, shots):
    for k, shot in enumerate(shots):
        picture(root / f"image_left/{k:06d}_left.png")
        write(root / f"depth_left/{k:06d}_left_depth.npy", shot.depth)
        write(root / f"flow/{k:06d}_{k + 1:06d}_flow.npy", flow_to(shot, shots[min(k + 1, 2)]))
    forward = [(*np.roll(shot.camera.position, 1), 0, 0, 0, 1) for shot in shots]
    np.savetxt(root / "pose_left.txt", forward)
    return root


def spring(root, shots):
    h5py = pytest.importorskip("h5py", reason="no h5py")
    for name in ("disp1_left", "flow_BW_left", "cam_data"):
        (root / name).mkdir()
    for k, shot in enumerate(shots, 1):
        picture(root / f"frame_left/frame_left_{k:04d}.png")
        with h5py.File(root / f"disp1_left/disp1_left_{k:04d}.dsp5", "w") as file:
            file["disparity"] = (0.065 * shot.camera.fx / shot.depth).repeat(2, 0).repeat(2, 1)
        with h5py.File(root / f"flow_BW_left/flow_BW_left_{k:04d}.flo5", "w") as file:
            file["flow"] = flow_to(shot, shots[max(k - 2, 0)]).repeat(2, 0).repeat(2, 1)
    np.savetxt(root / "cam_data/intrinsics.txt", [shot.camera.intrinsics for shot in shots])
    np.savetxt(root / "cam_data/extrinsics.txt", [shot.camera.world_to_view.ravel() for shot in shots])
    return root


@pytest.mark.parametrize("write_set", [sintel, tartanair, spring], ids=lambda one: one.__name__)
def test_recipes_of_data_sets(tmp_path, monkeypatch, write_set):
    (tmp_path / "in").mkdir()
    folder = write_set(tmp_path / "in", frames())
    monkeypatch.setattr(sys, "argv", ["recipe", str(folder), str(tmp_path / "out")])
    runpy.run_path(str(RECIPES / f"{write_set.__name__}.py"), run_name="__main__")
    sequence = open_sequence(tmp_path / "out")
    assert [entry.reset for entry in sequence.rendered] == [True, False, False]
    first = sequence.rendered[0].render_camera
    for found, shot in zip(sequence, frames(), strict=True):
        np.testing.assert_allclose(found.color, 0.5, atol=0.005)
        np.testing.assert_allclose(found.depth, shot.depth, rtol=1e-5)
        turned = found.camera.world_to_view @ np.linalg.inv(first.world_to_view)  # whatever the world's axes
        expected = shot.camera.world_to_view @ np.linalg.inv(CAMERAS[0].world_to_view)
        np.testing.assert_allclose(turned, expected, atol=1e-6)
        if not found.reset:
            off = np.linalg.norm(found.motion - shot.motion, axis=-1)
            assert np.percentile(off, 90) < 0.1 and np.abs(shot.motion).max() > 0.5
