"""Courtyard: a sunlit court with arcades and laundry, seen by someone who turns quickly."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *

HALF, ARCADE, STOREY, TOP = 7.0, 2.2, 3.5, 5.7
FOUNTAIN = (0.0, -2.6)


def build(seed: int, rng: np.random.Generator) -> Scene:
    plaster = Material(
        vary(rng, pick(rng, (0.62, 0.5, 0.34), (0.6, 0.4, 0.3), (0.62, 0.58, 0.5), (0.58, 0.46, 0.42))),
        scale=0.9,
        contrast=0.16,
        roughness=0.95,
        seed=seed,
    )
    stone = Material(vary(rng, (0.52, 0.48, 0.42)), scale=0.5, contrast=0.25, roughness=0.85, seed=seed + 1)
    paving = Material(
        *pick(rng, ((0.38, 0.35, 0.31), (0.17, 0.15, 0.13)), ((0.38, 0.29, 0.23), (0.2, 0.16, 0.12))),
        texture=pick(rng, "cobbles", "tiles", "bricks"),
        scale=pick(rng, 0.35, 0.5),
        contrast=0.3,
        roughness=0.8,
        seed=seed,
    )
    groups = [Group([Box((0, -0.5, 0), (60, 1.0, 60), paving)], name="paving")]
    for yaw in (0, 90, 180, 270):
        groups += _side(rng, yaw, plaster, stone)
    groups += _fountain(rng, stone)
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(56, 64))
    sun = np.array((np.sin(azimuth), np.tan(elevation), np.cos(azimuth)))
    groups += _laundry(rng)
    groups += _wind_wheels(rng, sun)
    groups += _birds(rng, sun)
    groups += _greenery(rng)
    groups += _people(rng)
    warm = rng.random()
    lights = [
        Light("sun", tuple(sun), tint((1.0, 0.93 - 0.1 * warm, 0.84 - 0.24 * warm), rng.uniform(2.1, 2.5)), size=0.005)
    ]
    ball, rate = Place(FOUNTAIN[0], 2.1, FOUNTAIN[1]), rng.uniform(50, 80) * pick(rng, -1, 1)
    patches, mirrors = gazing_ball(ball, (1.0, 0.93, 0.82), rng.uniform(60, 80), rate)
    lights, groups = lights + patches, groups + mirrors
    air = Air(
        zenith=tint((0.13, 0.3, 0.7), rng.uniform(0.85, 1.1)),
        horizon=(0.66, 0.76, 0.9),
        clouds=rng.uniform(0.15, 0.5),
        ambient_up=tint((0.16, 0.2, 0.27), rng.uniform(0.8, 1.1)),
        ambient_down=tint((0.17, 0.15, 0.12), rng.uniform(0.8, 1.1)),
        haze_color=(0.6, 0.66, 0.74),
        haze=0.002,
    )
    eye, target = _mouse_look(rng)
    return Scene("courtyard", seed, groups, lights, air, eye, target, focal=0.8)


def _mouse_look(rng):
    """Return paths of eye and target: a slow walk on a small loop; the head turns in quick strokes with pauses between
    them."""
    strokes = rng.uniform(35, 80, 12) * np.where(rng.random(12) < 0.6, 1, -1)
    strokes[-1] += 360 * round(strokes.sum() / 360) - strokes.sum()  # closes the loop
    strokes[-1] = (strokes[-1] + 180) % 360 - 180
    pauses, spans = rng.uniform(0.1, 0.45, 12), np.abs(strokes) / rng.uniform(58, 80) + 0.12
    starts = np.concatenate([[0.0], np.cumsum(pauses + spans)])
    headings = rng.uniform(0, 360) + np.concatenate([[0.0], np.cumsum(strokes)])
    period, lag, height = rng.uniform(20, 28), rng.random(), rng.uniform(1.5, 1.7)

    def heading(time):
        time = time % starts[-1]
        k = min(int(np.searchsorted(starts, time, side="right")) - 1, 11)
        u = np.clip((time - starts[k] - pauses[k]) / spans[k], 0.0, 1.0)
        return headings[k] + strokes[k] * u * u * (3 - 2 * u)

    def eye(time):
        u = 2 * np.pi * (time / period + lag)
        return np.array((1.3 * np.sin(u), height + 0.02 * np.sin(2 * np.pi * time / 0.6), 2.2 + 0.9 * np.cos(u)))

    def target(time):
        angle = np.radians(heading(time))
        nod = -0.16 + 0.07 * np.sin(2 * np.pi * time / 5.3)
        return eye(time) + np.array((np.sin(angle), nod, -np.cos(angle)))

    return eye, target


def _side(rng, yaw, plaster, stone) -> list[Group]:
    """Return one side of the court in its own space: arcade in the plane z = −HALF, upper storey with windows above."""
    at, bays = Place(yaw=yaw), 5
    pitch = 2 * HALF / bays
    pane = Material((0.04, 0.055, 0.07), specular=0.06, roughness=0.02, mirror=1.0, contrast=0.0)
    shutter = Material(vary(rng, pick(rng, (0.1, 0.25, 0.2), (0.14, 0.2, 0.35), (0.3, 0.12, 0.08))), roughness=0.5)
    tiles = Material(vary(rng, (0.45, 0.2, 0.12)), (0.2, 0.09, 0.06), "bricks", scale=0.2, contrast=0.3)
    spring, r = 2.1, pitch / 2 - 0.28
    upper = [
        Box((0, (STOREY + TOP) / 2, -HALF - 0.2), (2 * HALF + 0.8, TOP - STOREY, 0.4), plaster),
        Box((0, STOREY, -HALF - 0.17), (2 * HALF + 0.7, 0.18, 0.52), stone),
        Box((0, TOP + 0.1, -HALF + 0.05), (2 * HALF + 1.2, 0.16, 1.1), tiles),
        Box((0, STOREY / 2, -HALF - ARCADE - 0.1), (2 * HALF + 2 * ARCADE, STOREY, 0.2), plaster),
        Box((0, STOREY - 0.04, -HALF - ARCADE / 2 - 0.2), (2 * HALF + 2 * ARCADE, 0.12, ARCADE), plaster),
    ]
    groups, piers = [], []
    for k in range(bays + 1):
        x = (k - bays / 2) * pitch
        piers += [
            Cylinder((x, 0, -HALF - 0.2), (x, spring - 0.12, -HALF - 0.2), 0.2, stone),
            Box((x, 0.12, -HALF - 0.2), (0.54, 0.24, 0.54), stone),
            Box((x, spring - 0.05, -HALF - 0.2), (0.56, 0.16, 0.5), stone),
        ]
    for k in range(bays):
        x = (k + 0.5 - bays / 2) * pitch
        arch = [(x + r * np.cos(a), spring + r * np.sin(a) * 0.92, -HALF - 0.2) for a in np.linspace(0, np.pi, 9)]
        piers += [Capsule(a, b, 0.14, stone) for a, b in zip(arch[:-1], arch[1:], strict=True)]
        edges = np.linspace(-pitch / 2, pitch / 2, 13)  # the wall above the arch, in steps behind its ring
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            inner = min(abs(a), abs(b)) if a * b > 0 else 0.0
            low = spring + 0.92 * np.sqrt(max(r * r - inner * inner, 0.0)) - 0.02
            piers.append(Box((x + (a + b) / 2, (low + STOREY) / 2, -HALF - 0.2), (b - a, STOREY - low, 0.22), plaster))
        y, w, h = 4.65, 0.9, 1.3
        upper += [Box((x, y, -HALF), (w + 0.24, h + 0.24, 0.08), stone), Box((x, y, -HALF + 0.02), (w, h, 0.08), pane)]
        upper.append(Box((x, y, -HALF + 0.03), (0.05, h, 0.09), stone))
        upper += [Box((x + s * (w / 2 + 0.36), y, -HALF + 0.03), (0.44, h, 0.06), shutter) for s in (-1, 1)]
        if rng.random() < 0.4:
            door = [Box((x, 1.1, -HALF - ARCADE + 0.02), (1.1, 2.2, 0.08), shutter)]
            groups.append(Group(door, at, name="door"))
    return [*groups, Group(piers, at, name="arcade"), Group(upper, at, name="storey")]


def _fountain(rng, stone) -> list[Group]:
    """Return a basin of water, a column with a bowl, and drops that the wind carries round."""
    water = Material(
        (0.03, 0.1, 0.12), (0.06, 0.17, 0.19), "water", scale=0.4, specular=0.06, roughness=0.03, mirror=1.0
    )
    at, rim = Place(FOUNTAIN[0], 0, FOUNTAIN[1]), 2 * np.pi * np.arange(13) / 12
    basin = [
        Capsule((1.5 * np.cos(a), 0.42, 1.5 * np.sin(a)), (1.5 * np.cos(b), 0.42, 1.5 * np.sin(b)), 0.13, stone)
        for a, b in zip(rim[:-1], rim[1:], strict=True)
    ]
    basin += [Cylinder((0, 0, 0), (0, 0.36, 0), 1.5, water), Cylinder((0, 0.3, 0), (0, 1.2, 0), 0.14, stone)]
    basin += [Cone((0, 1.1, 0), (0, 1.3, 0), 0.15, 0.62, stone), Cylinder((0, 1.2, 0), (0, 1.95, 0), 0.05, IRON)]
    return [Group(basin, at, name="fountain")]


def _laundry(rng) -> list[Group]:
    """Return lines across the court with sheets and slatted blinds that swing in the wind."""
    groups, along_x = [], bool(rng.integers(2))
    for offset in (-4.6, -0.8, 3.2, 5.4):
        y = rng.uniform(4.0, 4.8)
        line = Place(0, y, offset, yaw=0) if along_x else Place(offset, y, 0, yaw=90)
        groups.append(Group([Capsule((-HALF, 0.02, 0), (HALF, 0.02, 0), 0.012, IRON)], line, name="line"))
        x, gust = -5.6 + rng.uniform(0, 0.6), rng.random()
        while x < 5.2:
            width, drop = rng.uniform(0.8, 1.5), rng.uniform(1.0, 1.6)
            color = vary(rng, pick(rng, (0.7, 0.69, 0.66), (0.6, 0.12, 0.1), (0.12, 0.3, 0.5), (0.65, 0.5, 0.14)))
            cloth = Material(
                color,
                tint(color, 0.5),
                pick(rng, "plain", "stripes", "checker"),
                scale=0.14,
                contrast=0.1,
                roughness=1.0,
            )
            swing = Swing("x", rng.uniform(26, 42), rng.uniform(1.3, 1.8), gust + 0.04 * x)
            at = line @ Place(x + width / 2, 0, 0) @ swing
            if rng.random() < 0.45:
                slats = [Box((0, -0.1 - 0.16 * j, 0), (width, 0.07, 0.012), WOOD) for j in range(int(drop / 0.16))]
                slats += [Box((s * 0.42 * width, -drop / 2, 0), (0.03, drop, 0.008), WOOD) for s in (-1, 1)]
                groups.append(Group(slats, at, name="blind"))
            else:
                groups.append(Group([Box((0, -drop / 2, 0), (width, drop, 0.012), cloth)], at, name="sheet"))
            x += width + rng.uniform(0.15, 0.9)
    return groups


def _above(point, sun, height) -> np.ndarray:
    """Return the position at `height` from which a shadow falls on the ground at (x, z)."""
    return np.array((point[0], 0.0, point[1])) + sun * (height / sun[1])


def _wind_wheels(rng, sun) -> list[Group]:
    """Return wheels on masts on the roof, out of sight mostly, whose shadows turn on the ground."""
    groups, vane = [], Material((0.5, 0.5, 0.48), roughness=0.5)
    for x, z in ((3.2, -3.6), (-3.6, 3.0), (3.4, 4.4)):
        hub = _above((x + rng.uniform(-0.5, 0.5), z + rng.uniform(-0.5, 0.5)), sun, rng.uniform(9.0, 10.5))
        facing = Place(*hub, yaw=float(np.degrees(np.arctan2(sun[0], sun[2]))), pitch=-50)
        turn = facing @ Spin("z", rng.uniform(130, 200) * pick(rng, -1, 1))
        count = int(rng.integers(6, 9))
        blades = []
        for k in range(count):
            a = 2 * np.pi * k / count
            c, s = np.cos(a), np.sin(a)
            blades.append(Cone((0.25 * c, 0.25 * s, 0), (1.5 * c, 1.5 * s, 0), 0.06, 0.2, vane))
        groups.append(Group(blades, turn, name="wind wheel"))
    return groups


def _birds(rng, sun) -> list[Group]:
    """Return a flock that circles over the roofs, so that its shadows cross the court."""
    groups = []
    feather = Material(vary(rng, pick(rng, (0.5, 0.5, 0.5), (0.1, 0.1, 0.11), (0.4, 0.36, 0.3))), roughness=0.7)
    height, turn = rng.uniform(9.5, 11.5), pick(rng, -1, 1)
    for k in range(9):
        r, lift = rng.uniform(2.0, 5.2), 0.35 * k
        center = _above(rng.uniform(-1.2, 1.2, 2), sun, height + lift)
        angles = turn * np.linspace(0, 2 * np.pi, 9)[:-1]
        ring = [(center[0] + r * np.cos(a), center[1], center[2] + r * np.sin(a)) for a in angles]
        path = Path(ring, rng.uniform(6.5, 9.5), rng.random())
        body = [
            Ellipsoid((0, 0, 0), (0.12, 0.1, 0.36), feather),
            Cone((0, 0, -0.3), (0, 0, -0.62), 0.05, 0.13, feather),
        ]
        groups.append(Group(body, path, name="bird"))
        for s in (-1, 1):
            flap = path @ Swing("z", 32 * s, rng.uniform(0.45, 0.6), 0.1 * k, rest=6 * s) @ Place(0.05 * s, 0.02, 0)
            groups.append(Group([Ellipsoid((0.42 * s, 0, 0), (0.44, 0.02, 0.15), feather)], flap, name="wing"))
    return groups


def _greenery(rng) -> list[Group]:
    x, z = 4.3 * pick(rng, -1, 1), -3.9
    kerb = Material((0.42, 0.4, 0.36), contrast=0.3, roughness=0.9)
    groups = [Group([Cylinder((x, 0, z), (x, 0.3, z), 0.8, kerb)], name="kerb")]
    tree = broad_tree(x, z, rng, rng.uniform(4.6, 5.6), bark_material(rng), leaf_material(rng), blobs=16)
    for group in tree[1:]:  # a gusty day
        assert isinstance(group.motion, Chain)
        group.motion = group.motion.outer @ Swing((1, 0, 0.4), 4.0, rng.uniform(1.5, 2.0), rng.random())
    groups += tree
    for a, b in ((-6.2, -6.2), (6.2, 6.2), (-6.2, 6.0), (6.3, -1.0)):
        groups += potted_plant(a, b, rng, rng.uniform(1.0, 1.6))
    groups += bench(Place(-5.9, 0, -0.5, yaw=90)) + bench(Place(0.5, 0, -6.2, yaw=0))
    return groups


def _people(rng) -> list[Group]:
    groups = []
    ring = [(2.9 * np.cos(a), -2.6 + 2.4 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 9)[:-1]]
    groups += walker(Path(ring, rng.uniform(1.0, 1.6), rng.random()), rng)
    far = HALF + 1.1
    lane = [(far, far), (0, far), (-far, far), (-far, 0), (-far, -far), (0, -far), (far, -far), (far, 0)]
    for k in range(2):
        groups += walker(Path(lane, rng.uniform(1.0, 1.7), 0.5 * k + 0.3 * rng.random()), rng)
    rubber = Material(vary(rng, (0.6, 0.1, 0.1), 0.4), (0.65, 0.6, 0.5), "stripes", scale=0.11, roughness=0.3)
    sway = Place(-4.6, 2.9, -4.6) @ Swing("z", 25, 2.1, rng.random())
    groups.append(Group([Capsule((0, 0, 0), (0, -1.9, 0), 0.015, IRON), Sphere((0, -2.1, 0), 0.24, rubber)], sway))
    return groups
