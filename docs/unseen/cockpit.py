"""The view out of a shaking vehicle, 640×360, supersampled: dashboard, pillars and a wiper before a mountain road."""

from __future__ import annotations

import functools
import math

import moderngl
import numpy as np

import gffe_cl as gffe
from unseen.opengl import SupersampledScene, Target, array_bytes, matrix_bytes, repeating_texture
from unseen.recording import noise_texture, placed, wobble

_SUPERSAMPLING = 3
_SPEED = 15.0  # of the vehicle, units per second
_NEAR, _FAR = 0.05, 900.0
_SHAKES = (9.0, 13.7, 21.0)

_VERTEX = """#version 330
uniform mat4 model, view, projection, previous_view_model;
in vec3 position, normal, paint;
in float material;
out vec3 object, world, here, before, upward, tint;
flat out int kind;
void main() {
    vec4 placed = model * vec4(position, 1);
    object = position;
    world = placed.xyz;
    here = (view * placed).xyz;
    before = (previous_view_model * vec4(position, 1)).xyz;
    upward = mat3(model) * normal;
    tint = paint;
    kind = int(material + 0.5);
    gl_Position = projection * view * placed;
}
"""
_FRAGMENT = """#version 330
uniform sampler2D noise;
uniform vec3 sun, eye;
uniform vec4 pinhole;
in vec3 object, world, here, before, upward, tint;
flat in int kind;
layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth_and_motion;

float road(float y) { return 7.0 * sin(0.03 * y) + 3.0 * sin(0.071 * y); }
vec2 projected(vec3 p) { return pinhole.zw + pinhole.xy * vec2(p.x, -p.y) / -p.z; }
float around(vec3 p, vec3 n) {  // the texture from three sides
    vec3 w = n * n;
    float mean = w.x * texture(noise, p.yz).r + w.y * texture(noise, p.xz).r + w.z * texture(noise, p.xy).r;
    return smoothstep(0.25, 0.75, mean);
}
void main() {
    vec3 n = normalize(upward);
    float coarse = around(object * 0.07, n), fine = around(object * 0.61, n), grain = around(object * 3.7, n);
    vec3 albedo = tint * (0.3 + 0.5 * coarse + 0.6 * fine + 0.4 * grain);
    float gloss = 0.05;
    if (kind == 1) {
        float across = world.x - road(world.y), along = mod(world.y, 6.0);
        float rock = smoothstep(0.75, 0.6, n.z + 0.25 * (fine - 0.5));
        albedo = mix(mix(vec3(0.2, 0.3, 0.07), vec3(0.42, 0.38, 0.16), fine), vec3(0.45, 0.42, 0.38), rock);
        albedo *= 0.35 + 0.6 * coarse + 0.8 * grain * fine + 0.3 * grain;
        float asphalt = smoothstep(4.4, 4.1, abs(across) + 0.5 * (fine - 0.5));
        albedo = mix(albedo, vec3(0.17, 0.17, 0.18) * (0.5 + grain + 0.4 * coarse), asphalt);
        float line = (abs(across) < 0.09 && along < 3.0) || abs(abs(across) - 3.6) < 0.08 ? 1.0 : 0.0;
        albedo = mix(albedo, vec3(0.85) * (0.6 + 0.5 * fine), line * smoothstep(0.15, 0.35, fine));
    } else if (kind == 2) {  // stitched and printed surfaces of the dashboard
        gloss = 0.4;
        vec2 cell = abs(fract(object.xz * 22.0) - 0.5);
        albedo *= 0.8 + 0.5 * step(0.42, max(cell.x, cell.y));
    } else if (kind == 3) {  // glowing gauges
        float ring = length(object.xz);
        float tick = step(0.8, fract(atan(object.z, object.x) * 5.0)) * step(0.05, ring) * step(ring, 0.065);
        color = vec4(mix(vec3(0.03), vec3(1.0, 0.6, 0.2), tick) + tint * step(1.5, tint.r), 1);
    }
    float facing = max(dot(n, sun), 0.0);
    vec3 toward = normalize(eye - world);
    vec3 light = facing * vec3(1.7, 1.5, 1.2) + mix(vec3(0.14, 0.12, 0.1), vec3(0.28, 0.35, 0.46), 0.5 + 0.5 * n.z);
    vec3 lit = albedo * light + gloss * 2.0 * pow(max(dot(n, normalize(sun + toward)), 0.0), 24.0) * facing;
    if (kind != 3) color = vec4(mix(vec3(0.62, 0.7, 0.8), lit, exp(here.z / 300.0)), 1);
    depth_and_motion = vec4(-here.z, projected(before) - projected(here), 1);
}
"""
_SKY_VERTEX = """#version 330
in vec2 corner;
out vec2 place;
void main() { place = corner; gl_Position = vec4(corner, 1, 1); }
"""
_SKY = """#version 330
uniform sampler2D noise;
uniform mat4 view_to_world;
uniform vec4 pinhole;
uniform vec2 size;
uniform vec3 sun;
in vec2 place;
layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth_and_motion;
void main() {
    vec2 pixel = vec2(place.x + 1.0, 1.0 - place.y) * 0.5 * size;
    vec3 d = normalize(mat3(view_to_world) * vec3((pixel - pinhole.zw) / pinhole.xy, 1));
    vec2 high = d.xy / (abs(d.z) + 0.12);
    float cover = smoothstep(0.5, 0.8, 0.6 * texture(noise, high * 0.03).r + 0.4 * texture(noise, high * 0.11).r);
    color = vec4(mix(vec3(0.62, 0.7, 0.8), vec3(0.13, 0.3, 0.68), sqrt(clamp(d.z, 0.0, 1.0))), 1);
    color.rgb = mix(color.rgb, vec3(1.1, 1.05, 1.0), cover * smoothstep(0.0, 0.15, d.z));
    color.rgb += vec3(3.0, 2.6, 2.0) * pow(max(dot(d, sun), 0.0), 600.0);
    depth_and_motion = vec4(0);
}
"""
_TERRAIN, _DASHBOARD, _GAUGE = 1, 2, 3  # materials; 0: painted


class Cockpit(SupersampledScene):
    """A drive through hills: a truck comes, the wiper swings, the steering wheel turns, the head shakes."""

    fps = 24.0

    def __init__(self, width: int = 640, height: int = 360, frames: int = 16):
        super().__init__(width, height, frames, _SUPERSAMPLING)
        self._program = self._context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        self._sky = self._context.program(vertex_shader=_SKY_VERTEX, fragment_shader=_SKY)
        corners = self._context.buffer(array_bytes([-1, -1, 3, -1, -1, 3]))
        self._sky_vertices = self._context.vertex_array(self._sky, [(corners, "2f", "corner")])
        repeating_texture(self._context, noise_texture(512, 71, 7, 0.75)[..., None]).use(0)
        self._bodies = [(self._mesh(soup), matrix) for soup, matrix in _bodies()]

    def draw(self, target: Target, camera: gffe.Camera, before: gffe.Camera, now: float, earlier: float) -> None:
        """Draw the sky, and before it everything else as it is placed `now`."""
        sun = array_bytes(np.array([-0.55, 0.45, 0.6]) / np.linalg.norm([0.55, 0.45, 0.6]))
        pinhole = array_bytes(camera.intrinsics)
        shared = {"view_to_world": matrix_bytes(camera.view_to_world), "pinhole": pinhole, "sun": sun}
        for name, value in (shared | {"size": array_bytes([target.width, target.height])}).items():
            self._sky[name].write(value)
        self._context.disable(moderngl.DEPTH_TEST)
        self._sky_vertices.render(moderngl.TRIANGLES, vertices=3)
        self._context.enable(moderngl.DEPTH_TEST)
        projection = camera.projection_matrix("opengl", target.width, target.height, _NEAR, _FAR)
        shared = {
            "view": matrix_bytes(camera.view_matrix("opengl")), "projection": matrix_bytes(projection),
            "pinhole": pinhole, "sun": sun, "eye": array_bytes(camera.position),
        }  # fmt: skip
        for name, value in shared.items():
            self._program[name].write(value)
        for vertices, matrix in self._bodies:
            self._program["model"].write(matrix_bytes(matrix(now)))
            self._program["previous_view_model"].write(matrix_bytes(before.view_matrix("opengl") @ matrix(earlier)))
            vertices.render(moderngl.TRIANGLES)

    def camera(self, time: float) -> gffe.Camera:
        """Return the camera at `time`: a head that shakes in the vehicle."""
        head = placed((-0.35, 0, 1.25)) @ placed([0.012 * wobble(time, _SHAKES, seed) for seed in (1, 2, 3)])
        head = head @ placed((0, 0, 0), 0.012 * wobble(time, _SHAKES, 4), (1, 0, 0))
        world_to_head = np.linalg.inv(_vehicle(time) @ head)
        axes = np.eye(4)
        axes[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # x right, y forward, z up → x right, y down, z forward
        focal = 0.62 * self.width
        return gffe.Camera(axes @ world_to_head, focal, focal, self.width / 2, self.height / 2)

    def _mesh(self, soup: np.ndarray) -> moderngl.VertexArray:
        buffer = self._context.buffer(array_bytes(soup))
        return self._context.vertex_array(
            self._program, [(buffer, "3f 3f 3f 1f", "position", "normal", "paint", "material")]
        )


def _road(y):
    return 7 * np.sin(0.03 * y) + 3 * np.sin(0.071 * y)


@functools.cache
def _hills() -> np.ndarray:
    return noise_texture(256, 72, 5, 0.5)


def _ground(x, y):
    """Return the height of the terrain: hills of noise beside a road that rises and falls."""
    away = np.clip((np.abs(x - _road(y)) - 5) / 22, 0, 1)
    hills = _hills()
    place_x, place_y = (np.asarray(v) * 256 / 260 % 256 for v in (x, y))
    low_x, low_y = place_x.astype(int), place_y.astype(int)
    part_x, part_y = place_x - low_x, place_y - low_y
    next_x, next_y = (low_x + 1) % 256, (low_y + 1) % 256
    height = (hills[low_y, low_x] * (1 - part_x) + hills[low_y, next_x] * part_x) * (1 - part_y)
    height += (hills[next_y, low_x] * (1 - part_x) + hills[next_y, next_x] * part_x) * part_y
    return 1.5 * np.sin(0.045 * y) + 34 * away * away * (3 - 2 * away) * height


def _vehicle(time: float) -> np.ndarray:
    """Return the vehicle's model matrix: x right, y forward, z up."""
    return _on_road(_SPEED * time, 1.9, 1.0 + 0.03 * wobble(time, _SHAKES, 7)) @ (
        placed((0, 0, 0), 0.014 * wobble(time, _SHAKES, 8), (1, 0, 0))
        @ placed((0, 0, 0), 0.018 * wobble(time, _SHAKES, 9), (0, 1, 0))
    )


def _on_road(y: float, lane: float, height: float) -> np.ndarray:
    """Return the matrix of what goes along the road, `lane` to the right of its middle."""
    ahead = np.array([_road(y + 1) - _road(y), 1.0])
    rise = 1.5 * (math.sin(0.045 * (y + 1)) - math.sin(0.045 * y))
    turned = placed((0, 0, 0), math.atan2(-ahead[0], ahead[1])) @ placed((0, 0, 0), math.atan(rise), (1, 0, 0))
    return placed((_road(y) + lane, y, 1.5 * math.sin(0.045 * y) + height)) @ turned


def _bodies():
    """Return (triangles as vertices, function of time that gives the model matrix) of everything."""
    bodies = [(np.vstack([_terrain(), _scenery()]), lambda time: np.eye(4))]
    bodies.append((_truck(), lambda time: _on_road(62 - 14 * time, -1.9, 0)))
    inside = np.vstack(
        [
            _box((-1.1, 0.75, 0.55), (1.1, 1.5, 0.93), (0.13, 0.13, 0.15), _DASHBOARD),
            _box((-0.75, 0.68, 0.86), (0.05, 1.0, 1.05), (0.2, 0.16, 0.13), _DASHBOARD),
            _box((0.2, 0.7, 0.7), (0.7, 0.76, 0.9), (0.5, 0.4, 0.3), _DASHBOARD),
            _beam((-1.1, 1.4, 0.85), (-0.85, 0.6, 1.95), 0.055, (0.16, 0.16, 0.17)),
            _beam((1.1, 1.4, 0.85), (0.85, 0.6, 1.95), 0.055, (0.16, 0.16, 0.17)),
            _beam((-1.0, 0.6, 1.9), (1.0, 0.6, 1.9), 0.08, (0.2, 0.2, 0.21)),
            _box((-1.3, 1.45, 0.5), (1.3, 3.0, 0.78), (0.55, 0.1, 0.06), 0),
            _box((-0.08, 0.62, 1.6), (0.3, 0.66, 1.72), (0.1, 0.1, 0.12), _DASHBOARD),
        ]
    )
    bodies.append((inside, _vehicle))
    for x in (-0.55, -0.35, -0.15):
        gauge = _box((-0.075, -0.004, -0.075), (0.075, 0.004, 0.075), (0, 0, 0), _GAUGE)
        needle = _box((-0.004, -0.012, 0), (0.004, -0.006, 0.06), (2, 0.3, 0.1), _GAUGE)
        place = placed((x, 0.67, 0.955))
        bodies.append((gauge, lambda time, m=place: _vehicle(time) @ m))
        bodies.append(
            (
                needle,
                lambda time, m=place, k=x: (
                    _vehicle(time) @ m @ placed((0, 0, 0), 2 * math.sin(3 * time + 9 * k), (0, 1, 0))
                ),
            )
        )
    wheel = np.vstack(
        [_torus(0.19, 0.017), _beam((-0.19, 0, 0), (0.19, 0, 0), 0.018, (0.3, 0.3, 0.3)),
         _beam((0, 0, 0), (0, 0, -0.19), 0.018, (0.3, 0.3, 0.3))]
    )  # fmt: skip
    tilt = placed((-0.35, 0.5, 0.9), -0.4, (1, 0, 0))
    bodies.append(
        (wheel, lambda time: _vehicle(time) @ tilt @ placed((0, 0, 0), 1.2 * math.sin(2.2 * time), (0, 1, 0)))
    )
    wiper = np.vstack(
        [
            _beam((0, 0, 0), (0, -0.33, 0.52), 0.008, (0.1, 0.1, 0.1)),
            _beam((-0.05, -0.2, 0.32), (0.05, -0.5, 0.8), 0.012, (0.06, 0.06, 0.06)),
        ]
    )
    for x in (-0.7, 0.25):
        hinge = placed((x, 1.35, 0.95))
        bodies.append(
            (
                wiper,
                lambda time, m=hinge: (
                    _vehicle(time) @ m @ placed((0, 0, 0), 0.55 + 0.9 * math.sin(5.5 * time), (0, 0.82, 0.57))
                ),
            )
        )
    return bodies


def _terrain() -> np.ndarray:
    x, y = np.meshgrid(np.arange(-130, 131, 1.0), np.arange(-20, 301, 1.0))
    points = np.stack([x, y, _ground(x, y)], -1)
    slope_y, slope_x = np.gradient(points[..., 2])
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    whole = np.concatenate([points, normals, np.ones_like(points), np.full((*x.shape, 1), _TERRAIN)], -1)
    a, b, c, d = whole[:-1, :-1], whole[:-1, 1:], whole[1:, 1:], whole[1:, :-1]
    return np.stack([a, b, c, a, c, d], 2).reshape(-1, 10)


def _scenery() -> np.ndarray:
    """Return trees, rocks, posts of the guard rail, and grass beside the road."""
    rng, parts = np.random.default_rng(5), []
    for y in rng.uniform(0, 290, 420):
        x = _road(y) + rng.choice([-1, 1]) * rng.uniform(6.5, 70)
        base, tall = np.array([x, y, _ground(x, y)]), rng.uniform(4, 9)
        if rng.random() < 0.25:
            parts.append(_rock(base, rng.uniform(0.5, 2.2), rng))
            continue
        parts.append(_beam(base - (0, 0, 0.5), base + (0, 0, 0.5 * tall), 0.16, (0.3, 0.2, 0.12)))
        green = np.array([0.14, 0.28, 0.1]) * rng.uniform(0.6, 1.5)
        parts += [
            _cone(base + (0, 0, tall * low), tall * wide, tall * 0.42, green)
            for low, wide in ((0.2, 0.3), (0.42, 0.23), (0.62, 0.15))
        ]
    for y in np.arange(0, 140, 2.0):
        foot = np.array([_road(y) + 5.0, y, _ground(_road(y) + 5.0, y)])
        end = np.array([_road(y + 2) + 5.0, y + 2, _ground(_road(y + 2) + 5.0, y + 2)])
        parts.append(_beam(foot, foot + (0, 0, 0.8), 0.05, (0.6, 0.6, 0.6)))
        parts.append(
            _beam(foot + (0, 0, 0.72), end + (0, 0, 0.72), 0.07, (0.8, 0.15, 0.1) if int(y) % 4 else (0.85, 0.85, 0.85))
        )
    y = rng.uniform(0, 90, 9000)
    x = _road(y) + rng.choice([-1, 1], y.size) * rng.uniform(4.7, 13, y.size)
    root = np.stack([x, y, _ground(x, y)], -1)
    lean, side = rng.normal(0, 0.12, (y.size, 3)) + (0, 0, 0.35), rng.normal(0, 0.05, (y.size, 3)) * (1, 1, 0)
    blades = np.stack([root - side, root + side, root + lean], 1)
    parts.append(_soup(blades, (0.3, 0.42, 0.12), 0, normals=np.broadcast_to((0, 0, 1.0), blades.shape)))
    return np.vstack(parts)


def _truck() -> np.ndarray:
    """Return a truck that looks toward −y."""
    parts = [
        _box((-1.2, 0, 0.9), (1.2, 7, 3.6), (0.75, 0.72, 0.65), 0),
        _box((-1.1, -2.2, 0.7), (1.1, -0.2, 2.9), (0.1, 0.25, 0.6), 0),
        _box((-1.0, -2.23, 1.7), (1.0, -2.1, 2.6), (0.08, 0.1, 0.13), 0),
        _box((-1.0, -2.0, 0.4), (1.0, 6.8, 0.9), (0.1, 0.1, 0.1), 0),
    ]  # fmt: skip
    parts += [_box((x - 0.15, -2.26, 0.9), (x + 0.15, -2.1, 1.15), (2.5, 2.4, 2.0), 0) for x in (-0.8, 0.8)]
    parts += [_box((-1.21, y, 1.2), (1.21, y + 0.5, 3.2), (0.7, 0.2, 0.1), 0) for y in (0.8, 2.8, 4.8)]
    parts += [
        _beam((x - 0.15, y, 0.45), (x + 0.15, y, 0.45), 0.45, (0.07, 0.07, 0.07), 12)
        for x in (-0.95, 0.95)
        for y in (-1.2, 1.2, 5, 6)
    ]
    return np.vstack(parts)


def _soup(triangles: np.ndarray, paint, material: int, normals: np.ndarray | None = None) -> np.ndarray:
    """Return vertices (3 N, 10) of triangles (N, 3, 3), with flat normals unless others are given."""
    triangles = np.asarray(triangles, float)
    if normals is None:
        across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
        normals = np.repeat(across[:, None], 3, 1)
    rest = np.broadcast_to((*paint, material), (*triangles.shape[:2], 4))
    return np.concatenate([triangles, normals, rest], -1).reshape(-1, 10)


def _box(low, high, paint, material: int) -> np.ndarray:
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)], float)
    faces = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    return _soup([corners[[f[a] for a in pick]] for f in faces for pick in ((0, 1, 2), (0, 2, 3))], paint, material)


def _ring(center, along, radius: float, sides: int) -> np.ndarray:
    """Return points of a circle around the direction `along`."""
    along = np.asarray(along, float) / np.linalg.norm(along)
    first = np.cross(along, (1, 0, 0) if abs(along[0]) < 0.9 else (0, 1, 0))
    first /= np.linalg.norm(first)
    angle = 2 * np.pi * np.arange(sides) / sides
    return center + radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(along, first))


def _beam(start, end, radius: float, paint, sides: int = 8) -> np.ndarray:
    """Return a cylinder between two points, with caps."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    low, high = (_ring(center, end - start, radius, sides) for center in (start, end))
    triangles = []
    for k in range(sides):
        after = (k + 1) % sides
        triangles += [(low[k], low[after], high[after]), (low[k], high[after], high[k])]
        triangles += [(start, low[after], low[k]), (end, high[k], high[after])]
    return _soup(triangles, paint, 0)


def _cone(base, radius: float, height: float, paint, sides: int = 9) -> np.ndarray:
    ring, tip = _ring(base, (0, 0, 1), radius, sides), base + np.array([0, 0, height])
    triangles = [(ring[k], ring[(k + 1) % sides], tip) for k in range(sides)]
    return _soup(triangles + [(ring[(k + 1) % sides], ring[k], base) for k in range(sides)], paint, 0)


def _rock(base, radius: float, rng: np.random.Generator) -> np.ndarray:
    """Return a ball with bumps."""
    rows, sides = 6, 10
    shape = rng.uniform(0.75, 1.1, (rows + 1, sides))
    shape[0], shape[-1] = shape[0, 0], shape[-1, 0]
    tilt = np.pi * np.arange(rows + 1)[:, None] / rows
    angle = 2 * np.pi * np.arange(sides) / sides
    points = np.stack([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), 0.8 * np.cos(tilt) + 0 * angle], -1)
    points = base + radius * shape[..., None] * points
    after = np.roll(points, -1, 1)
    faces = [np.stack([points[:-1], points[1:], after[1:]], 2), np.stack([points[:-1], after[1:], after[:-1]], 2)]
    return _soup(np.concatenate(faces).reshape(-1, 3, 3), (0.5, 0.47, 0.43), 0)


def _torus(radius: float, tube: float, sides: int = 28) -> np.ndarray:
    """Return a ring around y, as short beams."""
    centers = _ring(np.zeros(3), (0, 1, 0), radius, sides)
    return np.vstack([_beam(centers[k - 1], centers[k], tube, (0.09, 0.08, 0.08)) for k in range(sides)])
