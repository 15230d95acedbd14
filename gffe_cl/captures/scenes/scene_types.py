"""Types that describe a scene: primitives, materials, groups, lights, air, camera path, scene.

World axes: x right, y up, z towards the viewer; meters, seconds. Colors are linear RGB; light colors are
intensities (radiance at one meter) for lamps and irradiance for the sun, scaled so that a white surface
facing a light of strength 1 shows radiance 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.captures.scenes.motions import Motion, Place
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.program import constants

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
    description: str
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
