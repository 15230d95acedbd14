"""Cameras, depth and motion of graphics APIs and engines: points go through the API's own matrices to the screen, and
must be where our camera sees them."""

import json
import re

import numpy as np
import pytest

from gffe_cl import (
    Camera,
    GffeError,
    depth_from_device,
    depth_from_distance,
    motion_from_ndc,
    motion_from_unreal,
    motion_from_uv,
)
from gffe_cl.engine.frame.conventions import rigid

SIZE = (320, 180)


def turn(seed):
    """A random rotation and translation, (4, 4) for column vectors."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.linalg.det(q))
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = q, rng.normal(size=3) * 5
    return m


def frustum(z_sign, left, right, bottom, top, z_row):
    """The projection of the plane at distance 1, from the graphics APIs' specifications; y as in `bottom` < `top`."""
    return np.array(
        [
            [2 / (right - left), 0, -z_sign * (right + left) / (right - left), 0],
            [0, 2 / (top - bottom), -z_sign * (top + bottom) / (top - bottom), 0],
            [0, 0, z_sign * z_row[0], z_row[1]],
            [0, 0, z_sign, 0],
        ]
    )


NEAR, FAR = 0.25, 80.0
Z_ROWS = {  # device depth = a + b / z: forward, reversed, each with finite and infinite far planes
    "0..1": (FAR / (FAR - NEAR), -FAR * NEAR / (FAR - NEAR)),
    "0..1 infinite": (1.0, -NEAR),
    "reversed": (-NEAR / (FAR - NEAR), FAR * NEAR / (FAR - NEAR)),
    "reversed infinite": (0.0, NEAR),
    "-1..1": ((FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)),
    "-1..1 infinite": (1.0, -2 * NEAR),
}


def screen(view, projection, world, ndc_up):
    """World (N, 3) → pixels from the top left corner, and device depth: what a rasterizer does."""
    clip = np.c_[world, np.ones(len(world))] @ view.T @ projection.T
    ndc = clip[:, :3] / clip[:, 3:]
    y = -ndc[:, 1] if ndc_up else ndc[:, 1]
    return np.stack([(ndc[:, 0] + 1) / 2 * SIZE[0], (y + 1) / 2 * SIZE[1]], -1), ndc[:, 2], clip[:, 3]


def seen_points(view, z_sign, y_sign=1):
    """World points that the view sees: view z of `z_sign`, distance 0.3 to 70."""
    rng = np.random.default_rng(7)
    z = rng.uniform(0.3, 70, 200)
    in_view = np.stack([rng.uniform(-0.5, 0.5, 200) * z, y_sign * rng.uniform(-0.3, 0.3, 200) * z, z_sign * z], -1)
    return (np.c_[in_view, np.ones(200)] @ np.linalg.inv(view).T)[:, :3]


CASES = {  # z of the view that is forward, whether the screen's y goes up, whether the world or view is mirrored
    "opengl": (Camera.from_opengl, -1, True, False),
    "direct3d": (Camera.from_direct3d, 1, True, False),
    "direct3d right-handed": (Camera.from_direct3d, -1, True, False),
    "vulkan": (Camera.from_vulkan, 1, False, False),
    "unity": (Camera.from_unity, -1, True, True),
    "unreal": (Camera.from_unreal, 1, True, False),
}


@pytest.mark.parametrize("layout", ["row-major", "column-major", "auto", "auto transposed", "flat"])
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("rows", ["0..1", "reversed infinite", "-1..1"])
def test_points_are_where_the_api_puts_them(case, rows, layout):
    make, z_sign, up, mirrored = CASES[case]
    view = turn(3) @ np.diag([1, 1, -1 if mirrored else 1, 1])
    projection = frustum(z_sign, -0.6, 0.5, -0.3, 0.35, Z_ROWS[rows])
    if case == "vulkan":  # bottom and top are in a view whose y is down
        projection = frustum(z_sign, -0.6, 0.5, -0.35, 0.3, Z_ROWS[rows])
    world = seen_points(view, z_sign)
    px, device, distance = screen(view, projection, world, up)
    given = [view, projection]
    if layout in ("column-major", "auto transposed"):
        given = [m.T for m in given]
    if layout == "flat":
        given = [m.ravel().tolist() for m in given]
    camera = make(*given, SIZE, layout if layout.endswith("major") else "auto")
    px_ours, depth = camera.project(world)
    np.testing.assert_allclose(px_ours, px, atol=1e-8)
    np.testing.assert_allclose(depth, distance, rtol=1e-9)
    np.testing.assert_allclose(depth_from_device(device, given[1]), distance, rtol=1e-4)
    handed = np.linalg.det(camera.world_to_view[:3, :3])
    assert handed == pytest.approx(np.sign(np.linalg.det(view[:3, :3])) * (-1 if case in ("direct3d", "unreal") else 1))


def oblique(projection, plane):
    """The projection whose near plane is `plane` (4,) of view space (Lengyel, Oblique View Frustum Depth Projection and
    Clipping)."""
    made, corner = projection.copy(), np.linalg.inv(projection) @ [*np.sign(plane[:2]), 1, 1]
    made[2] = plane * (2 / (plane @ corner)) - made[3]
    return made


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_an_oblique_near_plane_changes_no_camera(case, transposed):
    """That of water or a mirror: pixels do not depend on it. Depth from the buffer is refused in one line."""
    make, z_sign, _, mirrored = CASES[case]
    plain = frustum(z_sign, -0.6, 0.5, -0.3, 0.35, Z_ROWS["-1..1"])
    view = turn(4) @ np.diag([1, 1, -1 if mirrored else 1, 1])
    for plane in ((0, 0.35, z_sign, -0.3), (0.6, -0.2, 0.4 * z_sign, -1.7)):
        given = view, oblique(plain, np.array(plane) / np.linalg.norm(plane[:3]))
        given = [m.T for m in given] if transposed else given
        camera, expected = make(*given, SIZE), make(view, plain, SIZE)
        np.testing.assert_allclose(camera.world_to_view, expected.world_to_view, atol=1e-12)
        np.testing.assert_allclose(camera.intrinsics, expected.intrinsics, rtol=1e-12)
        with pytest.raises(GffeError, match=r"oblique near plane \(third row .*expected .*linear depth\)"):
            depth_from_device([0.5], given[1])


def test_vulkan_with_a_view_of_opengl_turned_upside_down():
    """glm's matrices with projection[1][1] negated, as most programs have it."""
    view, projection = turn(5), frustum(-1, -0.6, 0.5, -0.3, 0.3, Z_ROWS["0..1"])
    projection[1] *= -1
    world = seen_points(view, -1)
    px, _, distance = screen(view, projection, world, ndc_up=False)
    ours, depth = Camera.from_vulkan(view, projection, SIZE).project(world)
    np.testing.assert_allclose(ours, px, atol=1e-8)
    np.testing.assert_allclose(depth, distance)


def test_unity_into_a_texture():
    """GetGPUProjectionMatrix(…, true) is upside down and reversed; the image, seen upright, is the same."""
    view, projection = turn(6), frustum(-1, -0.6, 0.5, -0.3, 0.4, Z_ROWS["-1..1"])
    flipped = frustum(-1, -0.6, 0.5, -0.3, 0.4, Z_ROWS["reversed"])
    flipped[1] *= -1
    assert Camera.from_unity(view, flipped, SIZE) == Camera.from_unity(view, projection, SIZE)


def test_our_own_matrices_come_back():
    camera = Camera.look_at((1, 2, 3), (0, 1, 0), (0, 1, 0), fx=300, fy=310, cx=170, cy=80)
    for api, make in (
        ("opengl", Camera.from_opengl),
        ("direct3d", Camera.from_direct3d),
        ("vulkan", Camera.from_vulkan),
    ):
        for reverse in (False, True):
            p = camera.projection_matrix(api, *SIZE, near=0.1, reverse_depth=reverse)
            made = make(camera.view_matrix(api), p, SIZE)
            np.testing.assert_allclose(made.intrinsics, camera.intrinsics)
            np.testing.assert_allclose(made.world_to_view, camera.world_to_view, atol=1e-12)


def test_unreal_pose():
    """Axes by Unreal's documentation: x forward, y right, z up; yaw turns right, pitch looks up, roll leans right."""
    ahead = Camera.from_unreal_pose((10, 20, 30), (0, 0, 0), 90, SIZE)
    px, depth = ahead.project([(110, 20, 30), (110, 30, 30), (110, 20, 40)])
    np.testing.assert_allclose(px, [(160, 90), (176, 90), (160, 74)])
    np.testing.assert_allclose(depth, 100)
    np.testing.assert_allclose(
        Camera.from_unreal_pose((0, 0, 0), (0, 90, 0), 90, SIZE).direction, (0, 1, 0), atol=1e-12
    )
    np.testing.assert_allclose(Camera.from_unreal_pose((0, 0, 0), (30, 0, 0), 90, SIZE).direction[2], 0.5)
    leaning = Camera.from_unreal_pose((0, 0, 0), (0, 0, 10), 90, SIZE)
    assert leaning.up[1] == pytest.approx(np.sin(np.radians(10)))  # to the right, which is +y
    with pytest.raises(GffeError, match="fov"):
        Camera.from_unreal_pose((0, 0, 0), (0, 0, 0), 180, SIZE)


@pytest.mark.parametrize("rows", Z_ROWS)
def test_a_cleared_depth_buffer_is_sky(rows):
    projection = frustum(1, -1, 1, -1, 1, Z_ROWS[rows])
    cleared = 0.0 if rows.startswith("reversed") else 1.0
    assert depth_from_device([[cleared]], projection) == np.inf
    assert depth_from_device([[np.nan]], projection)[0, 0] != depth_from_device([[np.nan]], projection)[0, 0]
    if "infinite" not in rows:
        np.testing.assert_allclose(depth_from_device(cleared, projection, sky=False), FAR, rtol=1e-6)


def test_opengl_buffers_hold_half_of_the_device_depth():
    a, b = Z_ROWS["-1..1"]
    depth = np.array([0.3, 5.0, 60.0])
    buffer = (a + b / depth + 1) / 2
    projection = frustum(-1, -1, 1, -1, 1, (a, b))
    np.testing.assert_allclose(depth_from_device(buffer, projection, opengl_buffer=True), depth, rtol=1e-5)


@pytest.mark.parametrize("far", [np.inf, 100.0, 1.2, 0.25])
@pytest.mark.parametrize("opengl_buffer", [True, False])
def test_reversed_planes_of_opengl_tell_the_range(far, opengl_buffer):
    """With glClipControl depth goes from 1 to 0, without from 1 to -1: the matrix tells which one it is."""
    near, depth = 0.1, np.array([0.1, 0.17, 0.2])
    a, b = (0.0, near) if far == np.inf else (-near / (far - near), near * far / (far - near))
    for noise in (0, 6e-8, -6e-8):
        projection = frustum(-1, -1, 1, -1, 1, (a + noise, b))
        made = depth_from_device(a + b / depth, projection, opengl_buffer=opengl_buffer)
        np.testing.assert_allclose(made, depth, rtol=1e-5)
        assert depth_from_device([0.0], projection, opengl_buffer=opengl_buffer) == np.inf
    a, b = (-1.0, 2 * near) if far == np.inf else (-(far + near) / (far - near), 2 * near * far / (far - near))
    projection, device = frustum(-1, -1, 1, -1, 1, (a, b)), a + b / depth
    buffer = (device + 1) / 2 if opengl_buffer else device
    np.testing.assert_allclose(depth_from_device(buffer, projection, opengl_buffer=opengl_buffer), depth, rtol=1e-5)


def test_distances_along_rays():
    camera = Camera(np.eye(4), 30, 25, 9.5, 4.25)
    y, x = np.mgrid[:8, :20] + 0.5
    world = camera.unproject(np.stack([x, y], -1), np.full((8, 20), 7.0))
    np.testing.assert_allclose(depth_from_distance(np.linalg.norm(world, axis=-1), camera), 7, rtol=1e-6)


def test_motion_in_other_units():
    """A point 8 px to the left of and 6 px below where it was: previous − here is (8, −6)."""
    w, h = SIZE
    ours = np.array([[[8.0, -6.0]]])
    made = {
        "ndc": motion_from_ndc([[[8 / w * 2, 6 / h * 2]]], SIZE),
        "ndc, down": motion_from_ndc([[[8 / w * 2, -6 / h * 2]]], SIZE, y="down"),
        "ndc, forward": motion_from_ndc([[[-8 / w * 2, -6 / h * 2]]], SIZE, "from_previous"),
        "uv": motion_from_uv([[[8 / w, -6 / h]]], SIZE),
        "uv of Unity": motion_from_uv([[[-8 / w, -6 / h]]], SIZE, "from_previous", y="up"),
        "unreal": motion_from_unreal([[[0.5 - 8 / w / 2, 0.5 - 6 / h / 2]]], SIZE),
        "unreal, by Epic": motion_from_unreal([[[0.5 - 8 / w, 0.5 - 6 / h]]], SIZE, scale=1),
    }
    for name, motion in made.items():
        np.testing.assert_allclose(motion, ours, rtol=1e-5, err_msg=name)
        assert motion.dtype == np.float32


@pytest.mark.parametrize("layout", ["auto", "row-major", "column-major"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_z_up_view_is_refused_with_what_converts_it(axis, layout):
    camera = Camera.look_at((1, 2, 3), (0, 1, 0), (0, 1, 0), fx=300, fy=310, cx=170, cy=80)
    forward, side = ([0, 0, -1, 0], [1, 0, 0, 0]) if axis == "y" else ([0, 0, -1, 0], [-1, 0, 0, 0])
    rows = [side, forward] if axis == "y" else [forward, side]
    turned = np.array([*rows, [0, 1, 0, 0], [0, 0, 0, 1]], float)
    view = turned @ camera.view_matrix("opengl")
    projection = camera.projection_matrix("opengl", *SIZE, near=0.1) @ turned.T
    given = (view.T, projection.T) if layout == "column-major" else (view, projection)
    with pytest.raises(GffeError, match=f"looks along {axis} with z vertical") as refused:
        Camera.from_opengl(*given, SIZE, layout)
    convert = np.array(json.loads(re.search(r"T = (.*\]\]):", str(refused.value))[1]))
    made = Camera.from_opengl(convert @ view, projection @ convert.T, SIZE)
    np.testing.assert_allclose(made.intrinsics, camera.intrinsics)
    np.testing.assert_allclose(made.world_to_view, camera.world_to_view, atol=1e-12)


@pytest.mark.parametrize("layout", ["auto", "row-major", "column-major"])
def test_a_projection_alone_is_judged_alone(layout):
    """No message speaks of a view."""
    symmetric = frustum(1, -1, 1, -1, 1, (1.0, -1.0))
    for projection in (np.eye(4), np.zeros((4, 4)), *([symmetric] if layout == "auto" else [])):
        with pytest.raises(GffeError, match="projection") as refused:
            depth_from_device([0.5], projection, layout=layout)
        assert "view" not in str(refused.value)


def test_a_scaled_view_keeps_its_place():
    view = turn(2)
    made = rigid(np.diag([2, 2, 2, 1]) @ view, "view")
    np.testing.assert_allclose(made, view, atol=1e-12)
