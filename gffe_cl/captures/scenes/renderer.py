"""Renderer of a built-in scene on an OpenCL device."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from gffe_cl.captures.scenes.flatten import FlatScene, build_tree, nearest_first
from gffe_cl.captures.scenes.scene_types import Scene
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import build, constants

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
        Pixels over which textures are filtered: below 1 for frames that will be upscaled (engines: mip bias).
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
        offset=(0.0, 0.0, 0.0),
        phase: int = 0,
        motion_step: float = 0.0,
    ) -> SceneImage:
        """Render at `time` through `camera` (pixels of this renderer's image, any principal point), and return the
        image.

        Parameters
        ----------
        other_time, other_camera
            The frame that motion and other_position refer to: normally the previous rendered frame, but any time before
            or after will do. None: the same time; the same camera.
        offset : (3,) world units
            The whole world is moved by it; `camera` and `other_camera` stand in the moved world.
        phase : int
            Phase of the directions in which rough surfaces reflect: frames of different phases average to more of them.
        motion_step : float
            Pixels to multiples of which motion is rounded; 0: exact.
        """
        other_time = time if other_time is None else other_time
        other_camera = camera if other_camera is None else other_camera
        offset = np.asarray(offset, np.float64)
        poses = self.flat.poses(time)
        other_poses = poses if other_time == time else self.flat.poses(other_time)
        objects = self.flat.objects(poses, camera, other_poses, other_camera, offset)
        lights = self.flat.lights(time, camera, offset)
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
            "motion_step": np.float32(motion_step),
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
