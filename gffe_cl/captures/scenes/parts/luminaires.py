"""Moving lamps that throw traveling light and shadows. Each function returns its lights and its groups."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.scenes.parts.furniture import IRON, pendant
from gffe_cl.captures.scenes.parts.motions import Motion, Place, Spin, Swing
from gffe_cl.captures.scenes.scene_types import Capsule, Cone, Cylinder, Group, Light, Material, Sphere, tint

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
