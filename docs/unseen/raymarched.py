"""Raymarched signed-distance fields, 854×480: fractal pillars, swinging balls, soft shadows of a moving sun."""

from __future__ import annotations

import math

import moderngl
import numpy as np

import gffe_cl as gffe
from unseen.opengl import SupersampledScene, Target, array_bytes, matrix_bytes
from unseen.recording import placed, wobble

_BALLS = 5
_MOVERS = _BALLS + 2  # and two rings that turn
_SUPERSAMPLING = 2

_VERTEX = """#version 330
in vec2 corner;
void main() { gl_Position = vec4(corner, 0, 1); }
"""
_FIELD = """#version 330
#define MOVERS %d
#define BALLS %d
uniform mat4 view_to_world, previous_view;
uniform mat4 to_object[MOVERS], previous_from_current[MOVERS];
uniform vec4 pinhole;
uniform vec2 size;
uniform vec3 sun;

float box(vec3 p, vec3 b) { vec3 q = abs(p) - b; return length(max(q, 0)) + min(max(q.x, max(q.y, q.z)), 0); }

float pillar(vec3 p) {  // a Menger-like column, folded three times
    float d = box(p - vec3(0, 0, 2.5), vec3(0.55, 0.55, 2.5)), scale = 1.6;
    for (int k = 0; k < 3; k++) {
        vec3 a = mod(p * scale, 2.0) - 1.0;
        scale *= 3.0;
        vec3 r = abs(1.0 - 3.0 * abs(a));
        float cross = (min(max(r.x, r.y), min(max(r.y, r.z), max(r.z, r.x))) - 1.0) / scale;
        d = max(d, cross);
    }
    return d;
}

vec2 nearer(vec2 a, vec2 b) { return a.x < b.x ? a : b; }

// Distance, and what is there: 0 floor, 1 pillars, 2 arches, 3 … movers.
vec2 field(vec3 p) {
    vec2 d = vec2(p.z + 0.06 * sin(p.x * 1.3) * sin(p.y * 1.1), 0);
    vec3 q = vec3(mod(p.x + 2.0, 4.0) - 2.0, mod(p.y + 2.5, 5.0) - 2.5, p.z);
    float bound = box(q - vec3(0, 0, 2.5), vec3(0.6, 0.6, 2.6));
    d = nearer(d, vec2(bound > 0.3 ? bound : pillar(q), 1));
    vec2 arch = vec2(length(vec2(q.x, p.z - 5.2)) - 0.35, 2);
    arch.x = max(arch.x, -(length(vec2(mod(p.y, 0.5) - 0.25, p.z - 5.2)) - 0.18));
    d = nearer(d, arch);
    for (int k = 0; k < MOVERS; k++) {
        vec3 o = (to_object[k] * vec4(p, 1)).xyz;
        float away;
        if (k < BALLS) {
            away = min(length(o) - 0.45, max(length(o.xy) - 0.02, abs(o.z - 2.0) - 2.0));
            if (away < 0.2) away = max(away, -(length(abs(o) - 0.3) - 0.14));
        } else {
            vec2 ring = vec2(length(o.xy) - 1.1, o.z);
            away = length(ring) - 0.12;
            float angle = atan(o.y, o.x), part = 6.2831853 / 8.0;
            angle = mod(angle + 0.5 * part, part) - 0.5 * part;
            vec3 spoke = vec3(length(o.xy) * vec2(cos(angle), sin(angle)), o.z);
            away = min(away, box(spoke - vec3(0.6, 0, 0), vec3(0.5, 0.04, 0.04)));
        }
        d = nearer(d, vec2(away, 3 + k));
    }
    return d;
}

vec3 outward(vec3 p, float step) {
    vec2 e = vec2(step, -step);
    return normalize(e.xyy * field(p + e.xyy).x + e.yyx * field(p + e.yyx).x
        + e.yxy * field(p + e.yxy).x + e.xxx * field(p + e.xxx).x);
}

vec2 march(vec3 from, vec3 along, float far) {  // distance, what
    float t = 0.02;
    vec2 d = vec2(0);
    for (int k = 0; k < 160 && t < far; k++) {
        d = field(from + t * along);
        if (d.x < 0.0004 * t) return vec2(t, d.y);
        t += 0.9 * d.x;
    }
    return vec2(t < far ? t : -1.0, d.y);
}

vec3 ray(vec2 pixel) { return vec3((pixel - pinhole.zw) / pinhole.xy, 1); }
vec2 pixel_here() { return vec2(gl_FragCoord.x, size.y - gl_FragCoord.y); }
"""
_COLOR = """
out vec4 color;
float hash(vec3 p) { return fract(sin(dot(floor(p), vec3(127.1, 311.7, 74.7))) * 43758.5453); }
float noise(vec3 p) {
    vec3 i = floor(p), f = fract(p);
    f = f * f * (3.0 - 2.0 * f);
    vec4 low = vec4(hash(i), hash(i + vec3(1, 0, 0)), hash(i + vec3(0, 1, 0)), hash(i + vec3(1, 1, 0)));
    i.z += 1.0;
    vec4 high = vec4(hash(i), hash(i + vec3(1, 0, 0)), hash(i + vec3(0, 1, 0)), hash(i + vec3(1, 1, 0)));
    vec4 at = mix(low, high, f.z);
    return mix(mix(at.x, at.y, f.x), mix(at.z, at.w, f.x), f.y);
}
float detail(vec3 p) { return 0.5 * noise(p) + 0.3 * noise(2.3 * p) + 0.2 * noise(5.1 * p); }
vec3 sky(vec3 d) { return mix(vec3(0.75, 0.62, 0.5), vec3(0.16, 0.3, 0.6), pow(clamp(d.z, 0, 1), 0.5))
    + vec3(2.0, 1.5, 0.9) * pow(max(dot(d, sun), 0), 200.0); }
float shadow(vec3 p) {
    float lit = 1.0, t = 0.03;
    for (int k = 0; k < 48 && t < 14.0; k++) {
        float d = field(p + t * sun).x;
        if (d < 0.0006) return 0.0;
        lit = min(lit, 14.0 * d / t);
        t += clamp(d, 0.02, 0.5);
    }
    return lit * lit * (3.0 - 2.0 * lit);
}
void main() {
    vec3 from = view_to_world[3].xyz, along = normalize(mat3(view_to_world) * ray(pixel_here()));
    vec2 hit = march(from, along, 60.0);
    if (hit.x < 0.0) { color = vec4(sky(along), 1); return; }
    vec3 p = from + hit.x * along, n = outward(p, 0.0007 * hit.x);
    vec3 paint, o = p;
    int what = int(hit.y + 0.5);
    if (what >= 3) o = (to_object[what - 3] * vec4(p, 1)).xyz;
    if (what == 0) {
        vec2 tile = floor(p.xy * 1.5);
        paint = mix(vec3(0.34, 0.26, 0.2), vec3(0.6, 0.54, 0.44), mod(tile.x + tile.y, 2.0)) * (0.5 + detail(9.0 * p));
    } else if (what == 1) {
        paint = mix(vec3(0.55, 0.5, 0.42), vec3(0.3, 0.36, 0.4), detail(7.0 * p)) * (0.7 + 0.5 * detail(25.0 * p));
    } else if (what == 2) paint = vec3(0.5, 0.24, 0.16) * (0.6 + 0.8 * detail(12.0 * p));
    else if (what < 3 + BALLS) {
        float stripe = step(0.5, fract(3.0 * o.z + 0.25 * sin(8.0 * atan(o.y, o.x))));
        vec3 own = 0.5 + 0.45 * cos(vec3(0, 2, 4) + float(what) * 1.7);
        paint = mix(vec3(0.8, 0.72, 0.6), own, stripe) * (0.6 + 0.6 * detail(8.0 * o));
    } else paint = vec3(0.7, 0.5, 0.2) * (0.5 + 0.8 * detail(14.0 * o));
    float facing = max(dot(n, sun), 0.0);
    float lit = facing > 0.0 ? facing * shadow(p + 0.003 * n) : 0.0;
    float open = clamp(field(p + 0.25 * n).x / 0.25, 0.0, 1.0);
    vec3 around = mix(vec3(0.16, 0.13, 0.1), vec3(0.3, 0.36, 0.48), 0.5 + 0.5 * n.z);
    vec3 shaded = paint * (lit * vec3(2.3, 1.8, 1.3) + (0.3 + 0.7 * open) * around);
    shaded += (what >= 3 ? 0.6 : 0.1) * lit * pow(max(dot(n, normalize(sun - along)), 0.0), 40.0);
    color = vec4(mix(sky(vec3(along.xy, 0.05)), shaded, exp(-hit.x * 0.012)), 1);
}
"""
_GEOMETRY = """
out vec4 depth_and_motion;
void main() {
    vec3 from = view_to_world[3].xyz, direction = ray(pixel_here());
    vec3 along = normalize(mat3(view_to_world) * direction);
    vec2 hit = march(from, along, 60.0);
    if (hit.x < 0.0) { depth_and_motion = vec4(0); return; }
    vec4 p = vec4(from + hit.x * along, 1);
    int what = int(hit.y + 0.5);
    if (what >= 3) p = previous_from_current[what - 3] * p;
    vec3 before = (previous_view * p).xyz;
    vec2 place = pinhole.zw + pinhole.xy * before.xy / before.z;
    depth_and_motion = vec4(hit.x / length(direction), place - pixel_here(), 1);
}
"""


class Raymarched(SupersampledScene):
    """A flight between pillars while balls swing, rings turn and the sun moves."""

    fps = 24.0

    def __init__(self, width: int = 854, height: int = 480, frames: int = 12):
        super().__init__(width, height, frames, _SUPERSAMPLING, outputs=1)
        field = _FIELD % (_MOVERS, _BALLS)
        corners = self._context.buffer(array_bytes([-1, -1, 3, -1, -1, 3]))
        self._passes = {}
        for source, target in zip((_COLOR, _GEOMETRY), self._targets, strict=True):
            program = self._context.program(vertex_shader=_VERTEX, fragment_shader=field + source)
            vertices = self._context.vertex_array(program, [(corners, "2f", "corner")])
            self._passes[target] = program, vertices

    def draw(self, target: Target, camera: gffe.Camera, before: gffe.Camera, now: float, earlier: float) -> None:
        """Draw colors into the target with samples, depth and motion into the other."""
        program, vertices = self._passes[target]
        places, old_places = _places(now), _places(earlier)
        angle = 3.9 + 0.35 * now
        values = {
            "view_to_world": matrix_bytes(camera.view_to_world),
            "previous_view": matrix_bytes(before.world_to_view),
            "to_object": b"".join(matrix_bytes(np.linalg.inv(m)) for m in places),
            "previous_from_current": b"".join(
                matrix_bytes(old @ np.linalg.inv(new)) for new, old in zip(places, old_places, strict=True)
            ),
            "sun": array_bytes(np.array([math.cos(angle), math.sin(angle), 0.75]) / math.hypot(1, 0.75)),
            "pinhole": array_bytes(camera.intrinsics),
            "size": array_bytes([target.width, target.height]),
        }
        for name, value in values.items():
            if name in program:
                program[name].write(value)
        vertices.render(moderngl.TRIANGLES, vertices=3)

    def camera(self, time: float) -> gffe.Camera:
        """Return the camera at `time`: it flies forward and rolls."""
        position = np.array(
            [1.9 + 0.5 * math.sin(1.3 * time), -9.5 + 3.2 * time, 1.9 + 0.25 * wobble(time, (2, 3.7), 2)]
        )
        target = position + (-0.5 + 1.1 * time, 6, 0.35 - 0.4 * time)
        focal = 0.8 * self.width
        return gffe.Camera.look_at(
            position, target, (0.12 * math.sin(2 * time), 0, 1), focal, focal, self.width / 2, self.height / 2
        )


def _places(time: float) -> list[np.ndarray]:
    """Return the model matrix of every mover."""
    places = []
    for k in range(_BALLS):  # pendulums below the arches
        swing = 0.75 * math.sin((2.6 + 0.3 * k) * time + 1.9 * k)
        pivot = ((0.8, 3.1, 1.9, 0.4, 3.4)[k], (-3.6, -1.2, 1.4, 3.5, 6.0)[k], 5.4)
        axis = (math.cos(1.1 * k), math.sin(1.1 * k), 0.2)
        places.append(placed(pivot, swing, axis) @ placed((0, 0, -3.9), 3 * time + k))
    places.append(
        placed((3.9, 0.6, 1.7), 1.9 * time, (0, 0, 1))
        @ placed((0, 0, 0), math.pi / 2, (0, 1, 0))
        @ placed((0, 0, 0), 2.4 * time)
    )
    places.append(
        placed((0.3 + 0.9 * time, -4.8 + 2.2 * time, 0.9), math.pi / 2, (1, 0, 0)) @ placed((0, 0, 0), -2 * time)
    )
    return places
