"""Props of scenes: furniture of squares and rooms, plants and lamps; people and animals in their gaits, and vehicles.
Places import the whole vocabulary of scenes from here."""
# ruff: noqa: F403, F405 (the vocabulary of scenes)

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.captures.scenes.scene_types import *

STEEL = Material((0.55, 0.56, 0.58), specular=0.6, roughness=0.25, mirror=0.5, contrast=0.05)
IRON = Material((0.035, 0.035, 0.04), roughness=0.45, specular=0.08, contrast=0.3, scale=0.1)
BRASS = Material((0.75, 0.5, 0.18), specular=0.65, roughness=0.2, mirror=0.6, contrast=0.05)
WOOD = Material((0.34, 0.17, 0.07), (0.2, 0.09, 0.035), "planks", scale=0.12, roughness=0.4, contrast=0.5)
GLASS = Material((0.93, 0.97, 0.95), transparency=0.92, mirror=0.04, specular=0.04, roughness=0.02)
CERAMIC = Material((0.5, 0.22, 0.12), scale=0.3, roughness=0.6, contrast=0.2)
MIRROR = Material((0.92, 0.93, 0.94), specular=0.93, roughness=0.0, mirror=1.0, contrast=0.0)


def railing(start, end, height, spacing, material, at: Motion | None = None, radius=0.014) -> list[Group]:
    """Return thin upright bars between two ground points (x, z), with a top and a bottom rail."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    length = np.linalg.norm(end - start)
    groups, at = [], at or Place()
    pieces = max(int(np.ceil(length / 2.5)), 1)
    for piece in range(pieces):
        a, b = (start + (end - start) * (piece + k) / pieces for k in (0, 1))
        bars = max(round(length / pieces / spacing), 1)
        prims = [
            Capsule((a[0], height, a[1]), (b[0], height, b[1]), radius * 1.9, material),
            Capsule((a[0], 0.12, a[1]), (b[0], 0.12, b[1]), radius * 1.3, material),
            Cylinder((a[0], 0, a[1]), (a[0], height, a[1]), radius * 2.0, material),
        ]
        for k in range(1, bars):
            p = a + (b - a) * k / bars
            prims.append(Capsule((p[0], 0.12, p[1]), (p[0], height, p[1]), radius, material))
        groups.append(Group(prims, at, name="railing"))
    return groups


def wall_with_windows(x, z_start, z_end, height, sill, head, width, pitch, wall, frame) -> list[Group]:
    """Return a wall in the plane x, from z_start down to z_end, with a window every `pitch` meters; frames and panes
    included."""
    thick = 0.22
    length = z_start - z_end
    middle = (z_start + z_end) / 2
    groups = [
        Group([Box((x, sill / 2, middle), (thick, sill, length), wall)], name="wall"),
        Group([Box((x, (head + height) / 2, middle), (thick, height - head, length), wall)], name="wall"),
    ]
    count = int(length // pitch)
    edges = [z_start]
    for k in range(count):
        z = z_start - (k + 0.5) * length / count
        edges += [z + width / 2, z - width / 2]
        y = (sill + head) / 2
        bars = [
            Box((x, sill + 0.015, z), (thick + 0.12, 0.05, width + 0.1), frame),
            Box((x, y, z), (0.05, head - sill, 0.045), frame),
            Box((x, sill + 0.68 * (head - sill), z), (0.05, 0.04, width), frame),
        ]
        bars += [Box((x, y, z + s * (width / 2 - 0.025)), (0.1, head - sill, 0.05), frame) for s in (-1, 1)]
        groups.append(Group(bars, name="window frame"))
        pane = Box((x - 0.04, y, z), (0.006, head - sill, width), GLASS)
        groups.append(Group([pane], casts_shadow=False, name="pane"))
    edges.append(z_end)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        pier = Box((x, (sill + head) / 2, (a + b) / 2), (thick - 0.002, head - sill, a - b), wall)
        groups.append(Group([pier], name="pier"))
    return groups


def bench(at: Motion, wood: Material = WOOD, legs: Material = IRON) -> list[Group]:
    """Return a slatted seat 1.6 m long along x, with a back."""
    prims = [Box((0, 0.44, -0.19 + 0.13 * k), (1.6, 0.035, 0.1), wood) for k in range(4)]
    prims += [Box((0, 0.62 + 0.14 * k, -0.27 - 0.02 * k), (1.6, 0.1, 0.03), wood) for k in range(2)]
    for x in (-0.65, 0.65):
        prims += [
            Box((x, 0.21, 0.0), (0.05, 0.42, 0.42), legs),
            Box((x, 0.6, -0.3), (0.05, 0.5, 0.03), legs),
        ]
    return [Group(prims, at, name="bench")]


def potted_plant(x, z, rng: np.random.Generator, height=1.1) -> list[Group]:
    """Return a pot on the ground and a crown that sways a little."""
    pot = Material(vary(rng, pick(rng, (0.5, 0.22, 0.12), (0.55, 0.55, 0.52), (0.1, 0.18, 0.25)), 0.2), roughness=0.4)
    leaf = leaf_material(rng)
    soil = Material((0.05, 0.035, 0.02), roughness=1.0)
    crown = [Cone((0, 0.0, 0), (0, 0.45 * height, 0), 0.025, 0.015, soil)]
    for _ in range(9):
        angle, tip = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.0) * (height - 0.4)
        reach = 0.32 * rng.uniform(0.4, 1.0)
        out = np.array((np.cos(angle) * reach, tip, np.sin(angle) * reach))
        crown.append(Ellipsoid(tuple(out * (0.8, 1, 0.8)), (0.13, 0.17, 0.13), leaf))
        crown.append(Capsule((0, 0.05, 0), tuple(out), 0.008, leaf))
    return [
        Group(
            [Cone((x, 0, z), (x, 0.4, z), 0.17, 0.23, pot), Cylinder((x, 0.36, z), (x, 0.41, z), 0.245, pot)],
            name="pot",
        ),
        Group(crown, Place(x, 0.4, z) @ Swing("z", 1.6, rng.uniform(2.5, 4.5), rng.random()), name="plant"),
    ]


def leaf_material(rng: np.random.Generator, autumn=0.0) -> Material:
    """Return foliage green, turning yellow and red with `autumn` from 0 to 1."""
    green = np.array(vary(rng, (0.12, 0.24, 0.05), 0.35))
    turned = np.array(vary(rng, pick(rng, (0.5, 0.28, 0.04), (0.45, 0.14, 0.03), (0.5, 0.38, 0.06)), 0.2))
    color = tuple(green + (turned - green) * autumn)
    return Material(
        color,
        tint(color, 0.28),
        "leaves",
        scale=0.4,
        roughness=0.8,
        specular=0.02,
        seed=int(rng.integers(1 << 16)),
    )


def bark_material(rng: np.random.Generator) -> Material:
    color = vary(rng, pick(rng, (0.26, 0.19, 0.13), (0.2, 0.16, 0.12), (0.34, 0.3, 0.25), (0.3, 0.17, 0.1)), 0.2)
    return Material(color, tint(color, 0.35), "bark", scale=0.22, roughness=0.95, seed=int(rng.integers(1 << 16)))


def broad_tree(x, z, rng: np.random.Generator, height, bark, leaf, blobs=14) -> list[Group]:
    """Return trunk with branches, and a crown of leafy blobs in two parts that sway."""
    trunk_top, radius = 0.5 * height, 0.028 * height * rng.uniform(0.8, 1.25)
    trunk = [
        Cone((0, -0.1, 0), (0, 0.35, 0), radius * 1.7, radius * 1.05, bark),
        Cone((0, 0.3, 0), (0, trunk_top, 0), radius * 1.06, radius * 0.65, bark),
    ]
    crowns = [[], []]
    for k in range(blobs):
        angle = 2.4 * k + rng.uniform(-0.4, 0.4)
        level = (k + 0.5) / blobs
        reach = 0.24 * height * np.sqrt(np.sin(np.pi * (0.12 + 0.82 * level))) * rng.uniform(0.55, 1.0)
        size = 0.43 * height / np.sqrt(blobs) * rng.uniform(0.7, 1.2)
        center = (np.cos(angle) * reach, height * (0.42 + 0.5 * level), np.sin(angle) * reach)
        radii = (size * rng.uniform(1, 1.35), size * rng.uniform(0.7, 0.9), size * rng.uniform(1, 1.35))
        crowns[k % 2].append(Ellipsoid(center, radii, leaf))
        if k % 3 == 0:
            foot = (0, height * (0.3 + 0.2 * level), 0)
            trunk.append(Cone(foot, center, radius * 0.4, radius * 0.12, bark))
    at = Place(x, 0, z, yaw=float(rng.uniform(0, 360)))
    groups = [Group(trunk, at, name="trunk")]
    for part in crowns:
        sway = Swing((rng.uniform(-1, 1), 0, 1), 0.5, rng.uniform(2.5, 5.0), rng.random())
        groups.append(Group(part, at @ sway, name="crown"))
    return groups


def conifer(x, z, rng: np.random.Generator, height, bark, leaf) -> list[Group]:
    """Return a spruce: a thin trunk and stacked cones."""
    lean = Place(x, 0, z, yaw=float(rng.uniform(0, 360)), roll=float(rng.uniform(-2, 2)))
    prims = [Cone((0, -0.1, 0), (0, 0.9 * height, 0), 0.03 * height, 0.006 * height, bark)]
    tiers = 6
    for k in range(tiers):
        low = height * (0.16 + 0.78 * k / tiers)
        prims.append(
            Cone(
                (0, low, 0),
                (0, low + 0.26 * height, 0),
                height * 0.19 * (1 - 0.8 * k / tiers),
                0.012 * height,
                leaf,
            )
        )
    return [Group(prims, lean @ Swing("x", 0.35, rng.uniform(3, 5), rng.random()), name="conifer")]


def pendant(x, y, z, drop, color, swing: Motion, shade: Material) -> list[Group]:
    """Return a lamp on a cord below (x, y, z); its bulb is at (0, −drop, 0) of the returned motion's space."""
    bulb = Material(tint(color, 0.5), emission=tint(color, 1.0))
    at = Place(x, y, z) @ swing
    return [
        Group([Capsule((0, 0, 0), (0, 0.1 - drop, 0), 0.008, IRON)], at, casts_shadow=False, name="cord"),
        Group(
            [Cone((0, 0.02 - drop, 0), (0, 0.2 - drop, 0), 0.22, 0.05, shade)],
            at,
            casts_shadow=False,
            name="shade",
        ),
        Group([Sphere((0, -drop - 0.02, 0), 0.07, bulb)], at, casts_shadow=False, name="bulb"),
    ]


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


Luminaire = tuple[list[Light], list[Group]]


def bulb_material(color, brightness=4.0) -> Material:
    return Material(tint(color, 0.5), emission=tint(color, brightness), contrast=0.0)


def swinging_lamp(at: Motion, drop, color, strength, swing: Swing, shade: Material, size=0.015, angle=75) -> Luminaire:
    """Return a shaded lamp on a cord of length `drop` below `at`, which swings."""
    groups = pendant(0.0, 0.0, 0.0, drop, tint(color, 4), swing, shade)
    for group in groups:
        group.motion = at @ group.motion
    light = Light("spot", (0, -drop - 0.03, 0), tint(color, strength), size, angle=angle, motion=at @ swing)
    return [light], groups


def spotlight(at: Motion, color, strength, shade: Material, size=0.012, angle=45) -> Luminaire:
    """Return a small can that shines along the −y of `at`."""
    groups = [
        Group([Cone((0, -0.02, 0), (0, 0.2, 0), 0.09, 0.05, shade)], at, casts_shadow=False, name="spotlight"),
        Group([Sphere((0, -0.025, 0), 0.05, bulb_material(color))], at, casts_shadow=False, name="bulb"),
    ]
    return [Light("spot", (0, -0.03, 0), tint(color, strength), size, angle=angle, motion=at)], groups


def turning_lantern(
    at: Motion, color, strength, rate, bars, radius, height, frame: Material, thick=0.018, lean=0.0
) -> Luminaire:
    """Return a lamp in a cage of upright bars that turns about y and throws their shadows all around.

    `lean` turns the top ring against the bottom one, in degrees.
    """
    cage, half, ring = [], height / 2, 2 * np.pi * np.arange(bars + 1) / bars
    for a, b in zip(ring[:-1], ring[1:], strict=True):
        top, after = a + np.radians(lean), b + np.radians(lean)
        foot = (radius * np.cos(a), -half, radius * np.sin(a))
        head = (radius * np.cos(top), half, radius * np.sin(top))
        cage += [
            Capsule(foot, head, thick, frame),
            Capsule(foot, (radius * np.cos(b), -half, radius * np.sin(b)), 0.7 * thick, frame),
            Capsule(head, (radius * np.cos(after), half, radius * np.sin(after)), 0.7 * thick, frame),
        ]
    groups = [
        Group(cage, at @ Spin("y", rate), name="cage"),
        Group([Sphere((0, 0, 0), 0.05, bulb_material(color, 6.0))], at, casts_shadow=False, name="bulb"),
    ]
    return [Light("lamp", (0, 0, 0), tint(color, strength), 0.005, motion=at)], groups


def beacon(at: Motion, color, strength, rate, angle=24.0, dip=6.0, beams=2) -> Luminaire:
    """Return a warning light: a dome with beams that turn about y, dipped by `dip` degrees."""
    turn = at @ Place(0, 0.14, 0) @ Spin("y", rate)
    lights = []
    for k in range(beams):
        a, down = 2 * np.pi * k / beams, np.radians(dip)
        axis = (np.sin(a) * np.cos(down), -np.sin(down), np.cos(a) * np.cos(down))
        lights.append(Light("spot", (0, 0, 0), tint(color, strength), 0.02, axis, angle, motion=turn))
    dome = Material(tint(color, 0.5), emission=tint(color, 1.6), roughness=0.2, contrast=0.0)
    reflector = [Cylinder((0.0, -0.07, 0), (0.0, 0.07, 0), 0.035, IRON)]
    for k in range(beams):
        a = 2 * np.pi * (k + 0.5) / beams
        reflector.append(Capsule((0, 0, 0), (0.075 * np.sin(a), 0, 0.075 * np.cos(a)), 0.05, IRON))
    groups = [
        Group([Cylinder((0, 0, 0), (0, 0.05, 0), 0.12, IRON)], at, casts_shadow=False, name="beacon"),
        Group([Sphere((0, 0.14, 0), 0.1, dome)], at, casts_shadow=False, name="dome"),
        Group(reflector, turn @ Place(0, 0.1, 0), casts_shadow=False, name="reflector"),
    ]
    return lights, groups


def gazing_ball(at: Motion, color, strength, rate, beams=5, angle=10.0, lift=9.0) -> Luminaire:
    """Return a turning ball of mirrors that throws patches of light around, raised by `lift` degrees."""
    turn, lights = at @ Spin("y", rate), []
    for k in range(beams):
        a, up = 2 * np.pi * k / beams, np.radians(lift * (0.5 + k % 3))
        axis = (np.sin(a) * np.cos(up), np.sin(up), np.cos(a) * np.cos(up))
        lights.append(Light("spot", (0, 0, 0), tint(color, strength), 0.01, axis, angle, motion=turn))
    chrome = Material((0.86, 0.87, 0.88), specular=0.85, roughness=0.03, mirror=1.0, contrast=0.0)
    facets = [
        Sphere((0.05 * np.cos(a), 0.04 * np.sin(2 * a), 0.05 * np.sin(a)), 0.21, chrome) for a in (0.3, 1.9, 3.6, 5.1)
    ]
    return lights, [Group(facets, turn, casts_shadow=False, name="gazing ball")]


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


def walker(path: Path, rng: np.random.Generator) -> list[Group]:
    """Return a person who walks along `path` at its speed: ten rigid groups; looks come from `rng`."""
    h = float(rng.uniform(1.58, 1.9)) / 1.75
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
