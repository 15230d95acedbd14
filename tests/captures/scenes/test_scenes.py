"""Built-in scenes: geometry against a NumPy caster, motion, determinism, invariances, sensible places."""

import numpy as np
import pytest
from scene_oracle import cast, followed

from gffe_cl.captures.offline.source import Live
from gffe_cl.captures.scenes import SCENES, SITUATIONS, SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import host_arrays
from gffe_cl.engine.frame.window import WindowChooser
from gffe_cl.engine.opencl.device import list_devices, open_info

NAMES = list(SCENES)
W, H = 48, 27
TIME, STEP = 1.3, 1 / 30


def rendered(
    device,
    scene,
    time=TIME,
    other_time=TIME - STEP,
    width=W,
    height=H,
    samples=2,
    **cameras,
):
    camera = cameras.get("camera") or scene.camera(time, width, height)
    other = cameras.get("other") or scene.camera(other_time, width, height)
    renderer = SceneRenderer(device, scene, width, height, samples)
    return renderer.render(time, camera, other_time, other).numpy()


# ---- pure ----


def test_unknown_scene_lists_the_names():
    with pytest.raises(GffeError, match="corridor, plaza, room, forest"):
        load_scene("kitchen")
    with pytest.raises(GffeError, match="seed"):
        load_scene("room", -1)


def test_frames_of_a_scene(device):
    """Motion leads into the rendered frame before, of frames and of the truth; windows follow what was seen."""
    scene, size = load_scene("room"), (32, 18)
    renderer = SceneRenderer(device, scene, *size, samples=1)
    made = SceneFrames(renderer)
    frames = list(made.sequence(3, fps=10, start=2.0))
    assert np.allclose([f.time for f in frames], [2.0, 2.1, 2.2]) and [f.reset for f in frames] == [True, False, False]
    assert all(f.camera == f.display_camera == scene.camera(f.time, *size) for f in frames)
    image = renderer.render(frames[2].time, frames[2].camera, frames[1].time, frames[1].camera).numpy()
    for name in ("color", "depth", "motion"):
        assert getattr(image, name).tobytes() == getattr(frames[2], name).tobytes()
    truth = made.truth(2.15, frames[1]).read("motion")
    image = renderer.render(2.15, scene.camera(2.15, *size), frames[1].time, frames[1].camera)
    assert image.read("motion").tobytes() == truth.tobytes() != made.truth(2.15).read("motion").tobytes()
    windows = WindowChooser("adaptive", size, [0.5])
    windowed = list(SceneFrames(renderer, windows).sequence(3, fps=10, start=2.0))
    assert windowed[0].camera == frames[0].camera and windowed[2].camera != windowed[2].display_camera
    assert windowed[2].display_camera == frames[2].camera
    with pytest.raises(GffeError, match="at least 1 frame"):
        list(made.sequence(0))


# ---- device ----


@pytest.mark.device
@pytest.mark.parametrize("name", [*NAMES, *SITUATIONS])
def test_surfaces_match_the_oracle(device, name):
    scene = load_scene(name, 2)
    camera, other = scene.camera(TIME, W, H), scene.camera(TIME - STEP, W, H)
    out = rendered(device, scene)
    depth, object_id, position = cast(scene, TIME, camera)
    same = out.object_id == object_id
    assert same.mean() > 0.99  # the rest are silhouettes and surfaces that touch
    assert np.array_equal(np.isinf(out.depth), out.object_id < 0)
    solid = same & (object_id >= 0)
    # Grazing rays turn float32's 1e-7 of position into more of depth.
    error = np.abs(out.depth / np.where(solid, depth, 1) - 1)[solid]
    assert np.median(error) < 1e-6 and np.quantile(error, 0.99) < 1e-5

    there = followed(scene, TIME, TIME - STEP, other, object_id, position)
    with np.errstate(invalid="ignore"):
        px_there = there[..., :2] / there[..., 2:] * (other.fx, other.fy) + (other.cx, other.cy)
    px = np.stack(np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5), -1)
    motion_error = np.abs(out.motion - (px_there - px)).max(-1)
    assert np.quantile(motion_error[same], 0.99) < 1e-3
    assert np.quantile(np.abs(out.other_position[..., :3] - there)[solid], 0.99) < 1e-4
    sky = same & (object_id < 0)
    if sky.any():
        assert np.isposinf(out.other_position[sky][:, 2]).all()
        assert np.abs(out.other_position[sky][:, :2] - there[sky][:, :2] / there[sky][:, 2:]).max() < 1e-5


@pytest.mark.device
def test_no_other_time_means_no_motion(device):
    scene = load_scene("plaza")
    renderer = SceneRenderer(device, scene, W, H, 1)
    out = renderer.render(TIME, scene.camera(TIME, W, H)).numpy()
    assert np.abs(out.motion).max() < 1e-3
    assert np.allclose(out.other_position[..., 2], out.depth, rtol=1e-5)


@pytest.mark.device
@pytest.mark.parametrize("name", [*NAMES, *SITUATIONS])
def test_same_bits_twice_and_seeds_differ_and_color_is_well_exposed(device, name):
    one, two = (rendered(device, load_scene(name, 4)) for _ in range(2))
    for field in ("color", "depth", "motion", "other_position", "object_id"):
        assert getattr(one, field).tobytes() == getattr(two, field).tobytes()
    other = rendered(device, load_scene(name, 5))
    assert (np.abs(other.color.astype(np.float32) - one.color.astype(np.float32)).max(-1) > 0.02).mean() > 0.5
    for color in (one.color.astype(np.float32), other.color.astype(np.float32)):
        assert np.isfinite(color).all() and color.min() >= 0 and 0.005 < np.median(color) < 0.6


@pytest.mark.device
def test_window_equals_the_crop(device):
    scene = load_scene("forest", 3)
    big = rendered(device, scene, width=67, height=41)
    x0, y0, w, h = 13, 9, 35, 21

    def window(camera):
        return Camera(camera.world_to_view, camera.fx, camera.fy, camera.cx - x0, camera.cy - y0)

    cameras = {
        "camera": window(scene.camera(TIME, 67, 41)),
        "other": window(scene.camera(TIME - STEP, 67, 41)),
    }
    small = rendered(device, scene, width=w, height=h, **cameras)
    crop = np.s_[y0 : y0 + h, x0 : x0 + w]
    assert np.array_equal(small.object_id, big.object_id[crop])
    assert np.allclose(small.depth, big.depth[crop], rtol=1e-6)
    assert np.abs(small.motion - big.motion[crop]).max() < 1e-3


@pytest.mark.device
@pytest.mark.parametrize("size", [(1, 1), (7, 3), (33, 17)])
def test_odd_sizes(device, size):
    out = rendered(device, load_scene("room"), width=size[0], height=size[1])
    assert out.color.shape == (size[1], size[0], 3) and np.isfinite(out.color.astype(np.float32)).all()


@pytest.mark.device
def test_runtimes_agree():
    infos = [info for info in list_devices() if info.works]
    if len(infos) < 2:
        pytest.skip("only one usable OpenCL device")
    scene = load_scene("room", 1)
    one, two = (rendered(open_info(info), scene) for info in infos[:2])
    same = one.object_id == two.object_id
    assert same.mean() > 0.998
    finite = same & np.isfinite(one.depth)
    assert np.allclose(one.depth[finite], two.depth[finite], rtol=1e-4)
    difference = np.abs(one.color.astype(np.float32) - two.color.astype(np.float32))
    assert np.quantile(difference, 0.98) < 0.01


@pytest.mark.parametrize("scale", [0.0, 2.0])
def test_frames_of_a_scene_by_number(device, scale):
    """As in order, if the one before was asked for last; otherwise resets."""
    live = Live(load_scene("plaza"), device, 32, 20, 4, 30.0, "adaptive", scale)
    in_order = [frame for _, frame in live.frames([0.5], strict=False)]
    live.restart()
    for k, frame in enumerate(in_order):
        again = live.rendered(k)
        assert (again.time, again.camera, again.reset) == (live.time(k), frame.camera, k == 0)
        assert again.motion.tobytes() == frame.motion.tobytes()
    assert in_order[3].camera.fx != in_order[0].camera.fx and live.interval(0) == pytest.approx(1 / 30)
    alone = live.rendered(2)
    assert alone.reset and alone.camera.fx == in_order[0].camera.fx


def test_strict_counts_bad_pixels_of_built_in_scenes(device, monkeypatch):
    live = Live(load_scene("corridor"), device, 16, 12, 2, 30.0)
    render = SceneFrames.rendered

    def spoilt(*given):
        frame = render(*given)
        frame.depth[3, 5] = np.nan
        return frame

    monkeypatch.setattr(SceneFrames, "rendered", spoilt)
    assert [host_arrays(frame).bad.depth for _, frame in live.frames([0.5], strict=False)] == [1, 1]
    with pytest.raises(GffeError, match=r"frame_000000.exr: 1 × invalid depth .* \(strict\)"):
        next(live.frames([0.5], strict=True))
