"""Figures that move: people and animals, in their gaits, and vehicles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.captures.scenes.motions import Motion, Path, rotation, translation
from gffe_cl.captures.scenes.scene_types import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Group,
    Light,
    Material,
    Sphere,
    pick,
    tint,
    vary,
)

_SHIRTS = (
    (0.5, 0.08, 0.07),
    (0.1, 0.2, 0.45),
    (0.65, 0.6, 0.5),
    (0.12, 0.32, 0.18),
    (0.62, 0.42, 0.08),
    (0.3, 0.12, 0.34),
    (0.08, 0.36, 0.4),
    (0.7, 0.3, 0.12),
)
_TROUSERS = ((0.06, 0.08, 0.16), (0.12, 0.1, 0.08), (0.3, 0.25, 0.17), (0.05, 0.05, 0.06), (0.2, 0.22, 0.26))
_SKIN = ((0.55, 0.34, 0.24), (0.42, 0.24, 0.15), (0.2, 0.1, 0.06), (0.62, 0.42, 0.32))
_HAIR = ((0.03, 0.02, 0.015), (0.12, 0.06, 0.025), (0.35, 0.24, 0.1), (0.3, 0.3, 0.3))


@dataclass(frozen=True)
class _Joint(Motion):
    """Limb, attached at `offset` in its parent's space. It swings about x by `angle(phase of the gait)` radians."""

    parent: Motion
    offset: tuple
    angle: Callable
    gait: Callable

    def __call__(self, time):
        turned = rotation("x", np.degrees(self.angle(self.gait(time))))
        return self.parent(time) @ translation(self.offset) @ turned


@dataclass(frozen=True)
class _Body(Motion):
    """Motion along the path, with the bob and sway of the gait."""

    path: Path
    gait: Callable
    bob: float
    height: float

    def __call__(self, time):
        phase = self.gait(time)
        return (
            self.path(time)
            @ translation((0.0, self.height + self.bob * np.cos(2 * phase), 0.0))
            @ rotation("y", 4.0 * np.sin(phase))
        )


def walker(path: Path, rng: np.random.Generator, height: float | None = None) -> list[Group]:
    """Return a person who walks along `path` at its speed: ten rigid groups; looks come from `rng`."""
    h = (height or float(rng.uniform(1.58, 1.9))) / 1.75
    shirt_color = vary(rng, pick(rng, *_SHIRTS))
    seed = int(rng.integers(1 << 16))
    shirt = Material(
        shirt_color,
        vary(rng, pick(rng, *_SHIRTS)),
        pick(rng, "plain", "stripes", "stripes"),
        scale=0.06,
        contrast=0.2,
        roughness=0.9,
        seed=seed,
    )
    trousers = Material(vary(rng, pick(rng, *_TROUSERS)), scale=0.1, contrast=0.3, roughness=0.9, seed=seed)
    skin = Material(pick(rng, *_SKIN), scale=0.3, contrast=0.08, roughness=0.5)
    hair = Material(pick(rng, *_HAIR), scale=0.02, contrast=0.4, roughness=0.4)
    shoe = Material(vary(rng, (0.08, 0.06, 0.05), 0.5), roughness=0.3)
    long_sleeves, skirt, bag = rng.random() < 0.6, rng.random() < 0.25, rng.random() < 0.4
    sleeve = shirt if long_sleeves else skin

    stride = 1.45 * h
    shift = float(rng.uniform(0, 2 * np.pi))

    def gait(time):
        return shift + 2 * np.pi * path.distance(time) / stride

    def leg(side):
        return lambda phase: -0.48 * np.sin(phase + side)

    def knee(side):
        return lambda phase: 0.12 + 0.42 * (1 + np.cos(phase + side + 0.5)) * 0.9

    def arm(side):
        return lambda phase: 0.42 * np.sin(phase + side)

    def elbow(side):
        return lambda phase: -0.35 - 0.2 * (1 + np.sin(phase + side + np.pi))

    body = _Body(path, gait, 0.025 * h, 0.93 * h)
    torso = [
        Capsule((-0.07 * h, 0.04 * h, 0), (0.07 * h, 0.04 * h, 0), 0.115 * h, trousers),
        Ellipsoid((0, 0.2 * h, 0), (0.165 * h, 0.23 * h, 0.115 * h), shirt),
        Ellipsoid((0, 0.39 * h, 0), (0.19 * h, 0.17 * h, 0.125 * h), shirt),
        Capsule((-0.13 * h, 0.485 * h, 0), (0.13 * h, 0.485 * h, 0), 0.07 * h, shirt),
        Capsule((0, 0.5 * h, 0), (0, 0.6 * h, 0.01), 0.05 * h, skin),
    ]
    if skirt:
        torso.append(Cone((0, -0.42 * h, 0), (0, 0.1 * h, 0), 0.26 * h, 0.14 * h, trousers))
    if bag:
        leather = Material(vary(rng, (0.3, 0.14, 0.06), 0.4), roughness=0.4, contrast=0.3)
        torso.append(Box((0, 0.3 * h, -0.18 * h), (0.28 * h, 0.36 * h, 0.14 * h), leather))
    head = [
        Ellipsoid((0, 0.1 * h, 0.01), (0.085 * h, 0.115 * h, 0.1 * h), skin),
        Ellipsoid((0, 0.135 * h, -0.018 * h), (0.094 * h, 0.1 * h, 0.104 * h), hair),
        Sphere((0, 0.085 * h, 0.105 * h), 0.018 * h, skin),
    ]
    groups = [
        Group(torso, body, name="torso"),
        Group(head, _Joint(body, (0, 0.61 * h, 0.01), lambda phase: 0.04 * np.sin(2 * phase), gait), name="head"),
    ]
    for side, x in ((0.0, -1.0), (np.pi, 1.0)):
        thigh = _Joint(body, (0.1 * h * x, 0.02 * h, 0), leg(side), gait)
        shin = _Joint(thigh, (0, -0.44 * h, 0), knee(side), gait)
        upper = _Joint(body, (0.235 * h * x, 0.48 * h, 0), arm(side), gait)
        fore = _Joint(upper, (0, -0.29 * h, 0), elbow(side), gait)
        calf_material = skin if skirt else trousers
        groups += [
            Group([Capsule((0, 0, 0), (0, -0.42 * h, 0), 0.082 * h, calf_material)], thigh, name="thigh"),
            Group(
                [
                    Cone((0, 0.0, 0), (0, -0.42 * h, 0), 0.072 * h, 0.045 * h, calf_material),
                    Sphere((0, 0, 0), 0.072 * h, calf_material),
                    Capsule((0, -0.445 * h, -0.02 * h), (0, -0.455 * h, 0.15 * h), 0.042 * h, shoe),
                ],
                shin,
                name="shin",
            ),
            Group([Capsule((0, 0, 0), (0, -0.27 * h, 0), 0.056 * h, shirt)], upper, name="upper arm"),
            Group(
                [
                    Capsule((0, 0, 0), (0, -0.23 * h, 0), 0.043 * h, sleeve),
                    Ellipsoid((0, -0.3 * h, 0), (0.03 * h, 0.075 * h, 0.045 * h), skin),
                ],
                fore,
                name="forearm",
            ),
        ]
    return groups


def animal(path: Path, rng: np.random.Generator, size: float = 1.0) -> list[Group]:
    """Return a four-legged animal (dog at size 0.6, deer at 1.0) trotting along `path`: six rigid groups."""
    coat = Material(
        vary(rng, pick(rng, (0.34, 0.2, 0.09), (0.22, 0.17, 0.13), (0.5, 0.42, 0.32), (0.08, 0.07, 0.06)), 0.2),
        (0.1, 0.06, 0.03),
        "bark",
        scale=0.15 * size,
        roughness=0.9,
        seed=int(rng.integers(1 << 16)),
    )
    dark = Material((0.05, 0.04, 0.03), roughness=0.4)
    s, shift = size, float(rng.uniform(0, 2 * np.pi))

    def gait(time):
        return shift + 2 * np.pi * path.distance(time) / (1.3 * s)

    body = _Body(path, gait, 0.03 * s, 0.95 * s)
    groups = [
        Group(
            [
                Ellipsoid((0, 0, -0.12 * s), (0.2 * s, 0.22 * s, 0.45 * s), coat),
                Ellipsoid((0, 0.03 * s, 0.3 * s), (0.18 * s, 0.24 * s, 0.28 * s), coat),
                Capsule((0, 0.1 * s, -0.52 * s), (0, 0.0, -0.68 * s), 0.04 * s, coat),
            ],
            body,
            name="trunk",
        ),
        Group(
            [
                Capsule((0, 0, 0), (0, 0.32 * s, 0.2 * s), 0.1 * s, coat),
                Ellipsoid((0, 0.4 * s, 0.3 * s), (0.09 * s, 0.1 * s, 0.2 * s), coat),
                Sphere((0, 0.37 * s, 0.5 * s), 0.035 * s, dark),
                Cone((-0.06 * s, 0.46 * s, 0.18 * s), (-0.13 * s, 0.62 * s, 0.14 * s), 0.045 * s, 0.005, coat),
                Cone((0.06 * s, 0.46 * s, 0.18 * s), (0.13 * s, 0.62 * s, 0.14 * s), 0.045 * s, 0.005, coat),
            ],
            _Joint(body, (0, 0.1 * s, 0.42 * s), lambda phase: 0.1 * np.sin(2 * phase), gait),
            name="neck",
        ),
    ]
    for x, z, lag in ((-1, 0.35, 0.0), (1, 0.35, np.pi), (-1, -0.42, np.pi + 0.4), (1, -0.42, 0.4)):

        def swing(phase, lag=lag):
            return 0.45 * np.sin(phase + lag)

        groups.append(
            Group(
                [
                    Capsule((0, 0, 0), (0, -0.4 * s, 0.03 * s * np.sign(z)), 0.065 * s, coat),
                    Cone((0, -0.38 * s, 0.03 * s * np.sign(z)), (0, -0.84 * s, 0), 0.05 * s, 0.035 * s, coat),
                ],
                _Joint(body, (0.11 * s * x, -0.06 * s, z * s), swing, gait),
                name="leg",
            )
        )
    return groups


_PAINTS = ((0.35, 0.03, 0.03), (0.03, 0.06, 0.2), (0.4, 0.4, 0.42), (0.02, 0.02, 0.025), (0.4, 0.3, 0.05))


def car(at: Motion, rng: np.random.Generator) -> list[Group]:
    """Return a small car, 4 m long, its front towards +z; lamps glow, see `headlight`."""
    paint = Material(vary(rng, pick(rng, *_PAINTS)), roughness=0.06, specular=0.06, mirror=1.0, contrast=0.02)
    pane = Material((0.02, 0.025, 0.03), roughness=0.02, specular=0.06, mirror=1.0, contrast=0.0)
    rubber = Material((0.02, 0.02, 0.02), roughness=0.9)
    white = Material((0.8, 0.8, 0.75), emission=(9.0, 8.6, 7.5), contrast=0.0)
    red = Material((0.5, 0.02, 0.02), emission=(2.2, 0.06, 0.04), contrast=0.0)
    prims = [
        Box((0, 0.55, 0), (1.66, 0.46, 3.7), paint),
        Ellipsoid((0, 0.62, 1.5), (0.82, 0.26, 0.55), paint),
        Ellipsoid((0, 0.64, -1.5), (0.82, 0.28, 0.5), paint),
        Box((0, 0.98, -0.3), (1.4, 0.46, 1.75), pane),
        Box((0, 1.24, -0.35), (1.34, 0.09, 1.5), paint),
        Capsule((-0.62, 0.78, 0.95), (-0.58, 1.22, 0.4), 0.04, paint),
        Capsule((0.62, 0.78, 0.95), (0.58, 1.22, 0.4), 0.04, paint),
    ]
    for x in (-0.78, 0.78):
        prims += [Cylinder((x - 0.1, 0.31, z), (x + 0.1, 0.31, z), 0.31, rubber) for z in (-1.2, 1.2)]
    glow = [Ellipsoid((s * 0.6, 0.62, 1.9), (0.14, 0.09, 0.12), white) for s in (-1, 1)]
    glow += [Box((s * 0.66, 0.66, -1.9), (0.26, 0.12, 0.1), red) for s in (-1, 1)]
    return [Group(prims, at, name="car"), Group(glow, at, casts_shadow=False, name="car lamps")]


def headlight(at: Motion, strength: float, color=(1.0, 0.95, 0.84), angle=64.0) -> Light:
    """Return the beam of a `car`'s two headlights, as one."""
    return Light("spot", (0, 0.66, 2.02), tint(color, strength), 0.012, (0, -0.03, 1), angle, motion=at)
