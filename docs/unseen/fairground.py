"""A fairground at night, 800×450: a big wheel with bright bulbs, a carousel, lights on wires, visitors, barriers."""

from __future__ import annotations

import numpy as np

import gffe_cl as gffe
from unseen.posed import PosedScene, ball, mesh, sheet, tube
from unseen.recording import wobble

_STILL, _WHEEL, _CABIN, _CAROUSEL, _HORSE, _VISITOR, _LIMB = range(7)
_GLOW = 10  # added to a kind: it shines by itself

_POSE = """
#define HUB vec3(-3.5, 15.0, 8.2)
#define MIDDLE vec3(3.2, 6.0, 0.0)
vec3 around_y(vec3 p, float a) { return vec3(cos(a) * p.x - sin(a) * p.z, p.y, sin(a) * p.x + cos(a) * p.z); }
vec3 around_z(vec3 p, float a) { return vec3(cos(a) * p.x - sin(a) * p.y, sin(a) * p.x + cos(a) * p.y, p.z); }
vec3 posed(vec3 p, int kind, vec4 a, vec4 b, float t) {
    if (kind >= 10) kind -= 10;
    if (kind == 1) return HUB + around_y(p, 0.45 * t);
    if (kind == 2)  // a: place on the wheel, phase of its swing
        return HUB + around_y(a.xyz, 0.45 * t) + around_y(p, 0.2 * sin(2.3 * t + a.w));
    if (kind == 3) return MIDDLE + around_z(p, 1.1 * t);
    if (kind == 4)  // a: place on the carousel, phase; it goes up and down
        return MIDDLE + around_z(a.xyz + around_z(p, atan(a.y, a.x) + 1.5708)
            + vec3(0, 0, 0.3 * sin(3.1 * t + a.w)), 1.1 * t);
    if (kind >= 5) {  // a: start, heading; b: speed, phase, of a limb its joint and its swing
        float swing = kind == 6 ? b.w * sin(7.0 * t + b.y) : 0.0;
        vec3 q = kind == 6 ? vec3(0, 0, b.z) + around_y(p - vec3(0, 0, b.z), swing) : p;
        q.z += 0.03 * abs(sin(7.0 * t + b.y));
        return a.xyz + around_z(q + vec3(b.x * t, 0, 0), a.w);
    }
    return p;
}
"""
_SHADE = """
vec3 lamp(vec3 n, vec3 at, vec3 power) {
    vec3 to = at - world;
    return power * max(dot(n, normalize(to)), 0.0) / (0.6 + dot(to, to));
}
vec3 shaded(vec3 n) {
    if (what >= 10) return tint;
    vec3 paint = tint * (0.35 + 1.2 * grain(0.9 * object) * (0.6 + 0.8 * grain(0.13 * object)));
    if (what == 0 && n.z > 0.9) {
        vec2 stone = abs(fract(world.xy * 2.0 + vec2(0.5 * floor(world.y * 2.0), 0)) - 0.5);
        paint *= max(stone.x, stone.y) > 0.46 ? 0.4 : 1.0;
    }
    if (what == 3 && n.z < 0.5) paint *= 0.5 + step(0.5, fract(atan(object.y, object.x) * 3.8197));
    vec3 light = vec3(0.03, 0.035, 0.06) + 0.02 * n.z;
    for (int k = 0; k < 5; k++) light += lamp(n, vec3(-6.0 + 3.0 * k, 2.2, 4.1), vec3(6.0, 4.4, 2.6));
    light += lamp(n, vec3(3.2, 6.0, 3.0), vec3(9.0, 5.0, 3.5)) + lamp(n, vec3(-3.5, 13.0, 8.2), vec3(8.0, 6.0, 14.0));
    float turn = 1.1 * now;
    light += lamp(n, vec3(3.2 + 3.5 * cos(turn), 6.0 + 3.5 * sin(turn), 3.2), vec3(2.0, 5.0, 7.0));
    return paint * light;
}
"""


class Fairground(PosedScene):
    """A visitor who walks along a barrier and looks around."""

    def __init__(self, width: int = 800, height: int = 450, frames: int = 12):
        super().__init__(width, height, frames, _contents(), _POSE, _SHADE, (0.004, 0.006, 0.016))

    def camera(self, time: float) -> gffe.Camera:
        """Return the camera at `time` (seconds)."""
        step = 0.02 * abs(np.sin(6.0 * time))
        position = np.array([-2.6 + 1.3 * time, -4.6 + 0.2 * time, 1.65 + step])
        target = position + (1.1 * np.sin(1.4 * time) + 0.03 * wobble(time, (9, 14), 3), 5, 0.75 - 0.5 * time)
        focal = 0.72 * self.width
        return gffe.Camera.look_at(position, target, (0.01, 0, 1), focal, focal, self.width / 2, self.height / 2)


def _circle(radius: float, count: int, y: float = 0.0) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count + 1) / count
    return np.stack([radius * np.cos(angle), np.full(count + 1, y), radius * np.sin(angle)], -1)


def _box(low, high) -> np.ndarray:
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)], float)
    faces = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    return np.array([corners[[face[k] for k in pick]] for face in faces for pick in ((0, 1, 2), (0, 2, 3))])


def _contents() -> np.ndarray:
    rng = np.random.default_rng(53)
    grid = np.stack([*np.meshgrid(np.linspace(-30, 30, 31), np.linspace(-8, 40, 25)), np.zeros((25, 31))], -1)
    parts = [mesh(sheet(grid), (0.5, 0.46, 0.42))]
    for k in range(16):  # booths at the back
        x, tall, paint = -24 + 3.1 * k, rng.uniform(2.4, 4.5), rng.uniform(0.2, 0.8, 3)
        parts.append(mesh(_box((x, 21, 0), (x + 2.6, 23, tall)), paint))
        parts.append(mesh(_box((x + 0.3, 20.9, 1.0), (x + 2.3, 21, 1.9)), rng.uniform(0.5, 3.0, 3), _GLOW))
    return np.vstack([*parts, *_wheel(), *_carousel(rng), *_wires(), *_barrier(), *_visitors(rng)])


def _wheel() -> list[np.ndarray]:
    steel, parts = (0.55, 0.55, 0.6), []
    for y in (-0.5, 0.5):
        parts += [mesh(tube(_circle(radius, 48, y), 0.06, 6), steel, _WHEEL) for radius in (6.6, 5.4)]
        for place in _circle(6.6, 24, y)[:-1]:
            parts.append(mesh(tube([(0, y, 0), place], 0.035, 5), steel, _WHEEL))
        for k, place in enumerate(_circle(6.75, 72, 1.1 * y)[:-1]):
            parts.append(mesh(ball(place, 0.09, 4), ((14, 9, 4), (3, 10, 14), (14, 3, 5))[k % 3], _WHEEL + _GLOW))
    for k, place in enumerate(_circle(6.6, 12)[:-1]):
        paint = ((0.7, 0.15, 0.1), (0.15, 0.3, 0.7), (0.75, 0.6, 0.1))[k % 3]
        parts.append(mesh(_box((-0.6, -0.45, -1.5), (0.6, 0.45, -0.5)), paint, _CABIN, (*place, k)))
        parts.append(mesh(tube([(0, 0, 0), (0, 0, -0.5)], 0.05, 5), steel, _CABIN, (*place, k)))
    legs = [((-3.5, 15.8, 8.2), (-3.5 + side, 16.2, 0)) for side in (-3, 3)]
    return parts + [mesh(tube(leg, 0.16), steel) for leg in legs]


def _carousel(rng: np.random.Generator) -> list[np.ndarray]:
    angle, parts = 2 * np.pi * np.arange(33) / 32, []
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    wall, roof = (0.0, 0.35, 2.6, 2.6, (0.6, 0.2, 0.15)), (2.9, 4.2, 2.7, 0.1, (0.7, 0.6, 0.4))
    for low, high, inner, outer, paint in (wall, roof):
        parts.append(mesh(sheet(np.stack([inner * ring + (0, 0, low), outer * ring + (0, 0, high)])), paint, _CAROUSEL))
    parts.append(mesh(sheet(np.stack([0 * ring, 2.6 * ring]) + (0, 0, 0.35)), (0.5, 0.35, 0.2), _CAROUSEL))
    parts.append(mesh(tube([(0, 0, 0.3), (0, 0, 3.2)], 0.5, 16), (0.7, 0.55, 0.3), _CAROUSEL))
    for k in range(32):
        bulb = 2.72 * ring[k] + (0, 0, 2.86)
        parts.append(mesh(ball(bulb, 0.05, 4), (16, 12, 6), _CAROUSEL + _GLOW))
    for k in range(10):
        a = 2 * np.pi * k / 10
        place, pose = (2.1 * np.cos(a), 2.1 * np.sin(a), 1.25), rng.uniform(0, 6)
        hide = rng.uniform(0.3, 0.9, 3)
        limbs = [ball((0, 0, 0), (0.5, 0.16, 0.2), 6), ball((0.55, 0, 0.32), (0.2, 0.08, 0.12), 5)]
        limbs += [tube([(0.3, 0, 0.1), (0.55, 0, 0.35)], 0.09, 6)]
        limbs += [tube([(x, y, 0), (1.3 * x, y, -0.55)], 0.05, 5) for x in (-0.35, 0.35) for y in (-0.1, 0.1)]
        parts += [mesh(limb, hide, _HORSE, (*place, pose)) for limb in limbs]
        parts.append(mesh(tube([(0, 0, -0.6), (0, 0, 1.6)], 0.025, 5), (0.8, 0.7, 0.3), _HORSE, (*place, pose)))
    return parts


def _wires() -> list[np.ndarray]:
    """Return strings of lights between posts, in front of everything."""
    parts = []
    for y in (-1.0, 2.2):
        for k in range(6):
            x = -9 + 3.2 * k + 0.5 * y
            parts.append(mesh(tube([(x, y, 0), (x, y, 4.2)], 0.04, 6), (0.25, 0.25, 0.27)))
            span = np.linspace(0, 1, 15)
            line = np.stack([x + 3.2 * span, np.full(15, y), 4.1 - 1.6 * span * (1 - span)], -1)
            parts.append(mesh(tube(line, 0.008, 4), (0.05, 0.05, 0.05)))
            parts += [mesh(ball(at - (0, 0, 0.05), 0.035, 4), (24, 17, 9), _GLOW) for at in line[1::2]]
    return parts


def _barrier() -> list[np.ndarray]:
    steel, parts = (0.6, 0.6, 0.62), []
    for z in (0.25, 1.1):
        parts.append(mesh(tube([(-9, 0.6, z), (9, 0.6, z)], 0.022, 6), steel))
    return parts + [mesh(tube([(x, 0.6, 0.25), (x, 0.6, 1.1)], 0.011, 5), steel) for x in np.arange(-9, 9, 0.12)]


def _visitors(rng: np.random.Generator) -> list[np.ndarray]:
    parts = []
    for k in range(22):
        start = (rng.uniform(-6, 6), rng.uniform(1.2, 5.5) if k < 15 else rng.uniform(-2.2, 0.2), 0.0)
        heading = rng.choice([0, np.pi]) + rng.normal(0, 0.2)
        speed, phase = rng.uniform(0.8, 1.6), rng.uniform(0, 6)
        cloth, trousers, skin = rng.uniform(0.1, 0.9, 3), rng.uniform(0.05, 0.4, 3), (0.6, 0.42, 0.33)
        body = (_VISITOR, (*start, heading), (speed, phase, 0, 0))
        parts.append(mesh(ball((0, 0, 1.2), (0.16, 0.23, 0.36), 6), cloth, *body))
        parts.append(mesh(ball((0, 0, 1.68), (0.11, 0.1, 0.14), 6), skin, *body))
        for side in (-1, 1):
            leg = (_LIMB, (*start, heading), (speed, phase, 0.9, 0.5 * side))
            arm = (_LIMB, (*start, heading), (speed, phase, 1.45, -0.4 * side))
            parts.append(mesh(tube([(0, 0.1 * side, 0.9), (0, 0.1 * side, 0.05)], (0.09, 0.055), 6), trousers, *leg))
            parts.append(mesh(tube([(0, 0.26 * side, 1.45), (0.05, 0.28 * side, 0.85)], 0.05, 6), cloth, *arm))
    return parts
