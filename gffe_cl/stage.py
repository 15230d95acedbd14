"""The contract of a stage: it declares its named buffers, allocates them once, and launches kernels.

What the stage dump writes, the viewer lists and the README tabulates comes from `Stage.buffers`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from gffe_cl.camera import Camera
from gffe_cl.frame import BYTES_PER_PIXEL, PackedFrame
from gffe_cl.inference import MULTIPLE
from gffe_cl.opencl.device import Device
from gffe_cl.opencl.program import build

_EVENTS = 1024  # kept per stage for whoever asks for timings
_ROW = 64  # work-items of a work-group, all in one row: rows stream better than squares on CPUs


@dataclass(frozen=True)
class Sizes:
    """Width and height in pixels of rendered (source) and extrapolated (target) images."""

    source: tuple[int, int]
    target: tuple[int, int]


@dataclass(frozen=True)
class BufferSpec:
    """One named buffer of a stage.

    `grid` says whose pixels it has: "source" (rendered frame), "target" (extrapolated frame), "blocks"
    (target / 32, rounded up), "level0" … (source / 2^l, rounded up), "mip1" … (target / 2^l, rounded up), "network"
    (target / 2, rounded up to multiples of 16) or "once" (no image). `components` name its channels; a single one goes
    without. `view` says what it means, and so how to show it: "color" (linear RGB), "depth" (view z), "motion" (pixels,
    from here), "place" (position in pixels), "world" (position in the view space of the rendered camera), "mask" (0 or
    1), "label" (`labels` name its values), "scalar". `mapped`: the host works in it.
    """

    name: str
    dtype: type
    components: tuple[str, ...]
    grid: str
    description: str
    view: str = "scalar"
    planes: int = 1
    labels: tuple[tuple[int, str], ...] = ()
    mapped: bool = False

    @property
    def channels(self) -> int:
        return max(len(self.components), 1)

    def size(self, sizes: Sizes) -> tuple[int, int]:
        """Width and height in pixels or texels."""
        if self.grid.startswith("mip"):
            return halved(sizes.target, int(self.grid[3:]))
        if self.grid.startswith("level"):
            return halved(sizes.source, int(self.grid[5:]))
        return {
            "source": sizes.source,
            "target": sizes.target,
            "blocks": halved(sizes.target, 5),
            "network": tuple(-(-n // MULTIPLE) * MULTIPLE for n in halved(sizes.target, 1)),
            "once": (1, 1),
        }[self.grid]

    def shape(self, sizes: Sizes) -> tuple[int, ...]:
        """Shape of the NumPy array: (planes?, H, W, channels?)."""
        width, height = self.size(sizes)
        shape = (height, width) if self.grid != "once" else ()
        return (self.planes,) * (self.planes > 1) + shape + (self.channels,) * (self.channels > 1 or not shape)

    def nbytes(self, sizes: Sizes) -> int:
        return int(np.prod(self.shape(sizes))) * np.dtype(self.dtype).itemsize


@dataclass
class DeviceFrame:
    """A rendered frame on the device: `color` half ×4, `depth` float, `motion` float ×2 (OpenCL buffers); `camera` in
    pixels of these images, `display_camera` in pixels of the display."""

    color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    camera: Camera
    display_camera: Camera
    time: float

    @classmethod
    def allocate(cls, device: Device, size: tuple[int, int], camera, display_camera, time) -> DeviceFrame:
        """New buffers for images of `size` (width, height)."""
        pixels = size[0] * size[1]
        return cls(*(device.buffer(pixels * n) for n in BYTES_PER_PIXEL), camera, display_camera, time)

    def upload(self, device: Device, packed: PackedFrame) -> None:
        """Copy host arrays in."""
        for buffer, array in zip(self.buffers, (packed.color, packed.depth, packed.motion), strict=True):
            cl.enqueue_copy(device.queue, buffer, array)

    @property
    def buffers(self) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
        return self.color, self.depth, self.motion


RGBA = ("R", "G", "B", "A")
XY = ("x", "y")


class Stage:
    """Base of all stages.

    Subclasses set `name` (kernel file and module too), `buffers` (or override `declare`), and have methods
    that launch their kernels. `events` holds the latest profiling events since the last `take_events`.
    """

    name = ""
    buffers: tuple[BufferSpec, ...] = ()

    def __init__(self, device: Device, sizes: Sizes, **variant: int):
        self.device = device
        self.sizes = sizes
        self.program = build(device, self.name, **variant)
        self.buffer = self.allocate(self.buffers)
        self.events: deque[tuple[str, cl.Event]] = deque(maxlen=_EVENTS)

    def allocate(self, specs: Iterable[BufferSpec]) -> dict[str, cl.Buffer]:
        """New device buffers by name, all bits zero."""
        made = {spec.name: self.device.buffer(spec.nbytes(self.sizes), spec.mapped) for spec in specs}
        for buffer in made.values():
            cl.enqueue_fill_buffer(self.device.queue, buffer, np.uint8(0), 0, buffer.size)
        return made

    def launch(self, kernel: str, size: tuple[int, int], *args, group: int = _ROW) -> None:
        """Enqueue `kernel` over a (width, height) grid in rows of `group` work-items.

        The width is rounded up to whole groups: kernels guard against the padding.
        """
        width, height = size
        grid = (-(-width // group) * group, height)
        event = self.program.kernels[kernel](self.device.queue, grid, (group, 1), *args)
        self.events.append((kernel, event))

    def fill(self, buffer: cl.Buffer, byte: int, nbytes: int | None = None) -> None:
        """Enqueue setting the first `nbytes` bytes of `buffer`, or all of them."""
        event = cl.enqueue_fill_buffer(self.device.queue, buffer, np.uint8(byte), 0, nbytes or buffer.size)
        self.events.append(("fill", event))

    def copy(self, to: cl.Buffer, of: cl.Buffer) -> None:
        """Enqueue a copy between buffers of one size."""
        self.events.append(("copy", cl.enqueue_copy(self.device.queue, to, of)))

    def take_milliseconds(self) -> float:
        """Kernel time since events were last taken; the device must have finished."""
        return sum(e.profile.end - e.profile.start for _, e in self.take_events()) * 1e-6

    def take_events(self) -> list[tuple[str, cl.Event]]:
        events = list(self.events)
        self.events.clear()
        return events

    def upload(self, name: str, values: np.ndarray) -> None:
        """Copy host values into a named buffer."""
        cl.enqueue_copy(self.device.queue, self.buffer[name], values)

    def spec(self, name: str) -> BufferSpec:
        return next(spec for spec in self.buffers if spec.name == name)

    def read(self, name: str) -> np.ndarray:
        """Copy a named buffer to the host."""
        spec = self.spec(name)
        out = np.empty(spec.shape(self.sizes), spec.dtype)
        cl.enqueue_copy(self.device.queue, out, self.buffer[name])
        return out


class NearestStage(Stage):
    """A stage that keeps the nearest of several fragments per pixel (nearest.h).

    With 64-bit atomics one key holds depth and index; without, a second pass finds the least index among the
    nearest. Both give the same bits. A kernel that offers fragments is launched once for each of `passes`.
    """

    def __init__(self, device: Device, sizes: Sizes, int64: bool | None):
        """`int64`: use 64-bit atomics; None: if the device has them."""
        self.int64 = device.int64_atomics if int64 is None else int64
        self.passes = range(1 if self.int64 else 2)
        super().__init__(device, sizes, **({"INT64_ATOMICS": 1} if self.int64 else {}))

    def key_buffers(self, pixels: int) -> tuple[cl.Buffer, cl.Buffer]:
        """Keys and winners for so many pixels."""
        return self.device.buffer(pixels * (8 if self.int64 else 4)), self.device.buffer(
            4 if self.int64 else pixels * 4
        )

    def clear_keys(self, keys: tuple[cl.Buffer, cl.Buffer], size: tuple[int, int]) -> None:
        """Enqueue emptying the keys of an image of (width, height), before fragments are offered."""
        pixels = size[0] * size[1]
        self.fill(keys[0], 0xFF, pixels * (8 if self.int64 else 4))
        if not self.int64:
            self.fill(keys[1], 0xFF, pixels * 4)


def read_some_rows(device: Device, depth: cl.Buffer, size: tuple[int, int], every: int = 16) -> np.ndarray:
    """(ceil(H / every), W) float32: each `every`-th row of a depth buffer of `size` (width, height)."""
    width, height = size
    rows = np.empty((-(-height // every), width), np.float32)
    pitch = width * rows.itemsize
    cl.enqueue_copy(
        device.queue,
        rows,
        depth,
        buffer_origin=(0, 0, 0),
        host_origin=(0, 0, 0),
        region=(pitch, len(rows), 1),
        buffer_pitches=(pitch * every, 0),
        host_pitches=(pitch, 0),
    )
    return rows


def zoom(source: Camera, target: Camera) -> np.ndarray:
    """(2,) float32: target pixels per source pixel of what is equally far from both cameras."""
    return np.array([target.fx / source.fx, target.fy / source.fy], np.float32)


def halved(size: tuple[int, int], times: int) -> tuple[int, int]:
    """(ceil(W / 2^times), ceil(H / 2^times))."""
    return tuple(-(-n // (1 << times)) for n in size)


def reprojection(source: Camera, target: Camera) -> np.ndarray:
    """The `Reprojection` struct of common.h, composed in float64: source view space → target view space."""
    matrix = source.to_view_of(target)
    packed = np.zeros((6, 4), np.float32)
    packed[:3] = matrix[:3]
    packed[3] = source.intrinsics
    packed[4] = (1 / source.fx, 1 / source.fy, source.cx, source.cy)
    packed[5] = target.intrinsics
    return packed


def int2(size: tuple[int, int]) -> tuple[np.int32, np.int32]:
    """(width, height) as kernel arguments."""
    return np.int32(size[0]), np.int32(size[1])
