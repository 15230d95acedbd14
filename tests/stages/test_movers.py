"""Movers whose speed changes: what the acceleration of `acceleration.cl` is worth, and that it harms none."""

import numpy as np
import pytest

from gffe_cl.evaluation.metrics import to_display
from gffe_cl.pipeline.options import Options
from gffe_cl.pipeline.pipeline import Pipeline
from gffe_cl.scenes import SceneFrames, SceneRenderer
from gffe_cl.scenes.parts.motions import Bounce, Carry, Motion, Place, Spin, Swing, rotation, translation
from gffe_cl.scenes.scene_types import Air, Box, Capsule, Group, Light, Material, Scene, Sphere, wave

RED = Material((0.8, 0.2, 0.15), (0.9, 0.8, 0.2), "checker", 0.12)
GREY = Material((0.5, 0.55, 0.6), (0.25, 0.3, 0.35), "checker", 0.5)
FLIGHT = Place(-1.2, 0.4, 0) @ Carry((2.4, 0, 0), 1.0) @ Bounce(1.2, 0.9, 0.1)


class Stops(Motion):
    """Rolls a metre from 0.1 s on, and stands still from 0.3 s on."""

    def __call__(self, time):
        way = 5 * (np.clip(time, 0.1, 0.3) - 0.1)
        return translation((way, 0, 0)) @ rotation("z", -np.degrees(way / 0.3))


def ball(motion):
    return [Group([Sphere((0, 0, 0), 0.3, RED)], motion)]


def leg(x, z, phase):
    return Group([Capsule((0, 0, 0), (0, -0.9, 0), 0.1, RED)], Place(x, 1.2, z) @ Swing("z", 30, 0.9, phase))


def rotor(rate):
    blades = [Box((0, 0, 0), (2.0, 0.2, 0.1), RED), Box((0, 0, 0), (0.2, 2.0, 0.1), RED)]
    return [Group(blades, Place(0, 1, -0.3) @ Spin("z", rate))]


BARS = [Group([Box((x, 1, 0.9), (0.07, 2, 0.07), GREY) for x in np.arange(-1.5, 1.6, 0.3)])]
# By name: groups, and by how many dB at t + ½ and t + 1 linear prediction is beaten at least.
CASES = {
    "a ball that flies": (ball(FLIGHT), 0.03, 0.1),
    "a ball that bounces": (ball(Place(-1.2, 0.3, 0) @ Carry((2.4, 0, 0), 1.0) @ Bounce(0.7, 0.45)), 0.1, 0.3),
    "a ball that rolls and stops": (ball(Place(-0.6, 0.3, 0) @ Stops()), -0.03, -0.03),
    "a rotor": (rotor(240), 0.05, 0.15),
    "a fast rotor": (rotor(720), 1.0, 1.0),
    "swinging legs": ([leg(-0.2, 0, 0.0), leg(0.3, 0.2, 0.5)], 0.0, 0.03),
    "a ball behind bars": (ball(FLIGHT) + BARS, -0.03, 0.0),
}


@pytest.mark.parametrize("name", CASES)
def test_acceleration_is_worth_it(device, name):
    groups, *least = CASES[name]
    room = [Group([Box((0, -0.1, -1), (12, 0.2, 12), GREY)]), Group([Box((0, 2, -3), (12, 4, 0.2), GREY)])]
    lights = [Light("lamp", (2, 4, 3), (14, 14, 13)), Light("fill", (-3, 3, 3), (4, 4, 5))]
    eye = wave((0, 1.2, 4), (0.4, 0.05, 0.1), 4.0)
    scene = Scene("movers", "", 0, room + groups, lights, Air(), eye, lambda time: np.array((0, 1.0, 0)))
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
    """Velocity is forgotten; an acceleration that is new does not count."""
    size = (96, 64)
    scene = Scene("movers", "", 0, ball(FLIGHT), [], Air(), wave((0, 1.2, 4), (0, 0, 0), 4.0), lambda t: np.zeros(3))
    frames = list(SceneFrames(SceneRenderer(device, scene, *size)).sequence(4))
    pipeline = Pipeline(device, *size, Options(shading_correction=False, static_threshold=0.25))
    stage, trusted, known = pipeline.stages["acceleration"], [], []
    for frame in (*frames, frames[0]):
        pipeline.submit(frame)
        trust = stage.read("acceleration")[..., 3]
        known.append((trust >= 0).any())
        trusted.append((trust > 0).any())
        assert not (stage.read("velocity")[..., 3] > 0).any() or not frame.reset
    assert known == [False, False, True, True, False] and trusted == [False, False, False, True, False]
