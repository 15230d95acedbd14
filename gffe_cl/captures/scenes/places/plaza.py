"""Plaza: a town square behind a fence, with a fountain, a statue and people."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *

FENCE_Z, FOUNTAIN = 0.0, (0.0, -9.0)


def build(seed: int, rng: np.random.Generator) -> Scene:
    paving = Material(
        *pick(
            rng,
            ((0.36, 0.34, 0.31), (0.13, 0.12, 0.11)),
            ((0.42, 0.35, 0.28), (0.16, 0.13, 0.1)),
            ((0.33, 0.34, 0.37), (0.12, 0.12, 0.13)),
        ),
        texture=pick(rng, "cobbles", "tiles", "bricks"),
        scale=pick(rng, 0.28, 0.4, 0.6),
        contrast=0.35,
        roughness=0.8,
        seed=seed,
    )
    apron = Material((0.4, 0.37, 0.33), (0.2, 0.18, 0.16), "tiles", scale=0.45, contrast=0.3, seed=seed + 1)
    groups = [
        Group([Box((0, -0.5, -10), (160, 1.0, 160), paving)], name="paving"),
        Group([Cylinder((*_at(FOUNTAIN, -0.3),), (*_at(FOUNTAIN, 0.06),), 5.2, apron)], name="apron"),
    ]
    groups += railing(
        (-11, FENCE_Z),
        (11, FENCE_Z),
        rng.uniform(1.05, 1.35),
        rng.uniform(0.14, 0.2),
        pick(
            rng,
            IRON,
            STEEL,
            Material((0.06, 0.16, 0.1), roughness=0.4),
            Material((0.6, 0.58, 0.53), roughness=0.5),
        ),
        radius=rng.uniform(0.012, 0.02),
    )
    groups += _fountain(rng)
    groups += _buildings(rng)
    groups += _greenery_and_seats(rng)
    groups += _people(rng)

    evening = rng.uniform(0, 1)
    azimuth = np.radians(rng.uniform(20, 160) * pick(rng, -1, 1))
    elevation = np.radians(rng.uniform(26, 55) - 8 * evening)
    sun = (np.sin(azimuth), np.tan(elevation), np.cos(azimuth) * 0.8)
    sun_color = tint((1.0, 0.93 - 0.2 * evening, 0.82 - 0.36 * evening), rng.uniform(2.0, 2.7))
    lights = [Light("sun", sun, sun_color, size=rng.uniform(0.01, 0.03))]
    air = Air(
        zenith=tint((0.14, 0.3, 0.68), rng.uniform(0.8, 1.1)),
        horizon=(0.62 + 0.2 * evening, 0.7, 0.82 - 0.2 * evening),
        clouds=rng.uniform(0.25, 0.75),
        ambient_up=tint((0.36, 0.43, 0.54), rng.uniform(0.8, 1.1)),
        ambient_down=tint((0.22, 0.2, 0.18), rng.uniform(0.8, 1.1)),
        haze_color=(0.6, 0.66, 0.74),
        haze=rng.uniform(0.002, 0.006),
    )
    height, reach, period = rng.uniform(1.5, 1.75), rng.uniform(3.5, 5.5), rng.uniform(13, 18)
    back = rng.uniform(1.8, 2.8)
    eye = wave(
        (0, height, FENCE_Z + back),
        (reach, 0.04, 0.3),
        (period, 1.1, period / 1.7),
        (rng.random(), 0, rng.random()),
    )
    target = wave(
        (0, 1.75, -9.0), (reach * 0.45, 0.15, 0), (period * rng.uniform(0.6, 0.9), 9, 1), (rng.random(), 0, 0)
    )
    return Scene("plaza", seed, groups, lights, air, eye, target, focal=0.9)


def _at(place, y) -> tuple:
    return (place[0], y, place[1])


def _fountain(rng) -> list[Group]:
    """Return basin, statue and drops that rise and fall."""
    stone = Material(
        vary(rng, pick(rng, (0.5, 0.46, 0.4), (0.45, 0.45, 0.46), (0.55, 0.42, 0.33))),
        scale=0.4,
        contrast=0.3,
        roughness=0.8,
    )
    bronze = Material(
        vary(rng, pick(rng, (0.16, 0.3, 0.24), (0.3, 0.19, 0.09))),
        (0.08, 0.12, 0.1),
        "marble",
        scale=0.5,
        contrast=0.4,
        specular=0.3,
        roughness=0.35,
    )
    water = Material((0.05, 0.16, 0.2), (0.1, 0.26, 0.3), "water", scale=0.5, specular=0.05, roughness=0.06, mirror=1.0)
    x, z = FOUNTAIN
    basin = []
    for k in range(12):
        a, b = (2 * np.pi * (k + s) / 12 for s in (0, 1))
        basin.append(
            Capsule(
                (2.9 * np.cos(a), 0.36, 2.9 * np.sin(a)),
                (2.9 * np.cos(b), 0.36, 2.9 * np.sin(b)),
                0.16,
                stone,
            )
        )
    basin.append(Cylinder((0, 0.05, 0), (0, 0.3, 0), 2.9, water))
    plinth = [
        Cylinder((0, 0, 0), (0, 0.75, 0), 0.9, stone),
        Cone((0, 0.7, 0), (0, 1.6, 0), 0.6, 0.45, stone),
        Cylinder((0, 1.55, 0), (0, 1.7, 0), 0.62, stone),
    ]
    raised = rng.uniform(0.3, 0.8)
    statue = [
        Capsule((-0.13, 0.1, 0), (-0.12, 0.9, 0.02), 0.12, bronze),
        Capsule((0.16, 0.1, 0.1), (0.12, 0.9, 0.0), 0.12, bronze),
        Ellipsoid((0, 1.25, 0), (0.27, 0.42, 0.2), bronze),
        Ellipsoid((0, 1.98, 0.02), (0.14, 0.18, 0.16), bronze),
        Capsule((0, 1.6, 0), (0, 1.82, 0.01), 0.08, bronze),
        Capsule((-0.28, 1.55, 0), (-0.62, 1.3 + raised, 0.12), 0.075, bronze),
        Capsule((-0.62, 1.3 + raised, 0.12), (-0.75, 1.75 + raised, 0.2), 0.06, bronze),
        Capsule((0.28, 1.55, 0), (0.45, 1.1, 0.15), 0.075, bronze),
        Cone((0, 0.05, -0.1), (0, 1.5, -0.14), 0.42, 0.2, bronze),
    ]
    at = Place(x, 0, z)
    turned = Place(x, 1.7, z, yaw=float(rng.uniform(-60, 60)))
    groups = [
        Group(basin, at, name="basin"),
        Group(plinth, at, name="plinth"),
        Group(statue, turned, name="statue"),
    ]
    drop = Material((0.6, 0.7, 0.75), specular=0.3, roughness=0.1, contrast=0.0)
    jets, period = int(rng.integers(5, 8)), rng.uniform(1.0, 1.4)
    for k in range(jets):
        angle = 2 * np.pi * k / jets
        for j in range(4):
            fall = Place(x + 1.8 * np.cos(angle), 0.25, z + 1.8 * np.sin(angle)) @ Bounce(
                rng.uniform(0.9, 1.3), period, j / 4 + rng.uniform(0, 0.1)
            )
            groups.append(
                Group([Ellipsoid((0, 0, 0), (0.05, 0.09, 0.05), drop)], fall, casts_shadow=False, name="drop")
            )
    return groups


def _facade(rng, width, height, depth) -> Group:
    """Return a town house in its own space: front in the plane z = 0, door in the middle."""
    wall = Material(
        vary(
            rng,
            pick(
                rng,
                (0.55, 0.42, 0.28),
                (0.48, 0.2, 0.13),
                (0.55, 0.52, 0.45),
                (0.45, 0.5, 0.5),
                (0.6, 0.45, 0.38),
                (0.52, 0.5, 0.3),
            ),
            0.15,
        ),
        (0.42, 0.38, 0.33),
        pick(rng, "bricks", "plain", "plain"),
        scale=0.11,
        contrast=0.2,
        roughness=0.9,
        seed=int(rng.integers(999)),
    )
    trim = Material(vary(rng, (0.6, 0.57, 0.5)), roughness=0.7, contrast=0.1)
    pane = Material((0.05, 0.07, 0.09), specular=0.06, roughness=0.02, mirror=1.0, contrast=0.0)
    paint = Material(
        vary(rng, pick(rng, (0.1, 0.25, 0.18), (0.4, 0.1, 0.06), (0.12, 0.16, 0.3), (0.3, 0.17, 0.07))),
        roughness=0.5,
        texture="planks",
        second=(0.1, 0.06, 0.04),
        scale=0.15,
    )
    roof = Material(vary(rng, (0.32, 0.14, 0.09), 0.3), (0.14, 0.07, 0.05), "bricks", scale=0.2, contrast=0.3)
    prims = [
        Box((0, height / 2, -depth / 2), (width, height, depth), wall),
        Box((0, height + 0.1, -depth / 2 + 0.1), (width + 0.3, 0.28, depth + 0.5), trim),
        Box((0, height + 0.75, -depth / 2 - 0.2), (width * 0.97, 1.1, depth * 0.8), roof),
        Box((0, 0.3, -depth / 2), (width + 0.08, 0.6, depth + 0.08), trim),
    ]
    columns, floors = max(int(width / 2.3), 2), max(int(height / 3.1), 1)
    shop = rng.random() < 0.6
    for i in range(columns):
        x = (i + 0.5 - columns / 2) * width / columns
        for j in range(floors):
            y = 1.75 + j * 3.1
            if j == 0 and i == columns // 2:
                prims += [
                    Box((x, 1.2, 0), (1.25, 2.4, 0.12), trim),
                    Box((x, 1.12, 0.02), (1.0, 2.2, 0.14), paint),
                ]
                continue
            w, h = (1.7, 1.9) if j == 0 and shop else (1.0, 1.6)
            prims += [
                Box((x, y, 0), (w + 0.24, h + 0.24, 0.1), trim),
                Box((x, y, 0.012), (w, h, 0.1), pane),
                Box((x, y, 0.02), (0.05, h, 0.11), trim),
                Box((x, y - h / 2 - 0.1, 0.08), (w + 0.4, 0.08, 0.26), trim),
            ]
            if j > 0 and rng.random() < 0.7:
                prims += [Box((x + s * (w / 2 + 0.36), y, 0.03), (0.42, h, 0.06), paint) for s in (-1, 1)]
    if shop:
        sign = Material(
            vary(rng, (0.55, 0.5, 0.38), 0.3),
            vary(rng, (0.12, 0.1, 0.2), 0.5),
            "sign",
            scale=0.32,
            seed=int(rng.integers(999)),
        )
        prims.append(Box((0, 3.05, 0.06), (width * 0.7, 0.5, 0.14), sign))
    return Group(prims, name="house")


def _buildings(rng) -> list[Group]:
    groups = []
    for x0, z0, yaw, count in ((-21, -25, 0, 5), (-20, 6, 90, 4), (20, -24, -90, 4)):
        along = 0.0
        direction = np.array((np.cos(np.radians(yaw)), -np.sin(np.radians(yaw))))
        for _ in range(count):
            width, height = rng.uniform(6.5, 9.5), pick(rng, 6.6, 9.6, 9.9, 12.8) * rng.uniform(0.95, 1.08)
            house = _facade(rng, width, height, 8.0)
            x, z = np.array((x0, z0)) + direction * (along + width / 2)
            house.motion = Place(x, 0, z - rng.uniform(0, 0.4), yaw=yaw)
            groups.append(house)
            along += width + (0.02 if rng.random() < 0.75 else rng.uniform(1.5, 3.0))
    hill = Material((0.16, 0.24, 0.12), (0.08, 0.13, 0.06), "grass", scale=3.0)
    for x, z, r in ((-60, -110, 45), (30, -130, 60), (110, -90, 50)):
        groups.append(Group([Ellipsoid((x, -12, z), (r, r * 0.42, r * 0.6), hill)], name="hill"))
    return groups


def _greenery_and_seats(rng) -> list[Group]:
    bark, groups = bark_material(rng), []
    autumn = rng.random() ** 2
    kerb = Material((0.4, 0.38, 0.35), contrast=0.3, roughness=0.9)
    for x, z in ((-8.5, -4.5), (9, -5), (-10, -14), (10.5, -15.5)):
        if rng.random() < 0.85:
            x, z = x + rng.uniform(-1, 1), z + rng.uniform(-1, 1)
            groups.append(Group([Cylinder((x, 0, z), (x, 0.14, z), 0.75, kerb)], name="kerb"))
            groups += broad_tree(x, z, rng, rng.uniform(4.5, 6.5), bark, leaf_material(rng, autumn))
    for x, z, yaw in ((-4.6, -5.2, -45), (4.8, -5.0, 45), (-5.2, -13, 215), (5.4, -12.6, 145)):
        groups += bench(Place(x, 0, z, yaw=yaw + 180), WOOD)
    post = IRON
    for x in (-6.3, 6.3):
        for z in (-2.6, -16.5):
            lamp = Material((0.8, 0.75, 0.6), emission=(0.25, 0.22, 0.15), roughness=0.3)
            groups.append(
                Group(
                    [
                        Cone((x, 0, z), (x, 0.6, z), 0.14, 0.07, post),
                        Cylinder((x, 0.5, z), (x, 3.4, z), 0.05, post),
                        Capsule((x - 0.35, 3.3, z), (x + 0.35, 3.3, z), 0.03, post),
                        Sphere((x - 0.38, 3.5, z), 0.16, lamp),
                        Sphere((x + 0.38, 3.5, z), 0.16, lamp),
                    ],
                    name="lamp post",
                )
            )
    for k in range(int(rng.integers(2, 5))):  # café tables
        x, z = 8.0 + 2.6 * (k % 2) + rng.uniform(-0.3, 0.3), -8.5 - 2.6 * (k // 2)
        cloth = Material(
            vary(rng, pick(rng, (0.6, 0.12, 0.08), (0.6, 0.52, 0.36), (0.1, 0.3, 0.32))),
            (0.62, 0.58, 0.5),
            "stripes",
            scale=0.12,
            roughness=0.9,
        )
        table = [
            Cylinder((0, 0, 0), (0, 2.4, 0), 0.025, STEEL),
            Cylinder((0, 0.72, 0), (0, 0.76, 0), 0.45, WOOD),
            Cylinder((0, 0, 0), (0, 0.05, 0), 0.25, IRON),
        ]
        groups.append(Group(table, Place(x, 0, z), name="table"))
        sway = Place(x, 2.1, z) @ Swing("z", 2.0, rng.uniform(2.5, 4), rng.random())
        groups.append(Group([Cone((0, 0, 0), (0, 0.45, 0), 1.35, 0.04, cloth)], sway, name="umbrella"))
    return groups


def _people(rng) -> list[Group]:
    """Return walkers on loops between fence and fountain and around it; a dog; a ball; balloons."""
    groups = []
    near = int(rng.integers(2, 4))
    for k in range(near):
        z, dz, half = -1.2 - 1.1 * k, 0.55, rng.uniform(5, 8)
        ring = [(-half, z), (0, z + 0.1), (half, z), (half, z - dz), (0, z - dz - 0.1), (-half, z - dz)]
        ring = ring if rng.random() < 0.5 else ring[::-1]
        groups += walker(Path(ring, rng.uniform(0.9, 1.7), rng.random()), rng)
    for k in range(int(rng.integers(2, 4))):
        r = 4.1 + 0.9 * k
        ring = [(FOUNTAIN[0] + r * np.cos(a), FOUNTAIN[1] + r * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 9)[:-1]]
        ring = ring if k % 2 else ring[::-1]
        groups += walker(Path(ring, rng.uniform(0.8, 1.5), rng.random()), rng)
    z = -4.6
    groups += animal(
        Path(
            [(-4, z), (0, z + 0.5), (4, z), (4.5, z - 0.7), (0, z - 0.4), (-4.5, z - 0.7)],
            rng.uniform(1.5, 2.4),
            rng.random(),
        ),
        rng,
        0.55,
    )
    rubber = Material(vary(rng, (0.6, 0.12, 0.1), 0.4), (0.65, 0.6, 0.5), "stripes", scale=0.11, roughness=0.3)
    hop = (
        Place(0, 0.16, -3.2)
        @ Slide((3.5, 0, 0.4), rng.uniform(5, 8), rng.random())
        @ Bounce(0.9, 0.85)
        @ Spin("z", 200)
    )
    groups.append(Group([Sphere((0, 0, 0), 0.16, rubber)], hop, name="ball"))
    for k in range(3):
        skin = Material(
            vary(rng, pick(rng, (0.65, 0.1, 0.1), (0.7, 0.5, 0.06), (0.08, 0.3, 0.6), (0.2, 0.5, 0.15))),
            roughness=0.15,
            specular=0.06,
            contrast=0.03,
        )
        at = Place(-7.2 + 0.35 * k, 2.6 + 0.25 * (k % 2), -7.0 + 0.2 * k) @ Swing("z", 5, 2.2 + 0.3 * k, rng.random())
        at = at @ Place(0, 0.4, 0)
        groups.append(
            Group(
                [
                    Ellipsoid((0, 0, 0), (0.19, 0.24, 0.19), skin),
                    Capsule((0, -0.24, 0), (0, -1.6, 0), 0.006, IRON),
                ],
                at,
                name="balloon",
            )
        )
    return groups
