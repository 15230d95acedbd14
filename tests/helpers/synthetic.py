"""Exact frames of textured rectangles, in float64 NumPy: the ground truth of the geometry tests."""

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame


@dataclass
class Rect:
    """A rectangle facing −z: `center` at time 0 and `velocity` in world units (per second), `half` size."""

    center: tuple
    half: tuple = (1e9, 1e9)
    velocity: tuple = (0, 0, 0)
    frequency: float = 1.0  # of the texture, cycles per world unit
    tint: tuple = (0.5, 0.4, 0.3)
    ramp: bool = False  # red and green grow with x and y instead: color tells the place

    def at(self, time):
        return np.asarray(self.center, np.float64) + time * np.asarray(self.velocity, np.float64)

    def texture(self, uv):
        if self.ramp:
            return np.stack([0.5 + 0.05 * uv[..., 0], 0.5 + 0.05 * uv[..., 1], 0 * uv[..., 0]], -1)
        k = 2 * np.pi * self.frequency
        wave = np.sin(k * uv[..., 0]) * np.cos(0.8 * k * uv[..., 1] + 0.5)
        return np.asarray(self.tint) * (1 + 0.6 * wave[..., None])


@dataclass
class Rects:
    """Rectangles in front of an optional sky; nearest wins."""

    rects: list
    offset: tuple = (0, 0, 0)  # of the whole world, cameras included

    def _hit(self, camera, time, px):
        """Return the rectangle (−1 sky) at `px`, its depth, and the world hit point less the rectangle's center."""
        camera = camera.moved(-np.asarray(self.offset, np.float64))
        origin = camera.position
        far = camera.unproject(px, np.ones(px.shape[:-1]))
        direction = far - origin
        which = np.full(px.shape[:-1], -1)
        depth = np.full(px.shape[:-1], np.inf)
        local = np.zeros((*px.shape[:-1], 3))
        for k, rect in enumerate(self.rects):
            center = rect.at(time)
            with np.errstate(all="ignore"):
                t = (center[2] - origin[2]) / direction[..., 2]  # view depth: `direction` has depth 1
                hit = origin + t[..., None] * direction - center
            ok = (t > 1e-6) & (t < depth) & (np.abs(hit[..., :2]) <= rect.half).all(-1)
            which[ok], depth[ok], local[ok] = k, t[ok], hit[ok]
        return which, depth, local

    def color(self, camera, time, width, height, samples=1):
        """Return (H, W, 3) float64: mean over samples × samples per pixel."""
        total = 0
        for sy in range(samples):
            for sx in range(samples):
                y, x = np.mgrid[:height, :width]
                px = np.stack([x + (sx + 0.5) / samples, y + (sy + 0.5) / samples], -1)
                which, _, local = self._hit(camera, time, px)
                c = np.full((height, width, 3), 0.7) + px[..., 1:] * 1e-3
                for k, rect in enumerate(self.rects):
                    c[which == k] = rect.texture(local[which == k])
                total = total + c
        return total / samples**2

    def frame(self, camera, time, width, height, previous=None, reset=False, samples=1):
        """Return a RenderedFrame; `previous` is (camera, time) of the rendered frame before."""
        y, x = np.mgrid[:height, :width]
        px = np.stack([x + 0.5, y + 0.5], -1)
        which, depth, local = self._hit(camera, time, px)
        motion = np.zeros((height, width, 2))
        if previous is not None:
            before = np.zeros((height, width, 3))
            for k, rect in enumerate(self.rects):
                before[which == k] = local[which == k] + rect.at(previous[1]) + self.offset
            motion = np.where((which >= 0)[..., None], previous[0].project(before)[0] - px, 0)
        return RenderedFrame(
            self.color(camera, time, width, height, samples).astype(np.float16),
            depth.astype(np.float32),
            motion.astype(np.float32),
            camera,
            time,
            reset=reset,
        )


def camera(width, height, position=(0, 0, 0), yaw=0.0, pitch=0.0, roll=0.0, fov=1.2):
    """Return a camera whose axes are the world's at zero angles: x right, y down, z forward. Angles in radians."""
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (np.cos, np.sin))
    turn = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    tilt = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    spin = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = spin @ tilt @ turn
    matrix[:3, 3] = -matrix[:3, :3] @ np.asarray(position, np.float64)
    focal = width / (2 * np.tan(fov / 2))
    return Camera(matrix, focal, focal, width / 2, height / 2)


def psnr(a, b, mask=None):
    error = (np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2
    if mask is not None:
        error = error[mask]
    return min(100.0, -10 * np.log10(error.mean() + 1e-30))
