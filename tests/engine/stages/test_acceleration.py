"""Movers whose speed changes: what the acceleration of `acceleration.h` is worth, and that it harms none."""

import numpy as np
import pytest
from parameters import few

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.scenes.scene_types import (
    Air,
    Bounce,
    Box,
    Capsule,
    Carry,
    Cylinder,
    Group,
    Light,
    Material,
    Motion,
    Place,
    Scene,
    Sphere,
    Spin,
    Swing,
    rotation,
    translation,
    wave,
)
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.lab.metrics import to_display

RED = Material((0.8, 0.2, 0.15), (0.9, 0.8, 0.2), "checker", 0.12)
GRAY = Material((0.5, 0.55, 0.6), (0.25, 0.3, 0.35), "checker", 0.5)
FLIGHT = Place(-1.2, 0.4, 0) @ Carry((2.4, 0, 0), 1.0) @ Bounce(1.2, 0.9, 0.1)


class Stops(Motion):
    """Rolls a meter from 0.1 s on, and stands still from 0.3 s on."""

    def __call__(self, time):
        way = 5 * (np.clip(time, 0.1, 0.3) - 0.1)
        return translation((way, 0, 0)) @ rotation("z", -np.degrees(way / 0.3))


def ball(motion):
    return [Group([Sphere((0, 0, 0), 0.3, RED)], motion)]


def leg(x, z, phase, angle=30, period=0.9):
    return Group([Capsule((0, 0, 0), (0, -0.9, 0), 0.1, RED)], Place(x, 1.2, z) @ Swing("z", angle, period, phase))


def rotor(rate):
    blades = [Box((0, 0, 0), (2.0, 0.2, 0.1), RED), Box((0, 0, 0), (0.2, 2.0, 0.1), RED)]
    return [Group(blades, Place(0, 1, -0.3) @ Spin("z", rate))]


def wheel(rate):
    """Return a disk with spokes that rolls by: 120 degrees in an interval are a turn every three."""
    spokes = [Box((0, 0.2, 0.12), (0.1, 0.4, 0.1), GRAY), Box((0.2, 0, 0.12), (0.4, 0.1, 0.1), GRAY)]
    disk = Cylinder((0, 0, -0.1), (0, 0, 0.1), 0.5, RED)
    return [Group([disk, *spokes], Place(-1, 0.6, -0.3) @ Carry((2, 0, 0), 1.5) @ Spin("z", rate))]


BARS = [Group([Box((x, 1, 0.9), (0.07, 2, 0.07), GRAY) for x in np.arange(-1.5, 1.6, 0.3)])]
# By name: groups, and by how many dB at t + ½ and t + 1 linear prediction is beaten at least.
CASES = {
    "a ball that flies": (ball(FLIGHT), 0.03, 0.1),
    "a ball that bounces": (ball(Place(-1.2, 0.3, 0) @ Carry((2.4, 0, 0), 1.0) @ Bounce(0.7, 0.45)), 0.1, 0.3),
    "a ball that rolls and stops": (ball(Place(-0.6, 0.3, 0) @ Stops()), 0.2, 0.2),
    "a rotor": (rotor(240), 0.05, 0.15),
    "a fast rotor": (rotor(720), 1.0, 1.0),
    "a wheel": (wheel(3600), 4.0, 5.0),
    "a quick swing": ([leg(0, 0.2, 0.0, 50, 0.5)], 2.0, 2.3),
    "swinging legs": ([leg(-0.2, 0, 0.0), leg(0.3, 0.2, 0.5)], -0.02, 0.05),
    "a ball behind bars": (ball(FLIGHT) + BARS, -0.03, 0.0),
}


@pytest.mark.parametrize("name", few(CASES, "a ball that flies", "a wheel", "a ball behind bars"))
def test_acceleration_is_worth_it(device, name):
    groups, *least = CASES[name]
    room = [Group([Box((0, -0.1, -1), (12, 0.2, 12), GRAY)]), Group([Box((0, 2, -3), (12, 4, 0.2), GRAY)])]
    lights = [Light("lamp", (2, 4, 3), (14, 14, 13)), Light("fill", (-3, 3, 3), (4, 4, 5))]
    eye = wave((0, 1.2, 4), (0.4, 0.05, 0.1), 4.0)
    scene = Scene("movers", 0, room + groups, lights, Air(), eye, lambda time: np.array((0, 1.0, 0)))
    size = (240, 136)
    frames = SceneFrames(SceneRenderer(device, scene, *size))
    plain = Options(shading_correction=False, acceleration=False)
    pipelines = [Pipeline(device, *size, options) for options in (plain, Options(shading_correction=False))]
    gains = []
    for k, frame in enumerate(frames.sequence(14)):
        for pipeline in pipelines:
            pipeline.submit(frame)
        if k < 3:
            continue
        for alpha in (0.5, 1.0):
            time = frame.time + alpha / 30
            truth = to_display(frames.truth(time).read("color")[..., :3], scene.exposure)
            made = [p.extrapolate(frames.display_camera(time), time).numpy("color") for p in pipelines]
            errors = [np.square(to_display(color, scene.exposure) - truth).mean() for color in made]
            gains.append(10 * np.log10(errors[0] / errors[1]))
    half, whole = np.reshape(gains, (-1, 2)).mean(0)
    assert half >= least[0] and whole >= least[1], (half, whole)


def test_nothing_is_known_after_a_reset(device):
    """Velocity is forgotten; an acceleration that is new counts by a half."""
    size = (96, 64)
    scene = Scene("movers", 0, ball(FLIGHT), [], Air(), wave((0, 1.2, 4), (0, 0, 0), 4.0), lambda t: np.zeros(3))
    frames = list(SceneFrames(SceneRenderer(device, scene, *size)).sequence(4))
    pipeline = Pipeline(device, *size, Options(shading_correction=False, static_threshold=0.25))
    stage, trusted, known = pipeline.stages["acceleration"], [], []
    for frame in (*frames, frames[0]):
        pipeline.submit(frame)
        trust = stage.read("acceleration")[..., 3]
        known.append((trust >= 0).any())
        trusted.append(trust.max())
        assert not (stage.read("velocity")[..., 3] > 0).any() or not frame.reset
    assert known == [False, False, True, True, False] and np.argmax(trusted) == 3
    assert trusted[:3] == [-1, -1, pytest.approx(0.5)] and trusted[4] == -1


class Shaken(Motion):
    """A camera's place, and what is fixed to it: it goes ahead, and trembles."""

    def __call__(self, time):
        return translation((0.05 * np.sin(31 * time), 0.06 * np.sin(43 * time), -time))


def test_what_the_camera_carries_moves_on_in_view_space(device):
    """A wiper before a shaken camera, and one in the world."""
    size, camera = (128, 72), Shaken()
    room = [Group([Box((0, -0.7, -8), (40, 0.2, 40), GRAY)]), Group([Box((0, 2, -12), (40, 12, 0.2), GRAY)])]
    blade = [Box((0, 0.3, 0), (0.1, 0.6, 0.05), RED)]
    carried = Group(blade, camera @ Place(-0.25, -0.3, -1.2) @ Swing("z", 35, 1.1))
    in_world = Group(blade, Place(0.6, 0, -2.5) @ Swing("z", 35, 1.1))
    scene = Scene(
        "wiper",
        0,
        [*room, carried, in_world],
        [Light("lamp", (2, 4, 3), (30, 30, 28))],
        Air(),
        lambda time: camera(time)[:3, 3],
        lambda time: camera(time)[:3, 3] - np.array((0, 0, 1.0)),
    )
    frames = SceneFrames(SceneRenderer(device, scene, *size))
    options = [Options(shading_correction=False, camera_fixed=on) for on in (False, True)]
    pipelines = [Pipeline(device, *size, option) for option in options]
    stage, errors = pipelines[1].stages["acceleration"], []
    names = ("velocity", "acceleration", "bend", "view_velocity")
    for k, frame in enumerate(frames.sequence(8)):
        for pipeline in pipelines:
            pipeline.submit(frame)
        now = [stage.read(name) for name in names]
        if k >= 3:
            time = frame.time + 1 / 30
            to = frames.display_camera(time)
            truth = to_display(frames.truth(time).read("color")[..., :3], scene.exposure)
            made = [pipeline.extrapolate(to, time).numpy("color") for pipeline in pipelines]
            errors.append([np.square(to_display(color, scene.exposure) - truth).mean() for color in made])
    mover = now[0][..., 3]
    assert (now[3][..., 3][(mover > 0) & (mover < 1.5)] > 0).mean() > 0.8
    assert not now[3][..., 3][mover > 1.5].any()
    world, view = 10 * np.log10(np.mean(errors, 0))
    assert view < world - 2, (world, view)


class Recoils(Motion):
    """Lifts by 0.12 m between 0.1 and 0.13 s."""

    def __call__(self, time):
        return translation((0, 0.12 * np.clip((time - 0.1) * 30, 0, 1), 0))


def test_what_recoils_is_still_carried(device):
    """A weapon that jumps in view space, while the camera carries it ahead faster than it jumps."""
    camera = Shaken() @ Carry((0, 0, -7), 1.0)
    sways = Place(0.1, -0.2, -1.2) @ Recoils() @ Swing("z", 6, 0.4)
    weapon = Group([Box((0, 0, 0), (0.3, 0.3, 0.4), RED)], camera @ sways)
    room = [Group([Box((0, -0.9, -8), (40, 0.2, 40), GRAY)]), Group([Box((0, 2, -16), (40, 12, 0.2), GRAY)])]
    scene = Scene(
        "weapon",
        0,
        [*room, weapon],
        [Light("lamp", (2, 4, 3), (30, 30, 28))],
        Air(),
        lambda time: camera(time)[:3, 3],
        lambda time: camera(time)[:3, 3] - np.array((0, 0, 1.0)),
    )
    pipeline, carried = Pipeline(device, 128, 72, Options(shading_correction=False)), []
    for frame in SceneFrames(SceneRenderer(device, scene, 128, 72)).sequence(6):
        pipeline.submit(frame)
        mover, view = (pipeline.stages["acceleration"].read(name) for name in ("velocity", "view_velocity"))
        carried.append(view[..., 3][mover[..., 3] > 0] > 0)
    shares = [cells.mean() for cells in carried[3:]]
    assert min(shares) > 0.8, shares


def test_a_camera_that_does_not_shake_carries_nothing(device):
    """A path that fits as well in view space as in the world is one in the world: the next camera may turn."""
    size, scene = (160, 90), load_scene("gallery")
    pipeline = Pipeline(device, *size, Options(shading_correction=False))
    for frame in SceneFrames(SceneRenderer(device, scene, *size)).sequence(6):
        pipeline.submit(frame)
    stage = pipeline.stages["acceleration"]
    assert (stage.read("velocity")[..., 3] > 0).sum() > 10 and not stage.read("view_velocity")[..., 3].any()
