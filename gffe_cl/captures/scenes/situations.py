"""Situations: small built-in scenes, each with one difficulty for frame extrapolation and little else. They are in two
places, a yard in the sun and a hall under lamps, both still: the camera stands at positive z, the back wall at
`BACK`."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gffe_cl.captures.scenes.props import *

BACK, HALF_WIDTH, HEIGHT = -5.5, 4.5, 3.4  # meters; width and height of the hall


def yard(rng: np.random.Generator, seed: int) -> list[Group]:
    """Return paving before a brick wall with windows, a bench and barrels."""
    paving = Material(
        vary(rng, (0.4, 0.36, 0.31)),
        (0.16, 0.14, 0.12),
        pick(rng, "cobbles", "tiles"),
        scale=0.4,
        contrast=0.35,
        roughness=0.85,
        seed=seed,
    )
    brick = Material(
        vary(rng, pick(rng, (0.42, 0.2, 0.13), (0.45, 0.36, 0.26), (0.36, 0.35, 0.34))),
        (0.5, 0.47, 0.42),
        "bricks",
        scale=0.16,
        contrast=0.35,
        roughness=0.9,
        seed=seed,
    )
    frame, pane = Material((0.6, 0.58, 0.54), roughness=0.6), Material((0.05, 0.07, 0.09), contrast=0.1)
    groups = [
        Group([Box((0, -0.1, -10), (60, 0.2, 60), paving)], name="paving"),
        Group([Box((0, 2.2, BACK - 0.1), (24, 4.4, 0.2), brick)], name="wall"),
        Group([Box((0, 4.45, BACK - 0.05), (24, 0.14, 0.4), frame)], name="coping"),
    ]
    for x in np.arange(-7.0, 8.0, 2.8) + rng.uniform(-0.5, 0.5):
        window = [Box((x, 2.2, BACK), (1.1, 1.5, 0.1), frame), Box((x, 2.2, BACK + 0.01), (0.96, 1.36, 0.1), pane)]
        window += [Box((x, 2.2, BACK + 0.03), (0.05, 1.4, 0.1), frame), Box((x, 1.42, BACK), (1.3, 0.08, 0.3), frame)]
        groups.append(Group(window, name="window"))
    groups += bench(Place(-2.3 + rng.uniform(-0.5, 0.5), 0, BACK + 0.7))
    for k in range(3):
        paint = Material(vary(rng, pick(rng, (0.1, 0.25, 0.3), (0.45, 0.1, 0.06), (0.4, 0.3, 0.1))), roughness=0.5)
        x, z = 1.6 + 0.75 * k, BACK + 0.75 + 0.3 * (k % 2)
        barrel = [Cylinder((x, 0, z), (x, 0.85, z), 0.29, paint)]
        barrel += [Cylinder((x, y, z), (x, y + 0.04, z), 0.305, STEEL) for y in (0.05, 0.4, 0.78)]
        groups.append(Group(barrel, name="barrel"))
    return groups


def sunlight(rng: np.random.Generator, strength: float = 1.5) -> tuple[list[Light], Air]:
    """Return a sun from the upper left behind the camera, and its sky."""
    sun = Light("sun", (-0.55 + rng.uniform(-0.2, 0.2), 0.9, 0.75), tint((1.0, 0.92, 0.8), strength), size=0.01)
    air = Air(
        zenith=(0.1, 0.23, 0.52),
        horizon=(0.48, 0.54, 0.63),
        clouds=rng.uniform(0.2, 0.6),
        ambient_up=(0.2, 0.23, 0.29),
        ambient_down=(0.13, 0.12, 0.1),
    )
    return [sun], air


def hall(rng: np.random.Generator, seed: int) -> list[Group]:
    """Return a room with planks, papered walls, pictures, a bookcase, a bench, a vase on a stand; nothing reflects."""
    oak = vary(rng, pick(rng, (0.42, 0.27, 0.14), (0.5, 0.38, 0.24), (0.3, 0.18, 0.1)))
    floor = Material(oak, tint(oak, 0.5), "planks", scale=0.14, contrast=0.5, roughness=0.7, seed=seed)
    color = vary(rng, pick(rng, (0.58, 0.53, 0.42), (0.42, 0.5, 0.5), (0.55, 0.42, 0.38), (0.46, 0.5, 0.38)))
    paper = Material(color, tint(color, 0.65), pick(rng, "wallpaper", "stripes"), scale=0.36, contrast=0.12, seed=seed)
    plaster = Material((0.66, 0.64, 0.6), scale=0.8, contrast=0.08, roughness=1.0)
    white = Material((0.6, 0.58, 0.54), roughness=0.6, contrast=0.05)
    w, h, near = HALF_WIDTH, HEIGHT, 4.5
    middle, length = (BACK + near) / 2, near - BACK
    groups = [
        Group([Box((0, -0.1, middle), (2 * w + 0.4, 0.2, length + 0.4), floor)], name="floor"),
        Group([Box((0, h + 0.1, middle), (2 * w + 0.4, 0.2, length + 0.4), plaster)], name="ceiling"),
        Group([Box((0, h / 2, BACK - 0.1), (2 * w, h, 0.2), paper)], name="wall"),
        Group([Box((0, h / 2, near + 0.1), (2 * w, h, 0.2), paper)], name="wall"),
        Group([Box((0, 0.07, BACK + 0.01), (2 * w, 0.14, 0.04), white)], name="skirting"),
    ]
    groups += [Group([Box((s * (w + 0.1), h / 2, middle), (0.2, h, length), paper)], name="wall") for s in (-1, 1)]
    for x in (-2.6, -0.2, 2.3):
        art = Material(
            vary(rng, (0.6, 0.5, 0.35), 0.6),
            vary(rng, (0.2, 0.28, 0.42), 0.7),
            "picture",
            scale=0.3,
            contrast=0.3,
            seed=int(rng.integers(1 << 16)),
        )
        size = rng.uniform(0.8, 1.3), rng.uniform(0.6, 0.9)
        hung = [Box((x, 1.9, BACK), (size[0] + 0.1, size[1] + 0.1, 0.06), IRON)]
        groups.append(Group([*hung, Box((x, 1.9, BACK + 0.02), (*size, 0.06), art)], name="picture"))
    groups += bookcase(rng, Material(tint(oak, 0.6), scale=0.2, contrast=0.3), -HALF_WIDTH)
    groups += bench(Place(0.5 + rng.uniform(-0.6, 0.6), 0, BACK + 0.6))
    glaze = Material(vary(rng, pick(rng, (0.1, 0.25, 0.45), (0.5, 0.2, 0.1), (0.12, 0.35, 0.25))), roughness=0.3)
    x, z = 3.0, BACK + 1.4
    stand = [Box((x, 0.45, z), (0.5, 0.9, 0.5), white), Cone((x, 0.9, z), (x, 1.25, z), 0.1, 0.22, glaze)]
    groups.append(Group([*stand, Cone((x, 1.25, z), (x, 1.5, z), 0.22, 0.09, glaze)], name="vase"))
    return groups


def lamplight(rng: np.random.Generator, strength: float = 1.0) -> tuple[list[Light], Air]:
    """Return the soft light of a room; at strength 1 it is bright enough to see by. Nothing of it moves."""
    warm = vary(rng, (1.0, 0.85, 0.66), 0.08)
    lights = [
        Light("lamp", (-1.5, HEIGHT - 0.3, 1.5), tint(warm, 9.0 * strength), size=0.25),
        Light("fill", (0, 0.6, -1.0), tint(warm, 1.4 * strength), size=2.0),
    ]
    air = Air(
        ambient_up=tint((0.3, 0.3, 0.31), strength),
        ambient_down=tint((0.26, 0.23, 0.2), strength),
        haze_color=(0.4, 0.4, 0.4),
    )
    return lights, air


def still_camera(rng: np.random.Generator, eye=(0.0, 1.55, 2.0), target=(0.0, 1.3, -3.0)) -> tuple[Callable, Callable]:
    """Return paths of eye and target of a nearly still camera, so that visible motion is the objects' own."""
    phase = rng.random(3)
    eye_path = wave(eye, (0.25, 0.04, 0.1), (9.0, 7.0, 11.0), phase)
    return eye_path, wave(target, (0.15, 0.03, 0.0), (8.0, 9.0, 1.0), phase)


def scene(name: str, seed: int, groups, lights, air, cameras, **more) -> Scene:
    """Return a `Scene` seen through `cameras`: paths of eye and target."""
    return Scene(name, seed, groups, lights, air, *cameras, focal=1.0, **more)


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
    return scene("bars", seed, groups, *sunlight(rng), still_camera(rng))


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
    return scene("railings", seed, groups, lights, air, (eye, target))


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
    return scene("balls", seed, groups, *lamplight(rng), still_camera(rng))


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
    return scene("rotors", seed, groups, *sunlight(rng), still_camera(rng))


def _ball(at: Motion, radius: float, rng) -> Group:
    rubber = Material(
        vary(rng, pick(rng, *_PAINTS), 0.3),
        vary(rng, (0.66, 0.64, 0.56)),
        pick(rng, "stripes", "checker"),
        scale=radius * 0.7,
        roughness=0.4,
    )
    return Group([Sphere((0, 0, 0), radius, rubber)], at, name="ball")


def _wheel(at: Motion, radius: float, spokes: int, rng) -> list[Group]:
    """Return a rim, spokes and a hub in the plane z = 0 of `at`, turning as one."""
    paint = Material(tint(vary(rng, pick(rng, *_PAINTS)), 0.8), contrast=0.4, scale=0.1, roughness=0.6)
    ring = [(radius * np.cos(a), radius * np.sin(a), 0.0) for a in 2 * np.pi * np.arange(25) / 24]
    parts = [Capsule(a, b, 0.06 * radius**0.5, paint) for a, b in zip(ring[:-1], ring[1:], strict=True)]
    for a in 2 * np.pi * np.arange(spokes) / spokes:
        parts.append(Capsule((0, 0, 0), (radius * np.cos(a), radius * np.sin(a), 0), 0.035 * radius**0.5, IRON))
    return [Group([*parts, Cylinder((0, 0, -0.08), (0, 0, 0.08), 0.14 * radius, paint)], at, name="wheel")]


def handheld(seed: int, rng: np.random.Generator) -> Scene:
    """Return a still room, seen by a camera that is swung to and fro."""
    period, phase = rng.uniform(1.5, 1.9), rng.random(3)
    eye = wave((0, 1.55, 1.8), (0.45, 0.05, 0.4), (1.3 * period, 0.6 * period, 1.7 * period), phase)
    target = wave((0, 1.4, -3.0), (1.6, 0.25, 0), (period, 0.8 * period, 1), rng.random(3))
    cameras = eye, target
    return scene("handheld", seed, hall(rng, seed), *lamplight(rng), cameras)


def cab(seed: int, rng: np.random.Generator) -> Scene:
    """Return a shaking cab that drives between trees. Its parts are fixed to the camera."""
    groups, cameras, _ = _cab(seed, rng)
    return scene("cab", seed, groups, *sunlight(rng), cameras)


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
    return scene("wipers", seed, groups, *sunlight(rng), cameras)


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


_WARM = (1.0, 0.82, 0.58)


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
    return scene("shadows", seed, groups, lights, air, still_camera(rng))


def fan(seed: int, rng: np.random.Generator) -> Scene:
    """Return a fan before a lamp: the shadows of its blades turn over walls and floor."""
    groups = hall(rng, seed) + _things(rng)
    lights, air = lamplight(rng, 0.15)
    at = Place(rng.uniform(-0.3, 0.3), 2.5, -1.8, pitch=58)  # its −y looks at the foot of the back wall
    lit, can = spotlight(at @ Place(0, 0.45, 0), _WARM, rng.uniform(26, 34), IRON, angle=58)
    groups += can + _fan(at, rng.uniform(160, 260) * pick(rng, -1, 1))
    return scene("fan", seed, groups, lights + lit, air, still_camera(rng))


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


def build(name: str, seed: int, rng: np.random.Generator) -> Scene:
    """Return the situation `name`, one of `SITUATIONS` of `gffe_cl.captures.scenes`."""
    return globals()[name](seed, rng)
