"""An aquarium, 720×405: schools of fish that bend, weeds that sway, bubbles, light that ripples over all of it."""

from __future__ import annotations

import numpy as np

import gffe_cl as gffe
from unseen.posed import PosedScene, ball, mesh, sheet, tube
from unseen.recording import wobble

_STILL, _FISH, _WEED, _BUBBLE = range(4)

_POSE = """
vec3 posed(vec3 p, int kind, vec4 a, vec4 b, float t) {
    if (kind == 1) {  // a: middle of its round, phase; b: radii, angular speed, size
        float turn = b.z * t + a.w;
        vec3 at = a.xyz + vec3(b.x * cos(turn), b.y * sin(turn), 0.2 * sin(1.7 * turn + a.w));
        vec2 ahead = normalize(vec2(-b.x * sin(turn), b.y * cos(turn)) * sign(b.z));
        float back = 0.5 - p.x;
        float side = p.y + 0.16 * back * back * sin(11.0 * t + 4.0 * back + 3.0 * a.w);
        return at + b.w * vec3(p.x * ahead + side * vec2(-ahead.y, ahead.x), p.z);
    }
    if (kind == 2)  // a: phase, height
        return p + p.z * p.z / a.y * vec3(0.35 * sin(1.6 * t + a.x + 1.3 * p.z), 0.25 * cos(1.2 * t + 2.0 * a.x), 0);
    if (kind == 3)  // a: speed, phase
        return p + vec3(0.05 * sin(5.0 * t + a.y), 0.04 * cos(4.0 * t + a.y), a.x * t);
    return p;
}
"""
_SHADE = """
float ripples(vec2 p) {
    float a = texture(noise, 0.09 * p + 0.05 * now).r, b = texture(noise, 0.11 * p.yx - 0.06 * now).r;
    return pow(max(1.0 - 2.2 * abs(a - b), 0.0), 6.0);
}
vec3 shaded(vec3 n) {
    vec3 paint = tint * (0.45 + 1.1 * grain(0.6 * object));
    if (what == 1) {
        float band = smoothstep(0.1, 0.2, abs(fract(3.0 * object.x + 0.4 * object.z) - 0.5));
        paint = mix(tint.zxy, tint, band) * (0.6 + 0.7 * grain(2.5 * object));
        if (length(object.xz - vec2(0.36, 0.03)) < 0.035) paint = vec3(0.01);
    }
    float down = 0.5 + 0.5 * n.z;
    vec3 light = mix(vec3(0.05, 0.11, 0.15), vec3(0.3, 0.52, 0.56), down);
    light += max(n.z + 0.3, 0.0) * 1.6 * ripples(world.xy + 0.4 * world.z) * vec3(0.8, 1.0, 0.9);
    vec3 c = paint * light;
    if (what == 3) c = vec3(0.35, 0.6, 0.65) + 2.5 * pow(max(n.z, 0.0), 24.0);
    return mix(vec3(0.03, 0.16, 0.22), c, exp(-0.075 * length(eye - world)));
}
"""


class Aquarium(PosedScene):
    """A diver's look around while fish of three sizes cross."""

    def __init__(self, width: int = 720, height: int = 405, frames: int = 12):
        super().__init__(width, height, frames, _contents(), _POSE, _SHADE, (0.03, 0.16, 0.22))

    def camera(self, time: float) -> gffe.Camera:
        """Return the camera at `time` (seconds)."""
        position = np.array([-1.2 + 1.1 * time, -6.5 + 0.4 * time, 1.9 + 0.15 * wobble(time, (2.1, 3.3), 1)])
        target = position + (0.9 - 1.9 * time + 0.1 * wobble(time, (4, 7), 2), 6, -0.25)
        focal = 0.85 * self.width
        return gffe.Camera.look_at(position, target, (0, 0, 1), focal, focal, self.width / 2, self.height / 2)


def _contents() -> np.ndarray:
    rng, parts = np.random.default_rng(37), []
    x, y = np.meshgrid(np.linspace(-16, 16, 65), np.linspace(-8, 14, 45))
    sand = np.stack([x, y, 0.25 * np.sin(0.9 * x) * np.cos(0.7 * y) + 0.03 * (y > 9) * (y - 9) ** 3], -1)
    parts.append(mesh(sheet(sand), (0.62, 0.52, 0.36)))
    for _ in range(26):
        at = np.array([rng.uniform(-8, 8), rng.uniform(-1, 9), 0.1])
        parts.append(mesh(ball(at, rng.uniform(0.2, 1.1, 3), 6), rng.uniform(0.15, 0.5, 3)))
    for _ in range(90):
        foot, tall = np.array([rng.uniform(-7, 7), rng.uniform(-3.5, 6), 0.0]), rng.uniform(0.8, 3.4)
        up = np.linspace(0, 1, 14)[:, None]
        wide = rng.uniform(0.02, 0.09) * (1.05 - up**2)
        edges = [foot + up * (0, 0, tall) + side * wide * (1, 0.4, 0) for side in (-1, 1)]
        color = np.array([0.15, 0.42, 0.14]) * rng.uniform(0.5, 1.6, 3)
        parts.append(mesh(sheet(np.stack(edges, 1)), color, _WEED, (rng.uniform(0, 6), tall, 0, 0)))
    for k in range(70):
        size = (0.35, 0.6, 1.3)[0 if k < 44 else 1 if k < 62 else 2] * rng.uniform(0.8, 1.2)
        middle = rng.uniform((-4, -1.5, 0.7), (4, 5, 3.4))
        radii, speed = rng.uniform(1.5, 4.5, 2), rng.choice([-1, 1]) * rng.uniform(0.4, 0.9)
        pose = (_FISH, (*middle, rng.uniform(0, 6.3)), (*radii, speed, size))
        color = rng.uniform(0.1, 0.9, 3)
        parts.append(mesh(ball((0.1, 0, 0), (0.4, 0.09, 0.17), 8), color, *pose))
        tail = [[(-0.22, 0, 0), (-0.5, 0, 0.2), (-0.42, 0, 0)], [(-0.22, 0, 0), (-0.42, 0, 0), (-0.5, 0, -0.2)]]
        fin = [[(0.2, 0, 0.14), (-0.15, 0, 0.28), (-0.1, 0, 0.1)]]
        parts.append(mesh(tail + fin, 0.8 * color, *pose))
    for _ in range(60):
        at = rng.uniform((-3, -4, 0), (3, 3, 3.5))
        pose = (rng.uniform(0.7, 1.4), rng.uniform(0, 6), 0, 0)
        parts.append(mesh(ball(at, rng.uniform(0.012, 0.05), 5), (1, 1, 1), _BUBBLE, pose))
    mast = [(2.4, 2.5, 0), (2.1, 2.6, 2.0), (1.4, 2.8, 5.0)]
    parts.append(mesh(tube(mast, 0.12), (0.34, 0.22, 0.13)))
    ribs = np.linspace(0, np.pi, 12)
    for k in range(7):
        rib = [(-3 + 0.7 * k, 3.4 + 1.2 * np.cos(a), 0.2 + 1.5 * np.sin(a)) for a in ribs]
        parts.append(mesh(tube(rib, 0.07), (0.3, 0.2, 0.12)))
    return np.vstack(parts)
