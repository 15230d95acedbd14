"""The adaptive rendering window covers what it says it covers, and projection matrices are what each API takes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import camera

from gffe_cl import Camera, GffeError, adaptive_window, fixed_window, nearest_depth, predict_camera
from gffe_cl.engine.frame.window import FULL, WindowChooser

SIZE = (320, 180)


@st.composite
def motions(draw, turn=0.3, travel=0.5):
    """Previous and current camera: any pose, off-center, then turned and moved by up to so much."""
    pose = [draw(st.floats(-50, 50)) for _ in range(3)]
    angles = [draw(st.floats(-3, 3)), draw(st.floats(-1.4, 1.4)), draw(st.floats(-3, 3))]
    fov, off = draw(st.floats(0.4, 1.8)), (draw(st.floats(-60, 60)), draw(st.floats(-40, 40)))
    moved = [p + draw(st.floats(-travel, travel)) for p in pose]
    turned = [a + draw(st.floats(-turn, turn)) for a in angles]
    made = []
    for position, (yaw, pitch, roll), zoom in ((pose, angles, 1.0), (moved, turned, draw(st.floats(0.8, 1.25)))):
        c = camera(*SIZE, position, yaw, pitch, roll, fov)
        made.append(Camera(c.world_to_view, c.fx * zoom, c.fy * zoom, c.cx + off[0], c.cy + off[1]))
    return made


def frustum_in_window(current, predicted, window, distance, size=SIZE):
    """Positions of points of the predicted frustum's edges from `distance` on, in the window's own coordinates."""
    render = window.camera(current, size)
    px = np.array([(0, 0), (size[0], 0), size, (0, size[1])], np.float64)
    uv = []
    for depth in (1e-3, 0.1, 0.5, 1, 2, 5, 20, 1e3, 1e6):
        at, z = render.project(predicted.unproject(px, np.full(4, depth * distance)))
        uv.append((2 * at / size - 1)[z >= distance])
    return np.concatenate(uv)


@settings(max_examples=100, deadline=None)
@given(motions(), st.lists(st.floats(0.05, 2), min_size=1, max_size=4), st.floats(0.5, 20))
def test_covers_every_predicted_frustum_or_says_so(cameras, alphas, distance):
    previous, current = cameras
    predicted = [predict_camera(previous, current, alpha) for alpha in alphas]
    window = adaptive_window(current, predicted, 3.0, size=SIZE, distance=distance)
    assert window.u0 <= -1 and window.v0 <= -1 and window.u1 >= 1 and window.v1 >= 1
    assert max(window.enlargement) <= 3.0 + 1e-9
    inside = [np.abs(frustum_in_window(current, p, window, distance)).max(initial=0) <= 1 + 1e-6 for p in predicted]
    assert all(inside) or window.clamped
    unlimited = adaptive_window(current, predicted, 1e5, size=SIZE, distance=distance)
    if not unlimited.clamped:
        assert window.clamped == (max(unlimited.enlargement) > 3.0)


@settings(max_examples=100, deadline=None)
@given(motions(turn=6.3, travel=30.0), st.floats(0.05, 4), st.floats(1, 4))
def test_any_motion_gives_a_window(cameras, alpha, most):
    """Turning past 90°, upside down, through walls: finite, not inverted, within the maximum."""
    previous, current = cameras
    predicted = predict_camera(previous, current, alpha)
    window = adaptive_window(current, predicted, most, size=SIZE, distance=1.0)
    assert np.isfinite(window[:4]).all()
    assert window.u0 <= -1 and window.v0 <= -1 and window.u1 >= 1 and window.v1 >= 1
    assert max(window.enlargement) <= most + 1e-9
    assert np.isfinite(window.camera(current, SIZE).intrinsics).all()


@settings(max_examples=100, deadline=None)
@given(st.floats(0.01, 0.2), st.floats(0.1, 1))
def test_the_appendix_formula(angle, alpha):
    """Centered, one predicted camera, no margin: u1 = max(1, x̄max / xmax) on the plane at distance d, and so on."""
    current, distance = camera(*SIZE, yaw=angle), 4.0
    predicted = predict_camera(camera(*SIZE), current, alpha)
    px = np.array([(0, 0), (SIZE[0], 0), SIZE, (0, SIZE[1])], np.float64)
    rays = predicted.unproject(px, np.ones(4)) - predicted.position
    rays = rays @ current.world_to_view[:3, :3].T
    met = rays / rays[:, 2:] * distance
    x_max, y_max = SIZE[0] / 2 / current.fx * distance, SIZE[1] / 2 / current.fy * distance
    expected = (
        min(-1, met[:, 0].min() / x_max),
        min(-1, met[:, 1].min() / y_max),
        max(1, met[:, 0].max() / x_max),
        max(1, met[:, 1].max() / y_max),
    )
    window = adaptive_window(current, predicted, 10.0, distance=distance, margin=0)
    np.testing.assert_allclose(window[:4], expected, atol=1e-6)


def test_standing_still_needs_no_window():
    for pose in ({}, {"position": (1e6, 3, -7), "yaw": 0.3, "pitch": 0.1, "roll": 2.0}):
        current = camera(*SIZE, **pose)
        window = adaptive_window(
            current, [predict_camera(current, current, a) for a in (0.5, 2)], size=SIZE, distance=1
        )
        assert window == FULL
        assert window.camera(current, SIZE) == current


@pytest.mark.parametrize(
    ("motion", "grows"),
    [
        ({"yaw": 0.05}, "u1"),
        ({"yaw": -0.05}, "u0"),
        ({"pitch": 0.05}, "v1"),
        ({"position": (0.2, 0, 0)}, "u1"),
        ({"position": (0, 0.2, 0)}, "v1"),
        ({"position": (0, 0, -0.5)}, "u0 v0 u1 v1"),  # backwards
        ({"roll": 0.05}, "u0 v0 u1 v1"),
        ({"position": (0, 0, 0.5)}, ""),  # forwards
    ],
)
def test_grows_where_the_camera_goes(motion, grows):
    current = camera(*SIZE, **motion)
    window = adaptive_window(current, predict_camera(camera(*SIZE), current, 0.5), size=SIZE, distance=3.0)
    enlarged = [name for name in ("u0", "v0", "u1", "v1") if abs(getattr(window, name)) > 1.01]
    assert set(grows.split()) <= set(enlarged) and not window.clamped
    if not grows:
        assert window == FULL


def test_turning_past_the_plane_is_clamped():
    current = camera(*SIZE)
    for yaw in (1.0, 1.7, 2.3):
        for side in (-1, 1):
            window = adaptive_window(current, camera(*SIZE, yaw=side * yaw), 2.0, size=SIZE)
            assert window.clamped and math.isclose(window.enlargement[0], 2.0)
            wanted, other = (window.u1, window.u0) if side > 0 else (window.u0, window.u1)
            assert abs(wanted) > abs(other)
    behind = adaptive_window(current, camera(*SIZE, yaw=math.pi), 2.0, size=SIZE)
    assert behind.clamped and math.isclose(behind.enlargement[0], 2.0)
    # Extrapolated from one turn by more than 90° to the next.
    current = camera(*SIZE, yaw=1.7)
    window = adaptive_window(current, predict_camera(camera(*SIZE), current, 8.0), 2.0, size=SIZE)
    assert window.clamped and window.u0 == -1 and window.u1 == 3


def test_the_side_that_asks_for_less_has_precedence():
    current = camera(*SIZE)
    wide = Camera(current.world_to_view, current.fx / 4, current.fy, current.cx * 0.5, current.cy)
    window = adaptive_window(current, wide, 1.5, size=SIZE, margin=0)
    assert window.clamped and math.isclose(window.enlargement[0], 1.5)
    np.testing.assert_allclose(window[:4], (-1.5, -1, 1.5, 1), atol=1e-9)
    little = Camera(current.world_to_view, current.fx / 2, current.fy, current.cx * 0.6, current.cy)
    np.testing.assert_allclose(
        adaptive_window(current, little, 1.5, size=SIZE, margin=0)[:4], (-1.2, -1, 1.8, 1), atol=1e-9
    )


@settings(max_examples=100, deadline=None)
@given(motions(), st.floats(1, 2))
def test_a_window_shows_the_same_rays(cameras, factor):
    """The display's pixels keep their directions; only where they lie in the rendered image changes."""
    _, current = cameras
    window = adaptive_window(current, cameras, 1 + factor, size=SIZE)
    for w, render_size in ((window, None), (fixed_window(factor), (401, 113))):
        render = w.camera(current, SIZE, render_size)
        width, height = render_size or SIZE
        corners = np.array([(0, 0), (width, height)], np.float64)
        px = np.array([[(w.u0 + 1) / 2, (w.v0 + 1) / 2], [(w.u1 + 1) / 2, (w.v1 + 1) / 2]]) * SIZE
        np.testing.assert_allclose(current.project(render.unproject(corners, np.ones(2)))[0], px, atol=1e-6 * max(SIZE))


def test_modes():
    still, turned = camera(*SIZE), camera(*SIZE, yaw=0.05)
    assert WindowChooser("off", SIZE, [0.5]).choose(turned, still) == FULL
    assert WindowChooser("fixed:1.2", SIZE, [0.5]).choose(turned, None) == fixed_window(1.2)
    # Frames at every α are covered, and a movement that leaves less than 0.05% of a side open is not worth a window.
    far = WindowChooser("adaptive", SIZE, [0.25, 1.5]).choose(turned, still)
    assert far.u1 > WindowChooser("adaptive", SIZE, [0.25]).choose(turned, still).u1 + 0.03
    assert WindowChooser("adaptive", SIZE, [0.5]).choose(camera(*SIZE, yaw=2e-4), still) == FULL
    chooser = WindowChooser("adaptive", SIZE, [0.5, 0.25])
    assert chooser.choose(turned, None) == FULL  # after a reset nothing is known
    turning = chooser.choose(turned, still)
    assert turning.u1 > 1.01 and turning.u0 == -1
    sideways = camera(*SIZE, (0.3, 0, 0))
    assert chooser.choose(sideways, still) == FULL  # as far as is known, everything is far away
    chooser.observe(np.full((9, 9), 3.0, np.float32))
    assert chooser.choose(sideways, still).u1 > 1.01
    for wrong in ("", "off:", "adaptive:", "fixed:1e12", "on", "fixed", "fixed:0.5", "fixed:nan", "adaptive:2"):
        with pytest.raises(GffeError, match="window"):
            WindowChooser(wrong, SIZE, [0.5])


def test_margin_and_zoom():
    """A pixel beyond enlarged sides, and none beyond others; zooming out is covered too."""
    still, turned = camera(*SIZE), camera(*SIZE, yaw=0.05)
    predicted = predict_camera(still, turned, 0.5)
    bare, usual = (adaptive_window(turned, predicted, size=SIZE, **m) for m in ({"margin": 0}, {}))
    np.testing.assert_allclose(usual.u1 - bare.u1, 2 / SIZE[0])
    assert usual.u0 == -1
    wider = Camera(still.world_to_view, still.fx * 0.9, still.fy * 0.8, still.cx, still.cy)
    zoomed = predict_camera(still, wider, 0.5)
    assert (zoomed.fx, zoomed.fy) == (pytest.approx(still.fx * 0.85), pytest.approx(still.fy * 0.7))
    window = adaptive_window(wider, zoomed, size=SIZE, margin=0)
    np.testing.assert_allclose(window[:4], (-0.9 / 0.85, -0.8 / 0.7, 0.9 / 0.85, 0.8 / 0.7))


def test_moving_past_the_plane():
    """The predicted camera stands beyond the virtual plane: what lies ahead of it is covered."""
    current = camera(*SIZE)
    beyond = camera(*SIZE, (2.0, 0, 5.0))
    window = adaptive_window(current, beyond, 9.0, size=SIZE, distance=1.0)
    assert np.abs(frustum_in_window(current, beyond, window, 5.0)).max() <= 1 + 1e-6 and not window.clamped


def test_nearest_depth_skips_what_is_no_depth():
    depth = np.full((40, 40), 7.0, np.float32)
    depth[:20] = np.inf
    depth[0, 0], depth[4, 4], depth[8, 8] = np.nan, -3, 0
    assert nearest_depth(depth) == 7
    assert nearest_depth(np.linspace(1, 101, 10201, dtype=np.float32).reshape(101, 101)) == pytest.approx(6, abs=0.1)
    assert nearest_depth(np.full((4, 4), np.inf)) == math.inf


# ---- what an engine needs ------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(motions(), st.sampled_from(["opengl", "direct3d", "vulkan"]), st.booleans(), st.sampled_from([50.0, math.inf]))
def test_projection_matrices(cameras, api, reverse, far):
    """Projection · view puts every point on its pixel, and the near and far planes on the ends of the depth range."""
    current, width, height, near = cameras[1], 400, 250, 0.1
    view, projection = current.view_matrix(api), current.projection_matrix(api, width, height, near, far, reverse)
    px = np.array([(0, 0), (400, 250), (13, 200), (350.5, 20.25), (77, 77)])
    depth = np.array([near, 50.0, 1.0, 9.0, near])
    world = np.concatenate([current.unproject(px, depth), np.ones((5, 1))], 1)
    clip = world @ (projection @ view).T
    assert (clip[:, 3] > 0).all()
    ndc = clip[:, :3] / clip[:, 3:]
    up = -1 if api == "vulkan" else 1
    scale = 1 + np.abs(current.position).max()
    np.testing.assert_allclose(ndc[:, 0], 2 * px[:, 0] / width - 1, atol=1e-7 * scale)
    np.testing.assert_allclose(ndc[:, 1], up * (1 - 2 * px[:, 1] / height), atol=1e-7 * scale)
    first, last = (1, 0) if reverse else (-1, 1) if api == "opengl" else (0, 1)
    np.testing.assert_allclose(ndc[[0, 4], 2], first, atol=1e-5 * scale)
    if far == 50.0:
        np.testing.assert_allclose(ndc[1, 2], last, atol=1e-7 * scale)
    else:
        assert min(first, last) <= ndc[1, 2] <= max(first, last)
    nearer = (ndc[3, 2] - ndc[2, 2]) * (last - first)
    assert nearer > 0  # depth 9 lies behind depth 1


def test_opengl_agrees_with_the_textbook():
    """A centered camera gives gluPerspective's matrix."""
    made = Camera(np.eye(4), 90, 90, 100, 50).projection_matrix("opengl", 200, 100, 0.5, 20)
    f = 90 / 50
    expected = [[f / 2, 0, 0, 0], [0, f, 0, 0], [0, 0, -20.5 / 19.5, -2 * 20 * 0.5 / 19.5], [0, 0, -1, 0]]
    np.testing.assert_allclose(made, expected, atol=1e-12)
