"""Random changes to built-in scenes that make training data varied: other lights, casters and finishes, moving
shading."""

from __future__ import annotations

import dataclasses

import numpy as np

from gffe_cl.captures.scenes.scene_types import (
    Box,
    Capsule,
    Ellipsoid,
    Group,
    Light,
    LightFlicker,
    Material,
    Motion,
    Place,
    Scene,
    Slide,
    Sphere,
    Spin,
    Swing,
    tint,
)

_UP = np.array((0.0, 1.0, 0.0))


def vary_scene(scene: Scene, rng: np.random.Generator, time: float) -> Scene:
    """Return `scene` with random lights, contrast, exposure and finishes, and with moving lights and casters near
    the camera's view at `time`: shadows of visible and invisible objects, sweeping lamps, a turning sun, glass. Some
    are at night or wet. Some also get posts, a flag, screens or a fan, where a correction easily does damage, or a
    vehicle with headlights."""
    eye, target = np.asarray(scene.eye(time)), np.asarray(scene.target(time))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, _UP)
    right /= max(np.linalg.norm(right), 1e-6)
    view = _View(eye, ahead, right, np.cross(right, ahead))
    indoors = not any(light.kind == "sun" for light in scene.lights)
    night = 2.0 ** rng.uniform(-5.0, -2.0) if rng.random() < 0.2 else 1.0
    lights = [_relit(light, rng, night) for light in scene.lights]
    groups = _refinished(scene.groups, rng, 0.7 if rng.random() < 0.2 else 0.2)
    air, contrast = scene.air, night * 2.0 ** rng.uniform(-3.3, 0.2)
    air = dataclasses.replace(
        air,
        ambient_up=tint(air.ambient_up, contrast),
        ambient_down=tint(air.ambient_down, contrast),
        zenith=tint(air.zenith, night),
        horizon=tint(air.horizon, night),
        haze_color=tint(air.haze_color, night),
    )
    level = _level(scene) * night**0.5
    for _ in range(int(rng.integers(night < 1, 4))):
        light, near = _moving_lamp(view, rng, level, time)
        lights.append(light)
        groups += near
    for _ in range(int(rng.integers(2, 8))):
        groups.append(_caster(view, rng, lights, time))
    if rng.random() < 0.2:
        groups.append(_pane(view, rng))
    for add in (_posts, _flag, _screens, _fan):
        if rng.random() < 0.3:
            groups += add(view, rng)
    if rng.random() < (0.7 if night < 1 else 0.2):
        headlights, vehicle = _vehicle(view, rng, level)
        lights += headlights
        groups.append(vehicle)
    exposure = scene.exposure * night**-0.4 * 2.0 ** rng.uniform(-1.2, 1.0) * (1.3 if indoors else 1.0)
    return dataclasses.replace(scene, groups=groups, lights=lights, air=air, exposure=exposure)


@dataclasses.dataclass
class _View:
    eye: np.ndarray
    ahead: np.ndarray
    right: np.ndarray
    up: np.ndarray

    @property
    def yaw(self) -> float:
        """Yaw in degrees that turns an object's +z side to the camera."""
        return float(np.degrees(np.arctan2(-self.ahead[0], -self.ahead[2])))

    def point(self, rng, near: float, far: float, spread: float = 0.6) -> np.ndarray:
        """Return a random point in, or `spread` times as far out as, the middle of the picture."""
        distance = rng.uniform(near, far)
        x, y = rng.uniform(-spread, spread, 2)
        return self.eye + distance * (self.ahead + x * self.right + 0.6 * y * self.up)


def _level(scene: Scene) -> float:
    """Return the strength that a light needs to be visible among the scene's own."""
    strongest = [max(light.color) for light in scene.lights if light.kind != "fill"]
    return float(np.clip(np.median(strongest), 0.5, 8.0)) if strongest else 2.0


def _relit(light: Light, rng, night: float) -> Light:
    """Return the light with another strength, size and, for a sun, course; `night`: factor of sun and sky."""
    strength = 2.0 ** rng.uniform(-0.8, 0.8) * (night if light.kind in ("sun", "fill") else 1.0)
    light = dataclasses.replace(light, color=tint(light.color, strength), size=light.size * rng.uniform(0.3, 2.0))
    if light.kind == "sun" and rng.random() < 0.6:
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        turn: Motion = Swing(tuple(axis), 2.0 ** rng.uniform(2, 5.3), rng.uniform(1.5, 6.0), rng.random())
        light = dataclasses.replace(light, motion=turn)
    return light


def _refinished(groups: list[Group], rng, share: float) -> list[Group]:
    """Return the groups with another finish on that share of the materials: glossy, wet, mirrors, or dull."""
    known: dict[Material, Material] = {}

    def finish(material: Material) -> Material:
        if material not in known:
            changed = material
            if material.transparency == 0 and rng.random() < share:
                changed = dataclasses.replace(
                    material,
                    mirror=rng.uniform(0.4, 1.0),
                    roughness=rng.choice((0.0, 0.05, 0.12, 0.3)),
                    specular=rng.choice((0.04, 0.08, 0.3, 0.7), p=(0.4, 0.3, 0.2, 0.1)),
                )
            known[material] = changed
        return known[material]

    return [
        dataclasses.replace(
            group, primitives=[dataclasses.replace(p, material=finish(p.material)) for p in group.primitives]
        )
        for group in groups
    ]


def _motion(rng, size: float) -> Motion:
    """Return a motion to and fro, and perhaps turning; `size` meters."""
    direction = rng.normal(size=3) * (1.0, 0.4, 1.0)
    direction *= size / max(np.linalg.norm(direction), 1e-6)
    motion: Motion = Slide(tuple(direction), rng.uniform(0.8, 4.0), rng.random())
    if rng.random() < 0.5:
        motion = motion @ Spin(("x", "y", "z")[int(rng.integers(3))], rng.uniform(-200, 200), rng.uniform(0, 360))
    return motion


def _moving_lamp(view: _View, rng, level: float, time: float) -> tuple[Light, list[Group]]:
    """Return a lamp or spot that moves or, as a beacon, turns; sometimes with blades round it that throw turning
    shadows."""
    where = view.point(rng, 1.5, 7.0, 1.0) + (0, rng.uniform(0.2, 1.2), 0)
    at = Place(*where) @ _motion(rng, rng.uniform(0.3, 2.0))
    warm = np.array((1.0, rng.uniform(0.55, 1.0), rng.uniform(0.3, 1.1)))
    color = tint(warm, level * 2.0 ** rng.uniform(0, 2.8))
    spot = rng.random() < 0.6
    aim = view.point(rng, 2.0, 9.0) - where
    if spot and rng.random() < 0.4:
        rate = rng.choice((-1, 1)) * 2.0 ** rng.uniform(4.5, 8.5)
        at = Place(*where) @ Spin("y", rate, rng.uniform(-30, 30) - rate * time)
    light = Light(
        "spot" if spot else "lamp",
        (0, 0, 0),
        color,
        rng.uniform(0.01, 0.12),
        tuple(aim / max(np.linalg.norm(aim), 1e-6)),
        rng.uniform(14, 60),
        motion=at,
    )
    groups = []
    if rng.random() < 0.4:
        dark = Material((0.1, 0.1, 0.1))
        blades = [Box((0.3, 0, k * 0.12 - 0.12), (0.02, 0.4, 0.05), dark) for k in range(int(rng.integers(1, 4)))]
        groups.append(Group(blades, at @ Spin("y", rng.uniform(-250, 250), rng.uniform(0, 360)), name="blades"))
    return light, groups


def _caster(view: _View, rng, lights: list[Light], time: float) -> Group:
    """Return an object that moves between a light and visible surfaces. It may be out of view."""
    size = rng.uniform(0.08, 0.5)
    material = Material(tuple(rng.uniform(0.05, 0.7, 3)), roughness=0.6)
    shape = int(rng.integers(4))
    if shape == 0:
        parts = [Box((0, 0, 0), tuple(size * rng.uniform(0.3, 3.0, 3)), material)]
    elif shape == 1:
        parts = [Sphere((0, 0, 0), size, material)]
    elif shape == 2:
        parts = [Ellipsoid((0, 0, 0), tuple(size * rng.uniform(0.3, 2.0, 3)), material)]
    else:
        parts = [
            Capsule((-size * 2, k * size, 0), (size * 2, k * size, 0), 0.15 * size, material)
            for k in range(int(rng.integers(1, 4)))
        ]
    seen = view.point(rng, 2.0, 9.0)
    casting = [light for light in lights if light.kind != "fill"]
    where = seen
    if casting and rng.random() < 0.8:
        light = casting[int(rng.integers(len(casting)))]
        pose = light.motion(time)
        if light.kind == "sun":
            where = seen + rng.uniform(0.7, 6.0) * _unit(pose[:3, :3] @ np.asarray(light.position, np.float64))
        else:
            lamp = pose[:3, :3] @ np.asarray(light.position, np.float64) + pose[:3, 3]
            where = lamp + rng.uniform(0.2, 0.8) * (seen - lamp)
    if np.linalg.norm(where - view.eye) < 1.2:
        where = view.eye + 1.5 * _unit(where - view.eye + 1e-3)
    return Group(parts, Place(*where) @ _motion(rng, 2.0 ** rng.uniform(-1.5, 1.5)), name="caster")


def _pane(view: _View, rng) -> Group:
    """Return a standing sheet of glass or tinted plastic ahead."""
    glass = Material(
        tuple(rng.uniform(0.6, 1.0, 3)), transparency=rng.uniform(0.4, 0.9), mirror=0.05, specular=0.04, roughness=0.05
    )
    where = view.eye + rng.uniform(1.6, 3.5) * view.ahead + rng.uniform(-1, 1) * view.right
    sheet = Box((0, 0, 0), (rng.uniform(0.6, 2.0), rng.uniform(0.6, 2.0), 0.01), glass)
    motion: Motion = Place(*where, yaw=view.yaw + rng.uniform(-40, 40))
    return Group([sheet], motion @ Swing("y", 10, 2.0) if rng.random() < 0.3 else motion, False, "pane")


def _posts(view: _View, rng) -> list[Group]:
    """Return two rows of posts ahead, one behind the other, with parallax before a far background."""
    groups = []
    material = Material(tuple(rng.uniform(0.1, 0.7, 3)), texture="stripes", scale=rng.uniform(0.1, 0.5))
    for distance in rng.uniform(2, 8, 2):
        middle = view.eye + distance * view.ahead + rng.uniform(-1, 1) * view.right
        posts = [Box((spread * distance, 0, 0), (0.15, 6, 0.15), material) for spread in np.arange(-0.6, 0.7, 0.3)]
        groups.append(Group(posts, Place(*middle, yaw=view.yaw) @ _motion(rng, rng.uniform(0, 0.6)), name="posts"))
    return groups


def _flag(view: _View, rng) -> list[Group]:
    """Return a sheet with fine checks that swings: its texture stays, and the light on it changes."""
    checks = Material(
        tuple(rng.uniform(0.4, 0.9, 3)),
        tuple(rng.uniform(0.02, 0.4, 3)),
        "checker",
        rng.uniform(0.05, 0.3),
        roughness=0.8,
    )
    swing = Swing(("x", "y")[int(rng.integers(2))], rng.uniform(10, 50), rng.uniform(0.5, 3.0))
    at = Place(*view.point(rng, 1.5, 5.0, 0.4), yaw=view.yaw + rng.uniform(-40, 40)) @ swing
    return [Group([Box((0, 0, 0), (rng.uniform(0.4, 1.6), rng.uniform(0.3, 1.2), 0.02), checks)], at, name="flag")]


def _screens(view: _View, rng) -> list[Group]:
    """Return screens side by side, whose brightness jumps."""
    at = Place(*view.point(rng, 2.0, 6.0, 0.4), yaw=view.yaw + rng.uniform(-40, 40))
    rate, side = rng.uniform(8, 30), rng.uniform(0.1, 0.5)
    groups = []
    for x, y in np.ndindex(*rng.integers(1, 5, 2)):
        material = Material(
            (0.02,) * 3,
            emission=tuple(rng.uniform(0.1, 1.5, 3)),
            flicker=LightFlicker(rate, 0.05, int(rng.integers(1 << 16))),
        )
        box = Box((x * side, y * side, 0), (0.9 * side, 0.9 * side, 0.02), material)
        groups.append(Group([box], at, casts_shadow=False, name="screen"))
    return groups


def _fan(view: _View, rng) -> list[Group]:
    """Return a fan of three to five blades, of which light falls through onto surfaces behind."""
    length, count = rng.uniform(0.2, 1.0), int(rng.integers(3, 6))
    material = Material(tuple(rng.uniform(0.05, 0.7, 3)), roughness=0.5)
    rate = rng.choice((-1, 1)) * 2.0 ** rng.uniform(5.0, 9.5)
    at = Place(*view.point(rng, 1.5, 6.0, 0.5), yaw=rng.uniform(0, 360), pitch=rng.uniform(-90, 90))
    blade = Box((0.55 * length, 0, 0), (0.9 * length, 0.3 * length, 0.02), material)
    turn = at @ Spin("z", rate, rng.uniform(0, 360))
    return [Group([blade], turn @ Place(roll=360 * k / count), name="fan") for k in range(count)]


def _vehicle(view: _View, rng, level: float) -> tuple[list[Light], Group]:
    """Return headlights and the vehicle that carries them to and fro, into the view and out of it."""
    size = rng.uniform(0.3, 1.0)
    paint = Material(tuple(rng.uniform(0.05, 0.8, 3)), mirror=rng.uniform(0, 0.6), roughness=0.1)
    lit = Material((0.02,) * 3, emission=tuple(level * rng.uniform(1, 6) * np.array((1.0, 0.9, 0.7))))
    heading = rng.uniform(0, 360)
    along = (np.sin(np.radians(heading)), 0.0, np.cos(np.radians(heading)))
    path = Slide(tuple(rng.uniform(2.0, 8.0) * np.array(along)), rng.uniform(1.5, 6.0), rng.random())
    at = Place(*view.point(rng, 2.5, 9.0)) @ path @ Place(yaw=heading)
    parts = [Box((0, 0.5 * size, 0), (1.6 * size, size, 3 * size), paint)]
    lights = []
    for side in (-0.55, 0.55):
        front = np.array((side * size, 0.4 * size, 1.5 * size))
        parts.append(Sphere(tuple(front), 0.12 * size, lit))
        color, spread = tint((1.0, 0.92, 0.75), level * 2.0 ** rng.uniform(1, 4)), rng.uniform(12, 35)
        ahead = Place(*(front + (0, 0, 0.15 * size)))
        lights.append(Light("spot", (0, 0, 0), color, 0.03, (0.0, -0.12, 0.99), spread, motion=at @ ahead))
    return lights, Group(parts, at, name="vehicle")


def _unit(v: np.ndarray) -> np.ndarray:
    return v / max(np.linalg.norm(v), 1e-9)
