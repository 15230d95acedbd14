"""Situations with difficult movers: behind bars, as thin as ropes, on parabolas, in circles."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.parts.figures import animal, walker
from gffe_cl.captures.scenes.parts.furniture import IRON, STEEL, railing
from gffe_cl.captures.scenes.parts.motions import Bounce, Carry, Motion, Path, Place, Roll, Slide, Spin, Swing
from gffe_cl.captures.scenes.parts.vehicles import car
from gffe_cl.captures.scenes.scene_types import (
    Box,
    Capsule,
    Cylinder,
    Group,
    Material,
    Scene,
    Sphere,
    pick,
    tint,
    vary,
    wave,
)
from gffe_cl.captures.scenes.situations.places import hall, lamplight, scene, still_camera, sunlight, yard

_PAINTS = ((0.6, 0.1, 0.06), (0.1, 0.28, 0.55), (0.62, 0.45, 0.06), (0.1, 0.4, 0.2), (0.45, 0.2, 0.45))


def bars(seed: int, rng: np.random.Generator) -> Scene:
    """Return people and an animal who pass behind upright bars."""
    paint = pick(rng, IRON, STEEL, Material((0.06, 0.16, 0.1), roughness=0.4))
    groups = yard(rng, seed)
    groups += railing((-2.9, -0.6), (2.9, -0.6), 2.2, rng.uniform(0.2, 0.26), paint, radius=rng.uniform(0.016, 0.024))
    for k in range(4):
        z = -1.6 - 0.7 * k
        loop = [(-2.4, z), (0, z - 0.2), (2.4, z), (2.8, z - 0.4), (0, z - 0.55), (-2.8, z - 0.4)]
        path = Path(loop[:: pick(rng, -1, 1)], rng.uniform(1.2, 1.9), rng.random())
        groups += animal(path, rng, 0.65) if k == 1 else walker(path, rng)
    return scene("bars", "Movers behind bars", seed, groups, *sunlight(rng), still_camera(rng))


def railings(seed: int, rng: np.random.Generator) -> Scene:
    """Return people who pass each other behind a fence and before it, and shadows of things out of view that cross
    them; the camera strafes."""
    groups = yard(rng, seed)
    groups += railing((-4.2, 0.3), (4.2, 0.3), 1.5, rng.uniform(0.14, 0.18), pick(rng, IRON, STEEL), radius=0.014)
    for k in range(5):
        z = (1.1, -0.5, -1.2, -2.1, -3.0)[k]
        loop = [(-2.6, z), (0, z - 0.1), (2.6, z), (2.9, z - 0.3), (0, z - 0.35), (-2.9, z - 0.3)]
        path = Path(loop[:: pick(rng, -1, 1)], rng.uniform(1.0, 1.8), rng.random())
        groups += animal(path, rng, 0.7) if k == 3 else walker(path, rng)
    lights, air = sunlight(rng, 2.0)
    dark = Material((0.1, 0.1, 0.1))
    for k in range(4):
        at = np.array((1.8 * k - 2.7, 0.0, -1.2 - 0.6 * k)) + 5.5 * np.array((-0.55, 0.9, 0.75))
        slide = Slide((rng.uniform(1.0, 1.8), 0, 0), rng.uniform(1.4, 2.4), rng.random())
        leaves = [Box((0.5 * j, 0, 0.2 * j), (0.24, 0.04, 1.2), dark) for j in (-1, 0, 1)]
        groups.append(Group(leaves, Place(*at) @ slide @ Place(yaw=rng.uniform(-40, 40)), name="caster"))
    eye = wave((0, 1.6, 5.2), (0.9, 0.03, 0.1), (rng.uniform(2.2, 3.0), 0.9, 2.0), rng.random(3))
    target = still_camera(rng)[1]
    return scene("railings", "Walkers and shadows behind a fence", seed, groups, lights, air, (eye, target))


def entering(seed: int, rng: np.random.Generator) -> Scene:
    """Return cars that drive in through the borders of the view, from the side and past the camera, and a walker
    towards whom the camera turns."""
    groups = yard(rng, seed)
    phase = rng.uniform(0.0, 0.05, 3)
    left = Place(-7.4, 0, -1.3) @ Carry((15.0, 0, 0), rng.uniform(1.3, 1.6), 0.12 + phase[0]) @ Place(yaw=90)
    right = Place(8.6, 0, -3.4) @ Carry((-16.0, 0, 0), rng.uniform(1.5, 1.8), 0.08 + phase[1]) @ Place(yaw=-90)
    past = Place(2.3, 0, 6.4) @ Carry((0, 0, -13.0), rng.uniform(1.7, 2.1), 0.21 + phase[2]) @ Place(yaw=180)
    groups += car(left, rng) + car(right, rng) + car(past, rng)
    groups += walker(Path([(-4.6, -3.4), (-1.0, -3.5), (2.0, -3.3), (-1.0, -4.4)], rng.uniform(1.4, 1.9)), rng)
    turn = wave((0.0, 1.3, -3.0), (0.9, 0.05, 0.0), (rng.uniform(1.6, 2.0), 3.0, 1.0), (0.5, 0.0, 0.0))
    eye, _ = still_camera(rng)
    return scene("entering", "Movers that enter through the border", seed, groups, *sunlight(rng), (eye, turn))


def ropes(seed: int, rng: np.random.Generator) -> Scene:
    """Return ropes, a few pixels wide, that swing before a wall."""
    hemp = Material(vary(rng, (0.55, 0.42, 0.24)), (0.3, 0.22, 0.12), "stripes", scale=0.05, roughness=1.0)
    post = Material((0.3, 0.2, 0.12), scale=0.2, contrast=0.4, roughness=0.8)
    top, z, groups = 3.2, -1.4, yard(rng, seed)
    gallows = [Cylinder((s * 3.2, 0, z), (s * 3.2, top, z), 0.08, post) for s in (-1, 1)]
    groups.append(Group([*gallows, Capsule((-3.4, top, z), (3.4, top, z), 0.07, post)], name="beam"))
    for k, x in enumerate(np.linspace(-2.6, 2.6, 12)):
        swing = Swing(pick(rng, "z", "z", "x"), rng.uniform(8, 17), rng.uniform(1.8, 2.9), rng.random())
        length, radius = rng.uniform(1.7, 2.6), (0.008, 0.013, 0.02)[k % 3]
        rope = [Capsule((0, 0, 0), (0, -length, 0), radius, hemp)]
        if k % 3 == 1:
            rope.append(Sphere((0, -length, 0), 3 * radius, hemp))
        groups.append(Group(rope, Place(x, top, z + rng.uniform(-0.2, 0.2)) @ swing, name="rope"))
    for k in range(3):  # slack lines that sway as a whole
        sway = Place(0, top - 0.1 - 0.25 * k, z - 0.5 - 0.2 * k) @ Swing("x", rng.uniform(9, 15), rng.uniform(1.6, 2.4))
        sag = [(x, -0.5 * (1 - (x / 3.2) ** 2), 0.0) for x in np.linspace(-3.2, 3.2, 13)]
        line = [Capsule(a, b, 0.009, hemp) for a, b in zip(sag[:-1], sag[1:], strict=True)]
        groups.append(Group(line, sway, name="line"))
    return scene("ropes", "Thin ropes that swing", seed, groups, *sunlight(rng), still_camera(rng))


def balls(seed: int, rng: np.random.Generator) -> Scene:
    """Return balls that fly, bounce and roll."""
    groups = hall(rng, seed)
    for k in range(3):  # across the room, on parabolas
        radius, period = rng.uniform(0.16, 0.24), rng.uniform(0.85, 1.3)
        fly = Slide((rng.uniform(1.6, 2.4), 0, rng.uniform(-0.4, 0.4)), rng.uniform(3.2, 4.5), rng.random())
        hop = Bounce(rng.uniform(0.9, 1.7), period, rng.random()) @ Spin((1, 0.4, 0.3 * k), rng.uniform(60, 200))
        groups.append(_ball(Place(0.4 * k - 0.4, radius, -1.2 - 0.9 * k) @ fly @ hop, radius, rng))
    for k in range(2):
        radius = 0.2 + 0.08 * k
        loop = [(-2.0, -1.4), (0, -1.0), (2.0, -1.5), (2.3, -2.8), (0, -3.6), (-2.3, -2.7)]
        path = Path(loop[:: 1 - 2 * k], rng.uniform(1.3, 2.0), rng.random())
        groups.append(_ball(Place(0, radius, 0) @ path @ Roll(path, radius), radius, rng))
    return scene("balls", "Balls that fly, bounce and roll", seed, groups, *lamplight(rng), still_camera(rng))


def rotors(seed: int, rng: np.random.Generator) -> Scene:
    """Return a pinwheel, a wheel with spokes, a rotor overhead, and a cart whose wheels roll."""
    groups, post = yard(rng, seed), Material((0.3, 0.3, 0.32), roughness=0.5)
    sails = Place(-1.5, 2.0, -2.6) @ Spin("z", rng.uniform(140, 230) * pick(rng, -1, 1))
    groups.append(Group([Cylinder((-1.5, 0, -2.75), (-1.5, 2.05, -2.75), 0.06, post)], name="post"))
    for k in range(4):
        sail = Material(vary(rng, _PAINTS[k]), (0.65, 0.62, 0.55), "stripes", scale=0.16, roughness=0.8)
        arm = [Box((0.62, 0.1, 0), (0.85, 0.34, 0.02), sail), Box((0.5, -0.08, 0), (1.0, 0.05, 0.03), post)]
        groups.append(Group(arm, sails @ Spin("z", 0, 90 * k), name="sail"))
    groups += _wheel(Place(1.5, 1.5, -3.0) @ Spin("z", rng.uniform(50, 90)), 1.05, 10, rng)
    groups.append(Group([Capsule((1.5 + s, 0, -3.2), (1.5, 1.5, -3.2), 0.05, post) for s in (-0.6, 0.6)], name="stand"))
    turn = Place(0.2, 2.75, -1.8) @ Spin("y", rng.uniform(260, 420) * pick(rng, -1, 1))
    blade = Material((0.3, 0.31, 0.33), roughness=0.5)
    blades = [Box((s * 0.62, 0, 0), (1.1, 0.02, 0.16), blade) for s in (-1, 1)]
    groups.append(Group([*blades, Cylinder((0, -0.12, 0), (0, 0.06, 0), 0.09, IRON)], turn, name="rotor"))
    path = Path([(-2.2, -1.4), (0, -1.3), (2.2, -1.4), (2.3, -2.0), (0, -2.1), (-2.3, -2.0)], rng.uniform(1.1, 1.6))
    paint = Material(vary(rng, pick(rng, *_PAINTS)), (0.6, 0.57, 0.5), "planks", scale=0.15, contrast=0.3)
    groups.append(Group([Box((0, 0.5, 0), (0.5, 0.3, 1.0), paint)], path, name="cart"))
    for x in (-0.34, 0.34):
        for z in (-0.36, 0.36):
            at = path @ Place(x, 0.3, z) @ Roll(path, 0.3) @ Place(yaw=90)
            groups += _wheel(at, 0.3, 6, rng)
    return scene("rotors", "Rotors and wheels", seed, groups, *sunlight(rng), still_camera(rng))


def _ball(at: Motion, radius: float, rng) -> Group:
    rubber = Material(
        vary(rng, pick(rng, *_PAINTS), 0.3), vary(rng, (0.66, 0.64, 0.56)), pick(rng, "stripes", "checker"),
        scale=radius * 0.7, roughness=0.4,
    )  # fmt: skip
    return Group([Sphere((0, 0, 0), radius, rubber)], at, name="ball")


def _wheel(at: Motion, radius: float, spokes: int, rng) -> list[Group]:
    """Return a rim, spokes and a hub in the plane z = 0 of `at`, turning as one."""
    paint = Material(tint(vary(rng, pick(rng, *_PAINTS)), 0.8), contrast=0.4, scale=0.1, roughness=0.6)
    ring = [(radius * np.cos(a), radius * np.sin(a), 0.0) for a in 2 * np.pi * np.arange(25) / 24]
    parts = [Capsule(a, b, 0.06 * radius**0.5, paint) for a, b in zip(ring[:-1], ring[1:], strict=True)]
    for a in 2 * np.pi * np.arange(spokes) / spokes:
        parts.append(Capsule((0, 0, 0), (radius * np.cos(a), radius * np.sin(a), 0), 0.035 * radius**0.5, IRON))
    return [Group([*parts, Cylinder((0, 0, -0.08), (0, 0, 0.08), 0.14 * radius, paint)], at, name="wheel")]
