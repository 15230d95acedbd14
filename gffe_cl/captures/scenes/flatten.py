"""Conversion of a scene to the arrays that kernels/scenes/scene.cl reads; float64 transforms, relative to the
camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from gffe_cl.captures.scenes.scene_types import ELLIPSOID, GEOMETRY, TEXTURES, Group, Light, Material, Scene, tint
from gffe_cl.engine.frame.camera import Camera

CASTS_SHADOW = GEOMETRY["CASTS_SHADOW"]


class FlatScene:
    """Static part of a scene.

    Attributes
    ----------
    prims : (P, 2, 4) float32; prim_info : (P, 2) int32, type and material
    object_info : (N, 4) int32, first primitive, count, flags, 0
    bounds : (N, 4) float64, center and radius in the object's local space
    boxes : (N, 2, 3) float64, center and half size of its box there
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        materials: dict[Material, int] = {}
        prims, prim_info, object_info, bounds, boxes = [], [], [], [], []
        for group in scene.groups:
            flags = CASTS_SHADOW if group.casts_shadow else 0
            object_info.append((len(prims), len(group.primitives), flags, 0))
            boxes.append(_bounding_box(group))
            bounds.append(_bounding_sphere(group, *boxes[-1]))
            for primitive in group.primitives:
                prims.append((primitive.a, primitive.b))
                index = materials.setdefault(primitive.material, len(materials))
                prim_info.append((primitive.kind, index))
        self.prims = np.array(prims, np.float32)
        self.prim_info = np.array(prim_info, np.int32)
        self.object_info = np.array(object_info, np.int32)
        self.bounds = np.array(bounds, np.float64)
        self.boxes = np.array(boxes, np.float64)
        self._materials = list(materials)
        self.flickers = any(m.flicker for m in materials)  # whether materials change with time
        self._still = {i: g.motion(0.0) for i, g in enumerate(scene.groups) if not g.motion.moves}

    def materials(self, time: float) -> np.ndarray:
        """Return the materials at `time` as (M, 5, 4) float32."""
        return np.array([_material_rows(m, time) for m in self._materials], np.float32)

    def poses(self, time: float) -> np.ndarray:
        """Return the poses at `time`, local → world of every object, as (N, 4, 4) float64."""
        return np.stack(
            [self._still[i] if i in self._still else group.motion(time) for i, group in enumerate(self.scene.groups)]
        )

    def objects(self, poses, camera: Camera, other_poses, other_camera: Camera, offset) -> np.ndarray:
        """Return the objects as (N, 7, 4) float32: bound; rel → local; rel → view space of the other camera at the
        other time."""
        to_rel, to_other_rel = offset - camera.position, offset - other_camera.position
        rotation, origin = poses[:, :3, :3], poses[:, :3, 3] + to_rel
        inverse = np.swapaxes(rotation, 1, 2)  # rel → local: p ↦ Rᵀ (p − origin)
        records = np.empty((len(poses), 7, 4), np.float64)
        records[:, 0, :3] = np.einsum("nij,nj->ni", rotation, self.bounds[:, :3]) + origin
        records[:, 0, 3] = self.bounds[:, 3]
        records[:, 1:4, :3] = inverse
        records[:, 1:4, 3] = -np.einsum("nij,nj->ni", inverse, origin)
        view = other_camera.world_to_view[:3, :3]
        other_rotation = view @ other_poses[:, :3, :3]
        other_origin = (other_poses[:, :3, 3] + to_other_rel) @ view.T
        records[:, 4:7, :3] = other_rotation @ inverse
        records[:, 4:7, 3] = other_origin + np.einsum("nij,nj->ni", other_rotation, records[:, 1:4, 3])
        return records.astype(np.float32)

    def rel_boxes(self, objects: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (N, 3) float64 each: lower and upper corners of the objects' boxes in rel, slightly grown."""
        rotation = np.swapaxes(objects[:, 1:4, :3], 1, 2).astype(np.float64)
        center = np.einsum("nij,nj->ni", rotation, self.boxes[:, 0] - objects[:, 1:4, 3])
        half = np.einsum("nij,nj->ni", np.abs(rotation), self.boxes[:, 1])
        half += 5e-4 + 1e-6 * np.abs(center)
        return center - half, center + half

    def lights(self, time: float, camera: Camera, offset) -> np.ndarray:
        """Return the lights at `time` as (L, 3, 4) float32."""
        to_rel = offset - camera.position
        rows = [_light_rows(light, time, to_rel) for light in self.scene.lights]
        return np.array(rows, np.float64).astype(np.float32).reshape(-1, 3, 4)

    def frame(self, camera: Camera, other_camera: Camera) -> np.ndarray:
        """Return the rows that kernels/scenes/geometry.h names, (15, 4) float32."""
        air = self.scene.air
        suns = [light for light in self.scene.lights if light.kind == "sun"]
        rows = np.zeros((GEOMETRY["HAZE"] + 1, 4), np.float64)

        def row(name: str, count: int = 1) -> np.ndarray:
            first = GEOMETRY[name]
            return rows[first : first + count] if count > 1 else rows[first]

        row("VIEW_TO_REL", 3)[:, :3] = camera.world_to_view[:3, :3].T
        row("PINHOLE_INVERSE")[:] = 1 / camera.fx, 1 / camera.fy, camera.cx, camera.cy
        row("OTHER_PINHOLE")[:] = other_camera.intrinsics
        row("REL_TO_OTHER", 3)[:, :3] = other_camera.world_to_view[:3, :3]
        row("AMBIENT_UP")[:3], row("AMBIENT_DOWN")[:3] = air.ambient_up, air.ambient_down
        row("ZENITH")[:] = *air.zenith, air.clouds
        row("HORIZON")[:] = *air.horizon, self.scene.seed % 97 * 1.7
        disc = row("SUN_DISC")
        disc[:] = 0.0, -1.0, 0.0, 1.0
        if suns:
            disc[:3] = np.asarray(suns[0].position) / np.linalg.norm(suns[0].position)
            disc[3] = np.cos(np.arctan(suns[0].size))
            row("SUN_COLOR")[:3] = suns[0].color
        row("HAZE")[:] = *air.haze_color, air.haze
        return rows.astype(np.float32)


def nearest_first(objects: np.ndarray) -> np.ndarray:
    """Return the indices of objects (N, 7, 4), sorted by the distance of their bounding spheres from the camera."""
    distance = np.linalg.norm(objects[:, 0, :3], axis=-1) - objects[:, 0, 3]
    return np.argsort(distance, kind="stable").astype(np.int32)


def build_tree(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a tree over boxes (N, 3): nodes (M, 2, 4) float32 in depth-first order, and each box's leaf (N,) int32.

    A node is (min, next node when missed), (max, box or −1); the integers are stored as their bits. The
    larger half comes first, so that big occluders are met early.
    """
    nodes: list = []
    leaves = np.zeros(len(low), np.int32)

    def add(members):
        index = len(nodes)
        nodes.append([low[members].min(0), high[members].max(0), index + 1, -1])
        if len(members) == 1:
            leaves[members[0]], nodes[index][3] = index, members[0]
            return
        for part in _split(members, low, high):
            add(part)
        nodes[index][2] = len(nodes)

    add(np.arange(len(low)))
    table = np.zeros((len(nodes), 2, 4), np.float32)
    table[:, 0, :3], table[:, 1, :3] = [n[0] for n in nodes], [n[1] for n in nodes]
    bits = table.view(np.int32)
    bits[:, 0, 3], bits[:, 1, 3] = [n[2] for n in nodes], [n[3] for n in nodes]
    return table, leaves


def _split(members: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two parts at the cheapest place along any axis by the surface area heuristic; the larger part first."""
    low, high = low[members], high[members]
    center = low + high
    best: tuple[float, Any] = (np.inf, None)
    for axis in range(3):
        rank = np.argsort(center[:, axis], kind="stable")
        left = _areas(low[rank], high[rank])
        right = _areas(low[rank[::-1]], high[rank[::-1]])[::-1]
        count = np.arange(1, len(rank))
        cost = left[:-1] * count + right[1:] * count[::-1]
        k = int(np.argmin(cost))
        if cost[k] < best[0]:
            best = cost[k], (rank[: k + 1], rank[k + 1 :], left[k] < right[k + 1])
    first, second, swap = best[1]
    return (members[second], members[first]) if swap else (members[first], members[second])


def _areas(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the surface areas of the boxes around the first 1, 2, … of the boxes (N, 3)."""
    size = np.maximum.accumulate(high) - np.minimum.accumulate(low)
    return size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]


def _bounding_box(group: Group) -> tuple[np.ndarray, np.ndarray]:
    low, high = (np.array(side) for side in zip(*(p.bounds() for p in group.primitives), strict=True))
    return (low.min(0) + high.max(0)) / 2, (high.max(0) - low.min(0)) / 2


def _bounding_sphere(group: Group, center: np.ndarray, half_size: np.ndarray) -> tuple:
    only = group.primitives[0]
    lone_sphere = len(group.primitives) == 1 and only.kind == ELLIPSOID
    radius = max(only.b[:3]) if lone_sphere else np.linalg.norm(half_size)
    return (*center, radius * 1.0005 + 1e-4)


def _material_rows(m: Material, time: float) -> list:
    glow = m.flicker(time) if m.flicker else 1.0
    spread = np.random.default_rng(m.seed).uniform(0, 64, 3)
    return [
        (*m.color, TEXTURES[m.texture]),
        (*m.second, m.scale),
        (m.specular, m.roughness, m.mirror, m.transparency),
        (*tint(m.emission, glow), m.contrast),
        (*spread, 0.0),
    ]


def _light_rows(light: Light, time: float, to_rel: np.ndarray) -> list:
    pose, factor = light.motion(time), light.flicker(time) if light.flicker else 1.0
    if light.kind == "sun":
        place = pose[:3, :3] @ (np.asarray(light.position) / np.linalg.norm(light.position))
    else:
        place = pose[:3, :3] @ np.asarray(light.position) + pose[:3, 3] + to_rel
    axis = pose[:3, :3] @ (np.asarray(light.axis) / np.linalg.norm(light.axis))
    return [
        (*place, light.size),
        (*tint(light.color, factor), GEOMETRY[light.kind.upper()]),
        (*axis, np.cos(np.radians(light.angle))),
    ]
