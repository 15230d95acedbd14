"""Recording: writes the pictures of a generator as a sequence with ground truth halfway between rendered frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

import gffe_cl as gffe
from gffe_cl.engine.frame.transfer_function import linear_values


@dataclass
class Picture:
    """One rendered picture.

    Attributes
    ----------
    color : (H, W, 3) linear
    depth : (H, W) float32, planar, infinite for sky
    motion : (H, W, 2) float32, previous pixel position − current one, or None without a previous picture
    camera : of this picture
    """

    color: np.ndarray
    depth: np.ndarray
    motion: np.ndarray | None
    camera: gffe.Camera


class Generator(Protocol):
    """Renders one sequence at any time."""

    width: int
    height: int
    fps: float
    frames: int

    def picture(self, time: float, previous: float | None) -> Picture:
        """Return what is seen at `time` (seconds), with motion since `previous`."""


def record(generator: Generator, folder: Path, progress=lambda done: None) -> None:
    """Write a sequence: every rendered frame, and the true color halfway between it and the next one."""
    step = 1 / generator.fps
    with gffe.SequenceWriter(folder, generator.width, generator.height, generator.fps) as writer:
        for k in range(generator.frames):
            rendered = generator.picture(k * step, (k - 1) * step if k else None)
            entry = gffe.FrameEntry(
                f"frame_{k:06d}.exr", time=k * step, reset=k == 0, render_camera=rendered.camera
            )  # fmt: skip
            writer.add(entry, gffe.named_channels(_half(rendered.color), rendered.depth, rendered.motion))
            between = generator.picture((k + 0.5) * step, None)
            entry = gffe.FrameEntry(
                f"truth_{k:06d}_0500.exr", time=(k + 0.5) * step, kind="ground_truth", display_camera=between.camera
            )
            writer.add(entry, dict(zip("RGB", np.moveaxis(_half(between.color), -1, 0), strict=True)))
            progress(k + 1)


def linear_from_bytes(display: np.ndarray) -> np.ndarray:
    """Return linear color of 8-bit sRGB values."""
    return linear_values(np.arange(256) / 255)[display]


def with_sky(depth: np.ndarray, motion: np.ndarray, camera: gffe.Camera, previous: gffe.Camera | None):
    """Return depth and motion with the sky filled in: where `depth` is 0, it is infinitely far and turns with the
    camera."""
    sky = depth == 0
    depth = np.where(sky, np.float32(np.inf), depth).astype(np.float32)
    if previous is None:
        return depth, None
    height, width = depth.shape
    here = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1)
    ray = np.concatenate([(here - (camera.cx, camera.cy)) / (camera.fx, camera.fy), np.ones((height, width, 1))], -1)
    ray = ray @ (previous.world_to_view[:3, :3] @ camera.world_to_view[:3, :3].T).T
    before = ray[..., :2] / ray[..., 2:] * (previous.fx, previous.fy) + (previous.cx, previous.cy)
    return depth, np.where(sky[..., None], before - here, motion).astype(np.float32)


def opengl_view(camera: gffe.Camera) -> np.ndarray:
    """Return the (4, 4) matrix from the world to OpenGL's view space: x right, y up, z backward."""
    return np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.world_to_view


def wobble(time: float, speeds: tuple[float, ...], seed: float) -> float:
    """Return a smooth, irregular value within ±1: the mean of sines of these angular speeds."""
    return float(np.mean([np.sin(speed * time + seed * (k + 1)) for k, speed in enumerate(speeds)]))


def placed(position, angle: float = 0.0, axis=(0, 0, 1)) -> np.ndarray:
    """Return the (4, 4) matrix of an object turned by `angle` (radians) around `axis`, then moved to `position`."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    matrix[:3, 3] = position
    return matrix


def noise_texture(size: int, seed: int, octaves: int = 6, roughness: float = 0.6) -> np.ndarray:
    """Return (size, size) values within 0 … 1 of noise that repeats; size is a power of two."""
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size))
    for octave in range(octaves):
        cells = 4 << octave
        grid = rng.random((cells, cells))
        place = np.arange(size) * cells / size
        low, part = place.astype(int), place % 1
        part = part * part * (3 - 2 * part)
        high = (low + 1) % cells
        rows = grid[low] * (1 - part)[:, None] + grid[high] * part[:, None]
        total += roughness**octave * (rows[:, low] * (1 - part) + rows[:, high] * part)
    total -= total.min()
    return total / total.max()


def _half(color: np.ndarray) -> np.ndarray:
    return np.clip(color, 0, 65504).astype(np.float16)
