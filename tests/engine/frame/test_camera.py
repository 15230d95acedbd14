"""Cameras: projection, composition far from the origin, prediction, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gffe_cl import Camera, GffeError, predict_camera, predict_camera_at
from gffe_cl.engine.frame.camera_prediction import RIDGE, _NextChange, rotation_matrix, rotation_vector

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
    """x right, y down, z forward; the pixel above the center is up."""
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


def test_a_prediction_without_a_direction_is_refused():
    behind, ahead = (Camera.look_at((0, 0, 0), (0, 0, z), (0, -1, 0), 9, 9, 5, 5) for z in (-1, 1))
    with pytest.raises(GffeError, match="direction has no length"):
        predict_camera(behind, ahead, -0.5)


def test_turning_steadily():
    from synthetic import camera

    predicted = predict_camera(camera(64, 48, yaw=0.1), camera(64, 48, yaw=0.15), 0.5)
    expected = camera(64, 48, yaw=0.175)
    np.testing.assert_allclose(predicted.world_to_view, expected.world_to_view, atol=1e-4)


# ---- from more than two poses ----------------------------------------------------------------------------


def swinging(time, jump=0.0):
    """A camera that accelerates along a curve while it turns."""
    from synthetic import camera

    return camera(64, 48, (2 * time + 3 * time**2 + jump, 0.2 * time, time**2), yaw=0.3 * time + 0.9 * time**2)


def px_error(predicted, true):
    """Mean distance in pixels of what both show at depth 5."""
    px = np.stack(np.meshgrid(np.linspace(1, 63, 5), np.linspace(1, 47, 4)), -1).reshape(-1, 2)
    return np.linalg.norm(predicted.project(true.unproject(px, np.full(len(px), 5.0)))[0] - px, axis=1).mean()


@pytest.mark.parametrize("times", [(0.3, 0.2, 0.1, 0.0), (0.3, 0.2, 0.1), (0.3, 0.25, 0.1, 0.05)])
def test_an_accelerating_camera_goes_on(times):
    """Whatever the intervals: hardly any error where the linear prediction has some."""
    cameras = [swinging(t) for t in times]
    for alpha in (0.5, 1.0):
        time = times[0] + alpha * (times[0] - times[1])
        errors = [px_error(predict_camera_at(time, cameras, times, order), swinging(time)) for order in (1, 2)]
        assert errors[1] < 0.1 * errors[0], errors


def test_order_1_and_two_poses_are_linear():
    cameras, times = [swinging(t) for t in (0.3, 0.2, 0.1)], (0.3, 0.2, 0.1)
    linear = predict_camera(cameras[1], cameras[0], 0.5)
    for predicted in (predict_camera_at(0.35, cameras, times, 1), predict_camera_at(0.35, cameras[:2], times[:2])):
        np.testing.assert_allclose(predicted.world_to_view, linear.world_to_view, atol=1e-12)
    assert predict_camera_at(0.35, cameras[:1], times[:1]) == cameras[0]


def test_after_a_jump_the_prediction_is_linear():
    """And when it has come to rest nothing of the jump is left."""
    times = (0.3, 0.2, 0.1, 0.0)
    cameras = [swinging(t, jump=9.0 * (t > 0.25)) for t in times]
    linear = predict_camera(cameras[1], cameras[0], 0.5)
    np.testing.assert_allclose(predict_camera_at(0.35, cameras, times).position, linear.position, atol=1e-12)
    after, rest = (0.4, *times[:3]), swinging(0.4, jump=9.0)
    linear = predict_camera(cameras[0], rest, 0.5)
    np.testing.assert_allclose(
        predict_camera_at(0.45, [rest, *cameras[:3]], after).position, linear.position, atol=1e-12
    )


def test_noise_does_not_go_on():
    """A hand that trembles costs hardly more than with the linear prediction."""
    from synthetic import camera

    rng = np.random.default_rng(0)
    cameras = [camera(64, 48, yaw=y, roll=r) for y, r in rng.normal(size=(60, 2)) * 0.01]
    errors = {1: [], 2: []}
    for k in range(4, 59):
        past = cameras[k : k - 4 : -1]
        for order, found in errors.items():
            found.append(px_error(predict_camera_at(k + 1, past, range(k, k - 4, -1), order), cameras[k + 1]))
    assert np.mean(errors[2]) < 1.1 * np.mean(errors[1])


@settings(max_examples=60, deadline=None)
@given(st.lists(cameras(), min_size=3, max_size=14), st.floats(0, 2))
def test_predicted_from_many_is_a_camera(path, alpha):
    predicted = predict_camera_at(alpha, path, range(0, -len(path), -1))
    rotation = predicted.world_to_view[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    if alpha == 0:
        np.testing.assert_allclose(predicted.world_to_view, path[0].world_to_view, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3))
def test_rotation_vectors(vector):
    np.testing.assert_allclose(rotation_vector(rotation_matrix(np.array(vector))), vector, atol=1e-9)


def test_poses_that_make_no_path():
    one = swinging(0.0)
    for cameras, times, order in (([], [], 2), ([one], [0, 1], 2), ([one, one], [0, 0], 2), ([one], [0], 3)):
        with pytest.raises(GffeError, match="camera: "):
            predict_camera_at(1.0, cameras, times, order)


def shaking(times, seed=0, pan=0.0, jump=None):
    """Cameras in a shaking hand: turned by sines of 0.5 to 8 Hz; `pan` radians a second, at rest but for that; from
    the time `jump` on somewhere else."""
    from synthetic import camera

    rng = np.random.default_rng(seed)
    hertz, phase = np.exp(rng.uniform(np.log(0.5), np.log(8), (9, 3))), rng.random((9, 3))

    def at(time):
        yaw, pitch, roll = 0.004 * (np.sin(2 * np.pi * (hertz * time + phase)) / hertz**0.8).sum(0)
        far = 7.0 * (jump is not None and time >= jump)
        return camera(64, 48, (far, 0, 0), yaw=yaw + pan * time, pitch=pitch, roll=roll)

    return [at(time) for time in times], at


def rms_errors(at, times, alphas=(0.5, 1.0), first=4):
    """By order, over all new frames between `times`."""
    found, path = {1: [], 2: [], None: []}, [at(time) for time in times]
    for k in range(first, len(times) - 1):
        known = slice(max(k - 14, 0), k + 1)
        for alpha in alphas:
            time = times[k] + alpha * (times[k + 1] - times[k])
            for order, errors in found.items():
                made = predict_camera_at(time, path[known][::-1], times[known][::-1], order)
                errors.append(px_error(made, at(time)) ** 2)
    return {order: float(np.sqrt(np.mean(errors))) for order, errors in found.items()}


@pytest.mark.parametrize(("fps", "most"), [(24, 0.9), (30, 0.7), (60, 0.5)])
@pytest.mark.parametrize("pan", [0.0, 0.5])
def test_a_shaking_camera_is_learned(fps, most, pan):
    times = (np.arange(3 * fps) / fps).tolist()
    errors = rms_errors(shaking(times, pan=pan)[1], times)
    assert errors[None] < most * min(errors[1], errors[2]), errors


def test_a_shaking_camera_is_learned_at_irregular_times():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.8, 1.25, 120) / 60).tolist()
    errors = rms_errors(shaking(times)[1], times)
    assert errors[None] < 0.9 * min(errors[1], errors[2]), errors


@pytest.mark.parametrize(
    "path",
    [
        lambda t: ((0.5 * t, 0, t), 0.4 * t),
        lambda t: ((0.5 * t**2, 0, t), 0.4 * t - 0.3 * t**2),
        lambda t: ((max(t - 0.5, 0.0), 0, 0), 0.4 * max(t - 0.5, 0.0)),
        lambda t: ((min(t, 0.7), 0, 0), 0.4 * min(t, 0.7)),
        lambda t: ((min(max(t - 0.3, 0.0), 0.4), 0, 0), 0.4 * min(max(t - 0.3, 0.0), 0.4)),
        lambda t: ((0, 0, 0), 0),
    ],
    ids=["constant velocity", "constant acceleration", "starting", "stopping", "starting and stopping", "at rest"],
)
def test_steady_movement_needs_no_learning(path):
    from synthetic import camera

    def at(time):
        position, yaw = path(round(time, 9))
        return camera(64, 48, position, yaw=yaw)

    errors = rms_errors(at, [k / 10 for k in range(30)])
    assert errors[None] <= errors[2] + 1e-3, errors


def test_a_jump_is_not_learned():
    """Neither the frames after it nor those of a trembling hand suffer."""
    times = (np.arange(60) / 30).tolist()
    errors = rms_errors(shaking(times, jump=1.0)[1], times)
    assert errors[None] <= 1.001 * errors[2], errors
    after = [k / 30 for k in range(20, 60)]
    before_and_after = rms_errors(shaking(after, jump=1.0)[1], after, first=14)
    assert before_and_after[None] < before_and_after[2], before_and_after


def test_four_poses_are_too_few_to_learn_from():
    times = [k / 30 for k in range(4, 0, -1)]
    cameras, _ = shaking(times)
    for count in (1, 2, 3, 4):
        known = cameras[:count], times[:count]
        assert predict_camera_at(0.15, *known) == predict_camera_at(0.15, *known, order=2)


def test_learning_does_not_depend_on_the_axes():
    from synthetic import camera

    times = [k / 30 for k in range(14, 0, -1)]
    cameras, _ = shaking(times, pan=0.3)
    world = np.linalg.inv(camera(64, 48, (3, -2, 1), yaw=1.0, pitch=0.6, roll=2.0).world_to_view)
    turned = [replace(c, world_to_view=c.world_to_view @ world) for c in cameras]
    expected, made = predict_camera_at(0.49, cameras, times), predict_camera_at(0.49, turned, times)
    np.testing.assert_allclose(made.world_to_view, expected.world_to_view @ world, atol=1e-9)


def test_an_older_change_counts_less():
    """An error weighs 0.9 of one an interval later: of two changes, 0 and then 1, the regression expects over half."""
    model, along = _NextChange(), [[1.0, 0, 0], [0.0, 0, 0], [0.0, 0, 0]]
    for change in (0.0, 1.0):
        model.learn(along, [0.0] * 3, [1.0, 0, 0], [change, 0, 0])
    assert model.correction(along, [0.0] * 3)[0] == pytest.approx(1 / (1.9 + RIDGE * 2.9))
    assert model.trust([1.0, 0, 0]) == pytest.approx(1 / (1.9 + RIDGE))
