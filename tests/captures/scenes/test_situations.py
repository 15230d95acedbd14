"""Situations: small scenes that each hold one thing that is hard. Geometry against the NumPy caster, and whether each
shows what it is named for."""

import numpy as np
import pytest
from scene_oracle import clearances

from gffe_cl.captures.scenes import SCENES, SITUATIONS, SceneRenderer, is_scene, load_scene
from gffe_cl.captures.scenes.scene_types import LightFlicker
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.table.footage import parse_subject

W, H = 64, 36
TIME, STEP = 0.7, 1 / 30
MOVING = ("handheld", "cab", "wipers", "railings")  # cameras
MOVERS = ("bars", "balls", "rotors")


def render(device, scene, time=TIME, other_time=TIME - STEP, size=(W, H), camera=None, **more):
    camera = camera or scene.camera(time, *size)
    renderer = SceneRenderer(device, scene, *size, samples=2)
    return renderer.render(time, camera, other_time, scene.camera(other_time, *size), **more).numpy()


def moving(scene):
    return np.array([group.motion.moves for group in scene.groups])


# ---- pure ----


def test_catalogue():
    assert not set(SITUATIONS) & set(SCENES)
    assert is_scene("bars") and parse_subject("bars:2", (8, 8), 4, 30, (0.5,)).name == "bars:2"
    with pytest.raises(GffeError, match=r"corridor, .*; bars, railings, balls, rotors"):
        load_scene("fence")


@pytest.mark.parametrize("name", [*SCENES, *SITUATIONS])
def test_motion_is_rigid_and_the_camera_keeps_clear(name):
    for seed in range(2):
        scene = load_scene(name, seed)
        for group in scene.groups:
            a, b = group.motion(2.0), group.motion(2.0 + 1e-4)
            assert np.allclose(a[:3, :3] @ a[:3, :3].T, np.eye(3), atol=1e-9)
            assert np.abs(a - b).max() < 5e-3, (name, group.name)
        times = np.linspace(0, 8, 16)
        assert min(clearances(scene, times, [scene.eye(t) for t in times])) > (0.5 if name in SITUATIONS else 0.12)


def test_flicker_holds_and_jumps():
    flicker = LightFlicker(rate=10.0, least=0.2, seed=3)
    values = np.array([[flicker((k + part) / 10) for part in (0.0, 0.4, 0.9)] for k in range(40)])
    assert np.ptp(values, axis=1).max() == 0 and 0.2 <= values.min() < 0.3 and 0.9 < values.max() <= 1
    assert np.abs(np.diff(values[:, 0])).mean() > 0.15
    assert values[5, 0] != LightFlicker(rate=10.0, least=0.2, seed=4)(0.5)


def test_a_handheld_camera_accelerates_and_others_hardly_move():
    """How far a point straight ahead would be from where the last two poses lead it, px of a picture of 480×270."""

    def bent(name, seed):
        scene = load_scene(name, seed)
        found = []
        for t in np.arange(0.2, 3.0, STEP):
            a, b, c = (scene.camera(t + k * STEP, 480, 270) for k in (-1, 0, 1))
            ahead = np.asarray(scene.target(t))
            px = [camera.project(ahead[None])[0][0] for camera in (a, b, c)]
            found.append(np.linalg.norm(px[2] - 2 * px[1] + px[0]))
        return np.median(found)

    assert all(bent("handheld", seed) > 0.7 for seed in range(3))
    assert all(bent(name, 0) < 0.1 for name in SITUATIONS if name not in MOVING)


# ---- device ----


@pytest.mark.device
@pytest.mark.parametrize("name", MOVERS)
def test_something_moves(device, name):
    scene, size = load_scene(name, 0), (120, 68)
    shown = render(device, scene, size=size).object_id
    share = (moving(scene)[shown] & (shown >= 0)).mean()
    assert 0.02 < share < 0.3
    if name == "bars":  # movers seen between bars: along rows, a bar with movers on both sides
        bars = [i for i, group in enumerate(scene.groups) if group.name == "railing"]
        before, bar, after = shown[:, :-4], shown[:, 2:-2], shown[:, 4:]
        behind = [moving(scene)[side] & (side >= 0) for side in (before, after)]
        assert (np.isin(bar, bars) & behind[0] & behind[1]).sum() >= 5
