"""Scenes whose vertices a shader poses at any time, so that what bends has exact motion: meshes, and their drawing."""

from __future__ import annotations

import moderngl
import numpy as np

import gffe_cl as gffe
from unseen.opengl import SupersampledScene, Target, array_bytes, matrix_bytes, repeating_texture
from unseen.recording import noise_texture

_SUPERSAMPLING = 2
_NEAR, _FAR = 0.05, 200.0

_VERTEX = """#version 330
uniform mat4 view, previous_view, projection;
uniform float now, earlier;
in vec3 position, paint;
in float kind;
in vec4 first, second;
out vec3 object, world, here, before, tint;
flat out int what;
%s
void main() {
    what = int(kind + 0.5);
    object = position;
    tint = paint;
    world = posed(position, what, first, second, now);
    here = (view * vec4(world, 1)).xyz;
    before = (previous_view * vec4(posed(position, what, first, second, earlier), 1)).xyz;
    gl_Position = projection * vec4(here, 1);
}
"""
_FRAGMENT = """#version 330
uniform sampler2D noise;
uniform vec3 eye;
uniform vec4 pinhole;
uniform float now;
in vec3 object, world, here, before, tint;
flat in int what;
layout(location = 0) out vec4 color;
layout(location = 1) out vec4 depth_and_motion;
float grain(vec3 p) { return 0.5 * (texture(noise, p.xy).r + texture(noise, p.yz + p.x).r); }
vec2 projected(vec3 p) { return pinhole.zw + pinhole.xy * vec2(p.x, -p.y) / -p.z; }
%s
void main() {
    vec3 n = normalize(cross(dFdx(world), dFdy(world)));
    n = dot(n, eye - world) < 0.0 ? -n : n;
    color = vec4(shaded(n), 1);
    depth_and_motion = vec4(-here.z, projected(before) - projected(here), 1);
}
"""


class PosedScene(SupersampledScene):
    """A generator that draws triangles which a shader poses.

    Parameters
    ----------
    vertices : (N, 15) array
        Three to a triangle: position, paint, kind, and eight numbers for the pose, as of `mesh`.
    pose : str
        GLSL of `vec3 posed(vec3 p, int kind, vec4 first, vec4 second, float time)`, a place in the world (z up).
    shade : str
        GLSL of `vec3 shaded(vec3 n)`: linear color, from `object`, `world`, `eye`, `tint`, `what`, `now`, `grain`.
    background : (r, g, b)
        Linear color where nothing is: the sky.
    """

    fps = 30.0

    def __init__(self, width: int, height: int, frames: int, vertices: np.ndarray, pose: str, shade: str, background):
        super().__init__(width, height, frames, _SUPERSAMPLING)
        self._background = np.asarray(background, np.float32)
        self._program = self._context.program(vertex_shader=_VERTEX % pose, fragment_shader=_FRAGMENT % shade)
        names = ("position", "paint", "kind", "first", "second")
        buffer = self._context.buffer(array_bytes(vertices))
        self._vertices = self._context.vertex_array(self._program, [(buffer, "3f 3f 1f 4f 4f", *names)])
        repeating_texture(self._context, noise_texture(256, 91, 6, 0.7)[..., None]).use(0)

    def shown(self, samples: np.ndarray) -> np.ndarray:
        """Return colors (H, W, 3) of drawn samples (H, W, 4): the background where nothing was drawn."""
        return np.where(samples[..., 3:] > 0, samples[..., :3], self._background)

    def draw(self, target: Target, camera: gffe.Camera, before: gffe.Camera, now: float, earlier: float) -> None:
        """Draw the scene as its vertices are posed `now`."""
        self._context.enable(moderngl.DEPTH_TEST)
        projection = camera.projection_matrix("opengl", target.width, target.height, _NEAR, _FAR)
        values = {
            "view": matrix_bytes(camera.view_matrix("opengl")), "projection": matrix_bytes(projection),
            "previous_view": matrix_bytes(before.view_matrix("opengl")), "pinhole": array_bytes(camera.intrinsics),
            "eye": array_bytes(camera.position), "now": array_bytes(now), "earlier": array_bytes(earlier),
        }  # fmt: skip
        for name, value in values.items():
            if name in self._program:
                self._program[name].write(value)
        self._vertices.render(moderngl.TRIANGLES)


def mesh(triangles, paint, kind: int = 0, first=(0, 0, 0, 0), second=(0, 0, 0, 0)) -> np.ndarray:
    """Return vertices (3 N, 15) of triangles (N, 3, 3) of one paint and one pose."""
    points = np.asarray(triangles, float).reshape(-1, 3)
    return np.hstack([points, np.broadcast_to([*paint, kind, *first, *second], (len(points), 12))])


def sheet(points: np.ndarray) -> np.ndarray:
    """Return triangles (N, 3, 3) between the points (H, W, 3) of a grid."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.stack([a, b, c, a, c, d], 2).reshape(-1, 3, 3)


def tube(line, radius, sides: int = 8) -> np.ndarray:
    """Return triangles of a tube along a line of points, of one radius or one for each."""
    line = np.asarray(line, float)
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, np.where(np.abs(along[:, :1]) < 0.9, (1.0, 0, 0), (0, 1.0, 0)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * np.cross(along, across)[:, None]
    return sheet(line[:, None] + np.broadcast_to(radius, len(line))[:, None, None] * ring)


def ball(center, radius, rows: int = 8) -> np.ndarray:
    """Return triangles of a ball, or of an ellipsoid with three radii."""
    tilt, angle = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, 2 * rows + 1), indexing="ij")
    points = np.stack([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)], -1)
    return sheet(np.asarray(center) + points * radius)
