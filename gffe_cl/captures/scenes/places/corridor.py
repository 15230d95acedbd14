"""Corridor: a sunlit passage of a public building."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.props import *

HALF_WIDTH, HEIGHT, FAR, NEAR = 2.5, 3.2, -34.0, 5.0


def build(seed: int, rng: np.random.Generator) -> Scene:
    floor = Material(
        *pick(
            rng,
            ((0.42, 0.38, 0.32), (0.16, 0.14, 0.12)),
            ((0.5, 0.47, 0.42), (0.13, 0.12, 0.13)),
            ((0.36, 0.24, 0.17), (0.52, 0.46, 0.38)),
            ((0.3, 0.33, 0.32), (0.5, 0.5, 0.46)),
        ),
        texture=pick(rng, "tiles", "checker", "checker"),
        scale=0.5,
        contrast=0.3,
        roughness=0.08,
        specular=0.05,
        mirror=0.8,
        seed=seed,
    )
    plaster = Material(
        vary(rng, pick(rng, (0.62, 0.55, 0.44), (0.5, 0.56, 0.55), (0.6, 0.48, 0.4), (0.55, 0.57, 0.5))),
        scale=0.8,
        contrast=0.12,
        roughness=0.95,
        seed=seed,
    )
    dado = Material(
        vary(rng, pick(rng, (0.3, 0.15, 0.07), (0.16, 0.24, 0.22), (0.36, 0.12, 0.09), (0.2, 0.2, 0.25))),
        (0.12, 0.07, 0.04),
        pick(rng, "planks", "bricks", "tiles"),
        scale=0.14,
        contrast=0.45,
        seed=seed + 1,
        roughness=0.5,
    )
    trim = Material(vary(rng, (0.6, 0.57, 0.5)), roughness=0.5, contrast=0.1)
    ceiling = Material((0.72, 0.7, 0.66), (0.5, 0.48, 0.45), "tiles", scale=0.6, contrast=0.08, roughness=1.0)
    lamp_color = np.array(vary(rng, (1.0, 0.72, 0.42)))
    length, middle = NEAR - FAR, (NEAR + FAR) / 2

    groups = [
        Group([Box((0, -0.1, middle), (2 * HALF_WIDTH + 0.4, 0.2, length), floor)], name="floor"),
        Group([Box((0, HEIGHT + 0.1, middle), (2 * HALF_WIDTH + 0.4, 0.2, length), ceiling)], name="ceiling"),
        Group([Box((HALF_WIDTH + 0.1, HEIGHT / 2, middle), (0.2, HEIGHT, length), plaster)], name="wall"),
        Group([Box((HALF_WIDTH - 0.03, 0.5, middle), (0.08, 1.0, length - 0.2), dado)], name="dado"),
        Group([Box((HALF_WIDTH - 0.04, 1.03, middle), (0.12, 0.07, length - 0.2), trim)], name="dado rail"),
        Group([Box((0, HEIGHT / 2, FAR - 0.1), (2 * HALF_WIDTH + 0.4, HEIGHT, 0.2), plaster)], name="end wall"),
        Group([Box((0, HEIGHT / 2, NEAR + 0.1), (2 * HALF_WIDTH + 0.4, HEIGHT, 0.2), plaster)], name="end wall"),
    ]
    groups += wall_with_windows(-HALF_WIDTH - 0.1, NEAR, FAR, HEIGHT, 0.85, 2.55, 2.1, 3.9, plaster, trim)
    groups += railing((-2.05, 3.5), (-2.05, FAR + 4), 0.95, 0.16, pick(rng, STEEL, IRON, BRASS))
    for z in np.arange(NEAR - 3.9, FAR, -3.9):
        groups.append(Group([Box((0, HEIGHT - 0.12, z), (2 * HALF_WIDTH, 0.24, 0.3), trim)], name="beam"))
    groups += _right_side(rng, trim)
    groups += _outside(rng)

    # The mirror ball on its plinth, the mirror at the end.
    ball_z = -16.5 + rng.uniform(-1, 1)
    groups += [
        Group([Box((1.85, 0.42, ball_z), (0.5, 0.84, 0.5), trim)], name="plinth"),
        Group([Sphere((1.85, 1.2, ball_z), 0.36, MIRROR)], name="mirror ball"),
        Group([Box((0, 1.55, FAR + 0.05), (2.6, 2.0, 0.06), MIRROR)], name="mirror"),
    ]

    # A pendulum lamp sweeps its light, others stay.
    lights, shade = [], Material(vary(rng, (0.12, 0.2, 0.16), 0.5), roughness=0.3)
    sun = np.array((-1.0, rng.uniform(0.62, 1.05), rng.uniform(-0.35, 0.45)))
    lights.append(Light("sun", tuple(sun), tint(vary(rng, (1.0, 0.84, 0.64), 0.12), rng.uniform(2.6, 4.0)), size=0.012))
    for k, z in enumerate((-7.3 + rng.uniform(-1, 1), -20.0 + rng.uniform(-2, 2))):
        swing = Swing("z" if k == 0 else "x", 24 if k == 0 else 10, rng.uniform(2.4, 3.4), rng.random())
        groups += pendant(0.0, HEIGHT - 0.02, z, 0.85, tint(lamp_color, 3), swing, shade)
        at = Place(0.0, HEIGHT - 0.02, z) @ swing
        lights.append(
            Light("spot", (0, -0.9, 0), tint(lamp_color, rng.uniform(3.5, 5.5)), 0.07, (0, -1, 0), 78, motion=at)
        )
    for z in (0.0, -12.0, -24.0):  # sunlight off the floor
        lights.append(Light("fill", (-0.6, 0.3, z), tint((1.0, 0.8, 0.58), rng.uniform(1.0, 1.5)), size=1.6))

    groups += _people(rng)
    day = rng.uniform(0.85, 1.15)
    air = Air(
        zenith=tint((0.16, 0.34, 0.75), day),
        horizon=tint((0.72, 0.82, 0.95), day),
        clouds=rng.uniform(0.2, 0.6),
        ambient_up=tint((0.2, 0.225, 0.26), day),
        ambient_down=tint((0.21, 0.175, 0.135), day),
        haze_color=(0.45, 0.45, 0.46),
        haze=0.004,
    )
    return _scene(seed, rng, groups, lights, air)


def _scene(seed, rng, groups, lights, air) -> Scene:
    period = rng.uniform(24, 32)
    sway, yaw_period, lag = rng.uniform(0.15, 0.4), rng.uniform(5, 8), rng.random()
    yaw, height = rng.uniform(0.25, 0.5), rng.uniform(1.5, 1.7)
    start = rng.uniform(0.08, 0.2)

    def eye(time):
        u = 2 * np.pi * (time / period + start)
        return np.array(
            (
                sway * np.sin(2 * np.pi * (time / 6.3 + lag)),
                height + 0.02 * np.sin(2 * np.pi * time / 0.9),
                -4.5 + 7.0 * np.cos(u),
            )
        )

    def target(time):
        angle = yaw * np.sin(2 * np.pi * (time / yaw_period + lag))
        return eye(time) + np.array((np.sin(angle), -0.06, -np.cos(angle)))

    return Scene("corridor", seed, groups, lights, air, eye, target, focal=0.85)


def _right_side(rng, trim) -> list[Group]:
    """Return doors, pictures, benches and plants along the right wall."""
    groups = []
    x = HALF_WIDTH
    for k, z in enumerate(np.arange(1.5, FAR + 2, -3.9)):
        kind = k % 3 if rng.random() < 0.8 else int(rng.integers(3))
        if kind == 0:
            wood = Material(
                vary(rng, pick(rng, (0.4, 0.2, 0.09), (0.16, 0.3, 0.34), (0.45, 0.1, 0.08)), 0.2),
                (0.15, 0.08, 0.04),
                "planks",
                scale=0.16,
                roughness=0.4,
                contrast=0.4,
                seed=int(rng.integers(999)),
            )
            groups.append(
                Group(
                    [
                        Box((x, 1.07, z), (0.2, 2.14, 1.15), trim),
                        Box((x - 0.02, 1.03, z), (0.2, 2.06, 0.98), wood),
                        Sphere((x - 0.17, 1.02, z + 0.38), 0.035, BRASS),
                        Box(
                            (x - 0.02, 2.4, z),
                            (0.16, 0.3, 0.9),
                            Material(
                                (0.75, 0.73, 0.66),
                                (0.05, 0.1, 0.25),
                                "sign",
                                scale=0.16,
                                seed=int(rng.integers(999)),
                            ),
                        ),
                    ],
                    name="door",
                )
            )
        else:
            art = Material(
                vary(rng, (0.6, 0.5, 0.35), 0.5),
                vary(rng, (0.15, 0.22, 0.4), 0.6),
                pick(rng, "picture", "picture", "sign"),
                scale=0.22,
                contrast=0.3,
                roughness=0.3,
                seed=int(rng.integers(1 << 16)),
            )
            size = (0.05, rng.uniform(0.8, 1.1), rng.uniform(0.9, 1.7))
            groups.append(Group([Box((x - 0.02, 1.75, z), size, art)], name="picture"))
            if kind == 1:
                groups += bench(Place(x - 0.42, 0, z, yaw=-90))
            else:
                groups += potted_plant(x - 0.4, z + 0.6, rng, rng.uniform(1.0, 1.5))
    return groups


def _outside(rng) -> list[Group]:
    """Return a lawn with trees, and passers-by whose shadows fall through the windows."""
    lawn = Material((0.16, 0.24, 0.07), (0.07, 0.12, 0.03), "grass", scale=0.5, roughness=1.0, contrast=0.2)
    groups = [Group([Box((-33, -0.6, -15), (60, 0.2, 120), lawn)], name="lawn")]
    bark = bark_material(rng)
    for k in range(4):
        x, z = -rng.uniform(8, 14), 3.0 - 11 * k + rng.uniform(-3, 3)
        groups += broad_tree(x, z, rng, rng.uniform(4.5, 6.5), bark, leaf_material(rng, 0.3 * rng.random()), blobs=8)
    board = Material(vary(rng, (0.5, 0.3, 0.12), 0.4), roughness=0.5)
    shutter = Place(-3.4, 1.9, -5.0) @ Slide((0, 0, 4.0), rng.uniform(5, 8), rng.random()) @ Spin("x", 40)
    groups.append(Group([Box((0, 0, 0), (0.04, 0.12, 1.6), board), Box((0, 0, 0), (0.04, 1.6, 0.12), board)], shutter))
    return groups


def _people(rng) -> list[Group]:
    """Return people in two lanes next to the camera's lane, and free walkers beyond its reach."""
    groups = []
    for side in (1.0, -1.0):
        a, b = (1.15, 1.6) if side > 0 else (-1.15, -1.65)
        z = (rng.uniform(1.5, 3.5), rng.uniform(-13, -10))
        lane = Path(
            ((a, z[0]), (a, (z[0] + z[1]) / 2), (a, z[1]), (b, z[1]), (b, (z[0] + z[1]) / 2), (b, z[0])),
            rng.uniform(0.9, 1.5),
            rng.random(),
        )
        groups += walker(lane, rng)
    for _ in range(int(rng.integers(2, 4))):
        z = -14.0 - rng.uniform(0, 5)
        w = rng.uniform(0.9, 1.4)
        loop = Path(((-w, z), (w, z - 1.5), (w * 0.8, z - 6), (-w * 0.8, z - 5)), rng.uniform(0.9, 1.6), rng.random())
        groups += walker(loop, rng)
    return groups
