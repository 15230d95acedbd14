"""The script that runs in Blender, with the `bpy` wheel of this Python or of the one that GFFE_BLENDER_PYTHON names."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from gffe_cl import open_capture
from gffe_cl.captures.sequence.engine_form import static_motion

SCRIPT = Path(__file__).parents[3] / "docs" / "blender" / "export_gffe.py"
PYTHON = os.environ.get("GFFE_BLENDER_PYTHON", sys.executable)
WIDTH, HEIGHT, EVERY = 81, 46, 2
STEP = np.array([0.3, 0.0, 0.1])  # of the cube, between rendered frames

SCENE = f"""
import math, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
def keyed(one, frame, **values):
    for name, value in values.items():
        setattr(one, name, value)
        one.keyframe_insert(name, frame=frame)
def straight(one):
    action = one.animation_data.action
    slots = action.layers[0].strips[0].channelbags if hasattr(action, "layers") else [action]
    for curve in slots[0].fcurves:
        curve.extrapolation = "LINEAR"
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
bpy.ops.mesh.primitive_plane_add(size=20)
bpy.ops.mesh.primitive_cube_add()
cube = bpy.context.object
keyed(cube, 1, location=(0, 0, 1))
keyed(cube, 1 + {EVERY}, location={(STEP + (0, 0, 1)).tolist()})
straight(cube)
bpy.ops.object.light_add(type="SUN")
bpy.ops.object.camera_add()
camera = scene.camera = bpy.context.object
camera.data.shift_x, camera.data.shift_y = 0.1, -0.05
camera.scale = (2, 2, 2)
camera.cycles.use_motion_blur = False
keyed(camera, 1, location=(0, -10, 4), rotation_euler=(math.radians(75), 0, 0))
keyed(camera, 9, location=(1, -9, 4.5), rotation_euler=(math.radians(73), 0.02, 0.1))
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising = 4, False
scene.render.resolution_x, scene.render.resolution_y = {WIDTH}, {HEIGHT}
scene.render.use_motion_blur = True
scene.frame_start, scene.frame_end, scene.render.fps = 1, 6, 60
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""


def run(*words, fails=False):
    done = subprocess.run([PYTHON, *map(str, words)], capture_output=True, text=True, timeout=300)
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def blend(tmp_path_factory):
    if subprocess.run([PYTHON, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("no bpy (pip install bpy, or GFFE_BLENDER_PYTHON=…)")
    path = tmp_path_factory.mktemp("blender") / "scene.blend"
    run("-c", SCENE, path)
    return path


def channels(path):
    return {name: one.pixels for part in OpenEXR.File(str(path), True).parts for name, one in part.channels.items()}


def reprojected(frame, before, depth, moved):
    """Motion (H, W, 2) of points that were `moved` further back, by depth and cameras."""
    view, view_before = np.array(frame["world_to_camera"]), np.array(before["world_to_camera"])
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    along = np.stack([(x - frame["cx"]) / frame["fx"], (y - frame["cy"]) / frame["fy"], np.ones_like(x)], -1)
    world = (along * depth[..., None] - view[:3, 3]) @ view[:3, :3] - moved
    u, v, w = np.moveaxis(world @ view_before[:3, :3].T + view_before[:3, 3], -1, 0)
    return np.stack([u / w * before["fx"] + before["cx"] - x, v / w * before["fy"] + before["cy"] - y], -1)


def test_depth_vectors_and_cameras_agree(blend, tmp_path):
    run(SCRIPT, blend, "--", tmp_path / "out", "--every", EVERY)
    described = json.loads((tmp_path / "out" / "cameras.json").read_text())
    frames = described["frames"]
    assert (described["width"], described["height"]) == (WIDTH, HEIGHT)
    assert [frame["kind"] for frame in frames] == ["rendered", "ground_truth"] * 3
    np.testing.assert_allclose([frame["time"] for frame in frames], np.arange(6) / 60)
    for before, frame in zip(frames[0:4:2], frames[2:6:2], strict=True):
        found = channels(tmp_path / "out" / frame["file"])
        depth = found["Data.Depth.Z"].astype(np.float64)
        motion = np.stack([found["Data.Vector.X"], -found["Data.Vector.Y"]], -1)
        sky = depth > 1e9
        residuals = [np.linalg.norm(motion - reprojected(frame, before, depth, d), axis=-1) for d in (0 * STEP, STEP)]
        assert min(r[~sky].min() for r in residuals) < 1e-3 and np.minimum(*residuals)[~sky].max() < 0.01
        for residual in residuals:  # both the floor and the cube are seen, and the sky
            assert (residual[~sky] < 0.01).mean() > 0.02
        assert 0 < sky.mean() < 0.9 and np.linalg.norm(motion, axis=-1).max() > 2
        assert found["ViewLayer.Combined.R"].dtype == np.float16 and depth.shape == (HEIGHT, WIDTH)
    assert not any("Depth" in name for name in channels(tmp_path / "out" / frames[1]["file"]))
    opens_as_it_is(tmp_path / "out", frames)


def opens_as_it_is(folder, frames):
    """Every command reads what the script wrote: exact motion of what stands still, sky, truth, cameras."""
    sequence = open_capture(folder)
    assert (sequence.width, sequence.height, sequence.fps) == (WIDTH, HEIGHT, 60 / EVERY)
    assert [entry.kind for entry in sequence.frames] == [frame["kind"] for frame in frames] and not sequence.warnings()
    for before, entry in zip(sequence.rendered, sequence.rendered[1:], strict=False):
        frame = sequence.read(entry)
        still, _ = static_motion(frame.depth, entry.render_camera, before.render_camera)
        off = np.linalg.norm(frame.motion - still, axis=-1)[np.isfinite(frame.depth)]
        assert np.median(off) < 0.01 and np.isinf(frame.depth).any() and frame.color.dtype == np.float16
    for entry in sequence.ground_truth:
        assert sequence.read_color(entry).shape == (HEIGHT, WIDTH, 3)
        assert sequence.camera_at(entry.time) is not None


def test_an_export_goes_on_where_it_stopped(blend, tmp_path):
    words = (SCRIPT, blend, "--", tmp_path, "--start", 3, "--end", 3)
    run(*words, "--between", 1)
    first, second = sorted(tmp_path.glob("frame_*.exr"))
    kept = first.stat().st_mtime_ns
    second.unlink()
    run(*words, "--between", 1)
    assert second.exists() and first.stat().st_mtime_ns == kept
    assert "holds another export" in run(*words, fails=True)
    assert not list(tmp_path.glob(".*"))


def test_only_cameras_between(blend, tmp_path):
    run(SCRIPT, blend, "--", tmp_path, "--start", 3, "--end", 3, "--between", 1, "--no-truth")
    rendered, between = json.loads((tmp_path / "cameras.json").read_text())["frames"]
    assert between["kind"] == "camera_only" and between["file"] is None and between["scene_frame"] == 3.5
    assert between["world_to_camera"] != rendered["world_to_camera"]
    assert [path.name for path in tmp_path.glob("*.exr")] == [rendered["file"]]
    sequence = open_capture(tmp_path)
    assert len(sequence.frames) == 1 and sequence.camera_at(between["time"]).fx == between["fx"]
