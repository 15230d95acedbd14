"""Situations with difficult cameras and vectors: a camera that accelerates; a cab that shakes with it; rounded motion
vectors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gffe_cl.captures.scenes.parts.figures import walker
from gffe_cl.captures.scenes.parts.furniture import bark_material, conifer, leaf_material
from gffe_cl.captures.scenes.parts.motions import Held, Path, Place, Swing
from gffe_cl.captures.scenes.scene_types import Box, Capsule, Cylinder, Group, Material, Scene, Sphere, vary, wave
from gffe_cl.captures.scenes.situations.places import hall, lamplight, scene, sunlight, yard


def handheld(seed: int, rng: np.random.Generator) -> Scene:
    """Return a still room, seen by a camera that is swung to and fro."""
    period, phase = rng.uniform(1.5, 1.9), rng.random(3)
    eye = wave((0, 1.55, 1.8), (0.45, 0.05, 0.4), (1.3 * period, 0.6 * period, 1.7 * period), phase)
    target = wave((0, 1.4, -3.0), (1.6, 0.25, 0), (period, 0.8 * period, 1), rng.random(3))
    cameras = eye, target
    return scene("handheld", "A camera that accelerates", seed, hall(rng, seed), *lamplight(rng), cameras)


def cab(seed: int, rng: np.random.Generator) -> Scene:
    """Return a shaking cab that drives between trees. Its parts are fixed to the camera."""
    groups, cameras, _ = _cab(seed, rng)
    return scene("cab", "A shaking cab", seed, groups, *sunlight(rng), cameras)


def wipers(seed: int, rng: np.random.Generator) -> Scene:
    """Return the scene `cab` with wipers and a hand on a lever that move in it: they shake with the camera, too."""
    groups, cameras, held = _cab(seed, rng)
    rubber = Material((0.03, 0.03, 0.03), roughness=0.8)
    period = rng.uniform(0.9, 1.3)
    for x in (-0.42, 0.3):
        arm = held @ Place(x, -0.34, -1.1) @ Swing("z", 42, period, rng.uniform(0, 0.05), rest=-5)
        blade = [Capsule((0, 0, 0), (0, 0.3, 0), 0.009, rubber), Box((0.012, 0.36, 0), (0.014, 0.42, 0.012), rubber)]
        groups.append(Group(blade, arm, name="wiper"))
    skin = Material(vary(rng, (0.5, 0.32, 0.22)), scale=0.2, contrast=0.1, roughness=0.6)
    sleeve = Material(vary(rng, (0.16, 0.22, 0.3)), (0.4, 0.4, 0.38), "stripes", scale=0.04, contrast=0.3)
    reach = held @ Place(0.62, -0.7, -0.55) @ Swing("y", 14, rng.uniform(0.9, 1.4), rng.random())
    hand = [Capsule((0, 0, 0), (-0.16, 0.2, -0.25), 0.05, sleeve), Sphere((-0.2, 0.26, -0.31), 0.06, skin)]
    hand += [
        Capsule((-0.2 + 0.03 * k, 0.28, -0.32), (-0.23 + 0.03 * k, 0.36, -0.36), 0.016, skin) for k in range(-1, 2)
    ]
    groups.append(Group(hand, reach, name="hand"))
    return scene("wipers", "Wipers and a hand in a shaking cab", seed, groups, *sunlight(rng), cameras)


def _cab(seed: int, rng: np.random.Generator) -> tuple[list[Group], tuple[Callable, Callable], Held]:
    """Return the groups of a cab between trees, the paths of eye and target, and the motion of parts fixed to the
    camera."""
    ground = Material(vary(rng, (0.2, 0.26, 0.1)), (0.3, 0.26, 0.18), "cobbles", scale=0.5, contrast=0.5, seed=seed)
    road = Material((0.16, 0.16, 0.17), (0.1, 0.1, 0.1), "cobbles", scale=0.2, contrast=0.4, roughness=0.9, seed=seed)
    groups = [
        Group([Box((0, -0.1, -30), (80, 0.2, 90), ground), Box((0, -0.09, -30), (5, 0.2, 90), road)], name="road")
    ]
    for k in range(24):
        x, z = (-1) ** k * rng.uniform(3.4, 9.0), 2.0 - 2.2 * k
        groups += conifer(x, z, rng, rng.uniform(3, 6), bark_material(rng), leaf_material(rng))
    shake, slow = rng.random(3), rng.random(3)

    def eye(time):
        jolt = wave((0, 0, 0), (0.02, 0.05, 0.0), (0.23, 0.17, 1.0), shake)(time)
        return np.array((0.4, 1.9, 4.0 - 5.0 * time)) + jolt

    def target(time):
        sway = wave((0, -1.4, -12.0), (1.4, 0.5, 0.0), (0.9, 0.31, 1.0), slow)(time)
        return np.array((0.4, 1.9, 4.0 - 5.0 * time)) + sway

    grained = Material((0.14, 0.12, 0.11), (0.06, 0.05, 0.05), "planks", scale=0.12, contrast=0.6, seed=seed)
    dial = Material((0.62, 0.6, 0.52), (0.08, 0.08, 0.08), "stripes", scale=0.03, contrast=0.3)
    inside = [Box((0, -0.52, -0.85), (2.2, 0.2, 0.5), grained), Box((0, -0.36, -1.06), (2.2, 0.14, 0.05), grained)]
    inside += [Cylinder((x, -0.385, -0.75), (x, -0.375, -0.73), 0.09, dial) for x in (-0.3, 0.0, 0.3)]
    inside += [Cylinder((s * 0.95, -0.5, -1.0), (s * 0.72, 0.9, -0.8), 0.05, grained) for s in (-1, 1)]
    held = Held(eye, target)
    groups.append(Group(inside, held, name="cab"))
    return groups, (eye, target), held


def quantized(seed: int, rng: np.random.Generator) -> Scene:
    """Return people in a yard; motion vectors are rounded to whole pixels."""
    groups = yard(rng, seed)
    for k in range(3):
        z = -1.5 - 1.0 * k
        loop = [(-2.4, z), (0, z + 0.3), (2.4, z), (2.6, z - 0.5), (0, z - 0.4), (-2.6, z - 0.5)]
        groups += walker(Path(loop, rng.uniform(1.1, 1.6), rng.random()), rng)
    eye = wave((0, 1.6, 2.2), (1.6, 0.1, 0.5), (6.0, 5.0, 7.0), rng.random(3))
    target = wave((0, 1.4, -3.0), (0.6, 0.1, 0), (7.0, 6.0, 1), rng.random(3))
    cameras = eye, target
    return scene("quantized", "Rounded motion vectors", seed, groups, *sunlight(rng), cameras, motion_step=1.0)
