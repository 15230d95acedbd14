"""Types that describe a scene: motions, primitives, materials, groups, lights, air, camera path, scene.

World axes: x right, y up, z towards the viewer; meters, degrees, seconds. Colors are linear RGB; light colors are
intensities (radiance at one meter) for lamps and irradiance for the sun, scaled so that a white surface facing a light
of strength 1 shows radiance 1.

A motion maps a time in seconds to a rigid transform, a 4×4 float64 matrix (column vectors, local → parent). `a @ b`
applies `b` first, then `a`: `Place(2, 0, 0) @ Spin("y", 90)` turns about its own axis, two meters to the right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.program import constants

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


GEOMETRY = constants("scenes/geometry.h")
TEXTURES = {name.lower(): number for name, number in constants("scenes/textures.h").items()}
BOX, ELLIPSOID, CAPSULE, CONE = (GEOMETRY[name] for name in ("BOX", "ELLIPSOID", "CAPSULE", "CONE"))


@dataclass(frozen=True)
class LightFlicker:
    """Brightness that jumps `rate` times per second to a random value from `least` to 1, by `seed`."""

    rate: float
    least: float = 0.0
    seed: int = 0

    def __call__(self, time: float) -> float:
        picture = int(np.floor(time * self.rate + 1e-9))
        return float(np.random.default_rng((self.seed, picture)).uniform(self.least, 1.0))


@dataclass(frozen=True)
class Material:
    """Material of a surface.

    Parameters
    ----------
    color, second : linear RGB
        The texture's two colors (grout, mortar, gaps, figure … are `second`).
    texture : str
        One of `TEXTURES`.
    scale : float
        Meters per period of the texture.
    contrast : float
        Strength of its irregularities, 0 to 1.
    specular : float
        Reflectance at normal incidence (0.04 for lacquer, above 0.5 for metal); also scales highlights.
    roughness : float
        0 (polished) to 1; widens highlights and blurs reflections.
    mirror : float
        How much of the Fresnel reflection is traced, 0 to 1; 0 leaves only highlights.
    transparency : float
        Share of the light that passes straight through; such a surface writes its own depth.
    emission : linear RGB
        Radiance of its own.
    seed : int
        Varies the texture.
    flicker : time → factor, or None
        Factor on the emission.
    """

    color: tuple = (0.5, 0.5, 0.5)
    second: tuple = (0.3, 0.3, 0.3)
    texture: str = "plain"
    scale: float = 0.5
    contrast: float = 0.25
    specular: float = 0.04
    roughness: float = 0.6
    mirror: float = 0.0
    transparency: float = 0.0
    emission: tuple = (0.0, 0.0, 0.0)
    seed: int = 0
    flicker: LightFlicker | None = None


@dataclass(frozen=True)
class Primitive:
    """A convex solid in its group's local space: two float4 as kernels/scenes/geometry.h reads them."""

    kind: int
    a: tuple
    b: tuple
    material: Material

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        a, b = np.asarray(self.a, np.float64), np.asarray(self.b, np.float64)
        if self.kind in (BOX, ELLIPSOID):
            return a[:3] - b[:3], a[:3] + b[:3]
        return (
            np.minimum(a[:3] - a[3], b[:3] - b[3]),
            np.maximum(a[:3] + a[3], b[:3] + b[3]),
        )


def Box(center, size, material) -> Primitive:
    """Return an axis-aligned box of full edge lengths `size`."""
    return Primitive(BOX, (*center, 0.0), (*(0.5 * s for s in size), 0.0), material)


def Sphere(center, radius, material) -> Primitive:
    return Primitive(ELLIPSOID, (*center, 0.0), (radius, radius, radius, 0.0), material)


def Ellipsoid(center, radii, material) -> Primitive:
    return Primitive(ELLIPSOID, (*center, 0.0), (*radii, 0.0), material)


def Capsule(start, end, radius, material) -> Primitive:
    return Primitive(CAPSULE, (*start, radius), (*end, radius), material)


def Cylinder(start, end, radius, material) -> Primitive:
    return Primitive(CONE, (*start, radius), (*end, radius), material)


def Cone(start, end, start_radius, end_radius, material) -> Primitive:
    """Return a truncated cone with flat caps."""
    return Primitive(CONE, (*start, start_radius), (*end, end_radius), material)


@dataclass
class Group:
    """Primitives that move rigidly together: one object for object ids and motion vectors."""

    primitives: list[Primitive]
    motion: Motion = field(default_factory=Place)
    casts_shadow: bool = True
    name: str = ""


@dataclass
class Light:
    """A light source.

    `kind` is "sun" (`position` is the direction towards it, `size` the tangent of its angular radius),
    "lamp" (a sphere of radius `size`), "spot" (a lamp with an `axis` and a cone of `angle` degrees half
    width) or "fill" (no shadow: stands for light bounced off large surfaces). `motion` moves position and
    axis.
    """

    kind: str
    position: tuple
    color: tuple
    size: float = 0.1
    axis: tuple = (0.0, -1.0, 0.0)
    angle: float = 40.0
    motion: Motion = field(default_factory=Place)


@dataclass
class Air:
    """Surroundings: sky, ambient light from above and below, haze.

    `clouds` is the cover from 0 to 1; `haze` is an extinction per meter.
    """

    zenith: tuple = (0.0, 0.0, 0.0)
    horizon: tuple = (0.0, 0.0, 0.0)
    clouds: float = 0.0
    ambient_up: tuple = (0.3, 0.3, 0.3)
    ambient_down: tuple = (0.2, 0.2, 0.2)
    haze_color: tuple = (0.5, 0.5, 0.5)
    haze: float = 0.0


@dataclass
class Scene:
    """A place that can be rendered at any time ≥ 0.

    Parameters
    ----------
    eye, target : callables, time → (3,) world position
        Path of the camera and of the point it looks at.
    focal : float
        Focal length in image heights.
    """

    name: str
    seed: int
    groups: list[Group]
    lights: list[Light]
    air: Air
    eye: Callable[[float], np.ndarray]
    target: Callable[[float], np.ndarray]
    focal: float = 0.9
    fps: float = 30.0
    exposure: float = 1.0

    def camera(self, time: float, width: int, height: int) -> Camera:
        """Return the camera at `time` for an image of the given size, principal point in its middle."""
        focal = self.focal * height
        return Camera.look_at(self.eye(time), self.target(time), (0.0, 1.0, 0.0), focal, focal, width / 2, height / 2)


def wave(center, amplitude, period, phase: ArrayLike = 0.0) -> Callable[[float], np.ndarray]:
    """Return a smoothly wandering function of time: center + amplitude · sin(2π (time / period + phase)), per
    coordinate."""
    center, amplitude = np.asarray(center, np.float64), np.asarray(amplitude, np.float64)
    period, phase = np.broadcast_to(period, 3), np.broadcast_to(phase, 3)

    def at(time):
        return center + amplitude * np.sin(2 * np.pi * (time / period + phase))

    return at


def tint(color, factor) -> tuple:
    """Return `color` times a factor or a color."""
    return tuple(float(c) for c in np.asarray(color) * np.asarray(factor))


def vary(rng: np.random.Generator, color, amount=0.15) -> tuple:
    """Return `color` with each channel and the whole scaled by up to ± `amount`."""
    scale = (1 + amount * rng.uniform(-1, 1)) * (1 + 0.6 * amount * rng.uniform(-1, 1, 3))
    return tuple(float(c) for c in np.clip(np.asarray(color) * scale, 0.0, None))


def pick(rng: np.random.Generator, *choices) -> Any:
    """Return one of `choices`, at random."""
    return choices[int(rng.integers(len(choices)))]
