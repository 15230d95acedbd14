"""Loops of benchmarks: rendered frames in a loop in which each one follows the frame that its motion refers to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame, host_arrays
from gffe_cl.engine.opencl.device import Device

WARM_UP = 3  # pairs of a scene that do not count


@dataclass(frozen=True)
class Turn:
    """One turn of the loop: submit `frame` (number `index` of the loop), then extrapolate by half an interval, seen
    by `camera` (None: the predicted one). `before`: the frame submitted before it, None after a reset."""

    index: int
    frame: RenderedFrame
    before: RenderedFrame | None
    camera: Camera | None
    counts: bool

    def time(self, interval: float) -> float:
        """Return the time of the extrapolated frame, seconds."""
        return self.frame.time + interval / 2


@dataclass(frozen=True)
class FrameLoop:
    """Input of a benchmark. `name`: the scene; `width`, `height`: of the display; `cameras`: of the extrapolated
    frames; `interval`: seconds; `render_size`: of rendered frames that are smaller than the display."""

    name: str
    width: int
    height: int
    exposure: float
    interval: float
    frames: tuple[RenderedFrame, ...]
    cameras: tuple[Camera | None, ...]
    render_size: tuple[int, int] | None = None

    def turns(self, counted: int) -> Iterator[Turn]:
        """Yield the turns of the loop, until so many have counted."""
        before, done, k = None, 0, 0
        while done < counted:
            index = k % len(self.frames)
            frame = replace(self.frames[index], time=k * self.interval, reset=k == 0)
            counts = k >= WARM_UP
            yield Turn(index, frame, None if frame.reset else before, self.cameras[index], counts)
            before, done, k = frame, done + counts, k + 1

    def part(self, width: int, height: int, center: tuple[float, float]) -> FrameLoop:
        """Return the loop of a part of the images, of at most that size, around `center` (shares of width and
        height); its frames are host arrays."""
        width, height = min(width, self.width), min(height, self.height)
        x = min(max(int(self.width * center[0] - width / 2), 0), self.width - width)
        y = min(max(int(self.height * center[1] - height / 2), 0), self.height - height)

        def cut(array: np.ndarray | None) -> np.ndarray | None:  # a reset may lack motion
            return None if array is None else np.ascontiguousarray(array[y : y + height, x : x + width])

        def moved(camera: Camera) -> Camera:
            return replace(camera, cx=camera.cx - x, cy=camera.cy - y)

        frames = tuple(
            replace(f, color=cut(f.color), depth=cut(f.depth), motion=cut(f.motion), camera=moved(f.camera))
            for f in self.frames
        )
        cameras = tuple(camera and moved(camera) for camera in self.cameras)
        return replace(self, width=width, height=height, frames=frames, cameras=cameras)

    def shown_larger(self, width: int, height: int) -> FrameLoop:
        """Return the same frames for a larger display."""
        factors = width / self.width, height / self.height
        frames = tuple(replace(f, display_camera=f.camera.scaled(*factors)) for f in self.frames)
        cameras = tuple(camera and camera.scaled(*factors) for camera in self.cameras)
        size = self.width, self.height
        return replace(self, width=width, height=height, frames=frames, cameras=cameras, render_size=size)

    def on(self, device: Device) -> FrameLoop:
        """Return the loop with its frames in buffers of `device`."""
        return replace(self, frames=tuple(uploaded(device, frame) for frame in self.frames))


def uploaded(device: Device, frame: RenderedFrame) -> RenderedFrame:
    host = host_arrays(frame).in_device_layout()
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffers = (cl.Buffer(device.context, flags, hostbuf=array) for array in (host.color, host.depth, host.motion))
    return replace(frame, **dict(zip(("color", "depth", "motion"), buffers, strict=True)))
