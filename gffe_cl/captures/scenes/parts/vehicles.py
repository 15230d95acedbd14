"""Cars with headlights."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.parts.motions import Motion
from gffe_cl.captures.scenes.scene_types import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Group,
    Light,
    Material,
    pick,
    tint,
    vary,
)

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
