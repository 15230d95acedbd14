"""History tracking: what is dynamic, and what is not."""

from dataclasses import replace

import numpy as np
import pytest
from device_arrays import copy_to
from moving_scene import MOVING, WALL, H, W, half, submit
from synthetic import Rect, Rects, camera

from gffe_cl.captures.sequence.encoding import Encoding
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, host_arrays
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Board, Step
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.history import HistoryTracking
from gffe_cl.engine.stages.warp import ColorCode


@pytest.mark.parametrize(("lookups", "sign"), [(1, 1), (2, 1), (1, -1)])
def test_threshold_beside_quantization(device, lanes, lookups, sign):
    """Half floats of UV, counted either way: the steps of each component and sign are found, and in the next frame how
    many of them were added; the static world stays static, and a mover of 3 px is dynamic."""
    width, height, encoding = 320, 180, Encoding.parse("half-uv")
    world = Rects([Rect((0, 0, 14), (40, 30)), Rect((0, 0, 6), (1.2, 1.2), velocity=(4, 0, 0))])
    board = Board(device, Sizes((width, height), (width, height)), Options())
    stage, past = HistoryTracking(board), None
    ColorCode(board)
    for k in range(3):
        view = camera(width, height, (0.02 * k, 0.02 * k, 0.6 * k))
        frame = world.frame(view, k / 30, width, height, past and (past.camera, past.time), reset=k == 0)
        mover = frame.depth < 10
        frame.motion = sum(sign * encoding.motion(sign * frame.motion / lookups) for _ in range(lookups))
        before = board.bindings.rendered
        taken = DeviceFrame.allocate(device, (width, height), view, view, frame.time)
        copy_to(device, taken, host_arrays(frame).in_device_layout())
        stage.swap()
        board.bindings.show(taken, before)
        stage.rendered(Step(taken, before, []))
        past = frame
    assert stage.read("static_threshold_squared") <= 0.25**2
    error = stage.read("quantization_error").ravel()
    steps = np.array(((1920 / 1024, 1920 / 2048)[::sign], (1080 / 1024, 1080 / 2048)[::sign])).ravel()
    assert np.allclose(error, lookups * steps / 2, rtol=0.07)
    dynamic = stage.read("dynamic_mask") > 0
    assert dynamic[mover].mean() > 0.9 and dynamic[~mover].mean() < 0.02, (
        dynamic[mover].mean(),
        dynamic[~mover].mean(),
    )


# ---- what is dynamic -----------------------------------------------------------------------------------


@pytest.mark.parametrize("camera_fixed", [True, False])
def test_what_is_fixed_to_the_camera_stays(device, camera_fixed):
    """A dashboard before a camera that drives on and shakes: it stays where it is in the image, to the bit."""
    wall = Rects([Rect((0, 0, 14), frequency=0.3)])
    cameras = [camera(W, H, position) for position in ((0, 0, 0), (0.02, -0.01, 0.4), (-0.03, 0.02, 0.8))]
    board = np.s_[3 * H // 4 :, :]
    pattern = half(np.random.default_rng(0).uniform(0.1, 0.9, (H, W, 3)))
    pipeline = Pipeline(device, W, H, options=Options(camera_fixed=camera_fixed))
    for k, now in enumerate(cameras):
        before = (cameras[max(k - 1, 0)], max(k - 1, 0) / 30)
        shown = wall.frame(now, k / 30, W, H, before)
        color, depth, motion = (np.array(a) for a in (shown.color, shown.depth, shown.motion))
        color[board], depth[board], motion[board] = pattern[board], 0.8, 0
        pipeline.submit(RenderedFrame(color, depth, motion, now, k / 30, reset=k == 0))
    labels, met = (pipeline.stages["history"].read(name)[board] for name in ("dynamic_mask", "met_depth"))
    out = pipeline.extrapolate(camera(W, H, (0.05, 0.03, 1.0)), 2.5 / 30)
    color, depth, motion, dynamic = (out.numpy(name)[board][1:] for name in ("color", "depth", "motion", "dynamic"))
    same = (color[..., :3] == pattern[board][1:]).all(-1) & (depth == np.float32(0.8))  # but for its soft upper edge
    if camera_fixed:
        assert (labels == 2).all() and (met == np.float32(0.8)).all()
        assert same.all() and (dynamic == 1).all() and not motion.any()
    else:
        assert (labels == 1).mean() > 0.9 and same.mean() < 0.5


def test_what_travels_with_the_camera_is_found_again(device):
    """A near panel that is carried along, and shakes a little before the camera: its last position is known."""
    wall = Rects([Rect((0, 0, 14), frequency=0.3)])
    panel = np.s_[H // 2 :, W // 4 : W // 2]
    met = {}
    for camera_fixed in (True, False):
        pipeline = Pipeline(device, W, H, options=Options(camera_fixed=camera_fixed))
        for k in range(3):
            now, before = camera(W, H, (0, 0, 0.4 * k)), camera(W, H, (0, 0, 0.4 * max(k - 1, 0)))
            shown = wall.frame(now, k / 30, W, H, (before, max(k - 1, 0) / 30))
            depth, motion = np.array(shown.depth), np.array(shown.motion)
            depth[panel], motion[panel] = 0.8, (0.5, 0)
            pipeline.submit(RenderedFrame(shown.color, depth, motion, now, k / 30, reset=k == 0))
        met[camera_fixed] = pipeline.stages["history"].read("met_depth")[panel][4:-4, 4:-4]
    assert (met[True] == np.float32(0.8)).all() and not met[False].all()


@pytest.mark.parametrize("pace", [1.0, 0.15])
def test_threshold_follows_quantized_motion(device, pace):
    """Motion rounded to 1.5 px must not make the static world dynamic, be it that the camera is slow and most vectors
    are equal; a mover stays dynamic."""
    fractions = []
    for step in (None, 1.5):
        pipeline = Pipeline(device, W, H)
        previous = None
        scene = Rects([WALL, Rect((0, 0, 6), (0.8, 0.8), velocity=(12, 0, 0))])
        for k in range(3):
            cam = camera(W, H, (0.11 * k * pace, 0.02 * k * pace, 0.2 * k * pace), 0.02 * k * pace)
            frame = scene.frame(cam, k / 30, W, H, previous, reset=k == 0)
            if step:
                frame.motion = (np.round(frame.motion / step) * step).astype(np.float32)
            pipeline.submit(frame)
            previous = (cam, k / 30)
        dynamic = pipeline.stages["history"].read("dynamic_mask") > 0
        mover = frame.depth < 7
        fractions.append((dynamic[mover].mean(), dynamic[~mover].mean()))
    for moving, static in fractions:
        assert moving > 0.95 and static < 0.02, fractions


@pytest.mark.parametrize("kind", ["looked up twice", "camera off"])
def test_threshold_follows_other_errors(device, kind):
    """Vectors over two intervals are the sum of two lookups, so their errors add up; a camera that is a fit is off by
    the same everywhere. Neither makes the static world dynamic; a mover stays dynamic."""
    pipeline, previous = Pipeline(device, W, H), None
    scene = Rects([WALL, Rect((0, 0, 6), (0.8, 0.8), velocity=(12, 0, 0))])
    for k in range(3):
        cam, half_ago = (camera(W, H, (0.25 * t, 0, 0)) for t in (k, k - 0.5))
        frame = scene.frame(cam, k / 30, W, H, previous, reset=k == 0)
        if kind == "looked up twice" and previous:
            first = scene.frame(cam, k / 30, W, H, (half_ago, (k - 0.5) / 30)).motion
            second = scene.frame(half_ago, (k - 0.5) / 30, W, H, previous).motion
            frame.motion = sum(Encoding.parse("half-uv").motion(motion) for motion in (first, second))
        elif kind == "camera off":
            frame.camera = replace(cam, cx=cam.cx + (0.4, -0.3, 0.2)[k], cy=cam.cy - (0.2, 0.3, -0.2)[k])
        pipeline.submit(frame)
        previous = (cam, k / 30)
    dynamic, mover = pipeline.stages["history"].read("dynamic_mask") > 0, frame.depth < 7
    assert dynamic[mover].mean() > 0.9 and dynamic[~mover].mean() < 0.04, (
        dynamic[mover].mean(),
        dynamic[~mover].mean(),
    )


@pytest.mark.parametrize("speed", [1.0, 2.0, 3.9])
def test_a_mover_that_fills_the_frame_is_no_noise(device, speed):
    """Nothing but sky and one mover: its residual is large everywhere, but it is motion all the same."""
    cam = camera(W, H)
    pipeline = Pipeline(device, W, H)
    y, x = np.mgrid[:H, :W]
    for k in range(3):
        mover = (np.abs(x - 30 - speed * k) < 20) & (np.abs(y - H / 2) < 24)
        depth = np.where(mover, 6.0, np.inf).astype(np.float32)
        motion = np.zeros((H, W, 2), np.float32)
        motion[mover] = (-speed, 0)
        color = half(np.where(mover[..., None], (0.8, 0.2, 0.1), (0.3, 0.4, 0.9)))
        pipeline.submit(RenderedFrame(color, depth, motion, cam, k / 30, reset=k == 0))
    assert pipeline.stages["history"].read("dynamic_mask")[mover].all()
    shown = np.flatnonzero(pipeline.extrapolate(cam, 3 / 30).numpy("color")[H // 2, :, 0] > 0.6)
    assert abs(shown.min() - (30 + speed * 3 - 19.5)) <= 1 and abs(shown.max() - (30 + speed * 3 + 19.5)) <= 1


@pytest.mark.parametrize("approach", [0.04, 0.06, 0.1])
def test_an_object_coming_straight_at_the_camera(device, approach):
    """Depth shrinks by up to 10% per frame with hardly any sideways motion: its history is known, it grows."""
    cam = camera(W, H)
    pipeline = Pipeline(device, W, H)

    def scene(k):
        return Rects([Rect((0, 0, 30), frequency=0.1), Rect((0, 0, 8 * (1 - approach) ** k), (1.5, 1.0))])

    for k in range(4):
        frame = scene(k).frame(cam, k / 30, W, H, reset=k == 0)
        y, x = np.nonzero(frame.depth < 20)
        away = np.stack([x + 0.5 - W / 2, y + 0.5 - H / 2], -1)
        frame.motion[y, x] = away * (1 - approach) - away
        pipeline.submit(frame)
    dynamic = pipeline.stages["history"].read("dynamic_mask") == 1
    known = pipeline.stages["history"].read("met_depth") > 0
    assert dynamic.sum() > 150 and known[dynamic].mean() > 0.9
    out = pipeline.extrapolate(cam, 3.5 / 30)
    expected = 8 * ((1 - approach) ** 3 + 0.5 * ((1 - approach) ** 3 - (1 - approach) ** 2))
    assert out.numpy("depth")[H // 2, W // 2 + 11] == pytest.approx(expected, rel=0.01)


def test_depth_met_at_edges_is_of_one_surface(device):
    """A board moves quickly before a wall that is plausible for it, too: between their pixels, its own depth is met."""
    cam = camera(W, H)
    pipeline = Pipeline(device, W, H)
    board = Rect((-2, 0, 8), (1, 0.8), velocity=(10.3 * 30 * 8 / cam.fx, 0, 0))
    world = Rects([Rect((0, 0, 8.6), frequency=0.3), board])
    for k in range(3):
        pipeline.submit(world.frame(cam, k / 30, W, H, (cam, max(k - 1, 0) / 30), reset=k == 0))
    moves = pipeline.stages["history"].read("dynamic_mask") == 1
    assert moves.sum() > 100 and np.allclose(pipeline.stages["history"].read("met_depth")[moves], 8, atol=1e-4)


def test_motion_onto_another_surface_means_no_motion(device):
    """Where the motion vector meets no plausible surface, the fragment is dynamic; the paper leaves it where it is."""
    cam = camera(W, H)
    pipeline = Pipeline(device, W, H, Options(static_threshold=0.5, entering=False))
    depth = np.full((H, W), 20, np.float32)
    color = half(np.full((H, W, 3), 0.3))
    still = np.zeros((H, W, 2), np.float32)
    pipeline.submit(RenderedFrame(color, depth, still, cam, 0.0, reset=True))
    depth2, motion2 = depth.copy(), still.copy()
    depth2[20:30, 40:50] = 3.0  # appears from nowhere, claiming to come from 12 px to the left
    motion2[20:30, 40:50] = (-12, 0)
    pipeline.submit(RenderedFrame(color, depth2, motion2, cam, 1 / 30))
    assert (pipeline.stages["history"].read("dynamic_mask")[20:30, 40:50] == 1).all()
    out = pipeline.extrapolate(cam, 1.5 / 30)
    assert np.array_equal(out.numpy("depth"), depth2)


def test_reset_forgets(device):
    """After a reset everything is predicted as static, whatever the motion vectors say."""
    pipeline = Pipeline(device, W, H)
    cams = [camera(W, H)] * 3
    submit(pipeline, MOVING, cams, [0, 1 / 30, 2 / 30])
    assert pipeline.stages["history"].read("dynamic_mask").any()
    frame = MOVING.frame(cams[0], 10.0, W, H, (cams[0], 10 - 1 / 30), reset=True)
    pipeline.submit(frame)
    assert not pipeline.stages["history"].read("dynamic_mask").any()
    out = pipeline.extrapolate(cams[0], 10 + 0.5 / 30)
    assert out.alpha == pytest.approx(0.5)
    assert out.numpy("color").tobytes() == frame.color.tobytes()
