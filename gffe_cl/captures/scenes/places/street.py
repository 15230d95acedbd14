"""Street: a wet night street with headlights, lanterns in the wind and neon."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *

KERB, FACADE, FAR, NEAR = 4.4, 7.4, -36.0, 12.0
_NEON = ((1.0, 0.12, 0.3), (0.1, 0.8, 1.0), (1.0, 0.45, 0.06), (0.3, 1.0, 0.25), (0.65, 0.2, 1.0))


def build(seed: int, rng: np.random.Generator) -> Scene:
    groups = _ground(rng, seed)
    groups += _houses(rng)
    groups += _kerbside(rng)
    groups += _people(rng)
    lights, lamps = _lanterns(rng)
    groups += lamps
    groups += _neon(rng, lights)
    tow = Place(3.45, 0, rng.uniform(-12.5, -10.0), yaw=180)
    groups += car(tow, rng)
    color, rate = pick(rng, (1.0, 0.4, 0.05), (0.12, 0.3, 1.0)), rng.uniform(230, 320) * pick(rng, -1, 1)
    beams, lamp = beacon(tow @ Place(0, 1.29, -0.3), color, rng.uniform(90, 120), rate, angle=26.0, dip=2.0)
    lights, groups = lights + beams, groups + lamp

    way = [
        (-1.7, 8), (-1.7, 13), (-4.5, 19), (0, 23), (4.5, 19), (1.7, 13), (1.7, 8), (1.7, -12), (1.7, FAR + 3),
        (4.5, FAR - 4), (0, FAR - 8), (-4.5, FAR - 4), (-1.7, FAR + 3), (-1.7, -12),
    ]  # fmt: skip
    speed, start, strength = rng.uniform(12, 15), rng.random(), rng.uniform(80, 110)
    for k in range(3):
        drive = Path(way, speed, start + k / 3 + rng.uniform(-0.04, 0.04))
        groups += car(drive, rng)
        lights.append(headlight(drive, strength))

    air = Air(
        zenith=(0.006, 0.009, 0.02),
        horizon=(0.025, 0.024, 0.035),
        clouds=rng.uniform(0.2, 0.6),
        ambient_up=tint((0.035, 0.042, 0.07), rng.uniform(0.8, 1.2)),
        ambient_down=tint((0.03, 0.025, 0.022), rng.uniform(0.8, 1.2)),
        haze_color=(0.03, 0.03, 0.04),
        haze=rng.uniform(0.002, 0.006),
    )
    period, start, lag = rng.uniform(26, 34), rng.random(), rng.random()
    side, height, look = rng.uniform(-5.75, -5.5), rng.uniform(1.55, 1.7), rng.uniform(0.2, 0.32)

    def eye(time):
        u = 2 * np.pi * (time / period + start)
        step = 2 * np.pi * time / 0.55
        x, y = side + 0.1 * np.sin(2 * u) + 0.02 * np.sin(step / 2), height + 0.02 * np.sin(step)
        return np.array((x, y, 0.5 + 5.0 * np.cos(u)))

    def target(time):
        angle = 0.42 + look * np.sin(2 * np.pi * (time / 7.3 + lag))
        return eye(time) + np.array((np.sin(angle), -0.07, -np.cos(angle)))

    return Scene("street", seed, groups, lights, air, eye, target, focal=0.8)


def _ground(rng, seed) -> list[Group]:
    """Return wet asphalt with puddles, pavements of slabs."""
    asphalt = Material(
        (0.045, 0.046, 0.05), contrast=0.5, scale=0.5, roughness=0.06, specular=0.05, mirror=0.9, seed=seed
    )
    slabs = Material(
        vary(rng, (0.17, 0.165, 0.16)),
        (0.06, 0.06, 0.06),
        pick(rng, "tiles", "cobbles"),
        scale=0.5,
        contrast=0.3,
        roughness=0.14,
        specular=0.03,
        mirror=0.8,
        seed=seed + 1,
    )
    paint = Material((0.4, 0.4, 0.38), contrast=0.5, scale=0.2, roughness=0.1, specular=0.04, mirror=0.7)
    water = Material((0.01, 0.011, 0.013), contrast=0.0, roughness=0.0, specular=0.07, mirror=1.0)
    length, middle = NEAR - FAR, (NEAR + FAR) / 2
    groups = [Group([Box((0, -0.1, -8), (90, 0.2, 110), asphalt)], name="road")]
    for s in (-1, 1):
        x = s * (KERB + (FACADE - KERB) / 2)
        groups.append(Group([Box((x, 0.06, middle), (FACADE - KERB, 0.12, length), slabs)], name="pavement"))
    marks = [Box((0, 0.001, z), (0.12, 0.006, 1.6), paint) for z in np.arange(FAR + 2, NEAR, 4.0)]
    marks += [Box((x, 0.001, -13.0), (0.45, 0.006, 2.6), paint) for x in np.arange(-3.8, 4.0, 0.95)]
    groups.append(Group(marks, name="marks"))
    puddles = []
    for z in np.arange(FAR, 8, 3.0):
        x, r = rng.uniform(-3.6, 3.6), rng.uniform(0.5, 1.3)
        puddles.append(Ellipsoid((x, 0.0, z), (r, 0.006, r * rng.uniform(0.5, 1.2)), water))
    groups.append(Group(puddles, name="puddles"))
    return groups


def _house(at: Place, rng, width, height) -> list[Group]:
    """Return a house with its front in the plane z = 0; some windows lit, a shop below."""
    wall = Material(
        vary(rng, pick(rng, (0.5, 0.46, 0.4), (0.42, 0.24, 0.17), (0.4, 0.42, 0.44), (0.52, 0.42, 0.28))),
        (0.3, 0.28, 0.26),
        pick(rng, "plain", "plain", "bricks"),
        scale=0.13,
        contrast=0.2,
        roughness=0.9,
        seed=int(rng.integers(999)),
    )
    trim = Material(vary(rng, (0.5, 0.48, 0.44)), roughness=0.7, contrast=0.1)
    dark = Material((0.02, 0.022, 0.03), roughness=0.02, specular=0.06, mirror=1.0, contrast=0.0)
    glow = vary(rng, pick(rng, (1.0, 0.66, 0.32), (1.0, 0.8, 0.5), (0.6, 0.75, 1.0)))
    body = [
        Box((0, height / 2, -3), (width, height, 6), wall),
        Box((0, height + 0.1, -2.85), (width + 0.1, 0.25, 6.2), trim),
        Box((0, 3.05, 0.02), (width, 0.14, 0.2), trim),
    ]
    groups = [Group(body, at, name="house")]
    columns = max(int(width / 2.4), 2)
    for i in range(columns):
        x, prims = (i + 0.5 - columns / 2) * width / columns, []
        for j in range(max(int(height / 3.1), 1)):
            lit = rng.random() < (0.5 if j == 0 else 0.22)
            room = Material(
                tint(glow, 0.5),
                tint(glow, 0.12),
                "books" if j == 0 else "stripes",
                scale=0.45,
                emission=tint(glow, rng.uniform(0.25, 0.7)),
                contrast=0.3,
                seed=int(rng.integers(999)),
            )
            w, h, y = (1.8, 2.0, 1.6) if j == 0 else (1.0, 1.6, 1.75 + 3.1 * j)
            prims += [
                Box((x, y, 0), (w + 0.2, h + 0.2, 0.1), trim),
                Box((x, y, 0.015), (w, h, 0.1), room if lit else dark),
            ]
            prims.append(Box((x, y, 0.03), (0.05, h, 0.1), trim))
        groups.append(Group(prims, at, casts_shadow=False, name="windows"))
    return groups


def _houses(rng) -> list[Group]:
    groups = []
    for s in (-1, 1):
        z = NEAR
        while z > FAR + 4:
            width = min(rng.uniform(6.0, 9.0), z - FAR)
            at = Place(s * FACADE, 0, z - width / 2, yaw=-90 * s)
            groups += _house(at, rng, width, pick(rng, 6.4, 9.5, 9.7, 12.6))
            z -= width + 0.02
    for x0, z0, yaw in ((-18, FAR - 14, 0), (0, FAR - 14.3, 0), (18, FAR - 14, 0), (0, 30, 180)):
        groups += _house(Place(x0, 0, z0, yaw=yaw), rng, 18.0, rng.uniform(8, 13))
    return groups


def _kerbside(rng) -> list[Group]:
    """Return railing, poles, bollards, a bench."""
    groups = []
    steel = Material((0.12, 0.12, 0.13), specular=0.2, roughness=0.3, contrast=0.1)
    for x, near, far in ((-KERB - 0.25, 9.0, -8.0), (KERB + 0.25, 2.0, -9.0)):
        groups += railing((x, near), (x, far), 1.05, rng.uniform(0.24, 0.34), steel, Place(0, 0.12, 0), radius=0.022)
    for s in (-1, 1):
        for z in np.arange(NEAR - 2 if s > 0 else -8.0, FAR, -5.5):
            x, z = s * (KERB + 0.45), z + rng.uniform(-0.6, 0.6)
            pole = [Cone((x, 0, z), (x, 1.0, z), 0.09, 0.06, IRON), Cylinder((x, 0.9, z), (x, 4.6, z), 0.045, IRON)]
            if rng.random() < 0.5:
                plate = Material((0.5, 0.5, 0.48), vary(rng, (0.4, 0.05, 0.05), 0.6), "sign", scale=0.2)
                pole.append(Box((x, 2.9, z), (0.7, 0.7, 0.04), plate))
            groups.append(Group(pole, name="pole"))
    for z in np.arange(-15, FAR, -2.2):
        groups.append(Group([Capsule((-KERB - 0.3, 0.1, z), (-KERB - 0.3, 0.9, z), 0.09, steel)], name="bollard"))
    groups += bench(Place(FACADE - 0.6, 0.12, -4.0, yaw=-90))
    return groups


def _people(rng) -> list[Group]:
    """Return passers-by on the other pavement, ahead on this one, and far away across the street."""
    groups = []
    for k in range(3):
        near, far = rng.uniform(2, 5) - 7 * k, rng.uniform(-9, -6) - 7 * k
        lane = [(5.0, near), (5.0, (near + far) / 2), (5.0, far), (6.2, far), (6.2, (near + far) / 2), (6.2, near)]
        groups += walker(Path([(x, 0.12, z) for x, z in lane], rng.uniform(0.9, 1.5), rng.random()), rng)
    lane = [(-5.2, -9.5), (-5.2, -15), (-5.2, -22), (-6.3, -22), (-6.3, -15), (-6.3, -9.5)]
    for k in range(2):
        groups += walker(
            Path([(x, 0.12, z) for x, z in lane], rng.uniform(0.9, 1.4), 0.5 * k + 0.3 * rng.random()), rng
        )
    return groups


def _lanterns(rng) -> tuple[list[Light], list[Group]]:
    """Return lanterns on wires across the street, swinging in the wind."""
    lights, groups = [], []
    color = np.array(vary(rng, pick(rng, (1.0, 0.6, 0.25), (1.0, 0.75, 0.45)), 0.1))
    shade = Material((0.04, 0.05, 0.05), roughness=0.4)
    for z in (-5.0 + rng.uniform(-1, 1), -19.0 + rng.uniform(-2, 2)):
        swing = Swing(pick(rng, "z", (0.5, 0, 1)), rng.uniform(22, 32), rng.uniform(1.9, 2.5), rng.random())
        some, parts = swinging_lamp(Place(0, 6.4, z), 1.0, color, rng.uniform(18, 24), swing, shade, angle=76)
        lights, groups = lights + some, groups + parts
        wire = [
            Capsule((-FACADE, 7.0, z), (0, 6.4, z), 0.012, IRON),
            Capsule((0, 6.4, z), (FACADE, 7.0, z), 0.012, IRON),
        ]
        groups.append(Group(wire, casts_shadow=False, name="wire"))
    return lights, groups


def _neon(rng, lights) -> list[Group]:
    """Return neon signs, two of which turn; each adds a fill of its color to `lights`."""
    groups = []
    order = rng.permutation(len(_NEON))
    for k, (s, z) in enumerate(((1, -1.0), (1, -10.0), (-1, -11.5), (1, -19.0), (-1, -24.0))):
        color, z = _NEON[order[k]], z + rng.uniform(-1, 1)
        x, y = s * (FACADE - 0.75), rng.uniform(3.5, 4.2)
        letters = Material(
            tint(color, 0.02),
            tint(color, 0.6),
            "sign",
            scale=0.3,
            emission=(0.0, 0.0, 0.0),
            contrast=0.0,
            seed=int(rng.integers(999)),
        )
        tube = Material(tint(color, 0.4), emission=tint(color, rng.uniform(2.5, 4.0)), contrast=0.0)
        arm = Box((s * (FACADE - 0.35), y, z), (0.8, 0.05, 0.05), IRON)
        groups.append(Group([arm], name="arm"))
        at = Place(x, y, z)
        if k in (0, 2):
            at = at @ Spin("y", rng.uniform(60, 110) * pick(rng, -1, 1))
        board = [Box((0, 0, 0), (0.95, 1.3, 0.1), letters)]
        board += [Capsule((-0.5, d, 0), (0.5, d, 0), 0.035, tube) for d in (-0.68, 0.68)]
        board += [Capsule((d, -0.68, 0), (d, 0.68, 0), 0.035, tube) for d in (-0.5, 0.5)]
        board += [
            Capsule((-0.3, d, 0.06 * f), (0.3, d + 0.1, 0.06 * f), 0.025, tube)
            for d in (-0.3, 0.05, 0.3)
            for f in (-1, 1)
        ]
        groups.append(Group(board, at, casts_shadow=False, name="neon sign"))
        lights.append(Light("fill", (x, y - 0.5, z), tint(color, rng.uniform(0.5, 0.9)), size=0.9))
    ball = Place(-FACADE + 0.9, 3.4, -5.5)
    groups.append(Group([Sphere((0, 0, 0), 0.22, bulb_material((1.0, 0.9, 0.75), 2.0))], ball, casts_shadow=False))
    return groups
