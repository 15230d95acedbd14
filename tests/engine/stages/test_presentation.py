"""What is shown of frames rendered through windows, and that extrapolation does not care about windows."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import Rect, Rects, camera, psnr
from twins import centers

from gffe_cl import Camera, GffeError, Options, Overlays, Pipeline, RenderedFrame, fixed_window, present
from gffe_cl.engine.frame.rendered_frame import require_one_pose
from gffe_cl.engine.frame.window import FULL, Window
from gffe_cl.engine.stages.background import REMEMBERED

W, H = 96, 64
SCENE = Rects(
    [
        Rect((0, 0, 14), frequency=0.12),
        Rect((-0.5, 0.3, 6), (1, 1), frequency=0.5, tint=(0.6, 0.3, 0.1)),
    ]
)
MOVING = Rects([SCENE.rects[0], replace(SCENE.rects[1], velocity=(4, 1, 0))])


def rendered(scene, display, window, time, previous=None, size=(W, H), render_size=None, samples=2, **given):
    """A frame of `scene` shown by `display`, rendered through `window`; `previous` is (render camera, time)."""
    through = window.camera(display, size, render_size)
    frame = scene.frame(through, time, *(render_size or size), previous, samples=samples, **given)
    return replace(frame, display_camera=display)


def turning(k):
    return camera(W, H, (0.05 * k, 0.01 * k, 0.02 * k), yaw=0.03 * k)


def test_a_full_window_is_bit_exact(device):
    frame = rendered(SCENE, camera(W, H), FULL, 0.0)
    shown = present(frame, frame, device=device)
    for name in ("color", "depth", "motion"):
        assert getattr(shown, name).tobytes() == getattr(frame, name).tobytes()
    pipeline = Pipeline(device, W, H)
    pipeline.submit(replace(frame, reset=True))
    presented = pipeline.present()
    assert presented.color is pipeline.frames.current.color and pipeline.display.presentation is None
    assert presented.numpy("color").tobytes() == frame.color.tobytes()
    assert presented.numpy("depth").tobytes() == frame.depth.tobytes()


def test_whole_pixels_of_overscan_are_cut_off_bit_exactly(device):
    """Rendered with 8 and 5 pixels more on each side at the display's density: the middle, unchanged."""
    display = camera(W, H)
    window = Window(-1 - 16 / W, -1 - 10 / H, 1 + 16 / W, 1 + 10 / H)
    frame = rendered(SCENE, display, window, 0.0, render_size=(W + 16, H + 10))
    shown = present(frame, size=(W, H), device=device)
    assert shown.color.tobytes() == frame.color[5:-5, 8:-8].tobytes()
    assert shown.depth.tobytes() == frame.depth[5:-5, 8:-8].tobytes()
    assert shown.camera == display and shown.motion is None


def test_shown_within_the_error_of_resampling(device):
    """Still, through 1.2: the display part is the picture itself but for the loss of 1.2 × coarser pixels, at the right
    place: better than shifted by a twentieth of a pixel."""
    scene, display = Rects(SCENE.rects[:1]), camera(W, H, yaw=0.1, roll=0.2)
    frame = rendered(scene, display, fixed_window(1.2), 0.0, samples=4)
    shown = present(frame, device=device).color
    truth = scene.color(display, 0.0, W, H, 4)
    assert psnr(shown, truth) > 50
    for offset in ((0.05, 0), (-0.05, 0), (0, 0.05), (0, -0.05)):
        moved = replace(display, cx=display.cx + offset[0], cy=display.cy + offset[1])
        assert psnr(shown, truth) > psnr(shown, scene.color(moved, 0.0, W, H, 4))


@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_playback_alternates_without_a_jump(device, factor):
    """A still scene: shown frames and extrapolated ones are the same picture; at 1.0 bit for bit."""
    display, window = camera(W, H), fixed_window(factor)
    pipeline = Pipeline(device, W, H)
    for k in range(3):
        pipeline.submit(rendered(SCENE, display, window, k / 30, reset=k == 0))
    shown = pipeline.present().numpy("color").astype(np.float64)
    made = pipeline.extrapolate(display, 2.5 / 30)
    difference = np.abs(made.numpy("color") - shown)
    if factor == 1.0:
        assert not difference.any()
        return
    edge = np.zeros((H, W), bool)  # at silhouettes the warp does not mix surfaces, resampling does
    depth = pipeline.present().numpy("depth")
    for dy in range(-3, 4):
        for dx in range(-3, 4):
            edge |= np.roll(depth, (dy, dx), (0, 1)) != depth
    assert difference[~edge].max() < 0.003  # the warp leaves out the corners of 4x4 taps
    assert difference.mean() < 0.002
    sharpness = [np.abs(np.diff(image, axis=1))[~edge[:, 1:]].mean() for image in (shown, made.numpy("color"))]
    assert abs(sharpness[0] / sharpness[1] - 1) < 0.005


WINDOWS = [FULL, Window(-1, -1, 1.25, 1.1), Window(-1.3, -1.05, 1, 1), fixed_window(1.15), Window(-1, -1.2, 1.2, 1)]


def test_motion_between_displayed_images(device):
    """Of a moving scene under a turning camera and windows that change: as if rendered without windows."""
    frames, previous = [], None
    for k in range(3):
        window = WINDOWS[k + 1]
        frames.append(rendered(MOVING, turning(k), window, k / 30, previous))
        previous = (frames[-1].camera, k / 30)
    shown = present(frames[2], frames[1], device=device)
    exact = MOVING.frame(turning(2), 2 / 30, W, H, (turning(1), 1 / 30))
    same_surface = np.abs(shown.depth / exact.depth - 1) < 0.01
    assert same_surface.mean() > 0.97
    np.testing.assert_allclose(shown.motion[same_surface], exact.motion[same_surface], atol=0.15)
    pipeline = Pipeline(device, W, H)
    for k, frame in enumerate(frames):
        pipeline.submit(replace(frame, reset=k == 0))
    assert pipeline.present().numpy("motion").tobytes() == shown.motion.tobytes()
    assert "presentation" in {stage.name for stage, _ in pipeline.named_buffers()}


def extrapolations(device, windows, scene=MOVING, count=6, size=(W, H), render_size=None, options=None):
    """Extrapolated frames after each of `count`, rendered through `windows` in turn, and their disocclusions."""
    pipeline = Pipeline(device, *size, options or Options(), render_size=render_size)
    previous = None
    for k in range(count):
        window = windows[k % len(windows)]
        frame = rendered(scene, turning(k), window, k / 30, previous, size, render_size, reset=k == 0)
        previous = (frame.camera, k / 30)
        pipeline.submit(frame)
        yield k, pipeline, pipeline.extrapolate(turning(k + 0.5), (k + 0.5) / 30)


def test_windows_that_change_extrapolate_as_one_that_does_not(device):
    """At the display's density: windows of 1.25 × the display that lie elsewhere in each frame against a fixed one."""
    render_size = (W * 5 // 4, H * 5 // 4)
    moving = [Window(-1.25, -1.25, 1.25, 1.25), Window(-1.1, -1.1, 1.4, 1.4), Window(-1.4, -1.25, 1.1, 1.25)]
    scores = []
    for windows in (moving[:1], moving):
        errors = []
        for k, _, made in extrapolations(device, windows, render_size=render_size):
            truth = MOVING.color(turning(k + 0.5), (k + 0.5) / 30, W, H, 2)
            if k >= 2:
                errors.append(((made.numpy("color") - truth) ** 2).mean())
        scores.append(-10 * np.log10(np.mean(errors)))
    assert scores[1] > scores[0] - 0.3, scores


def test_static_stays_static_through_windows(device):
    """The static test, the history and the background work in each frame's own pixels: under windows that change, what
    does not move is not taken for moving, what moves keeps its history, and the background does not fill with
    copies."""
    for k, pipeline, made in extrapolations(device, WINDOWS):
        if k < 1:
            continue
        dynamic = pipeline.stages["history"].read("dynamic_mask") > 0
        through = WINDOWS[k % len(WINDOWS)].camera(turning(k), (W, H))
        which, _, _ = MOVING._hit(through, k / 30, centers(H, W).astype(np.float64))
        assert (dynamic == (which == 1)).mean() > 0.99
        assert (pipeline.stages["background"].read("state_0") == REMEMBERED).mean() < 0.15
        motion = made.numpy("motion")
        assert np.isfinite(motion).all()


def test_a_display_camera_elsewhere_is_refused(device):
    frame = replace(SCENE.frame(camera(W, H), 0.0, W, H, reset=True), display_camera=camera(W, H, yaw=0.1))
    with pytest.raises(GffeError, match="display_camera must have the pose"):
        Pipeline(device, W, H).submit(frame)
    with pytest.raises(GffeError, match="display_camera must have the pose"):
        present(frame, device=device)


@pytest.mark.parametrize("distance", [0.0, 1e6])
def test_another_pose_is_refused_far_from_the_origin_too(distance):
    made, turned = camera(W, H, (0, distance, 0)), camera(W, H, (0, distance, 0), yaw=1e-3)
    for display in (turned, camera(W, H, (0.01 * (1 + distance), distance, 0))):
        with pytest.raises(GffeError, match="display_camera must have the pose"):
            require_one_pose(made, display)
    require_one_pose(made, made.scaled(2, 3))


def test_a_whole_frame_after_a_windowed_one(device):
    """Its motion is converted all the same: the frame before was shown elsewhere than it was rendered."""
    first = rendered(MOVING, turning(0), fixed_window(1.3), 0.0, reset=True)
    second = rendered(MOVING, turning(1), FULL, 1 / 30, (first.camera, 0.0))
    exact = MOVING.frame(turning(1), 1 / 30, W, H, (turning(0), 0.0)).motion
    pipeline = Pipeline(device, W, H)
    pipeline.submit(first)
    pipeline.submit(second)
    for motion in (present(second, first, device=device).motion, pipeline.present().numpy("motion")):
        np.testing.assert_allclose(motion, exact, atol=1e-3)
    pipeline.submit(rendered(MOVING, turning(2), FULL, 2 / 30, (second.camera, 1 / 30)))
    assert "presentation" not in {stage.name for stage, _ in pipeline.named_buffers()}


def test_a_reset_has_no_motion(device):
    first = rendered(MOVING, turning(0), fixed_window(1.3), 0.0)
    cut = replace(rendered(MOVING, turning(1), fixed_window(1.2), 1 / 30), reset=True, motion=None)
    assert present(cut, first, device=device).motion is None


def test_the_frame_before_may_have_another_size(device):
    first = rendered(MOVING, turning(0), FULL, 0.0, render_size=(W // 2, H // 2))
    first = replace(first, display_camera=None)
    second = rendered(MOVING, turning(1), fixed_window(1.2), 1 / 30, (first.camera, 0.0))
    shown = present(second, first, device=device)
    exact = MOVING.frame(turning(1), 1 / 30, W, H, (turning(0), 0.0))
    same = np.abs(shown.depth / exact.depth - 1) < 0.01
    np.testing.assert_allclose(shown.motion[same], exact.motion[same], atol=0.15)


def test_what_present_refuses(device):
    frame = rendered(SCENE, camera(W, H), fixed_window(1.1), 0.0)
    for wrong in (
        replace(frame, color=frame.color[:5]),
        replace(frame, depth=frame.depth[..., None]),
        replace(frame, color=None),
        replace(frame, overlays=Overlays(effects=np.zeros((H, W, 3)))),
    ):
        with pytest.raises(GffeError):
            present(wrong, device=device)
    for size in ((0, 0), (-4, 5), (3.5, 2), (1, 2, 3)):
        with pytest.raises(GffeError, match="in whole pixels"):
            present(frame, size=size, device=device)


def test_presenting_before_submitting_is_refused(device):
    with pytest.raises(GffeError, match="submit a rendered frame first"):
        Pipeline(device, W, H).present()


def test_float_color_stays_float(device):
    frame = rendered(SCENE, camera(W, H), fixed_window(1.1), 0.0)
    frame = RenderedFrame(frame.color.astype(np.float32), frame.depth, None, frame.camera, 0.0, camera(W, H))
    assert present(frame, device=device).color.dtype == np.float32
    assert isinstance(present(frame, device=device).camera, Camera)
