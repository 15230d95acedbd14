"""Cameras: projection, composition far from the origin, prediction, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gffe_cl import Camera, GffeError, predict_camera

angle = st.floats(-3, 3)
coordinate = st.floats(-100, 100)


@st.composite
def cameras(draw):
    from synthetic import camera

    made = camera(320, 200, [draw(coordinate) for _ in range(3)], draw(angle), draw(st.floats(-1.4, 1.4)), draw(angle))
    return Camera(made.world_to_view, made.fx, 1.1 * made.fy, 150 + draw(coordinate), 90.5)


@settings(max_examples=60, deadline=None)
@given(cameras(), coordinate, coordinate, st.floats(0.1, 1000))
def test_projection_and_its_inverse(camera, x, y, depth):
    world = camera.unproject(np.array([x, y]), np.array(depth))
    px, z = camera.project(world)
    np.testing.assert_allclose(px, (x, y), atol=1e-6 * (1 + 1000 / depth))
    np.testing.assert_allclose(z, depth, rtol=1e-9)


@settings(max_examples=40, deadline=None)
@given(cameras(), cameras())
def test_view_to_view(a, b):
    """Composed transforms agree with going through the world; equal poses give exactly 1."""
    point = np.array([0.3, -0.2, 2.0, 1.0])
    through_world = b.world_to_view @ (a.view_to_world @ point)
    np.testing.assert_allclose(a.to_view_of(b) @ point, through_world, atol=1e-9)
    assert np.array_equal(a.to_view_of(a), np.eye(4))


def test_axes():
    """x right, y down, z forward; the pixel above the centre is up."""
    camera = Camera.look_at((1, 2, 3), (1, 2, -7), (0, 1, 0), 100, 100, 50, 40)
    np.testing.assert_allclose(camera.position, (1, 2, 3))
    np.testing.assert_allclose(camera.direction, (0, 0, -1))
    np.testing.assert_allclose(camera.up, (0, 1, 0))
    px, depth = camera.project([[2, 2, -7], [1, 3, -7]])
    np.testing.assert_allclose(px, [[60, 40], [50, 30]])
    np.testing.assert_allclose(depth, 10)


@settings(max_examples=60, deadline=None)
@given(cameras(), cameras(), st.floats(0, 2))
def test_predicted_camera_is_a_camera(previous, current, alpha):
    """Rigid and finite whatever the motion; at α = 0 the current one; positions and focal lengths linear."""
    predicted = predict_camera(previous, current, alpha)
    rotation = predicted.world_to_view[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(
        predicted.position, current.position + alpha * (current.position - previous.position), atol=1e-6
    )
    if alpha == 0:
        np.testing.assert_allclose(predicted.world_to_view, current.world_to_view, atol=1e-9)


def test_prediction_keeps_handedness():
    left_handed = np.diag([1.0, -1, 1, 1])
    camera = Camera(left_handed, 100, 100, 50, 40)
    np.testing.assert_allclose(predict_camera(camera, camera, 0.5).world_to_view, left_handed, atol=1e-12)


@pytest.mark.parametrize("alpha", [0.5, 2.0])
def test_prediction_of_a_moving_left_handed_camera(alpha):
    """Mirrored, it predicts the mirror image of the right-handed prediction."""
    from synthetic import camera

    mirror = np.diag([-1.0, 1, 1, 1])
    pair = camera(64, 48, yaw=0.1), camera(64, 48, (0.3, 0, 0.1), yaw=0.15, roll=0.1)
    expected = mirror @ predict_camera(*pair, alpha).world_to_view
    mirrored = [Camera(mirror @ c.world_to_view, c.fx, c.fy, c.cx, c.cy) for c in pair]
    np.testing.assert_allclose(predict_camera(*mirrored, alpha).world_to_view, expected, atol=1e-12)


@pytest.mark.parametrize("alpha", [np.nan, np.inf])
def test_alpha_must_be_finite(alpha):
    from synthetic import camera

    with pytest.raises(GffeError, match="alpha"):
        predict_camera(camera(64, 48), camera(64, 48, yaw=0.1), alpha)


def test_turning_steadily():
    from synthetic import camera

    predicted = predict_camera(camera(64, 48, yaw=0.1), camera(64, 48, yaw=0.15), 0.5)
    expected = camera(64, 48, yaw=0.175)
    np.testing.assert_allclose(predicted.world_to_view, expected.world_to_view, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"world_to_view": np.zeros((4, 4))}, "singular or not rigid"),
        ({"world_to_view": 2 * np.eye(4)}, "not rigid"),
        ({"world_to_view": np.full((4, 4), np.nan)}, "not finite"),
        ({"world_to_view": np.eye(3)}, "must be 4×4, got 3×3"),
        ({"world_to_view": "identity"}, "4×4"),
        ({"world_to_view": np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [5, 0, 0, 1]])}, "last row"),
        ({"fx": 0}, "fx and fy must be positive"),
        ({"fy": -3}, "fx and fy must be positive"),
        ({"cx": np.inf}, "not finite"),
        ({"cy": "middle"}, "numbers"),
    ],
)
def test_refused(change, message):
    good = {"world_to_view": np.eye(4), "fx": 100, "fy": 100, "cx": 50, "cy": 40}
    with pytest.raises(GffeError, match=message):
        Camera(**good | change)
