"""Scene of the self-test: textured rectangles before a sky, some of them moving, and a cut to others.

It is computed on the host with +, −, ×, ÷ and floor alone, which every machine rounds alike. Kernels that draw may
differ between devices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import Overlays, RenderedFrame
from gffe_cl.engine.frame.window import WindowChooser

FPS = 30.0
ALPHAS = (1 / 3, 2 / 3)
FRAMES, CUT = 8, 5  # number of frames, and the first after a cut that is not marked


@dataclass(frozen=True)
class Rectangle:
    """Rectangle that faces along `axis` (1: lies flat, 2: upright): center at time 0, half its sides along the other
    axes, world units; velocity per second, acceleration per second²."""

    axis: int
    center: tuple[float, float, float]
    half: tuple[float, float]
    tint: tuple[float, float, float]
    cells: float  # of the texture, per world unit
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time: float) -> np.ndarray:
        """Return its center (3,) at `time`, seconds."""
        moved = zip(self.center, self.velocity, self.acceleration, strict=True)
        return np.array([c + time * v + time * time * a for c, v, a in moved])

    @property
    def others(self) -> tuple[int, int]:
        return (0, 2) if self.axis == 1 else (0, 1)


BEFORE_THE_CUT = (
    Rectangle(2, (0.0, -0.6, 9.0), (14.0, 1.9), (0.50, 0.42, 0.30), 1.5),
    Rectangle(1, (0.0, 1.3, 6.0), (14.0, 4.0), (0.30, 0.36, 0.40), 2.0),
    *(Rectangle(2, (0.5 * k - 2.0, 0.4, 3.2), (0.04, 0.9), (0.1, 0.08, 0.07), 3.0) for k in range(3)),
    Rectangle(2, (-1.6, 0.2, 5.0), (0.7, 1.1), (0.9, 0.3, 0.2), 3.0, (7.0, 0.0, 0.0), (9.0, 0.0, 0.0)),
    Rectangle(2, (1.6, -0.4, 6.5), (0.6, 0.6), (3.0, 2.6, 0.9), 4.0, (-9.0, 1.2, -2.0)),
)
AFTER_THE_CUT = (
    Rectangle(2, (3.0, 0.0, 4.0), (2.6, 3.0), (0.25, 0.50, 0.35), 2.5),
    Rectangle(2, (-4.0, 0.5, 15.0), (6.0, 4.0), (0.6, 0.55, 0.5), 0.7),
    Rectangle(2, (-0.6, 0.3, 2.8), (0.5, 0.8), (0.7, 0.7, 0.15), 4.0, (6.0, -0.5, 0.0)),
)
_SKY = (0.45, 0.6, 0.9)


def shown(frame: int) -> tuple[Rectangle, ...]:
    return BEFORE_THE_CUT if frame < CUT else AFTER_THE_CUT


def display_camera(time: float, width: int, height: int) -> Camera:
    """Return the display camera at `time` in seconds, with sizes in pixels. It strafes, nears and turns."""
    tangent = 0.15 * time  # of half the angle
    cosine, sine = (1 - tangent * tangent) / (1 + tangent * tangent), 2 * tangent / (1 + tangent * tangent)
    x, y, z = 0.9 * time, -0.1 * time, 1.2 * time
    matrix = [
        [cosine, 0.0, -sine, sine * z - cosine * x],
        [0.0, 1.0, 0.0, -y],
        [sine, 0.0, cosine, -sine * x - cosine * z],
        [0.0, 0.0, 0.0, 1.0],
    ]
    return Camera(np.array(matrix), 0.9 * width, 0.9 * width, 0.5 * width, 0.5 * height)


def frames(
    width: int,
    height: int,
    render_size: tuple[int, int] | None = None,
    count: int = FRAMES,
    samples: int = 2,
) -> list[RenderedFrame]:
    """Return `count` rendered frames for a display of that size, the first of them a reset. Colors are means of
    `samples`² samples per pixel. With a `render_size` they are rendered through an adaptive window, and some bring
    overlays and bad pixels."""
    size, windows = (width, height), WindowChooser("off", (width, height), [])
    if render_size:
        windows = WindowChooser("adaptive", size, list(ALPHAS))
    made: list[RenderedFrame] = []
    for k in range(count):
        before = made[-1] if made else None
        display = display_camera(k / FPS, width, height)
        camera = windows.choose(display, before and before.shown_camera).camera(display, size, render_size or size)
        frame = _rendered(k, camera, display, render_size or size, before, samples)
        windows.observe(frame.depth)
        if render_size:
            _spoil(frame, k)
            frame.overlays = _overlays(k, size, render_size)
        made.append(frame)
    return made


def _rendered(
    k: int, camera: Camera, display: Camera, size: tuple[int, int], before: RenderedFrame | None, samples: int
) -> RenderedFrame:
    x, y = _places(size, 0.5, 0.5)
    which, depth, hit = _hits(shown(k), camera, k / FPS, x, y)
    total = np.zeros((size[1], size[0], 3))
    for sub in range(samples * samples):
        at = _places(size, (sub % samples + 0.5) / samples, (sub // samples + 0.5) / samples)
        total += _colors(shown(k), *_hits(shown(k), camera, k / FPS, *at)[::2])
    motion = np.zeros((size[1], size[0], 2), np.float32)
    if before is not None:
        motion = _motion(shown(k), which, hit, (x, y), k / FPS, before)
    color = (total / samples**2).astype(np.float16)
    return RenderedFrame(color, depth.astype(np.float32), motion, camera, k / FPS, display, reset=before is None)


def _places(size: tuple[int, int], u: float, v: float) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y in pixels, (H, W) each, at (u, v) in every pixel."""
    y, x = np.mgrid[: size[1], : size[0]]
    return x + u, y + v


def _hits(rectangles, camera: Camera, time: float, x: np.ndarray, y: np.ndarray):
    """Return for each pixel position the number of the nearest rectangle (−1: sky), its view depth, and the hit point
    relative to its center, or for the sky the direction of the ray."""
    turn, shift = camera.world_to_view[:3, :3], camera.world_to_view[:3, 3]
    origin = [-(turn[0, i] * shift[0] + turn[1, i] * shift[1] + turn[2, i] * shift[2]) for i in range(3)]
    view_x, view_y = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    direction = [turn[0, i] * view_x + turn[1, i] * view_y + turn[2, i] for i in range(3)]
    which, depth = np.full(x.shape, -1), np.full(x.shape, np.inf)
    place = np.stack(direction, -1)
    for k, rectangle in enumerate(rectangles):
        center = rectangle.at(time)
        with np.errstate(all="ignore"):
            z = (center[rectangle.axis] - origin[rectangle.axis]) / direction[rectangle.axis]  # view depth
            hit = np.stack([origin[i] + z * direction[i] - center[i] for i in range(3)], -1)
        near = (z > 0.05) & (z < depth)
        for axis, half in zip(rectangle.others, rectangle.half, strict=True):
            near &= np.abs(hit[..., axis]) <= half
        which[near], depth[near], place[near] = k, z[near], hit[near]
    return which, depth, place


def _colors(rectangles, which: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return colors (H, W, 3) float64, linear RGB."""
    colors = np.empty((*which.shape, 3))
    colors[...] = np.array(_SKY) * (1 - 0.4 * place[..., 1:2])
    for k, rectangle in enumerate(rectangles):
        here = which == k
        u, v = (place[here][:, axis] * rectangle.cells for axis in rectangle.others)
        colors[here] = np.array(rectangle.tint) * (0.4 + 1.2 * _noise(u, v, k)[:, None])
    return colors


def _noise(u: np.ndarray, v: np.ndarray, salt: int) -> np.ndarray:
    """Return noise from 0 to 1: numbers of a lattice, bilinear in between."""
    cell_u, cell_v = np.floor(u), np.floor(v)
    u, v = u - cell_u, v - cell_v

    def corner(i: int, j: int) -> np.ndarray:
        number = (cell_u.astype(np.int64) + i) * 73856093 ^ (cell_v.astype(np.int64) + j) * 19349663 ^ salt * 83492791
        return (number * 2654435761 >> 8 & 0xFFFF) / 65536.0

    top = corner(0, 0) * (1 - u) + corner(1, 0) * u
    return top * (1 - v) + (corner(0, 1) * (1 - u) + corner(1, 1) * u) * v


def _motion(rectangles, which, place, here, time: float, before: RenderedFrame) -> np.ndarray:
    """Return motion (H, W, 2) float32, pixels: where each hit point was in the frame before, minus where it is. The sky
    moves only by the camera's rotation."""
    point = place.copy()
    for k, rectangle in enumerate(rectangles):
        point[which == k] += rectangle.at(before.time)
    turn = before.camera.world_to_view
    x, y, z = (
        turn[i, 0] * point[..., 0] + turn[i, 1] * point[..., 1] + turn[i, 2] * point[..., 2] + turn[i, 3] * (which >= 0)
        for i in range(3)
    )
    there = before.camera.fx * x / z + before.camera.cx, before.camera.fy * y / z + before.camera.cy
    return np.stack([there[0] - here[0], there[1] - here[1]], -1).astype(np.float32)


def _spoil(frame: RenderedFrame, k: int) -> None:
    """Replace a few pixels by values that a renderer should not write."""
    if k == 3:
        frame.color[5, 7:9], frame.depth[9, 20:23], frame.motion[12, 30:32] = np.nan, -1.0, np.inf
        frame.color[20, 20] = np.inf


def _overlays(k: int, size: tuple[int, int], render_size: tuple[int, int]) -> Overlays | None:
    """Return overlays for some frames, None for others: a pillar that stays in place, smoke that drifts, a user
    interface; premultiplied."""
    if k % 4 not in (2, 3):
        return None
    mask = np.zeros((render_size[1], render_size[0]), np.uint8)
    mask[-render_size[1] // 4 :, 4 : 4 + render_size[0] // 8] = 1
    x, y = _places(render_size, 0.5, 0.5)
    share = np.clip(1 - ((x - 12 - 3 * k) ** 2 + (y - 10) ** 2) / 64, 0, 1) * 0.5
    effects = np.stack([share * 0.8, share * 0.8, share * 0.9, share], -1).astype(np.float16)
    drift = np.full((render_size[1], render_size[0], 2), (-3.0, 0.5), np.float32)
    ui = np.zeros((size[1], size[0], 4), np.float16)
    ui[2:6, -20:-2] = (0.2, 0.4, 0.1, 0.5)
    return Overlays(mask, effects, drift, ui)
