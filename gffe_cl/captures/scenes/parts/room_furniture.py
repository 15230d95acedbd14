"""Furniture of the living room. Each function returns groups."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.parts.furniture import BRASS, CERAMIC, GLASS, IRON, MIRROR, STEEL, leaf_material
from gffe_cl.captures.scenes.parts.motions import Place, Spin, Swing
from gffe_cl.captures.scenes.scene_types import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Group,
    Material,
    Sphere,
    pick,
    vary,
)


def wood_frame(rng) -> Material:
    return Material(vary(rng, (0.25, 0.13, 0.06), 0.3), roughness=0.3, contrast=0.3)


def sofa(at, fabric, rng, width) -> list[Group]:
    """Return a sofa with its seat along x, facing +z."""
    cushion = Material(
        vary(rng, pick(rng, (0.6, 0.4, 0.1), (0.5, 0.16, 0.1), (0.12, 0.3, 0.32), (0.55, 0.5, 0.42))),
        (0.5, 0.46, 0.4),
        pick(rng, "stripes", "checker", "plain"),
        scale=0.07,
        roughness=1.0,
    )
    w = width / 2
    prims = [Box((0, 0.25, 0), (width, 0.3, 0.8), fabric), Box((0, 0.58, -0.33), (width, 0.5, 0.18), fabric)]
    prims += [Capsule((s * (w + 0.09), 0.5, -0.36), (s * (w + 0.09), 0.5, 0.36), 0.12, fabric) for s in (-1, 1)]
    prims += [Box((s * (w + 0.09), 0.29, 0), (0.2, 0.38, 0.78), fabric) for s in (-1, 1)]
    seats = max(round(width / 0.72), 1)
    for k in range(seats):
        x = (k + 0.5 - seats / 2) * width / seats
        prims.append(Ellipsoid((x, 0.41, 0.06), (0.48 * width / seats, 0.1, 0.36), fabric))
        prims.append(Ellipsoid((x, 0.62, -0.23), (0.44 * width / seats, 0.24, 0.12), fabric))
    feet = [Cylinder((s * w * 0.92, 0, d), (s * w * 0.92, 0.12, d), 0.03, IRON) for s in (-1, 1) for d in (-0.3, 0.3)]
    groups = [Group(prims + feet, at, name="sofa")]
    for s in (-1, 1)[: 1 if width < 1 else 2]:
        tilt = Place(s * w * 0.66, 0.66, -0.08, yaw=12 * s, pitch=-22)
        groups.append(Group([Ellipsoid((0, 0, 0), (0.24, 0.22, 0.09), cushion)], at @ tilt, name="cushion"))
    return groups


def coffee_table(rng, wood) -> list[Group]:
    """Return a low table with a glass top, a bowl of fruit, books, a cup."""
    groups = []
    legs = [
        Cylinder((sx * 0.5, 0, sz * 0.28), (sx * 0.5, 0.4, sz * 0.28), 0.025, STEEL) for sx in (-1, 1) for sz in (-1, 1)
    ]
    shelf = Box((0, 0.14, 0), (1.0, 0.025, 0.56), wood)
    groups.append(Group([*legs, shelf], Place(0, 0, -0.3), name="table"))
    groups.append(
        Group(
            [Box((0, 0.412, 0), (1.2, 0.022, 0.72), GLASS)],
            Place(0, 0, -0.3),
            casts_shadow=False,
            name="table top",
        )
    )
    bowl = [Cone((0, 0.424, 0), (0, 0.52, 0), 0.08, 0.19, CERAMIC)]
    for k in range(4):
        fruit = Material(
            pick(rng, (0.55, 0.1, 0.05), (0.62, 0.36, 0.04), (0.3, 0.42, 0.06)),
            roughness=0.3,
            contrast=0.2,
            scale=0.05,
        )
        a = 2 * np.pi * k / 4
        bowl.append(Sphere((0.08 * np.cos(a), 0.545, 0.08 * np.sin(a)), 0.05, fruit))
    groups.append(Group(bowl, Place(0.25, 0, -0.35), name="bowl"))
    pile = []
    for k in range(3):
        cover = Material(
            vary(rng, pick(rng, (0.45, 0.1, 0.08), (0.1, 0.22, 0.4), (0.5, 0.42, 0.2), (0.12, 0.3, 0.2)), 0.3),
            roughness=0.5,
        )
        pile.append(Box((0.02 * k, 0.44 + 0.035 * k, -0.015 * k), (0.26 - 0.02 * k, 0.032, 0.19), cover))
    groups.append(Group(pile, Place(-0.28, 0, -0.25, yaw=25), name="books"))
    return groups


def bookcase(rng, wood, wall_x) -> list[Group]:
    """Return a bookcase against the left wall."""
    books = Material(
        (0.4, 0.2, 0.1),
        (0.6, 0.55, 0.4),
        "books",
        scale=0.36,
        roughness=0.7,
        contrast=0.2,
        seed=int(rng.integers(999)),
    )
    z, x, w = -1.35, wall_x + 0.18, 1.7
    case = [Box((x, 1.08, z + s * w / 2), (0.34, 2.16, 0.04), wood) for s in (-1, 1)]
    case += [Box((x, 0.06 + 0.36 * k, z), (0.33, 0.03, w - 0.04), wood) for k in range(7)]
    rows = [Box((x - 0.02, 1.08, z), (0.22, 2.15, w - 0.06), books)]
    return [Group(case, name="bookcase"), Group(rows, name="books")]


def sideboard(rng, wood, wall_z) -> list[Group]:
    """Return a cabinet below the mirror, with a vase, a clock with a pendulum and a steel globe."""
    z = wall_z - 0.25
    front = Material(wood.color, wood.second, "tiles", scale=0.55, contrast=0.3, roughness=0.4)
    prims = [Box((-0.6, 0.42, z), (1.9, 0.6, 0.42), front), Box((-0.6, 0.74, z), (1.98, 0.04, 0.46), wood)]
    prims += [Cylinder((-0.6 + s * 0.85, 0, z), (-0.6 + s * 0.85, 0.14, z), 0.03, IRON) for s in (-1, 1)]
    glaze = Material(
        vary(rng, pick(rng, (0.1, 0.25, 0.4), (0.5, 0.3, 0.1), (0.15, 0.35, 0.25))),
        roughness=0.12,
        specular=0.06,
        mirror=0.5,
    )
    vase = [
        Ellipsoid((-1.25, 0.92, z), (0.12, 0.17, 0.12), glaze),
        Cone((-1.25, 1.04, z), (-1.25, 1.2, z), 0.06, 0.085, glaze),
    ]
    groups = [Group(prims, name="sideboard"), Group(vase, name="vase")]
    petal = Material(
        vary(rng, pick(rng, (0.6, 0.1, 0.12), (0.65, 0.45, 0.05), (0.5, 0.2, 0.5))),
        roughness=0.9,
        contrast=0.4,
        scale=0.03,
    )
    flowers = []
    for k in range(6):
        a = 2.4 * k
        tip = (0.11 * np.cos(a), 0.28 + 0.04 * (k % 3), 0.09 * np.sin(a))
        flowers += [Capsule((0, 0, 0), tip, 0.006, leaf_material(rng)), Sphere(tip, 0.045, petal)]
    groups.append(Group(flowers, Place(-1.25, 1.2, z) @ Swing("z", 2, 3.1), name="flowers"))
    globe = [Sphere((0.1, 0.95, z), 0.17, MIRROR), Cylinder((0.1, 0.76, z), (0.1, 0.79, z), 0.1, BRASS)]
    groups.append(Group(globe, name="globe"))
    x = 0.55 + 0.35
    face = Material((0.7, 0.68, 0.6), (0.1, 0.08, 0.06), "plain")
    clock = [
        Box((x, 1.02, wall_z - 0.14), (0.42, 2.04, 0.24), wood),
        Cylinder((x, 1.78, wall_z - 0.25), (x, 1.78, wall_z - 0.275), 0.15, face),
    ]
    groups.append(Group(clock, name="clock"))
    bob = [
        Capsule((0, 0, 0), (0, -0.62, 0), 0.01, BRASS),
        Cylinder((0, -0.66, -0.01), (0, -0.66, 0.01), 0.08, BRASS),
    ]
    groups.append(Group(bob, Place(x, 1.5, wall_z - 0.3) @ Swing("z", 9, 1.6), name="pendulum"))
    hand = [Capsule((0, 0, 0), (0, 0.11, 0), 0.006, IRON)]
    groups.append(Group(hand, Place(x, 1.78, wall_z - 0.285) @ Spin("z", 60), name="hand"))
    return groups


def glass_screen(rng) -> list[Group]:
    """Return two standing panels of tinted glass in a frame."""
    tinted = Material(
        vary(rng, pick(rng, (0.75, 0.9, 0.95), (0.95, 0.82, 0.6), (0.8, 0.92, 0.8))),
        transparency=0.75,
        specular=0.05,
        mirror=0.05,
        roughness=0.02,
    )
    groups = []
    for k, yaw in ((0, 62), (1, 118)):
        at = Place(2.75, 0, -2.35 + 0.02 * k, yaw=yaw)
        side = -1 if k == 0 else 1
        panel = [Box((side * 0.4, 0.85, 0), (0.7, 1.4, 0.02), tinted)]
        bars = [Box((side * (0.4 + s * 0.37), 0.82, 0), (0.04, 1.64, 0.04), IRON) for s in (-1, 1)]
        bars += [Box((side * 0.4, y, 0), (0.72, 0.04, 0.035), IRON) for y in (0.13, 1.57)]
        groups += [
            Group(panel, at, casts_shadow=False, name="glass panel"),
            Group(bars, at, name="screen frame"),
        ]
    return groups
