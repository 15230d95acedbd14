"""Situations with light that moves over static surfaces."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.parts.furniture import IRON
from gffe_cl.captures.scenes.parts.luminaires import spotlight, swinging_lamp
from gffe_cl.captures.scenes.parts.motions import Motion, Path, Place, Roll, Slide, Spin, Swing
from gffe_cl.captures.scenes.scene_types import (
    Air,
    Box,
    Capsule,
    Cylinder,
    Group,
    Light,
    LightFlicker,
    Material,
    Scene,
    Sphere,
    pick,
    tint,
    vary,
)
from gffe_cl.captures.scenes.situations.places import BACK, HEIGHT, hall, lamplight, scene, still_camera, yard

_WARM = (1.0, 0.82, 0.58)


def lamps(seed: int, rng: np.random.Generator) -> Scene:
    """Return shaded lamps that swing: their light and all shadows go to and fro."""
    shade = Material(vary(rng, (0.12, 0.2, 0.17), 0.5), roughness=0.4)
    groups = hall(rng, seed) + _things(rng)
    lights, air = lamplight(rng, 0.16)
    for x, z in ((-1.4, -2.0), (1.5, -3.0)):
        swing = Swing(pick(rng, "z", "x", (1, 0, 0.7)), rng.uniform(16, 26), rng.uniform(1.8, 2.4), rng.random())
        lit, hung = swinging_lamp(Place(x, HEIGHT, z), 1.1, _WARM, rng.uniform(8, 11), swing, shade, angle=76)
        lights, groups = lights + lit, groups + hung
    return scene("lamps", "Lamps that swing", seed, groups, lights, air, still_camera(rng))


def shadows(seed: int, rng: np.random.Generator) -> Scene:
    """Return things out of view whose shadows cross steps, columns and corners."""
    stone = Material(vary(rng, (0.5, 0.46, 0.4)), (0.3, 0.28, 0.25), "tiles", scale=0.6, contrast=0.2, seed=seed)
    groups = yard(rng, seed)
    for k in range(4):
        steps = Box((-0.2, 0.09 + 0.18 * k, BACK + 1.6 - 0.4 * k), (4.4 - 0.7 * k, 0.18, 0.8), stone)
        groups.append(Group([steps], name="step"))
    for x in (-2.6, 2.4):
        column = [Box((x, 0.15, -2.6), (0.7, 0.3, 0.7), stone), Cylinder((x, 0.3, -2.6), (x, 4.5, -2.6), 0.24, stone)]
        groups.append(Group(column, name="column"))
    towards = np.array((-0.5, 0.75, 0.55))
    lights = [Light("sun", tuple(towards), tint((1.0, 0.92, 0.8), 2.2), size=0.006)]
    dark = Material((0.1, 0.1, 0.1))
    for k in range(7):  # three over the ground, four over steps and wall
        x = (-1.9, 0.0, 1.8, -2.7, -0.9, 0.9, 2.7)[k] + rng.uniform(-0.3, 0.3)
        seen = np.array((x, 0.0, -2.0) if k < 3 else (x, rng.uniform(0.8, 2.4), BACK + 0.4))
        at = Place(*(seen + rng.uniform(5, 6) * towards))
        slide = Slide((rng.uniform(0.8, 1.6), 0, rng.uniform(-0.6, 0.6)), rng.uniform(1.6, 2.8), rng.random())
        boards = [Box((0.45 * j, 0, 0), (0.22, 0.05, 1.4), dark) for j in (-1, 0, 1)]
        turn = Spin("y", rng.uniform(-80, 80)) if k % 2 else Place(yaw=rng.uniform(-40, 40))
        groups.append(Group(boards, at @ slide @ turn, name="caster"))
    air = Air((0.1, 0.23, 0.52), (0.48, 0.54, 0.63), 0.4, (0.16, 0.19, 0.25), (0.1, 0.09, 0.08))
    return scene("shadows", "Shadows that cross edges", seed, groups, lights, air, still_camera(rng))


def fan(seed: int, rng: np.random.Generator) -> Scene:
    """Return a fan before a lamp: the shadows of its blades turn over walls and floor."""
    groups = hall(rng, seed) + _things(rng)
    lights, air = lamplight(rng, 0.15)
    at = Place(rng.uniform(-0.3, 0.3), 2.5, -1.8, pitch=58)  # its −y looks at the foot of the back wall
    lit, can = spotlight(at @ Place(0, 0.45, 0), _WARM, rng.uniform(26, 34), IRON, angle=58)
    groups += can + _fan(at, rng.uniform(160, 260) * pick(rng, -1, 1))
    return scene("fan", "A fan before a lamp", seed, groups, lights + lit, air, still_camera(rng))


def screen(seed: int, rng: np.random.Generator) -> Scene:
    """Return a wall of screens whose pictures jump, and the light that they throw."""
    groups = hall(rng, seed) + _things(rng)
    lights, air = lamplight(rng, 0.18)
    case = Material((0.03, 0.03, 0.035), roughness=0.5)
    groups.append(Group([Box((0.2, 1.75, BACK + 0.3), (3.0, 1.75, 0.3), case)], name="case"))
    rate, columns, rows = rng.uniform(11, 14), 6, 4
    for i in range(columns):
        for j in range(rows):
            color = pick(rng, (1.0, 0.35, 0.2), (0.25, 0.6, 1.0), (0.9, 0.9, 0.8), (0.3, 0.9, 0.4), (0.8, 0.3, 0.9))
            flicker = LightFlicker(rate, 0.05, seed=int(rng.integers(1 << 16)))
            glow = Material((0.02, 0.02, 0.02), emission=tint(color, 0.9), contrast=0.0, roughness=0.9, flicker=flicker)
            center = (0.2 + 0.47 * (i - 2.5), 1.75 + 0.4 * (j - 1.5), BACK + 0.46)
            groups.append(Group([Box(center, (0.44, 0.37, 0.02), glow)], casts_shadow=False, name="screen"))
    for k, x in enumerate((-0.8, 1.2)):
        flicker = LightFlicker(rate, 0.15, seed=seed * 2 + k)
        lights.append(Light("lamp", (x, 1.8, BACK + 1.0), tint((0.7, 0.85, 1.0), 3.0), size=0.3, flicker=flicker))
    return scene("screen", "Screens that flicker", seed, groups, lights, air, still_camera(rng))


def marbles(seed: int, rng: np.random.Generator) -> Scene:
    """Return balls of glass and of steel that roll over polished stone, before things that they mirror."""
    groups = hall(rng, seed) + _things(rng)
    stone = Material(vary(rng, (0.3, 0.3, 0.32)), (0.18, 0.17, 0.17), "tiles", scale=0.7, mirror=0.6, roughness=0.05)
    groups.append(Group([Box((0, 0.02, -1.6), (5.2, 0.04, 2.6), stone)], name="slab"))
    glass = Material((0.8, 0.95, 0.88), transparency=0.9, specular=0.06, mirror=0.06, roughness=0.02)
    steel = Material((0.55, 0.56, 0.58), specular=0.6, mirror=1.0, roughness=0.02)
    loop = [(-1.8, -0.9), (0, -0.7), (1.8, -0.9), (1.9, -1.9), (0, -1.6), (-1.9, -1.9)]
    speed, phase = rng.uniform(0.9, 1.4), rng.random()
    for k, (radius, material) in enumerate(((0.34, glass), (0.26, steel), (0.2, glass))):
        path = Path(loop, speed, phase + k / 3)
        at = Place(0, 0.04 + radius, 0) @ path @ Roll(path, radius)
        groups.append(Group([Sphere((0, 0, 0), radius, material)], at, name="marble"))
    return scene("marbles", "Glass that rolls", seed, groups, *lamplight(rng), still_camera(rng))


def _things(rng) -> list[Group]:
    """Return boxes and a ball on the floor, which cast and receive shadows."""
    groups = []
    for k, (x, z) in enumerate(((-1.9, -3.2), (-0.2, -2.6), (1.6, -1.9))):
        card = vary(rng, pick(rng, (0.42, 0.28, 0.15), (0.12, 0.25, 0.4), (0.5, 0.12, 0.08), (0.5, 0.5, 0.46)))
        box = Material(card, tint(card, 0.5), pick(rng, "stripes", "checker"), scale=0.2, roughness=0.8)
        h = rng.uniform(0.4, 0.8)
        at = Place(x, h / 2, z, yaw=rng.uniform(0, 90))
        groups.append(Group([Box((0, 0, 0), (0.5, h, 0.5), box)], at, name="box"))
        groups.append(Group([Sphere((0, 0, 0), 0.16, box)], Place(x + 0.5, 0.16, z + 0.3 * k), name="ball"))
    return groups


def _fan(at: Motion, rate: float) -> list[Group]:
    """Return blades and a guard ring round the y axis of `at`."""
    steel = Material((0.25, 0.26, 0.28), roughness=0.5)
    ring = [(0.5 * np.cos(a), 0.0, 0.5 * np.sin(a)) for a in 2 * np.pi * np.arange(21) / 20]
    guard = [Capsule(a, b, 0.012, IRON) for a, b in zip(ring[:-1], ring[1:], strict=True)]
    turn = at @ Spin("y", rate)
    blades = [
        Group([Box((0.26, 0, 0), (0.4, 0.012, 0.17), steel)], turn @ Spin("y", 0, 120 * k) @ Place(pitch=18))
        for k in range(3)
    ]
    hub = Group([Cylinder((0, -0.05, 0), (0, 0.05, 0), 0.06, steel)], turn, name="hub")
    return [Group(guard, at, name="guard"), hub, *blades]
