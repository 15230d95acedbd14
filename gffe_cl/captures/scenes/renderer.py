"""Renderer of scenes on an OpenCL device: the arrays of a scene at a time, images, frames and sequences of it, and
`gffe render`, which writes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.captures.scenes.scene_types import ELLIPSOID, GEOMETRY, TEXTURES, Group, Light, Material, Scene, tint
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.captures.sequence.description import rendered_entry
from gffe_cl.captures.sequence.encoding import EXACT, HALF, JITTERED, TAA, Encoding, TemporalAntialiasing
from gffe_cl.captures.sequence.exr import DEFAULT_COMPRESSION
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.window import Jitter, WindowChooser
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import build, constants

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

    def objects(self, poses, camera: Camera, other_poses, other_camera: Camera) -> np.ndarray:
        """Return the objects as (N, 7, 4) float32: bound; rel → local; rel → view space of the other camera at the
        other time."""
        rotation, origin = poses[:, :3, :3], poses[:, :3, 3] - camera.position
        inverse = np.swapaxes(rotation, 1, 2)  # rel → local: p ↦ Rᵀ (p − origin)
        records = np.empty((len(poses), 7, 4), np.float64)
        records[:, 0, :3] = np.einsum("nij,nj->ni", rotation, self.bounds[:, :3]) + origin
        records[:, 0, 3] = self.bounds[:, 3]
        records[:, 1:4, :3] = inverse
        records[:, 1:4, 3] = -np.einsum("nij,nj->ni", inverse, origin)
        view = other_camera.world_to_view[:3, :3]
        other_rotation = view @ other_poses[:, :3, :3]
        other_origin = (other_poses[:, :3, 3] - other_camera.position) @ view.T
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

    def lights(self, time: float, camera: Camera) -> np.ndarray:
        """Return the lights at `time` as (L, 3, 4) float32."""
        rows = [_light_rows(light, time, -camera.position) for light in self.scene.lights]
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
    pose = light.motion(time)
    if light.kind == "sun":
        place = pose[:3, :3] @ (np.asarray(light.position) / np.linalg.norm(light.position))
    else:
        place = pose[:3, :3] @ np.asarray(light.position) + pose[:3, 3] + to_rel
    axis = pose[:3, :3] @ (np.asarray(light.axis) / np.linalg.norm(light.axis))
    return [
        (*place, light.size),
        (*light.color, GEOMETRY[light.kind.upper()]),
        (*axis, np.cos(np.radians(light.angle))),
    ]


_TILE = constants("scenes/scene.cl")["SHADED_TILE"]
_BASE_SAMPLES = 3
_GROUP = 16, 4  # work-items of a work-group; the same for all images: PoCL builds kernels for each size, in seconds
_LAYOUT = {  # of a rendering's buffers: channels and type
    "color": ((4,), np.float16),
    "depth": ((), np.float32),
    "motion": ((2,), np.float32),
    "other_position": ((4,), np.float32),
    "object_id": ((), np.int32),
}


@dataclass
class SceneArrays:
    """A rendering on the host; color, depth and motion as in `gffe_cl.engine.frame.rendered_frame.RenderedFrame`.

    color (H, W, 3) float16; depth (H, W) float32; motion (H, W, 2) float32; other_position (H, W, 4) float32;
    object_id (H, W) int32.
    """

    color: np.ndarray
    depth: np.ndarray
    motion: np.ndarray
    other_position: np.ndarray
    object_id: np.ndarray


@dataclass
class SceneImage:
    """A rendering on the device; the buffers are the renderer's own and hold until its next `render`.

    Attributes
    ----------
    color : half ×4, linear RGB, antialiased
    depth : float, view z at the pixel's center, +inf for sky
    motion : float ×2, pixels: where the surface at the pixel's center was in the other image − here; NaN
        where that lies behind the other camera
    other_position : float ×4: that surface point at the other time in the other camera's view space
        (x, y, z, 1); for sky the direction there as (x/z, y/z, +inf, z): x and y project as those of a point
        at z = 1
    object_id : int, index of the rigid group, −1 for sky
    """

    color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    other_position: cl.Buffer
    object_id: cl.Buffer
    width: int
    height: int
    queue: cl.CommandQueue

    def read(self, name: str) -> np.ndarray:
        """Return a copy on the host of the buffer `name`, as in `SceneArrays`."""
        channels, dtype = _LAYOUT[name]
        out = np.empty((self.height, self.width, *channels), dtype)
        cl.enqueue_copy(self.queue, out, getattr(self, name))
        return np.ascontiguousarray(out[..., :3]) if name == "color" else out

    def numpy(self) -> SceneArrays:
        """Return copies of all buffers on the host."""
        return SceneArrays(**{name: self.read(name) for name in _LAYOUT})

    def copy_to(self, buffers: tuple[cl.Buffer, cl.Buffer, cl.Buffer]) -> None:
        """Enqueue copies of color, depth and motion into device buffers of exactly their size."""
        for buffer, made in zip(buffers, (self.color, self.depth, self.motion), strict=True):
            cl.enqueue_copy(self.queue, buffer, made, byte_count=buffer.size)


class SceneRenderer:
    """Renders `scene` at one image size.

    Parameters
    ----------
    samples : int
        Samples per pixel at edges and on mirrors; where a pixel's surroundings are one surface, a few do.
    footprint : float
        Pixels over which textures are filtered: below 1 for frames smaller than the display (engines: mip bias).
    """

    def __init__(self, device: Device, scene: Scene, width: int, height: int, samples: int = 8, footprint: float = 1.0):
        if width < 1 or height < 1 or samples < 1:
            raise GffeError(f"scene renderer: width, height and samples must be ≥ 1, got {width}×{height}, {samples}")
        self.device, self.scene = device, scene
        self.width, self.height, self.samples = int(width), int(height), int(samples)
        self.footprint = float(footprint)
        self.program = build(device, "scenes/scene")
        self.flat = FlatScene(scene)
        self._tiles = -(-self.width // _TILE) * -(-self.height // _TILE)
        n, pixels = len(scene.groups), self.width * self.height
        self._static = {
            name: self._uploaded(getattr(self.flat, name)) for name in ("object_info", "prims", "prim_info")
        }
        self._materials = self._uploaded(self.flat.materials(0.0))
        self._frame = device.buffer(15 * 16)
        self._objects = device.buffer(n * 7 * 16)
        self._order, self._leaf_of = device.buffer(n * 4), device.buffer(n * 4)
        self._nodes = device.buffer((2 * n - 1) * 2 * 16)
        self._lights = device.buffer(max(len(scene.lights), 1) * 3 * 16)
        self._tile_lists = device.buffer(self._tiles * (n + 1) * 4)
        self._keys = device.buffer(pixels * 4)
        self.image = SceneImage(
            *(device.buffer(pixels * size) for size in (8, 4, 8, 16, 4)),
            width=self.width,
            height=self.height,
            queue=device.queue,
        )

    def render(
        self,
        time: float,
        camera: Camera,
        other_time: float | None = None,
        other_camera: Camera | None = None,
        phase: int = 0,
    ) -> SceneImage:
        """Render at `time` through `camera` (pixels of this renderer's image, any principal point), and return the
        image.

        Parameters
        ----------
        other_time, other_camera
            The frame that motion and other_position refer to: normally the previous rendered frame, but any time before
            or after will do. None: the same time; the same camera.
        phase : int
            Phase of the directions in which rough surfaces reflect: frames of different phases average to more of them.
        """
        other_time = time if other_time is None else other_time
        other_camera = camera if other_camera is None else other_camera
        poses = self.flat.poses(time)
        other_poses = poses if other_time == time else self.flat.poses(other_time)
        objects = self.flat.objects(poses, camera, other_poses, other_camera)
        lights = self.flat.lights(time, camera)
        self._upload(self._objects, objects)
        nodes, leaf_of = build_tree(*self.flat.rel_boxes(objects))
        self._upload(self._order, nearest_first(objects))
        self._upload(self._nodes, nodes)
        self._upload(self._leaf_of, leaf_of)
        self._upload(self._frame, self.flat.frame(camera, other_camera))
        if len(lights):
            self._upload(self._lights, lights)
        if self.flat.flickers:
            self._upload(self._materials, self.flat.materials(time))

        queue, program, image = self.device.queue, self.program, self.image
        size = self.width, self.height
        values = self._static | {
            "frame": self._frame,
            "materials": self._materials,
            "objects": self._objects,
            "object_count": len(objects),
            "order": self._order,
            "lights": self._lights,
            "light_count": len(lights),
            "nodes": self._nodes,
            "node_count": len(nodes),
            "leaf_of": self._leaf_of,
            "tiles": self._tile_lists,
            "tile_stride": len(objects) + 1,
            "keys": self._keys,
            "base": min(_BASE_SAMPLES, self.samples),
            "samples": self.samples,
            "phase": phase,
            "footprint": np.float32(self.footprint),
            "width": self.width,
            "height": self.height,
            "color": image.color,
            "depth": image.depth,
            "motion": image.motion,
            "position": image.other_position,
            "object_id": image.object_id,
        }
        for kernel, items in (("bin", (self._tiles,)), ("surfaces", size), ("shade", size)):
            group = _GROUP[: len(items)]
            padded = tuple(-(-n // side) * side for n, side in zip(items, group, strict=True))
            program.launch(queue, kernel, padded, group, values)
        return image

    def _uploaded(self, array: np.ndarray) -> cl.Buffer:
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.device.context, flags, hostbuf=np.ascontiguousarray(array))

    def _upload(self, buffer: cl.Buffer, array: np.ndarray) -> None:
        cl.enqueue_copy(self.device.queue, buffer, np.ascontiguousarray(array), is_blocking=True)


JITTER_LENGTH = 16  # frames until built-in scenes repeat their jitter


def require_frames(count: int, fps: float) -> None:
    """Raise GffeError unless a scene can be asked for `count` rendered frames at `fps`."""
    if count < 1 or not (0 < fps < float("inf") and 1.0 / fps < float("inf")):
        raise GffeError(f"a built-in scene needs at least 1 frame and positive fps, got {count} and {fps:g}")


class SceneFrames:
    """Frames of a scene by `renderer`: rendered frames, and the truth at any time.

    Parameters
    ----------
    windows : WindowChooser or None
        Chooses the window of each rendered frame. None: no windows.
    size : (width, height) or None
        Size of the display, pixels; that of the renderer's image if None.
    jitter : Jitter or None
        Jitter of rendered frames. None: none.
    truths : SceneRenderer or None
        Renders truth; its image has the display's size. None: `renderer`, where that has it.
    """

    def __init__(
        self,
        renderer: SceneRenderer,
        windows: WindowChooser | None = None,
        size: tuple[int, int] | None = None,
        jitter: Jitter | None = None,
        truths: SceneRenderer | None = None,
    ):
        self.renderer, self.scene = renderer, renderer.scene
        self.render_size = (renderer.width, renderer.height)
        self.size = size or self.render_size
        self.windows = windows or WindowChooser("off", self.size, [])
        self.jitter = jitter or Jitter()
        self._truths = truths or renderer

    @classmethod
    def smaller(
        cls,
        device: Device,
        scene: Scene,
        size: tuple[int, int],
        scale: float,
        samples: int = 1,
        jitter: Jitter | None = None,
        windows: WindowChooser | None = None,
        truths: SceneRenderer | None = None,
    ) -> SceneFrames:
        """Return frames of `scene` for a display of `size`: `scale` times smaller each way, with `samples` per pixel,
        textures as fine as the display, and jitter (None: that of built-in scenes)."""
        width, height = (max(round(n / scale), 1) for n in size)
        renderer = SceneRenderer(device, scene, width, height, samples, 1 / scale)
        return cls(renderer, windows, size, jitter or Jitter(JITTER_LENGTH), truths)

    def display_camera(self, time: float) -> Camera:
        """Return the scene's camera at `time` (seconds), in display pixels."""
        return self.scene.camera(time, *self.size)

    def render_camera(self, shown: Camera, before: RenderedFrame | None, number: int = 0) -> Camera:
        """Return the camera to render frame `number` with, after the rendered frame `before` (None: after a reset), so
        that `shown` is seen."""
        window = self.windows.choose(shown, before and before.shown_camera)
        return self.jitter.camera(window.camera(shown, self.size, self.render_size), number)

    def image(self, time: float, camera: Camera, before: RenderedFrame | None = None, number: int = 0) -> SceneImage:
        """Return the image at `time` seen by `camera`, on the device until the next one is rendered. Motion refers to
        `before`; None: to the frame itself. `number`: for jitter."""
        phase = number % self.jitter.length
        other = before and before.time, before and before.camera
        return self.renderer.render(time, camera, *other, phase=phase)

    def rendered(self, time: float, before: RenderedFrame | None = None, number: int = 0) -> RenderedFrame:
        """Return the rendered frame at `time` after `before`, of host arrays; a reset without one. `number`: for
        jitter."""
        shown = self.display_camera(time)
        camera = self.render_camera(shown, before, number)
        image = self.image(time, camera, before, number).numpy()
        self.windows.observe(image.depth)
        return RenderedFrame(image.color, image.depth, image.motion, camera, time, shown, reset=before is None)

    def truth(self, time: float, before: RenderedFrame | None = None) -> SceneImage:
        """Return the displayed image at `time`, between rendered frames or at one; motion leads into the rendered frame
        `before`."""
        assert self.size == (self._truths.width, self._truths.height)
        return self._truths.render(time, self.display_camera(time), before and before.time, before and before.camera)

    def sequence(
        self, count: int, fps: float | None = None, start: float = 0.0, first: int = 0
    ) -> Iterator[RenderedFrame]:
        """Yield the rendered frames `first` … `count` − 1 in order of time, of which number 0 is at `start` (seconds),
        1 / `fps` (default: the scene's) apart; the first is a reset."""
        fps = fps or self.scene.fps
        require_frames(count, fps)
        step = 1.0 / fps
        before = None
        for k in range(first, count):
            before = self.rendered(start + k * step, before, k)
            yield before


class EncodedFrames:
    """Rendered frames of `frames`, stored by `encoding`. Jittered samples, where it needs them, are rendered beside."""

    def __init__(self, frames: SceneFrames, encoding: Encoding):
        self.frames, self.encoding = frames, encoding
        self._antialiasing = TemporalAntialiasing(frames.scene.exposure)
        device, jitter = frames.renderer.device, Jitter(JITTER_LENGTH)
        if encoding.parts & {TAA, JITTERED}:
            full = SceneRenderer(device, frames.scene, *frames.size, samples=1)
            self._samples = _JitteredSamples(SceneFrames(full, jitter=jitter))
        if HALF in encoding.parts:
            self._small = _JitteredSamples(SceneFrames.smaller(device, frames.scene, frames.size, 2.0))

    def encoded(self, frame: RenderedFrame, number: int) -> RenderedFrame:
        """Return `frame`, number `number`, after being stored. Where encodings are `is_rendered`, frames must come in
        order."""
        if self.encoding.is_rendered:
            frame = self._rendered(frame, number)
        return self.encoding.frame(frame, self.frames.scene.exposure)

    def _rendered(self, frame: RenderedFrame, number: int) -> RenderedFrame:
        """Return `frame` antialiased over time, or its geometry jittered, perhaps smaller, or both."""
        parts, sample = self.encoding.parts, None
        if parts & {TAA, JITTERED}:
            sample = self._samples.of(frame, number)
            if TAA in parts:
                frame = replace(frame, color=self._antialiasing.resolve(sample, frame.color))
        if HALF in parts:
            sample = self._small.of(frame, number)
            frame = replace(frame, geometry_size=(sample.depth.shape[1], sample.depth.shape[0]))
        if sample is None or not parts & {JITTERED, HALF}:
            return frame
        return replace(frame, depth=sample.depth, motion=sample.motion, geometry_jitter=sample.geometry_jitter)


class _JitteredSamples:
    """Jittered samples of a scene, one per pixel, in order of `frames`; their motion is without jitter."""

    def __init__(self, frames: SceneFrames):
        self._frames = frames
        self._last: RenderedFrame | None = None

    def of(self, frame: RenderedFrame, number: int) -> RenderedFrame:
        """Return the samples of `frame`, number `number`, with their `geometry_jitter`."""
        sample = self._frames.rendered(frame.time, None if frame.reset else self._last, number)
        self._last = sample
        x, y = self._frames.jitter.offset(number)
        x_before, y_before = (x, y) if frame.reset else self._frames.jitter.offset(number - 1)
        motion = sample.motion - np.array((x - x_before, y - y_before), np.float32)
        return replace(sample, motion=motion, geometry_jitter=(-x, -y))


_MOST_SCALE = 4
GENERATOR = "gffe-cl render"


def render_sequence(
    scene: Scene,
    output: Path,
    device: Device,
    width: int,
    height: int,
    frames: int,
    fps: float,
    *,
    ground_truth: bool = False,
    truth_every: int = 1,
    per_frame: int = 1,
    samples: int | None = None,
    window: str = "off",
    jitter: Jitter | None = None,
    scale: float = 1.0,
    encoding: Encoding = EXACT,
    compression: str = DEFAULT_COMPRESSION,
    part: range | None = None,
    on_frame: Callable[[], None] = lambda: None,
) -> int:
    """Render `frames` frames of `scene` at `fps` into the folder `output`, and return how many were written.

    With `ground_truth`, also `per_frame` frames after each, with their own depth and motion (to the rendered frame
    before), for measuring; with `truth_every` K after each Kth frame only. `window` is "off", "fixed:FACTOR" or
    "adaptive": covering the frames in between. `width` and `height` are the display's; rendered frames are `scale`
    times smaller each way, with textures as fine as the display. `samples` per pixel: 8 if None, 1 of jittered frames.
    Rendered frames are stored by `encoding`; truth is exact but for a user interface. `compression` is that of the EXRs
    (see `SequenceWriter`). `part`: rendered frames to write, with those in between; None: all. `on_frame`
    is called after every frame. Raises GffeError, also for a part of frames that depend on all before them.
    """
    if part is not None and (window == "adaptive" or encoding.is_rendered):
        raise GffeError(
            "--window adaptive and --encode taa, jittered, half need all frames before (expected no --scheduler)"
        )
    if frames < 1:
        raise GffeError(f"--frames must be at least 1, got {frames}")
    if not 0 < fps < float("inf"):
        raise GffeError(f"--fps must be positive, got {fps:g}")
    if per_frame < 0:
        raise GffeError(f"-n must be at least 0 frames in between, got {per_frame}")
    alphas = [j / (per_frame + 1) for j in range(1, per_frame + 1)]
    if not 1 <= scale <= _MOST_SCALE:
        raise GffeError(f"--scale must be 1 to {_MOST_SCALE}, got {scale:g}")
    windows = WindowChooser(window, (width, height), alphas)
    jitter = jitter or Jitter()
    if encoding.is_on_display and not (window == "off" and jitter.length == 1 and scale == 1):
        raise GffeError("--encode: taa, jittered, half and hud exclude --window, --jitter and --scale")
    samples = samples or (1 if jitter.length > 1 else 8)
    is_apart = ground_truth and (scale > 1 or jitter.length > 1)
    truths = SceneRenderer(device, scene, width, height, 8) if is_apart else None
    exact = SceneFrames.smaller(device, scene, (width, height), scale, samples, jitter, windows, truths)
    made = EncodedFrames(exact, encoding)
    writing = SequenceWriter(
        output,
        width,
        height,
        fps,
        scene.exposure,
        generator=GENERATOR,
        compression=compression,
        format=encoding.format,
    )
    with writing as writer:
        part = part or range(frames)
        first = max(part.start - 1, 0)  # motion leads into the frame before
        for k, frame in enumerate(exact.sequence(part.stop, fps, first=first), first):
            if k not in part:
                continue
            stored = made.encoded(frame, k)
            channels = named_channels(stored.color, stored.depth, stored.motion)
            writer.add(rendered_entry(k, stored, (width, height)), channels)
            on_frame()
            for alpha in alphas if ground_truth and (k + 1) % truth_every == 0 else ():
                time = (k + alpha) * (1.0 / fps)
                image = exact.truth(time, frame).numpy()
                color = encoding.truth(image.color, scene.exposure)
                file = f"truth_{k:06d}_{round(alpha * 1000):04d}.exr"
                entry = FrameEntry(file, time, "ground_truth", display_camera=exact.display_camera(time))
                writer.add(entry, named_channels(color, image.depth, image.motion))
                on_frame()
    return len(part) + sum((k + 1) % truth_every == 0 for k in part) * len(alphas) * ground_truth
