"""Furniture that scenes share: railings, plants, trees, benches, window walls. Each function returns groups."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.parts.motions import Motion, Place, Swing
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
    tint,
    vary,
)

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


def wall_with_windows(x, z_start, z_end, height, sill, head, width, pitch, wall, frame, glass=True) -> list[Group]:
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
        if glass:
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
