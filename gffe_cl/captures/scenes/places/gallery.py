"""Gallery: a hall of polished floors, mirrors and turning metal, lit by lamps that move."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *

HALF_WIDTH, HEIGHT, FAR, NEAR = 4.6, 4.2, -13.0, 8.0


def build(seed: int, rng: np.random.Generator) -> Scene:
    white = Material(vary(rng, (0.74, 0.73, 0.7), 0.06), scale=0.9, contrast=0.06, roughness=0.95, seed=seed)
    groups = _shell(rng, seed, white)
    groups += _art(rng, white)
    groups += _sculptures(rng)
    groups += _people(rng)
    lights, lamps = _lights(rng)
    groups += lamps
    dusk = rng.uniform(0.8, 1.15)
    air = Air(
        ambient_up=tint((0.045, 0.047, 0.055), dusk),
        ambient_down=tint((0.045, 0.04, 0.035), dusk),
        haze_color=(0.3, 0.3, 0.3),
    )
    period, start, sway = rng.uniform(24, 30), rng.random(), rng.uniform(0.35, 0.6)
    height, look, look_period, lag = rng.uniform(1.5, 1.65), rng.uniform(0.45, 0.7), rng.uniform(9, 13), rng.random()

    def eye(time):
        u = 2 * np.pi * (time / period + start)
        return np.array((sway * np.sin(2 * u), height + 0.05 * np.sin(3 * u), 2.2 + 4.2 * np.cos(u)))

    def target(time):
        angle = look * np.sin(2 * np.pi * (time / look_period + lag))
        return eye(time) + np.array((np.sin(angle), -0.09, -np.cos(angle)))

    return Scene("gallery", seed, groups, lights, air, eye, target, focal=0.8)


def _shell(rng, seed, white) -> list[Group]:
    """Return floor with a lacquered runner, walls, partitions, ceiling with beams."""
    stone = Material(
        *pick(
            rng,
            ((0.16, 0.15, 0.15), (0.5, 0.47, 0.42)),
            ((0.42, 0.38, 0.33), (0.14, 0.12, 0.11)),
            ((0.1, 0.13, 0.13), (0.36, 0.38, 0.36)),
            ((0.36, 0.3, 0.24), (0.2, 0.12, 0.09)),
        ),
        texture=pick(rng, "marble", "checker", "tiles"),
        scale=pick(rng, 0.8, 1.1),
        contrast=0.4,
        roughness=0.05,
        specular=0.12,
        mirror=1.0,
        seed=seed,
    )
    lacquer = Material(
        vary(rng, pick(rng, (0.16, 0.02, 0.015), (0.02, 0.02, 0.025), (0.02, 0.05, 0.08), (0.16, 0.08, 0.03))),
        contrast=0.1,
        roughness=0.16,
        specular=0.1,
        mirror=1.0,
    )
    trim = Material((0.1, 0.1, 0.11), roughness=0.4, contrast=0.1)
    ceiling = Material((0.24, 0.24, 0.25), roughness=1.0, contrast=0.05, scale=1.0)
    length, middle, width = NEAR - FAR, (NEAR + FAR) / 2, 2 * HALF_WIDTH
    groups = [
        Group([Box((0, -0.1, middle), (width + 0.4, 0.2, length + 0.4), stone)], name="floor"),
        Group([Box((0, 0.003, middle), (2.1, 0.01, length - 2), lacquer)], name="runner"),
        Group([Box((0, HEIGHT + 0.1, middle), (width + 0.4, 0.2, length + 0.4), ceiling)], name="ceiling"),
        Group([Box((0, HEIGHT / 2, FAR - 0.1), (width, HEIGHT, 0.2), white)], name="wall"),
        Group([Box((0, HEIGHT / 2, NEAR + 0.1), (width, HEIGHT, 0.2), white)], name="wall"),
    ]
    for s in (-1, 1):
        groups.append(Group([Box((s * (HALF_WIDTH + 0.1), HEIGHT / 2, middle), (0.2, HEIGHT, length), white)]))
        groups.append(Group([Box((s * (HALF_WIDTH - 0.01), 0.08, middle), (0.04, 0.16, length), trim)]))
    for s, z in ((1, -3.9), (-1, -0.9), (-1, -8.6)):
        groups.append(Group([Box((s * (HALF_WIDTH - 0.85), 1.6, z), (1.7, 3.2, 0.16), white)], name="partition"))
    for z in np.arange(NEAR - 2, FAR, -3.0):
        groups.append(Group([Box((0, HEIGHT - 0.1, z), (width, 0.2, 0.16), trim)], name="beam"))
    return groups


def _art(rng, white) -> list[Group]:
    """Return pictures and mirrors on the walls, a slatted screen, benches."""
    groups = []
    mirrors = {(1, int(rng.integers(1, 3))), (-1, int(rng.integers(2, 4)))}
    for s in (-1, 1):
        for k, z in enumerate((5.2, 2.0, -2.9, -6.6, -10.6)):
            x, z = s * HALF_WIDTH, z + rng.uniform(-0.3, 0.3)
            if (s, k) in mirrors:
                plate = [
                    Box((x, 1.6, z), (0.1, 2.7, 1.7), BRASS),
                    Box((x - 0.02 * s, 1.6, z), (0.1, 2.56, 1.56), MIRROR),
                ]
                groups.append(Group(plate, name="mirror"))
                continue
            if rng.random() < 0.25:
                continue
            art = Material(
                vary(rng, (0.6, 0.5, 0.35), 0.6),
                vary(rng, (0.15, 0.22, 0.4), 0.7),
                "picture",
                scale=0.3,
                contrast=0.3,
                roughness=0.5,
                seed=int(rng.integers(1 << 16)),
            )
            h, w = rng.uniform(0.9, 1.5), rng.uniform(0.8, 1.7)
            frame = [Box((x, 1.75, z), (0.06, h + 0.1, w + 0.1), IRON), Box((x, 1.75, z), (0.08, h, w), art)]
            groups.append(Group(frame, name="picture"))
    end = [Box((0, 1.75, FAR), (3.4, 3.0, 0.1), BRASS), Box((0, 1.75, FAR + 0.02), (3.24, 2.84, 0.1), MIRROR)]
    groups.append(Group(end, name="mirror"))
    wood = Material(vary(rng, (0.2, 0.1, 0.05), 0.3), roughness=0.4, contrast=0.3)
    spacing = rng.uniform(0.17, 0.22)
    for x, z in ((3.2, 1.6), (-3.3, -2.9), (3.2, -5.9)):
        z = z + rng.uniform(-0.3, 0.3)
        groups += railing((x, z - 1.5), (x, z + 1.5), 2.3, spacing, wood, radius=0.022)
    groups += bench(Place(-HALF_WIDTH + 0.6, 0, 3.6, yaw=90))
    return groups


def _hoop(radius, thick, material, count=18) -> list:
    """Return a ring in the plane z = 0, of capsules."""
    corners = [(radius * np.cos(a), radius * np.sin(a), 0.0) for a in np.linspace(0, 2 * np.pi, count, endpoint=False)]
    return [Capsule(a, b, thick, material) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]


def _sculpture(kind, at: Motion, rng, metal) -> list[Group]:
    """Return turning metal on top of a plinth at the origin of `at`."""
    rate = rng.uniform(70, 130) * pick(rng, -1, 1)
    if kind == 0:  # rings in rings
        groups, center = [], at @ Place(0, 0.62, 0)
        for k, radius in enumerate((0.52, 0.38)):
            turn = center @ Spin("y", rate * (1 + 0.5 * k)) @ Place(roll=20 * k, pitch=35 * k)
            groups.append(Group(_hoop(radius, 0.028, metal), turn, name="ring"))
        groups.append(Group([Sphere((0, 0, 0), 0.15, metal)], center, name="core"))
        return groups
    turn = at @ Spin("y", rate)
    if kind == 1:  # a spiral of leaves
        prims = [Cylinder((0, 0, 0), (0, 1.15, 0), 0.025, metal)]
        for k in range(9):
            a, y = 0.75 * k, 0.12 + 0.11 * k
            reach = 0.46 * np.sin(np.pi * (0.2 + 0.7 * k / 9))
            prims.append(Cone((0, y, 0), (reach * np.cos(a), y + 0.1, reach * np.sin(a)), 0.03, 0.075, metal))
            prims.append(Sphere((reach * np.cos(a), y + 0.1, reach * np.sin(a)), 0.09, metal))
        return [Group(prims, turn, name="spiral")]
    if kind == 2:  # a star
        prims = [Sphere((0, 0.6, 0), 0.17, metal)]
        for k in range(14):
            y = 1 - 2 * (k + 0.5) / 14
            a, r = 2.4 * k, np.sqrt(1 - y * y)
            tip = (0.56 * r * np.cos(a), 0.6 + 0.56 * y, 0.56 * r * np.sin(a))
            prims.append(Cone((0, 0.6, 0), tip, 0.08, 0.012, metal))
        return [Group(prims, turn, name="star")]
    prims = [Ellipsoid((0.1, 0.3, 0), (0.2, 0.32, 0.16), metal), Ellipsoid((-0.1, 0.75, 0), (0.17, 0.3, 0.12), metal)]
    prims += [
        Capsule((0.1, 0.95, 0), (0.42, 1.2, 0), 0.05, metal),
        Capsule((-0.2, 0.8, 0), (-0.5, 0.5, 0.1), 0.045, metal),
    ]
    return [Group(prims, turn, name="torso")]


def _sculptures(rng) -> list[Group]:
    groups = []
    plinth = Material(vary(rng, pick(rng, (0.7, 0.69, 0.66), (0.06, 0.06, 0.065))), roughness=0.5, contrast=0.05)
    chrome = Material((0.86, 0.87, 0.88), specular=0.85, roughness=0.03, mirror=1.0, contrast=0.0)
    kinds = rng.permutation(4)
    for k, (x, z) in enumerate(((3.0, -1.9), (-3.0, 1.2), (-2.9, -6.0), (2.9, -8.8))):
        x, z = x + rng.uniform(-0.2, 0.2), z + rng.uniform(-0.3, 0.3)
        groups.append(Group([Box((x, 0.45, z), (0.6, 0.9, 0.6), plinth)], name="plinth"))
        groups += _sculpture(int(kinds[k]), Place(x, 0.9, z), rng, pick(rng, BRASS, STEEL, chrome, chrome))
    return groups


def _people(rng) -> list[Group]:
    """Return visitors in lanes next to the camera's lane, and one at the far end."""
    groups = []
    for side in (1.0, -1.0):
        near, far = rng.uniform(2.5, 5.0), rng.uniform(-6.5, -4.0)
        a, b = 1.5 * side, 1.95 * side
        lane = Path(
            ((a, near), (a, (near + far) / 2), (a, far), (b, far), (b, (near + far) / 2), (b, near)),
            rng.uniform(0.8, 1.4),
            rng.random(),
        )
        groups += walker(lane, rng)
    ring = [(1.5 * np.cos(a), -9.8 + 1.6 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 8)[:-1]]
    groups += walker(Path(ring, rng.uniform(0.9, 1.5), rng.random()), rng)
    return groups


def _lights(rng) -> tuple[list[Light], list[Group]]:
    """Return a lamp that travels on its rail, one that swings, a lantern and a ball of mirrors that turn."""
    warm = np.array(vary(rng, (1.0, 0.86, 0.68), 0.1))
    cool = np.array(vary(rng, (0.8, 0.9, 1.0), 0.1))
    black = Material((0.05, 0.05, 0.055), roughness=0.35)
    side, x, y = pick(rng, -1, 1), rng.uniform(-0.5, 0.5), HEIGHT - 0.3
    groups = [Group([Box((x, y + 0.05, 0.0), (0.05, 0.05, 12.0), black)], name="rail")]
    travel = Slide((0, 0, rng.uniform(4.4, 5.2)), rng.uniform(3.8, 4.6), rng.random())
    parts = [spotlight(Place(x, y - 0.2, 0.0) @ travel, warm, rng.uniform(20, 25), black, angle=84)]
    swing = Swing(pick(rng, "z", "x", (1, 0, 0.6)), rng.uniform(24, 34), rng.uniform(1.9, 2.4), rng.random())
    parts.append(swinging_lamp(Place(-3.0, HEIGHT, 1.0), 1.2, warm, rng.uniform(4, 6), swing, black, angle=50))
    x, z, rate = 0.9 * side, -7.0, rng.uniform(100, 150) * pick(rng, -1, 1)
    bars, lean = int(rng.integers(7, 10)), rng.uniform(0, 40)
    lantern = turning_lantern(Place(x, 2.6, z), cool, rng.uniform(15, 18), rate, bars, 0.5, 0.8, black, 0.05, lean)
    parts.append(lantern)
    groups.append(Group([Capsule((x, 3.0, z), (x, HEIGHT, z), 0.012, IRON)], casts_shadow=False, name="cord"))
    x, z, rate = -0.9 * side, -4.6, rng.uniform(45, 70) * pick(rng, -1, 1)
    parts.append(gazing_ball(Place(x, 3.0, z), warm, rng.uniform(50, 65), rate, angle=9.0, lift=-9.0))
    groups.append(Group([Capsule((x, 3.2, z), (x, HEIGHT, z), 0.008, IRON)], casts_shadow=False, name="cord"))
    lights = [light for some, _ in parts for light in some]
    groups += [group for _, some in parts for group in some]
    lights.append(Light("fill", (0, 0.4, -1.0), tint(warm, 0.25), size=1.8))
    return lights, groups
