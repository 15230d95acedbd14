"""Room: a furnished living room."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *

HALF_X, HALF_Z, HEIGHT = 3.7, 3.3, 2.75


def build(seed: int, rng: np.random.Generator) -> Scene:
    fabric = Material(
        vary(
            rng,
            pick(
                rng,
                (0.16, 0.24, 0.34),
                (0.4, 0.13, 0.1),
                (0.2, 0.3, 0.2),
                (0.45, 0.36, 0.24),
                (0.35, 0.2, 0.32),
            ),
        ),
        (0.3, 0.3, 0.28),
        "plain",
        scale=0.06,
        contrast=0.35,
        roughness=1.0,
        seed=seed,
    )
    wood_color = vary(rng, pick(rng, (0.36, 0.19, 0.08), (0.5, 0.33, 0.17), (0.17, 0.09, 0.05), (0.42, 0.36, 0.28)))
    wood = Material(
        wood_color, tint(wood_color, 0.6), "planks", scale=0.14, contrast=0.5, roughness=0.35, seed=seed + 1
    )
    groups = _shell(rng, seed)
    groups += sofa(Place(0.0, 0, -HALF_Z + 0.52), fabric, rng, 2.1)
    groups += sofa(
        Place(-HALF_X + 0.55, 0, 0.9 + rng.uniform(-0.3, 0.3), yaw=90 + rng.uniform(-15, 15)),
        fabric,
        rng,
        0.75,
    )
    groups += coffee_table(rng, wood)
    groups += bookcase(rng, wood, -HALF_X)
    groups += sideboard(rng, wood, HALF_Z)
    groups += glass_screen(rng)
    groups += _toys(rng)
    groups += potted_plant(HALF_X - 0.5, HALF_Z - 0.55, rng, 1.5)
    groups += potted_plant(-HALF_X + 0.45, -HALF_Z + 0.5, rng, 1.3)

    warm = np.array(vary(rng, (1.0, 0.74, 0.46), 0.1))
    lights, lamps = _lights(rng, warm)
    groups += lamps
    night = rng.random() < 0.25
    sun = (1.0, rng.uniform(0.5, 0.9), rng.uniform(-0.6, 0.6))
    day = 0.05 if night else rng.uniform(0.8, 1.15)
    lights.append(Light("sun", sun, tint((1.0, 0.85, 0.66), 0.06 if night else rng.uniform(3.0, 5.0)), size=0.012))
    if not night:  # sunlight off the floor
        lights.append(Light("fill", (1.6, 0.15, 0.0), tint((1.0, 0.78, 0.55), rng.uniform(1.0, 1.6)), size=1.4))
    else:
        lights = [_stronger(light, 1.8) for light in lights]
    air = Air(
        zenith=tint((0.18, 0.36, 0.72), day),
        horizon=tint((0.75, 0.83, 0.95), day),
        clouds=rng.uniform(0.2, 0.7),
        ambient_up=(0.17, 0.17, 0.175),
        ambient_down=(0.19, 0.16, 0.13),
        haze_color=(0.4, 0.4, 0.4),
    )
    turn, period, start = pick(rng, -1, 1), rng.uniform(26, 36), rng.uniform(0, 1)
    radius, height, nod = rng.uniform(1.75, 1.95), rng.uniform(1.45, 1.65), rng.uniform(5, 8)

    def eye(time):
        a = 2 * np.pi * (turn * time / period + start)
        r = radius + 0.06 * np.sin(2 * np.pi * time / nod)
        return np.array((1.15 * r * np.cos(a), height + 0.12 * np.sin(2 * np.pi * time / nod), r * np.sin(a)))

    def target(time):
        a = 2 * np.pi * (turn * time / period + start)
        return np.array(
            (-0.7 * np.cos(a + 0.25), 0.98 + 0.12 * np.sin(2 * np.pi * time / 4.3), -0.7 * np.sin(a + 0.25))
        )

    return Scene("room", seed, groups, lights, air, eye, target, focal=0.72)


def _stronger(light: Light, factor: float) -> Light:
    light.color = tint(light.color, factor)
    return light


def _shell(rng, seed) -> list[Group]:
    """Return floor, walls, window, door, skirting, carpet, pictures and the mirror."""
    wall_color = vary(
        rng,
        pick(
            rng,
            (0.58, 0.54, 0.46),
            (0.42, 0.5, 0.48),
            (0.55, 0.42, 0.36),
            (0.5, 0.52, 0.58),
            (0.36, 0.42, 0.34),
        ),
    )
    paper = Material(
        wall_color,
        tint(wall_color, 0.72),
        pick(rng, "wallpaper", "wallpaper", "plain", "stripes"),
        scale=0.34,
        contrast=0.1,
        roughness=0.9,
        seed=seed,
    )
    plain = Material(wall_color, scale=0.7, contrast=0.1, roughness=0.9)
    oak = vary(rng, pick(rng, (0.4, 0.24, 0.12), (0.5, 0.36, 0.22), (0.24, 0.13, 0.07)))
    floor = Material(
        oak,
        tint(oak, 0.55),
        "planks",
        scale=0.13,
        contrast=0.5,
        roughness=0.1,
        mirror=0.8,
        specular=0.04,
        seed=seed,
    )
    white = Material((0.68, 0.66, 0.62), roughness=0.5, contrast=0.05)
    ceiling = Material((0.72, 0.71, 0.68), roughness=1.0, contrast=0.06, scale=1.0)
    x, z, h = HALF_X, HALF_Z, HEIGHT
    groups = [
        Group([Box((0, -0.1, 0), (2 * x + 0.6, 0.2, 2 * z + 0.6), floor)], name="floor"),
        Group([Box((0, h + 0.1, 0), (2 * x + 0.6, 0.2, 2 * z + 0.6), ceiling)], name="ceiling"),
        Group([Box((0, h / 2, -z - 0.1), (2 * x + 0.4, h, 0.2), paper)], name="wall"),
        Group([Box((0, h / 2, z + 0.1), (2 * x + 0.4, h, 0.2), paper)], name="wall"),
        Group([Box((-x - 0.1, h / 2, 0), (0.2, h, 2 * z), plain)], name="wall"),
    ]
    # The window wall on the right: piers, sill, head, frame and curtains.
    sill, head, half = 0.75, 2.35, rng.uniform(1.2, 1.6)
    groups += [
        Group([Box((x + 0.1, sill / 2, 0), (0.2, sill, 2 * z), plain)], name="wall"),
        Group([Box((x + 0.1, (head + h) / 2, 0), (0.2, h - head, 2 * z), plain)], name="wall"),
    ]
    y = (sill + head) / 2
    for s in (-1, 1):
        width = z - half
        groups.append(
            Group([Box((x + 0.1, y, s * (half + width / 2)), (0.198, head - sill, width), plain)], name="pier")
        )
    frame = [Box((x + 0.06, sill + 0.02, 0), (0.36, 0.05, 2 * half + 0.1), white)]
    frame += [Box((x + 0.1, y, half * k), (0.08, head - sill, 0.07), white) for k in (-1, -0.34, 0.34, 1)]
    frame += [Box((x + 0.1, sill + 0.66 * (head - sill), 0), (0.06, 0.05, 2 * half), white)]
    groups.append(Group(frame, name="window frame"))
    groups.append(
        Group([Box((x + 0.13, y, 0), (0.008, head - sill, 2 * half), GLASS)], casts_shadow=False, name="pane")
    )
    drape = Material(
        vary(rng, (0.5, 0.4, 0.28), 0.5),
        vary(rng, (0.3, 0.2, 0.16), 0.4),
        "stripes",
        scale=0.2,
        roughness=1.0,
    )
    for s in (-1, 1):
        folds = [
            Capsule((x - 0.12, 0.1, s * (half + 0.08 * k)), (x - 0.12, 2.5, s * (half + 0.07 * k)), 0.055, drape)
            for k in range(6)
        ]
        sway = Place(0, 2.5, 0) @ Swing("z", 0.7, rng.uniform(3, 5), rng.random()) @ Place(0, -2.5, 0)
        groups.append(Group(folds, sway, name="curtain"))
    groups.append(
        Group([Capsule((x - 0.12, 2.53, -half - 0.6), (x - 0.12, 2.53, half + 0.6), 0.02, BRASS)], name="rod")
    )

    skirting = [Box((0, 0.06, s * (z - 0.01)), (2 * x, 0.12, 0.03), white) for s in (-1, 1)]
    skirting += [Box((s * (x - 0.01), 0.06, 0), (0.03, 0.12, 2 * z - 0.1), white) for s in (-1, 1)]
    groups += [Group([board], name="skirting") for board in skirting]
    paint = Material(
        vary(rng, pick(rng, (0.5, 0.48, 0.42), (0.14, 0.24, 0.26), (0.38, 0.2, 0.1))),
        (0.2, 0.15, 0.1),
        "planks",
        scale=0.25,
        roughness=0.4,
    )
    door = [
        Box((1.9, 1.05, z), (1.1, 2.1, 0.1), white),
        Box((1.9, 1.02, z - 0.02), (0.92, 2.02, 0.1), paint),
        Sphere((1.52, 1.0, z - 0.12), 0.035, BRASS),
    ]
    groups.append(Group(door, name="door"))
    rug = Material(
        vary(rng, pick(rng, (0.36, 0.08, 0.06), (0.08, 0.14, 0.3), (0.42, 0.32, 0.18), (0.1, 0.25, 0.2))),
        vary(rng, (0.5, 0.4, 0.25), 0.3),
        "carpet",
        scale=0.32,
        contrast=0.25,
        roughness=1.0,
    )
    groups.append(Group([Box((0, 0.006, -0.2), (3.2, 0.014, 2.3), rug)], name="carpet"))
    for px, width in ((-1.5, 0.9), (1.3, 1.2)):
        art = Material(
            vary(rng, (0.6, 0.5, 0.35), 0.6),
            vary(rng, (0.2, 0.28, 0.42), 0.7),
            "picture",
            scale=0.3,
            contrast=0.3,
            roughness=0.4,
            seed=int(rng.integers(1 << 16)),
        )
        groups.append(Group([Box((px, 1.72, -z + 0.02), (width, rng.uniform(0.6, 0.85), 0.05), art)], name="picture"))
    gilt = pick(rng, BRASS, wood_frame(rng))
    mirror = [
        Box((-0.6, 1.55, z), (1.5, 1.25, 0.07), gilt),
        Box((-0.6, 1.55, z - 0.02), (1.34, 1.09, 0.07), MIRROR),
    ]
    groups.append(Group(mirror, name="mirror"))
    lawn = Material((0.17, 0.26, 0.08), (0.08, 0.13, 0.04), "grass", scale=0.5, roughness=1.0)
    groups.append(Group([Box((x + 40, -1.0, 0), (78, 0.2, 120), lawn)], name="garden"))
    bark = bark_material(rng)
    for _ in range(3):
        at = rng.uniform(7, 12), rng.uniform(-6, 6)
        groups += broad_tree(
            x + at[0], at[1], rng, rng.uniform(4, 6), bark, leaf_material(rng, 0.5 * rng.random()), blobs=8
        )
    return groups


def _toys(rng) -> list[Group]:
    """Return a train on a loop, a rolling ball, a bouncing ball, a mobile, a ceiling fan."""
    groups = []
    loop = [(-1.25, -1.05), (0, -1.2), (1.25, -1.05), (1.35, 0.4), (0, 0.65), (-1.35, 0.4)]
    loop = loop if rng.random() < 0.5 else loop[::-1]
    speed, start = rng.uniform(0.5, 0.9), rng.random()
    length = Path(loop, speed).length
    for k in range(4):
        paint = Material(
            vary(
                rng,
                pick(rng, (0.6, 0.08, 0.06), (0.08, 0.25, 0.55), (0.65, 0.45, 0.05), (0.1, 0.4, 0.15)),
                0.2,
            ),
            roughness=0.25,
            contrast=0.05,
        )
        prims = [Box((0, 0.1, 0), (0.15, 0.09, 0.22), paint), Box((0, 0.055, 0), (0.12, 0.02, 0.25), IRON)]
        prims += [
            Cylinder((sx * 0.085, 0.045, sz), (sx * 0.06, 0.045, sz), 0.035, IRON)
            for sx in (-1, 1)
            for sz in (-0.07, 0.07)
        ]
        if k == 0:
            prims += [
                Cylinder((0, 0.16, -0.02), (0, 0.16, 0.13), 0.055, paint),
                Cone((0, 0.2, 0.08), (0, 0.27, 0.08), 0.02, 0.035, IRON),
                Box((0, 0.2, -0.07), (0.14, 0.12, 0.08), paint),
            ]
        else:
            prims.append(Sphere((0, 0.17, 0), 0.055, BRASS))
        groups.append(Group(prims, Place(0, 0.012, 0) @ Path(loop, speed, start - 0.29 * k / length), name="train"))
    rubber = Material(vary(rng, (0.6, 0.15, 0.1), 0.5), (0.62, 0.6, 0.52), "stripes", scale=0.1, roughness=0.3)
    track = Path(
        [(-1.9, 1.6), (0.4, 1.35), (2.0, 1.7), (2.3, 0.2), (1.9, -1.3), (1.75, 0.5), (0.2, 1.75)],
        rng.uniform(0.6, 1.1),
        rng.random(),
    )
    groups.append(Group([Sphere((0, 0, 0), 0.15, rubber)], Place(0, 0.15, 0) @ track @ Roll(track, 0.15), name="ball"))
    hop = Place(-1.9, 0.11, -0.9) @ Bounce(rng.uniform(0.5, 0.9), rng.uniform(0.7, 0.9)) @ Spin((1, 0.3, 0.5), 130)
    dots = Material((0.65, 0.5, 0.06), (0.1, 0.3, 0.5), "checker", scale=0.055, roughness=0.3)
    groups.append(Group([Sphere((0, 0, 0), 0.11, dots)], hop, name="ball"))

    blade = Material(vary(rng, (0.4, 0.25, 0.13), 0.3), roughness=0.4)
    fan = Place(0, HEIGHT, 0) @ Spin("y", rng.uniform(90, 240))
    groups.append(
        Group(
            [
                Cylinder((0, -0.34, 0), (0, 0, 0), 0.02, BRASS),
                Cylinder((0, -0.4, 0), (0, -0.3, 0), 0.09, BRASS),
            ],
            fan,
            name="hub",
        )
    )
    blades = int(rng.integers(3, 6))
    for k in range(blades):
        turned = fan @ Place(0, -0.35, 0, yaw=360 * k / blades, roll=10)
        groups.append(Group([Box((0, 0, 0.42), (0.15, 0.012, 0.62), blade)], turned, name="fan blade"))
    mobile = Place(-1.7, HEIGHT - 0.1, 1.9) @ Spin("y", rng.uniform(20, 60))
    parts = [
        Capsule((-0.3, -0.35, 0), (0.3, -0.35, 0), 0.006, IRON),
        Capsule((0, 0, 0), (0, -0.35, 0), 0.004, IRON),
    ]
    for s, drop in ((-1, 0.62), (1, 0.75)):
        bead = Material(vary(rng, pick(rng, (0.6, 0.12, 0.1), (0.1, 0.4, 0.5), (0.6, 0.45, 0.08)), 0.3), roughness=0.2)
        parts += [
            Capsule((0.3 * s, -0.35, 0), (0.3 * s, -drop, 0), 0.003, IRON),
            Ellipsoid((0.3 * s, -drop, 0), (0.09, 0.06, 0.03), bead),
        ]
    groups.append(Group(parts, mobile, name="mobile"))
    return groups


def _lights(rng, warm) -> tuple[list[Light], list[Group]]:
    """Return a floor lamp and a pendant that swings over the table."""
    x, z = -HALF_X + 0.5, 2.55
    shade = Material(tint(warm, 0.5), emission=tint(warm, 0.75), roughness=1.0)
    bulb = Material(tint(warm, 0.5), emission=tint(warm, 5))
    groups = [
        Group(
            [Cylinder((x, 0, z), (x, 0.03, z), 0.17, IRON), Cylinder((x, 0, z), (x, 1.6, z), 0.015, IRON)],
            name="floor lamp",
        ),
        Group([Cone((x, 1.45, z), (x, 1.8, z), 0.24, 0.16, shade)], casts_shadow=False, name="lamp shade"),
    ]
    lights = [Light("lamp", (x, 1.62, z), tint(warm, rng.uniform(1.4, 2.2)), size=0.14)]
    swing = Place(1.0, HEIGHT, -1.3) @ Swing(
        pick(rng, "x", "z"), rng.uniform(8, 20), rng.uniform(2.2, 3.2), rng.random()
    )
    cone = Material(vary(rng, (0.14, 0.2, 0.18), 0.6), roughness=0.25)
    groups += [
        Group([Capsule((0, 0, 0), (0, -0.5, 0), 0.006, IRON)], swing, casts_shadow=False, name="cord"),
        Group([Cone((0, -0.68, 0), (0, -0.48, 0), 0.2, 0.04, cone)], swing, casts_shadow=False, name="pendant"),
        Group([Sphere((0, -0.68, 0), 0.055, bulb)], swing, casts_shadow=False, name="bulb"),
    ]
    color = tint(vary(rng, (1.0, 0.8, 0.56)), rng.uniform(1.8, 2.8))
    lights.append(Light("spot", (0, -0.7, 0), color, 0.07, (0, -1, 0), 80, motion=swing))
    return lights, groups
