"""Forest: a clearing among trunks, seen by someone who looks around quickly."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *


def build(seed: int, rng: np.random.Generator) -> Scene:
    autumn = float(np.clip(rng.uniform(-0.4, 1.0), 0, 1))
    ground = Material(
        vary(rng, (0.15 + 0.07 * autumn, 0.19, 0.06)),
        vary(rng, (0.1, 0.075, 0.04)),
        "grass",
        scale=0.35,
        contrast=0.25 + 0.75 * autumn,
        roughness=1.0,
        seed=seed,
    )
    eye, target, focal = _look_around(rng)
    walked = np.array([eye(t)[[0, 2]] for t in np.linspace(0, 120, 400)])
    loops = _loops(rng)
    keep_clear = np.concatenate([walked, *(path.curve[::6, [0, 2]] for path in loops)])

    groups = [Group([Box((0, -0.5, 0), (240, 1.0, 240), ground)], name="ground")]
    for _ in range(6):  # gentle rises beyond the clearing
        a, r = rng.uniform(0, 2 * np.pi), rng.uniform(24, 40)
        groups.append(
            Group(
                [
                    Ellipsoid(
                        (r * np.cos(a), -1.0, r * np.sin(a)),
                        (rng.uniform(9, 15), rng.uniform(2, 4), rng.uniform(9, 15)),
                        ground,
                    )
                ],
                name="rise",
            )
        )
    groups += _trees(rng, keep_clear, autumn)
    groups += _edge_of_the_wood(rng, autumn)
    groups += _undergrowth(rng, keep_clear, autumn)
    for path in loops[:2]:
        groups += animal(path, rng, rng.uniform(0.6, 1.05))
    groups += walker(loops[2], rng)
    groups += _small_life(rng)

    low = rng.random()
    azimuth = rng.uniform(0, 2 * np.pi)
    sun = (np.sin(azimuth), np.tan(np.radians(rng.uniform(28, 52) - 8 * low)), np.cos(azimuth))
    sun_color = tint((1.0, 0.92 - 0.16 * low, 0.78 - 0.3 * low), rng.uniform(2.2, 3.0))
    mist = rng.uniform(0.006, 0.015)
    air = Air(
        zenith=tint((0.2, 0.38, 0.7), rng.uniform(0.8, 1.1)),
        horizon=(0.72, 0.8, 0.84),
        clouds=rng.uniform(0.2, 0.6),
        ambient_up=tint((0.3, 0.38, 0.36), rng.uniform(0.85, 1.15)),
        ambient_down=tint((0.13, 0.14, 0.08), rng.uniform(0.9, 1.2)),
        haze_color=tint((0.6, 0.68, 0.66), rng.uniform(0.75, 1.0)),
        haze=mist,
    )
    lights = [Light("sun", sun, sun_color, size=rng.uniform(0.015, 0.03))]
    return Scene("forest", seed, groups, lights, air, eye, target, focal=focal)


def _look_around(rng):
    """Return paths of eye and target, and a focal length: a slow walk in a figure of eight; the head turns quickly from
    side to side."""
    period, size, lag = rng.uniform(24, 34), rng.uniform(1.8, 2.6), rng.random()
    turn, turn_period, heading = rng.uniform(0.55, 0.85), rng.uniform(3.8, 5.4), rng.uniform(0, 2 * np.pi)
    height = rng.uniform(1.5, 1.7)

    def eye(time):
        u = 2 * np.pi * (time / period + lag)
        return np.array(
            (size * np.sin(u), height + 0.025 * np.sin(2 * np.pi * time / 0.65), 0.6 * size * np.sin(2 * u))
        )

    def target(time):
        angle = heading + 0.05 * time + turn * np.sin(2 * np.pi * time / turn_period)
        nod = -0.04 + 0.07 * np.sin(2 * np.pi * time / (1.7 * turn_period))
        return eye(time) + np.array((np.sin(angle), nod, -np.cos(angle)))

    return eye, target, rng.uniform(0.8, 0.95)


def _loops(rng) -> list[Path]:
    """Return closed ways round the clearing, outside the camera's own."""
    loops = []
    for radius, speed in ((4.6, 1.9), (7.2, 2.6), (5.8, 1.25)):
        angles = np.linspace(0, 2 * np.pi, 8)[:-1] * pick(rng, -1, 1)
        radii = radius + rng.uniform(-0.45, 0.45, 7)
        loops.append(
            Path(
                np.stack([radii * np.cos(angles), radii * np.sin(angles)], -1),
                speed * rng.uniform(0.8, 1.2),
                rng.random(),
            )
        )
    return loops


def _clear(x, z, keep_clear, distance) -> bool:
    return bool(np.hypot(keep_clear[:, 0] - x, keep_clear[:, 1] - z).min() > distance)


def _scatter(rng, count, nearest, farthest, keep_clear, distance, apart=0.0):
    """Return up to `count` places in a ring, not on anyone's way."""
    places: list = []
    for _ in range(count * 6):
        a, r = rng.uniform(0, 2 * np.pi), np.sqrt(rng.uniform(nearest**2, farthest**2))
        x, z = r * np.cos(a), r * np.sin(a)
        free = all(np.hypot(x - px, z - pz) > apart for px, pz in places)
        if free and _clear(x, z, keep_clear, distance):
            places.append((x, z))
        if len(places) == count:
            break
    return places


def _trees(rng, keep_clear, autumn) -> list[Group]:
    groups = []
    barks = [bark_material(rng) for _ in range(3)]
    birch = Material((0.62, 0.6, 0.54), (0.16, 0.14, 0.12), "marble", scale=0.5, contrast=0.9, roughness=0.8)
    leaves = [leaf_material(rng, autumn * rng.uniform(0.3, 1.0)) for _ in range(4)]
    dark = leaf_material(rng)
    wild = rng.uniform(0.2, 0.6)
    for x, z in _scatter(rng, int(rng.integers(54, 66)), 3.2, 21, keep_clear, 1.0, apart=1.7):
        r = np.hypot(x, z)
        bark = pick(rng, *barks, *((birch,) if rng.random() < 0.5 else ()))
        if rng.random() < wild and r > 5.0:
            groups += conifer(x, z, rng, rng.uniform(6, 11), bark, dark)
        elif rng.random() < 0.55:
            groups += broad_tree(x, z, rng, rng.uniform(6.5, 10), bark, pick(rng, *leaves), blobs=18 if r < 10 else 11)
        else:  # a tall trunk, its crown out of sight, some dead branches
            height, radius = rng.uniform(9, 13), rng.uniform(0.13, 0.3)
            prims = [
                Cone((0, -0.1, 0), (0, 0.4, 0), radius * 1.6, radius * 1.03, bark),
                Cone((0, 0.35, 0), (0, height, 0), radius * 1.04, radius * 0.5, bark),
            ]
            for _ in range(4):
                y, a, reach = rng.uniform(1.6, 6), rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.3)
                prims.append(
                    Cone(
                        (0, y, 0),
                        (reach * np.cos(a), y + 0.5 * reach, reach * np.sin(a)),
                        radius * 0.22,
                        0.012,
                        bark,
                    )
                )
            at = Place(x, 0, z, roll=float(rng.uniform(-4, 4)), yaw=float(rng.uniform(0, 360)))
            groups.append(Group(prims, at, name="trunk"))
            crown = [
                Ellipsoid(
                    tuple(tuple(np.array((0, height, 0)) + rng.uniform(-1.2, 1.2, 3))),
                    (1.5, 1.0, 1.5),
                    pick(rng, *leaves),
                )
                for _ in range(3)
            ]
            groups.append(Group(crown, at @ Swing("x", 0.6, rng.uniform(3, 5), rng.random()), name="crown"))
    return groups


def _edge_of_the_wood(rng, autumn) -> list[Group]:
    """Return a closed backdrop of crowns and trunks behind everything."""
    groups = []
    bark = bark_material(rng)
    for k in range(16):
        prims = []
        for j in range(5):
            a, r = 2 * np.pi * (k + j / 5) / 16 + rng.uniform(-0.03, 0.03), rng.uniform(29, 36)
            x, z, h = r * np.cos(a), r * np.sin(a), rng.uniform(6, 11)
            leaf = leaf_material(rng, autumn * rng.random())
            prims += [
                Ellipsoid((x, h * 0.62, z), (rng.uniform(2.4, 3.4), h * 0.45, rng.uniform(2.4, 3.4)), leaf),
                Ellipsoid((x * 1.03, 0.8, z * 1.03), (2.6, 1.6, 2.6), leaf),
                Cone((x, 0, z), (x, h * 0.6, z), 0.32, 0.2, bark),
            ]
        groups.append(Group(prims, name="edge of the wood"))
    return groups


def _undergrowth(rng, keep_clear, autumn) -> list[Group]:
    """Return bushes, ferns, rocks, mushrooms and a fallen log."""
    groups = []
    for x, z in _scatter(rng, 20, 2.8, 16, keep_clear, 0.9, apart=1.2):
        leaf, size = leaf_material(rng, autumn * rng.random()), rng.uniform(0.3, 0.7)
        bush = []
        for k in range(7):
            a, r = 2.4 * k, size * np.sqrt((k + 0.3) / 7) * 0.9
            s = size * rng.uniform(0.32, 0.5)
            bush.append(Ellipsoid((r * np.cos(a), s * rng.uniform(0.6, 1.4), r * np.sin(a)), (s, s * 0.85, s), leaf))
        groups.append(Group(bush, Place(x, 0, z) @ Swing("z", 0.8, rng.uniform(2, 4), rng.random()), name="bush"))
    for x, z in _scatter(rng, 24, 2.2, 12, keep_clear, 0.75, apart=0.8):
        leaf, fronds = leaf_material(rng, 0.4 * autumn), []
        for k in range(8):
            a, reach = 2 * np.pi * k / 8 + rng.uniform(-0.2, 0.2), rng.uniform(0.3, 0.55)
            mid = (0.5 * reach * np.cos(a), 0.36 * reach + 0.2, 0.5 * reach * np.sin(a))
            fronds.append(Cone((0, 0.02, 0), mid, 0.012, 0.032, leaf))
            fronds.append(Cone(mid, (reach * np.cos(a), 0.22, reach * np.sin(a)), 0.032, 0.004, leaf))
        groups.append(Group(fronds, Place(x, 0, z) @ Swing("x", 2.0, rng.uniform(1.8, 3.2), rng.random()), name="fern"))
    for x, z in _scatter(rng, 12, 2.6, 14, keep_clear, 0.8, apart=1.0):
        stone = Material(vary(rng, (0.32, 0.31, 0.29), 0.25), (0.14, 0.18, 0.1), "bark", scale=0.4, roughness=0.95)
        r = rng.uniform(0.18, 0.5)
        rock = [
            Ellipsoid((0, 0.3 * r, 0), (r, 0.65 * r, 0.8 * r), stone),
            Ellipsoid((0.5 * r, 0.1, 0.3 * r), (0.5 * r, 0.35 * r, 0.5 * r), stone),
        ]
        groups.append(Group(rock, Place(x, 0, z, yaw=float(rng.uniform(0, 360))), name="rock"))
    cap = Material((0.5, 0.07, 0.04), roughness=0.3, contrast=0.2, scale=0.05)
    stem = Material((0.6, 0.56, 0.48), roughness=0.9)
    for x, z in _scatter(rng, 5, 2.0, 7, keep_clear, 0.6, apart=1.0):
        prims = []
        for _ in range(3):
            dx, dz, h = rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(0.08, 0.18)
            prims += [
                Cone((dx, 0, dz), (dx, h, dz), 0.025, 0.018, stem),
                Ellipsoid((dx, h, dz), (0.07, 0.045, 0.07), cap),
            ]
        groups.append(Group(prims, Place(x, 0, z), name="mushrooms"))
    for x, z in _scatter(rng, 1, 3.2, 8, keep_clear, 1.5):
        bark = bark_material(rng)
        at = Place(x, 0.25, z, yaw=float(rng.uniform(0, 360)))
        groups.append(
            Group(
                [
                    Cylinder((-1.3, 0, 0), (1.3, 0.04, 0), 0.25, bark),
                    Cone((0.3, 0.1, 0), (0.5, 0.7, 0.2), 0.07, 0.03, bark),
                ],
                at,
                name="log",
            )
        )
    return groups


def _small_life(rng) -> list[Group]:
    """Return hopping hares, birds that flap, falling leaves."""
    groups = []
    fur = Material(vary(rng, (0.34, 0.26, 0.17)), (0.2, 0.14, 0.09), "bark", scale=0.08, roughness=1.0)
    for k in range(2):
        ring = [((3.3 + 0.5 * k) * np.cos(a), (3.3 + 0.5 * k) * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 8)[:-1]]
        path = Path(ring if k else ring[::-1], rng.uniform(1.2, 2.2), rng.random())
        hare = [
            Ellipsoid((0, 0.14, 0), (0.09, 0.11, 0.17), fur),
            Sphere((0, 0.26, 0.16), 0.075, fur),
            Capsule((-0.03, 0.31, 0.14), (-0.05, 0.44, 0.1), 0.02, fur),
            Capsule((0.03, 0.31, 0.14), (0.05, 0.44, 0.1), 0.02, fur),
        ]
        groups.append(Group(hare, path @ Bounce(0.28, 0.45, rng.random()), name="hare"))
    feather = Material(vary(rng, pick(rng, (0.05, 0.05, 0.06), (0.4, 0.38, 0.36), (0.15, 0.22, 0.4))), roughness=0.6)
    for k in range(3):
        r = rng.uniform(3.5, 8)
        ring = [
            (r * np.cos(a), 3.2 + 0.7 * k + 0.4 * np.sin(2 * a), r * np.sin(a))
            for a in np.linspace(0, 2 * np.pi, 9)[:-1]
        ]
        path = Path(ring, rng.uniform(3, 5), rng.random())
        groups.append(
            Group(
                [
                    Ellipsoid((0, 0, 0), (0.07, 0.07, 0.2), feather),
                    Cone((0, 0, -0.15), (0, 0, -0.36), 0.04, 0.08, feather),
                ],
                path,
                name="bird",
            )
        )
        for s in (-1, 1):
            flap = path @ Swing("z", 38 * s, 0.42, 0.3 * k, rest=8 * s) @ Place(0.03 * s, 0.02, 0)
            groups.append(Group([Ellipsoid((0.24 * s, 0, 0), (0.25, 0.015, 0.09), feather)], flap, name="wing"))
    for _ in range(10):
        leaf = Material(pick(rng, (0.55, 0.3, 0.05), (0.5, 0.14, 0.04), (0.4, 0.36, 0.08)), roughness=0.8)
        a, r = rng.uniform(0, 2 * np.pi), rng.uniform(2.8, 8)
        at = Place(r * np.cos(a), 0, r * np.sin(a)) @ _Fall(rng.uniform(3, 5), rng.uniform(6, 10), rng.random())
        at = at @ Spin((rng.uniform(-1, 1), 1, rng.uniform(-1, 1)), rng.uniform(90, 220))
        groups.append(Group([Ellipsoid((0, 0, 0), (0.05, 0.006, 0.035), leaf)], at, casts_shadow=False, name="leaf"))
    return groups


class _Fall(Motion):
    """Fall from `height` with a sideways sway, once per `period`; it then starts again from above."""

    def __init__(self, height, period, phase):
        self.height, self.period, self.phase = height, period, phase

    def __call__(self, time):
        u = (time / self.period + self.phase) % 1.0
        matrix = np.eye(4)
        matrix[:3, 3] = 0.35 * np.sin(9 * u), self.height * (1 - u), 0.25 * np.cos(7 * u)
        return matrix
