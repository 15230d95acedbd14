"""A procedural city in Panda3D, 1920×1080: multisampled color over point-sampled, coarsely stored depth and motion."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from panda3d.core import NodePath

import gffe_cl as gffe
from unseen.panda import PandaRenderer, box, joined, mesh_node, texture
from unseen.recording import Picture, noise_texture, placed, wobble

_PAINTS = ((0.75, 0.1, 0.08), (0.1, 0.22, 0.6), (0.85, 0.85, 0.82), (0.12, 0.13, 0.14), (0.9, 0.65, 0.1))
_WHEEL = 0.36  # radius


class PandaCity:
    """A walk along a street with cars, pedestrians and a drone, filmed by hand."""

    fps = 30.0

    def __init__(self, width: int = 1920, height: int = 1080, frames: int = 12):
        self.width, self.height, self.frames = width, height, frames
        self._renderer = PandaRenderer(width, height, samples=4, shadow_size=110)
        self._rng = np.random.default_rng(11)
        self._movers: list[tuple[NodePath, object]] = []  # with the function of time that gives the model matrix
        self._renderer.add_sky(noise_texture(512, 8))
        self._renderer.set_light(
            toward_sun=(-0.32, -0.9, 0.85), center=(0, 22, 0), color=(0.95, 0.88, 0.74), ambient=(0.33, 0.36, 0.43),
            fog=(0.74, 0.79, 0.85, 220), zenith=(0.22, 0.42, 0.75),
        )  # fmt: skip
        self._build_street()
        for k, paint in enumerate(_PAINTS):
            self._add_car(paint, lane=(-2.0, 2.0)[k % 2], start=(4, 12, 24, 30, 40)[k], speed=(11, -9, 8, -13, 12)[k])
        self._add_car((0.5, 0.52, 0.5), lane=-4.6, start=9, speed=0)
        self._add_car((0.3, 0.05, 0.1), lane=-4.6, start=17, speed=0)
        for k in range(6):
            self._add_walker(x=(5.6, 6.8, 6.2, -6.4, -7.2, 7.0)[k], start=(6, 9, 15, 10, 18, 22)[k],
                             speed=(1.3, -1.5, 1.1, -1.2, 1.6, -1.4)[k], seed=k)  # fmt: skip
        self._add_drone()

    def picture(self, time: float, previous: float | None) -> Picture:
        """Return what is seen at `time` (seconds), with motion since `previous`."""
        earlier = time if previous is None else previous
        for node, matrix in self._movers:
            self._renderer.place(node, matrix(time), matrix(earlier))
        picture = self._renderer.picture(self._camera(time), None if previous is None else self._camera(previous))
        return replace(picture, depth=_through_half(picture.depth), motion=self._stored_motion(picture.motion))

    def close(self) -> None:
        """Release the engine."""
        self._renderer.close()

    def _camera(self, time: float) -> gffe.Camera:
        speeds = (3.1, 5.3, 8.9, 13.0)
        position = np.array([6.3, -2 + 1.8 * time, 1.7])
        position += 0.05 * np.array([wobble(time, speeds, seed) for seed in (1, 2, 3)])
        target = position + (-1.9 + 1.2 * math.sin(1.5 * time), 8, 0.35)
        target += 0.3 * np.array([wobble(time, speeds, 4), 0, wobble(time, speeds, 5)])
        up = (0.03 * wobble(time, speeds, 6), 0, 1)
        focal = 0.72 * self.width
        return gffe.Camera.look_at(position, target, up, focal, focal, self.width / 2, self.height / 2)

    def _stored_motion(self, motion: np.ndarray | None) -> np.ndarray | None:
        """Return motion as an engine stores it: current − previous in halves of the image, y up, around ½, in half
        floats."""
        if motion is None:
            return None
        size = np.array([self.width, -self.height], np.float32)
        stored = (0.5 - 0.5 * motion / size).astype(np.float16)
        return (0.5 - stored.astype(np.float32)) * 2 * size

    def _add(self, parts, image: np.ndarray, matrix=None) -> None:
        """Add a mesh with a texture; `matrix`: its model matrix by time, if it moves."""
        node = self._renderer.root.attachNewNode(mesh_node(*joined(parts)))
        node.setTexture(texture(image, mipmaps=True))
        if matrix:
            self._movers.append((node, matrix))

    def _build_street(self) -> None:
        self._add([box((-5.2, -30, -0.2), (5.2, 160, 0), 1 / 10.4)], _asphalt())
        pavement = [box((side * 7 - 1.8, -30, -0.2), (side * 7 + 1.8, 160, 0.14), 0.5) for side in (-1, 1)]
        self._add([*pavement, box((-60, -30, -0.3), (60, 160, -0.05), 0.5)], _paving())
        for side in (-1, 1):
            start = -24.0
            for k in range(13):
                length, height = self._rng.uniform(8, 14), self._rng.uniform(9, 26)
                inner = side * self._rng.uniform(8.8, 9.6)
                low, high = sorted((inner, inner + side * 12))
                parts = [box((low, start, 0), (high, start + length, height), 1 / 4)]
                edge = sorted((inner - side * 0.35, inner + side))
                for floor in range(1, int(height // 4) + 1):  # ledges, which hide and show facades
                    parts.append(box((edge[0], start, 4 * floor), (edge[1], start + length, 4 * floor + 0.25), 0.5))
                self._add(parts, _facade(20 + k + 40 * (side > 0)))
                start += length + self._rng.choice([0, 0, 0, 5])
        posts = []
        for y in range(2, 90, 9):
            for side in (-1, 1):
                x = side * 5.5
                posts += [box((x - 0.07, y - 0.07, 0), (x + 0.07, y + 0.07, 5.5))]
                posts += [box((min(x, x - side * 1.5), y - 0.06, 5.4), (max(x, x - side * 1.5), y + 0.06, 5.52))]
        rails = [box((5.42, y, 0.14), (5.48, y + 0.06, 1.0)) for y in np.arange(4, 30, 0.5)]
        rails += [box((5.42, 4, z), (5.48, 30, z + 0.06)) for z in (0.5, 0.95)]
        self._add(posts + rails, _painted((0.2, 0.23, 0.22), 3))

    def _add_car(self, paint, lane: float, start: float, speed: float) -> None:
        turn = 0 if speed >= 0 else math.pi

        def body(time: float) -> np.ndarray:
            bounce = 0.02 * math.sin(9 * time + start) * (speed != 0)
            return placed((lane, start + speed * time, bounce), turn)

        hull = [
            box((-0.9, -2.1, 0.3), (0.9, 2.1, 0.95), 0.5), box((-0.78, -1.4, 0.95), (0.78, 0.8, 1.05), 0.5),
            box((-0.75, -1.3, 1.42), (0.75, 0.6, 1.5), 0.5),
        ]  # fmt: skip
        hull += [
            box((x - 0.05, y - 0.05, 1), (x + 0.05, y + 0.05, 1.45)) for x in (-0.7, 0.7) for y in (-1.25, -0.3, 0.55)
        ]
        self._add(hull, _painted(paint, int(10 * start)), body)
        self._add([box((-0.7, -1.2, 1.0), (0.7, 0.5, 1.4), 0.7)], _painted((0.08, 0.1, 0.13), 5), body)
        lamps = [box((x - 0.2, y, 0.6), (x + 0.2, y + 0.06, 0.78)) for x in (-0.6, 0.6) for y in (-2.15, 2.09)]
        self._add(lamps, _painted((1, 0.9, 0.7), 6), body)
        for x in (-0.8, 0.8):
            for y in (-1.35, 1.35):

                def wheel(time: float, x=x, y=y) -> np.ndarray:
                    return body(time) @ placed((x, y, _WHEEL), -abs(speed) * time / _WHEEL, (1, 0, 0))

                self._add([_wheel_mesh()], _painted((0.5, 0.5, 0.52), 7, contrast=0.9), wheel)

    def _add_walker(self, x: float, start: float, speed: float, seed: int) -> None:
        turn = 0 if speed >= 0 else math.pi
        coat, trousers = self._rng.uniform(0.1, 0.9, 3), self._rng.uniform(0.05, 0.4, 3)

        def torso(time: float) -> np.ndarray:
            return placed((x, start + speed * time, 0.14 + 0.03 * abs(math.sin(6 * time + seed))), turn)

        def limb(side: int, height: float, reach: float):
            def matrix(time: float) -> np.ndarray:
                return torso(time) @ placed(
                    (side * reach, 0, height), 0.55 * side * math.sin(6 * time + seed), (1, 0, 0)
                )

            return matrix

        self._add([box((-0.22, -0.13, 0.85), (0.22, 0.13, 1.45), 1.5)], _painted(coat, seed, contrast=0.6), torso)
        self._add([box((-0.1, -0.11, 1.5), (0.1, 0.11, 1.75))], _painted((0.75, 0.55, 0.45), seed), torso)
        for side in (-1, 1):
            leg, arm = box((-0.09, -0.1, -0.85), (0.09, 0.1, 0.05), 1.5), box((-0.06, -0.07, -0.6), (0.06, 0.07, 0.05))
            self._add([leg], _painted(trousers, seed + 9), limb(side, 0.85, 0.11))
            self._add([arm], _painted(coat, seed + 17, contrast=0.6), limb(-side, 1.4, -0.29))

    def _add_drone(self) -> None:
        def body(time: float) -> np.ndarray:
            place = (3.2 - 2.6 * time, 4.0 + 2.2 * time, 2.6 + 0.25 * math.sin(5 * time))
            return placed(place, 0.8 * math.sin(3 * time)) @ placed((0, 0, 0), 0.25 * math.cos(4 * time), (0, 1, 0))

        arms = [box((-0.32, -0.025, 0), (0.32, 0.025, 0.04)), box((-0.025, -0.32, 0), (0.025, 0.32, 0.04))]
        self._add([box((-0.12, -0.12, -0.06), (0.12, 0.12, 0.08), 3), *arms], _painted((0.9, 0.45, 0.1), 31), body)
        for k, (x, y) in enumerate(((0.32, 0), (-0.32, 0), (0, 0.32), (0, -0.32))):

            def rotor(time: float, x=x, y=y, k=k) -> np.ndarray:
                return body(time) @ placed((x, y, 0.06), (14 + k) * time)

            self._add([box((-0.17, -0.02, 0), (0.17, 0.02, 0.015))], _painted((0.1, 0.1, 0.1), 32), rotor)


def _wheel_mesh(sides: int = 14) -> tuple[np.ndarray, np.ndarray]:
    """Return a cylinder along x, with sides and caps."""
    vertices, triangles = [], []
    for k in range(sides):
        angles = [2 * math.pi * (k + step) / sides for step in (0, 1)]
        rim = [(math.cos(a), math.sin(a)) for a in angles]
        first = len(vertices)
        vertices += [(x, _WHEEL * c, _WHEEL * s, 0, c, s, x, k / 3) for c, s in rim for x in (-0.12, 0.12)]
        triangles += [(first, first + 2, first + 1), (first + 1, first + 2, first + 3)]
        for x in (-0.12, 0.12):
            first, outward = len(vertices), math.copysign(1, x)
            corners = [(0, 0), *rim]
            vertices += [(x, _WHEEL * c, _WHEEL * s, outward, 0, 0, 0.5 + c / 2, 0.5 + s / 2) for c, s in corners]
            triangles.append((first, first + 1, first + 2) if x > 0 else (first, first + 2, first + 1))
    return np.array(vertices), np.array(triangles)


def _facade(seed: int) -> np.ndarray:
    """Return bricks with one window of 4×4 units, some of them lit, with frames and dirt."""
    rng, size = np.random.default_rng(seed), 256
    y, x = np.mgrid[:size, :size]
    wall = rng.uniform(0.35, 0.85) * np.array([1, rng.uniform(0.6, 0.95), rng.uniform(0.45, 0.85)])
    row = y // 8
    brick = ((y % 8) < 1) | (((x + 8 * (row % 2)) % 16) < 1)
    shade = rng.uniform(0.8, 1.1, (size // 8, size // 16 + 1))[row, (x + 8 * (row % 2)) // 16]
    image = wall * (shade * np.where(brick, 0.65, 1))[..., None]
    for left in (28, 150):
        frame = (abs(x - left - 40) < 40) & (abs(y - 128) < 72)
        pane = (abs(x - left - 40) < 35) & (abs(y - 128) < 67) & (abs(x - left - 40) > 2) & (abs(y - 110) > 2)
        glass = np.array([0.95, 0.8, 0.5]) if rng.random() < 0.3 else np.array([0.16, 0.2, 0.26])
        image = np.where(frame[..., None], 0.85 - 0.5 * rng.random() * np.ones(3), image)
        image = np.where(pane[..., None], glass * (0.7 + 0.6 * (y / size))[..., None], image)
    return image * (0.75 + 0.4 * noise_texture(size, seed))[..., None]


def _asphalt() -> np.ndarray:
    size = 512
    y, x = np.mgrid[:size, :size]
    image = (0.24 + 0.22 * noise_texture(size, 41, 8, 0.85))[..., None] * np.array([1, 1, 1.04])
    middle = (abs(x - size / 2) < 5) & (y % 256 < 130)
    border = (abs(x - 18) < 4) | (abs(x - size + 18) < 4)
    crossing = (y > 440) & (x // 26 % 2 == 0) & (x > 40) & (x < size - 40)
    paint = 0.7 + 0.25 * noise_texture(size, 42)
    return np.where((middle | border | crossing)[..., None], paint[..., None], image)


def _paving() -> np.ndarray:
    size = 256
    y, x = np.mgrid[:size, :size]
    shade = np.random.default_rng(43).uniform(0.45, 0.65, (4, 4))[y // 64, x // 64]
    joint = (y % 64 < 2) | (x % 64 < 2)
    return (np.where(joint, 0.25, shade) * (0.8 + 0.35 * noise_texture(size, 44, 7, 0.8)))[..., None] * np.array(
        [1, 0.98, 0.93]
    )


def _painted(color, seed: int, contrast: float = 0.25) -> np.ndarray:
    """Return a color with noise."""
    return np.asarray(color) * (1 - contrast / 2 + contrast * (noise_texture(128, 100 + seed) - 0.5))[..., None]


def _through_half(depth: np.ndarray) -> np.ndarray:
    return depth.astype(np.float16).astype(np.float32)
