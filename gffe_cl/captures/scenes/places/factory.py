"""Factory: a hall with strip curtains, glass, a conveyor, fans before the sun, a crane and a beacon."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *

HALF_WIDTH, HEIGHT, FAR, NEAR = 9.0, 7.5, -22.0, 8.0
FAN_Y, FAN_RADIUS = 4.6, 1.25


def build(seed: int, rng: np.random.Generator) -> Scene:
    yellow = Material(vary(rng, (0.6, 0.42, 0.05), 0.1), roughness=0.4, contrast=0.15, scale=0.4)
    paint = Material(
        vary(rng, pick(rng, (0.1, 0.25, 0.3), (0.14, 0.28, 0.16), (0.35, 0.12, 0.07))), roughness=0.4, contrast=0.2
    )
    fans = sorted(rng.uniform(-0.5, 0.5, 3) + np.array((-9.5, -4.0, 1.5)))
    groups = _hall(rng, seed, fans)
    groups += _conveyor(rng, paint)
    groups += _curtain(rng)
    groups += _office(rng)
    groups += _gratings_and_pipes(rng, yellow)
    groups += _people(rng)
    sun = np.array((-1.0, rng.uniform(0.62, 0.8), rng.uniform(-0.25, 0.25)))
    lights = [Light("sun", tuple(sun), tint(vary(rng, (1.0, 0.86, 0.66), 0.1), rng.uniform(7.0, 9.0)), size=0.004)]
    for z in fans:
        groups += _fan(Place(-HALF_WIDTH - 0.1, FAN_Y, z), rng)
    crane, lamps = _crane(rng, yellow)
    lights, groups = lights + crane, groups + lamps
    z, rate = -6.3 + rng.uniform(-0.4, 0.4), rng.uniform(220, 330) * pick(rng, -1, 1)
    post = Material((0.3, 0.3, 0.3), roughness=0.5)
    groups.append(Group([Cylinder((4.4, 0, z), (4.4, 2.3, z), 0.05, post)], casts_shadow=False, name="post"))
    color = pick(rng, (1.0, 0.4, 0.04), (1.0, 0.55, 0.08), (1.0, 0.12, 0.05))
    beams, lamp = beacon(Place(4.4, 2.3, z), color, rng.uniform(110, 140), rate, 28.0, beams=3)
    lights, groups = lights + beams, groups + lamp
    lights.append(Light("fill", (0, 0.5, -3.0), tint((1.0, 0.85, 0.66), rng.uniform(0.7, 1.1)), size=2.5))
    air = Air(
        zenith=(0.3, 0.45, 0.75),
        horizon=(0.8, 0.85, 0.9),
        clouds=0.3,
        ambient_up=tint((0.07, 0.073, 0.08), rng.uniform(0.8, 1.1)),
        ambient_down=tint((0.06, 0.055, 0.05), rng.uniform(0.8, 1.1)),
        haze_color=(0.32, 0.3, 0.28),
        haze=rng.uniform(0.002, 0.006),
    )
    period, start, lag = rng.uniform(22, 30), rng.random(), rng.random()
    height, pan = rng.uniform(1.55, 1.75), rng.uniform(0.3, 0.5)

    def eye(time):
        u = 2 * np.pi * (time / period + start)
        return np.array((0.4 + 2.0 * np.sin(u), height + 0.08 * np.sin(2 * u), 4.6 + 1.2 * np.cos(u)))

    def target(time):
        angle = -0.12 + pan * np.sin(2 * np.pi * (time / 11 + lag))
        return eye(time) + np.array((np.sin(angle), -0.04, -np.cos(angle)))

    return Scene("factory", seed, groups, lights, air, eye, target, focal=0.78)


def _hall(rng, seed, fans) -> list[Group]:
    """Return floor, walls, roof with trusses; the left wall has openings for the `fans`."""
    floor = Material(
        vary(rng, pick(rng, (0.36, 0.36, 0.35), (0.26, 0.32, 0.3), (0.38, 0.33, 0.28))),
        (0.22, 0.22, 0.22),
        "tiles",
        scale=2.4,
        contrast=0.25,
        roughness=0.12,
        specular=0.045,
        mirror=0.8,
        seed=seed,
    )
    brick = Material(
        vary(rng, pick(rng, (0.42, 0.24, 0.18), (0.42, 0.41, 0.38), (0.45, 0.38, 0.28))),
        (0.28, 0.26, 0.24),
        "bricks",
        scale=0.14,
        contrast=0.3,
        roughness=0.9,
        seed=seed,
    )
    roof = Material((0.2, 0.21, 0.22), (0.1, 0.1, 0.1), "planks", scale=0.5, roughness=0.9)
    length, middle, width = NEAR - FAR, (NEAR + FAR) / 2, 2 * HALF_WIDTH
    low, high = FAN_Y - FAN_RADIUS, FAN_Y + FAN_RADIUS
    x = -HALF_WIDTH - 0.15
    groups = [
        Group([Box((0, -0.1, middle), (width + 1, 0.2, length + 1), floor)], name="floor"),
        Group([Box((0, HEIGHT + 0.1, middle), (width + 1, 0.2, length + 1), roof)], name="roof"),
        Group([Box((0, HEIGHT / 2, FAR - 0.1), (width, HEIGHT, 0.2), brick)], name="wall"),
        Group([Box((0, HEIGHT / 2, NEAR + 0.1), (width, HEIGHT, 0.2), brick)], name="wall"),
        Group([Box((HALF_WIDTH + 0.1, HEIGHT / 2, middle), (0.2, HEIGHT, length), brick)], name="wall"),
        Group([Box((x, low / 2, middle), (0.3, low, length), brick)], name="wall"),
        Group([Box((x, (high + HEIGHT) / 2, middle), (0.3, HEIGHT - high, length), brick)], name="wall"),
    ]
    edges = [FAR, *(z + s * FAN_RADIUS for z in fans for s in (-1, 1)), NEAR]
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        groups.append(Group([Box((x, FAN_Y, (a + b) / 2), (0.298, 2 * FAN_RADIUS, b - a), brick)], name="pier"))
    for z in np.arange(NEAR - 3, FAR, -5.0):
        truss = [
            Box((0, HEIGHT - 0.12, z), (width, 0.2, 0.2), IRON),
            Box((0, HEIGHT - 1.0, z), (width, 0.14, 0.14), IRON),
        ]
        xs = np.linspace(-HALF_WIDTH, HALF_WIDTH, 9)
        for k, (p, q) in enumerate(zip(xs[:-1], xs[1:], strict=True)):
            y = (HEIGHT - 1.0, HEIGHT - 0.12)
            truss.append(Capsule((p, y[k % 2], z), (q, y[1 - k % 2], z), 0.04, IRON))
        groups.append(Group(truss, casts_shadow=False, name="truss"))
    line = Material(vary(rng, (0.6, 0.5, 0.08)), contrast=0.4, scale=0.2, roughness=0.4)
    groups.append(Group([Box((s, 0.002, -6), (0.12, 0.006, 26), line) for s in (-2.2, 3.2)], name="line"))
    return groups


def _fan(at: Motion, rng) -> list[Group]:
    """Return a ventilator in the opening of the wall: frame, hub, turning blades."""
    steel = Material((0.16, 0.17, 0.18), roughness=0.4, specular=0.1)
    turn = at @ Spin("x", rng.uniform(360, 520) * pick(rng, -1, 1))
    frame = [Box((0, 0, s * (FAN_RADIUS - 0.03)), (0.2, 2 * FAN_RADIUS, 0.1), IRON) for s in (-1, 1)]
    frame += [Box((0, s * (FAN_RADIUS - 0.03), 0), (0.2, 0.1, 2 * FAN_RADIUS), IRON) for s in (-1, 1)]
    groups = [Group(frame, at, name="fan frame")]
    groups.append(Group([Cylinder((-0.15, 0, 0), (0.15, 0, 0), 0.2, steel)], turn, name="hub"))
    blades = int(rng.integers(4, 7))
    for k in range(blades):
        blade = turn @ Spin("x", 0, 360 * k / blades) @ Place(0, 0.66, 0, yaw=28)
        groups.append(Group([Box((0, 0, 0), (0.025, 1.0, 0.34), steel)], blade, name="fan blade"))
    return groups


def _conveyor(rng, paint) -> list[Group]:
    """Return a belt from one machine to another, with boxes on it."""
    x, z0, z1 = -3.6, 1.8, -12.0
    belt = Material((0.05, 0.05, 0.05), (0.09, 0.09, 0.09), "stripes", scale=0.3, roughness=0.5)
    middle, length = (z0 + z1) / 2, z0 - z1
    frame = [Box((x, 0.76, middle), (0.9, 0.08, length), belt)]
    frame += [Box((x + s * 0.48, 0.78, middle), (0.06, 0.2, length), paint) for s in (-1, 1)]
    for z in np.linspace(z0 - 1, z1 + 1, 6):
        frame += [Box((x + s * 0.44, 0.36, z), (0.08, 0.72, 0.08), IRON) for s in (-1, 1)]
    groups = [Group(frame, name="conveyor")]
    for z in (z0 + 0.3, z1 - 0.3):
        machine = [Box((x, 0.95, z), (1.7, 1.9, 1.7), paint), Box((x, 1.95, z), (1.3, 0.12, 1.3), STEEL)]
        machine.append(Sphere((x + 0.9, 1.3, z), 0.12, Material((0.5, 0.02, 0.02), emission=(0.8, 0.03, 0.02))))
        groups.append(Group(machine, name="machine"))
    speed, count = rng.uniform(0.9, 1.5) * pick(rng, -1, 1), 9
    period = length / abs(speed)
    for k in range(count):
        card = vary(rng, pick(rng, (0.42, 0.28, 0.15), (0.5, 0.36, 0.2), (0.12, 0.25, 0.4), (0.5, 0.1, 0.06)))
        w, h, d = rng.uniform(0.35, 0.65), rng.uniform(0.3, 0.6), rng.uniform(0.4, 0.7)
        label = Material(card, tint(card, 0.35), pick(rng, "sign", "plain"), scale=0.14, contrast=0.2, seed=k)
        at = Place(x, 0.801 + h / 2, z0 if speed < 0 else z1) @ Carry(
            (0, 0, np.sign(speed) * length), period, k / count
        )
        groups.append(Group([Box((0, 0, 0), (w, h, d), label)], at, name="box"))
    return groups


def _curtain(rng) -> list[Group]:
    """Return clear plastic strips in a gateway across the hall, each swinging on its own; light passes."""
    tinted = Material(
        vary(rng, pick(rng, (0.95, 0.9, 0.7), (0.85, 0.93, 0.95), (0.95, 0.8, 0.62))),
        transparency=0.72,
        specular=0.05,
        mirror=0.05,
        roughness=0.02,
    )
    z, width, top = -4.4 + rng.uniform(-0.4, 0.4), 4.4, 3.0
    x0 = -1.6
    posts = [Box((x0 + s * width, top / 2, z), (0.16, top, 0.16), IRON) for s in (0, 1)]
    posts.append(Box((x0 + width / 2, top + 0.08, z), (width + 0.2, 0.16, 0.16), IRON))
    groups = [Group(posts, name="gate")]
    count = 11
    for k in range(count):
        x = x0 + (k + 0.5) * width / count
        sway = Swing("x", rng.uniform(4, 12), rng.uniform(1.8, 2.8), k * 0.13 + 0.1 * rng.random())
        at = Place(x, top, z + 0.03 * (k % 2)) @ sway
        strip = Box((0, -1.42, 0), (0.36, 2.8, 0.008), tinted)
        groups.append(Group([strip], at, casts_shadow=False, name="strip"))
    return groups


def _office(rng) -> list[Group]:
    """Return a glass booth on the right; someone walks in it."""
    x, z0, z1, h = 4.9, 1.0, -6.0, 2.6
    tinted = Material(vary(rng, (0.8, 0.92, 0.9), 0.08), transparency=0.82, specular=0.05, mirror=0.08, roughness=0.01)
    groups = []
    for a in np.linspace(z0, z1, 5)[:-1]:
        b = a - (z0 - z1) / 4
        groups.append(
            Group(
                [Box((x, h / 2, (a + b) / 2), (0.012, h, a - b - 0.08), pick(rng, tinted, GLASS))],
                casts_shadow=False,
                name="glass panel",
            )
        )
        groups.append(Group([Box((x, h / 2, a), (0.08, h, 0.08), IRON)], name="mullion"))
    groups.append(
        Group([Box((x, h / 2, z1), (0.08, h, 0.08), IRON), Box((x, h, (z0 + z1) / 2), (0.1, 0.1, z0 - z1), IRON)])
    )
    lane = [(5.9, z0 - 1), (5.9, -2.5), (5.9, z1 + 1), (7.4, z1 + 1), (7.4, -2.5), (7.4, z0 - 1)]
    groups += walker(Path(lane, rng.uniform(0.9, 1.4), rng.random()), rng)
    return groups


def _gratings_and_pipes(rng, yellow) -> list[Group]:
    """Return a gangway of bars along the right wall, below the crane; pipes and tanks."""
    groups, bar = [], Material((0.2, 0.2, 0.21), roughness=0.5, specular=0.1)
    x0, x1, y = 5.6, 8.6, 3.3
    for z in np.arange(-9.0, 2.0, 2.2):
        bars = [Box((x, y, z + 1.1), (0.05, 0.08, 2.2), bar) for x in np.arange(x0, x1, 0.34)]
        bars += [Box(((x0 + x1) / 2, y - 0.09, z + d), (x1 - x0, 0.08, 0.06), bar) for d in (0.4, 1.5)]
        groups.append(Group(bars, name="grating"))
    groups += railing((x0, 2.0), (x0, -9.0), 1.0, 0.3, yellow, Place(0, y, 0), radius=0.02)
    for z in (-8.8, -3.4, 1.8):
        groups.append(Group([Box((x0, y / 2, z), (0.14, y, 0.14), yellow)], name="support"))
    pipe = Material(
        vary(rng, pick(rng, (0.5, 0.5, 0.5), (0.2, 0.35, 0.5), (0.5, 0.3, 0.1))), roughness=0.3, specular=0.2
    )
    pipes = [Capsule((-8.6, 0.5 + 0.4 * k, 7), (-8.6, 0.5 + 0.4 * k, -21), 0.11, pipe) for k in range(4)]
    pipes += [Capsule((-8.5, 2.0, z), (-8.5, 7.4, z), 0.14, pipe) for z in (-1.2, -14.0)]
    groups.append(Group(pipes, name="pipes"))
    for x, z in ((1.5, -19.5), (-2.0, -19.0), (6.5, -17.0)):
        shell = pick(rng, STEEL, pipe)
        tank = [Cylinder((x, 0.3, z), (x, 3.2, z), 1.2, shell), Ellipsoid((x, 3.2, z), (1.2, 0.4, 1.2), shell)]
        groups.append(Group(tank, name="tank"))
    return groups


def _crane(rng, yellow) -> tuple[list[Light], list[Group]]:
    """Return a bridge that travels along the hall, its lamp swinging below the trolley."""
    travel = Place(0, HEIGHT - 1.35, -4.5) @ Slide((0, 0, rng.uniform(4.5, 5.5)), rng.uniform(4.4, 5.4), rng.random())
    bridge = [Box((0, 0, s * 0.5), (2 * HALF_WIDTH - 0.3, 0.4, 0.16), yellow) for s in (-1, 1)]
    trolley = travel @ Slide((2.0, 0, 0), rng.uniform(8, 11), rng.random()) @ Place(3.6, 0, 0)
    groups = [Group(bridge, travel, casts_shadow=False, name="crane")]
    groups.append(Group([Box((0, 0.1, 0), (0.9, 0.3, 1.2), IRON)], trolley, casts_shadow=False, name="trolley"))
    swing = Swing(pick(rng, "x", "z"), rng.uniform(14, 24), rng.uniform(2.0, 2.6), rng.random())
    shade = Material((0.06, 0.06, 0.06), roughness=0.4)
    lights, lamp = swinging_lamp(trolley, 1.2, (1.0, 0.95, 0.85), rng.uniform(26, 32), swing, shade, angle=80)
    return lights, groups + lamp


def _people(rng) -> list[Group]:
    """Return workers beyond the curtain and along the belt."""
    groups = []
    for x, z in ((0.6, -8.0), (2.2, -13.5)):
        ring = [(x + 1.4 * np.cos(a), z + 1.3 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 8)[:-1]]
        groups += walker(Path(ring, rng.uniform(0.9, 1.5), rng.random()), rng)
    lane = [(-5.2, 0.5), (-5.2, -4.0), (-5.2, -9.0), (-6.2, -9.0), (-6.2, -4.0), (-6.2, 0.5)]
    groups += walker(Path(lane, rng.uniform(0.9, 1.5), rng.random()), rng)
    return groups
