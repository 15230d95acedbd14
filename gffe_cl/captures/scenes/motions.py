"""Motions: rigid transforms as functions of time.

A motion maps a time in seconds to a 4×4 float64 matrix (column vectors, local → parent). `a @ b`
applies `b` first, then `a`: `Place(2, 0, 0) @ Spin("y", 90)` turns about its own axis, two meters to the
right.
World axes: x right, y up, z towards the viewer; meters, degrees, seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.frame.camera import Camera

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class Motion:
    """Base of motions: `motion(time)` returns (4, 4)."""

    moves = True  # False: the same at every time

    def __call__(self, time: float) -> np.ndarray:
        raise NotImplementedError

    def __matmul__(self, inner: Motion) -> Motion:
        return Chain(self, inner)


@dataclass(frozen=True)
class Chain(Motion):
    """Motion `outer` after motion `inner`."""

    outer: Motion
    inner: Motion

    @property
    def moves(self):
        return self.outer.moves or self.inner.moves

    def __call__(self, time):
        return self.outer(time) @ self.inner(time)


@dataclass(frozen=True)
class Place(Motion):
    """Fixed position, then yaw about y, pitch about x and roll about z."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    moves = False

    def __call__(self, time):
        matrix = rotation("y", self.yaw) @ rotation("x", self.pitch) @ rotation("z", self.roll)
        matrix[:3, 3] = (self.x, self.y, self.z)
        return matrix


@dataclass(frozen=True)
class Spin(Motion):
    """Steady turning about an axis through the origin; `rate` in degrees per second."""

    axis: str | tuple
    rate: float
    phase: float = 0.0

    def __call__(self, time):
        return rotation(self.axis, self.phase + self.rate * time)


@dataclass(frozen=True)
class Swing(Motion):
    """Pendulum about an axis: `amplitude` degrees to both sides of `rest`, one swing per `period`."""

    axis: str | tuple
    amplitude: float
    period: float
    phase: float = 0.0
    rest: float = 0.0

    def __call__(self, time):
        angle = self.amplitude * np.sin(2 * np.pi * (time / self.period + self.phase))
        return rotation(self.axis, self.rest + angle)


@dataclass(frozen=True)
class Slide(Motion):
    """Motion to and fro along `vector` (meters, from the middle to one end), once per `period`."""

    vector: tuple
    period: float
    phase: float = 0.0

    def __call__(self, time):
        return translation(np.asarray(self.vector) * np.sin(2 * np.pi * (time / self.period + self.phase)))


@dataclass(frozen=True)
class Bounce(Motion):
    """Bouncing in parabolas of `height` meters, one per `period`."""

    height: float
    period: float
    phase: float = 0.0

    def __call__(self, time):
        x = (time / self.period + self.phase) % 1.0
        return translation((0.0, 4.0 * self.height * x * (1.0 - x), 0.0))


@dataclass(frozen=True)
class Carry(Motion):
    """Motion along `vector` (meters) at constant speed, once per `period`; then again from its start."""

    vector: tuple
    period: float
    phase: float = 0.0

    def __call__(self, time):
        return translation(np.asarray(self.vector) * ((time / self.period + self.phase) % 1.0))


@dataclass(frozen=True)
class Held(Motion):
    """Fixed position relative to a camera at `eye` that looks at `target`, both functions of time: x right, y up, −z
    ahead of it."""

    eye: Callable[[float], np.ndarray]
    target: Callable[[float], np.ndarray]

    def __call__(self, time):
        view = Camera.look_at(self.eye(time), self.target(time), (0.0, 1.0, 0.0), 1.0, 1.0, 0.0, 0.0).world_to_view
        return np.linalg.inv(view) @ np.diag((1.0, -1.0, -1.0, 1.0))


class Path(Motion):
    """Motion along a smooth closed curve at constant speed, facing forward (+z is ahead).

    Parameters
    ----------
    points : (N, 2) or (N, 3)
        Corners that a closed Catmull-Rom spline passes: (x, z) on the ground, or (x, y, z).
    speed : float
        Meters per second.
    start : float
        Start position, as a fraction of the loop.
    """

    _STEPS = 48

    def __init__(self, points, speed, start=0.0):
        points = np.asarray(points, np.float64)
        if points.shape[1] == 2:
            points = np.stack([points[:, 0], np.zeros(len(points)), points[:, 1]], -1)
        self.curve = _closed_spline(points, self._STEPS)
        steps = np.linalg.norm(np.diff(self.curve, axis=0), axis=-1)
        self.along = np.concatenate([[0.0], np.cumsum(steps)])
        self.length = self.along[-1]
        self.speed = speed
        self.start = start

    def distance(self, time: float) -> float:
        """Return the meters traveled along the loop at `time`, not wrapped."""
        return self.start * self.length + self.speed * time

    def position(self, distance: float) -> np.ndarray:
        wrapped = distance % self.length
        return np.array([np.interp(wrapped, self.along, self.curve[:, k]) for k in range(3)])

    def __call__(self, time):
        distance = self.distance(time)
        ahead = self.position(distance + 0.25) - self.position(distance - 0.25)
        matrix = rotation("y", np.degrees(np.arctan2(ahead[0], ahead[2])))
        matrix[:3, 3] = self.position(distance)
        return matrix


@dataclass(frozen=True)
class Roll(Motion):
    """The turning of a ball of `radius` that rolls along `path` (about its own x axis)."""

    path: Path
    radius: float

    def __call__(self, time):
        return rotation("x", np.degrees(self.path.distance(time) / self.radius))


def rotation(axis: str | tuple, degrees: float) -> np.ndarray:
    """Return the right-handed rotation (4, 4) about an axis through the origin."""
    x, y, z = np.asarray(_AXES.get(axis, axis) if isinstance(axis, str) else axis, np.float64)
    norm = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / norm, y / norm, z / norm
    angle = np.radians(degrees)
    c, s = np.cos(angle), np.sin(angle)
    k = 1.0 - c
    matrix = np.eye(4)
    matrix[:3, :3] = (
        (c + x * x * k, x * y * k - z * s, x * z * k + y * s),
        (y * x * k + z * s, c + y * y * k, y * z * k - x * s),
        (z * x * k - y * s, z * y * k + x * s, c + z * z * k),
    )
    return matrix


def translation(vector) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = vector
    return matrix


def _closed_spline(points: np.ndarray, steps: int) -> np.ndarray:
    before, after, later = (np.roll(points, shift, 0)[:, None] for shift in (1, -1, -2))
    here = points[:, None]
    u = (np.arange(steps) / steps)[None, :, None]
    curve = 0.5 * (
        2 * here
        + (after - before) * u
        + (2 * before - 5 * here + 4 * after - later) * u**2
        + (3 * here - before - 3 * after + later) * u**3
    )
    curve = curve.reshape(-1, 3)
    return np.concatenate([curve, curve[:1]])
