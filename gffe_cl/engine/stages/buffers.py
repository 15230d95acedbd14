"""Named buffers on the device: their meaning, size and owner.

A buffer is called "<owner>.<name>": "rendered.depth" and "previous.depth" are of the rendered frame and of the one
before, "frame.color" of the extrapolated frame, all others of the stage that makes them: "history.dynamic_mask". An
apostrophe marks a buffer that a stage kept of the frame before, as in the paper: "history.history'".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
import pyopencl.array
from pyopencl.array import Array
from pyopencl.tools import PooledBuffer

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import BYTES_PER_PIXEL
from gffe_cl.engine.inference.layers import MULTIPLE
from gffe_cl.engine.opencl.device import Device, adopted, is_handle
from gffe_cl.engine.opencl.program import constants

_PX_UNITS = constants("background.cl")["PX_UNITS"]
_MOST_TRUST = constants("mover_grid.h")["MOST_TRUST"]


@dataclass(frozen=True)
class Packing:
    """A form in which pixels are stored: `name` as tables have it, `channels` of `dtype` each.

    `unpack` turns those of a block, (…, H, W, channels), into values (…, H, W, channels of the buffer), given column
    and row of its first texel and the side of a texel in pixels.
    """

    name: str
    dtype: type
    channels: int
    unpack: Callable[[np.ndarray, int, int, int], np.ndarray]


def _unpack_color(stored: np.ndarray, x: int, y: int, side: int) -> np.ndarray:
    bits = stored[..., 0]
    color = np.zeros((*bits.shape, 4), np.float16)
    unit = np.ldexp(np.float32(1), (bits >> 27).astype(np.int32) - 24)
    for channel in range(3):
        color[..., channel] = (bits >> 9 * channel & 511) * unit
    return color


def _unpack_place(stored: np.ndarray, x: int, y: int, side: int) -> np.ndarray:
    height, width = stored.shape[-3:-1]
    row, column = np.mgrid[y : y + height, x : x + width].astype(np.float32) + np.float32(0.5)
    unit = np.float32(side / _PX_UNITS)
    return np.stack([column, row], -1) * np.float32(side) + stored.astype(np.float32) * unit


def _unpack_trusted(stored: np.ndarray, x: int, y: int, side: int) -> np.ndarray:
    low, high = stored[..., 0], stored[..., 1]
    parts = [low & 0x7FFFF, low >> 19 | (high & 127) << 12, high >> 7 & 0x7FFFF]
    trust = (high >> 26).astype(np.int32)
    trusted = np.where(trust > _MOST_TRUST, np.float32(-1), trust / np.float32(_MOST_TRUST)).astype(np.float32)
    return np.stack([*((part << 13).astype(np.uint32).view(np.float32) for part in parts), trusted], -1)


RGB9E5 = Packing("RGB9E5", np.uint32, 1, _unpack_color)
OFFSET = Packing("int16 ×2", np.int16, 2, _unpack_place)
TRUSTED = Packing("3 × 19 bits + 6", np.uint32, 2, _unpack_trusted)


LEAST_ALIGNMENT = 1024  # of parts of a buffer; devices may ask for more

RGBA = ("R", "G", "B", "A")
XY = ("x", "y")

_LABELS = constants("common.h")
BLOCK = tuple(constants("blocks.h")[f"BLOCK_{side}"] for side in ("WIDTH", "HEIGHT"))  # pixels
_HOLES, _HISTORY = constants("holes.cl"), constants("history.cl")
DOWNSAMPLING = _HOLES["DOWNSAMPLING"]  # of hole filling as in the paper
CUT_SAMPLES = (_HISTORY["SAMPLES_X"], _HISTORY["SAMPLES_Y"])  # at most, of the rendered image
RUN_PIXELS = constants("upload.cl")["RUN_PIXELS"]
WALKERS = 2048 * constants("lists.h")["WALK_GROUP"]  # work-items that walk a list, at most
RESIDUAL_STRIDE, RESIDUAL_ROWS = _HISTORY["RESIDUAL_STRIDE"], _HISTORY["RESIDUAL_ROWS"]  # pixels, samples
BY_HOLE_FILLING, BY_NOTHING = _LABELS["BY_HOLE_FILLING"], _LABELS["BY_NOTHING"]
BY_WARP, BY_CRACK_CLOSING = _LABELS["BY_WARP"], _LABELS["BY_CRACK_CLOSING"]
BY_HIDDEN_PART, BY_FIXED = _LABELS["BY_HIDDEN_PART"], _LABELS["BY_FIXED"]
BY_REAPPEARING = _LABELS["BY_REAPPEARING"]
FILLED_BY = (
    (BY_WARP, "its own fragment"),
    *((1 + level, f"background level {level}") for level in range(4)),
    (BY_HIDDEN_PART, "hidden part of a mover"),
    (BY_FIXED, "a pixel that stays in place"),
    (BY_REAPPEARING, "part of a mover that reappears"),
    (BY_NOTHING, "nothing"),
    (BY_CRACK_CLOSING, "crack closing"),
    (BY_HOLE_FILLING, "hole filling"),
)


@dataclass(frozen=True)
class Sizes:
    """Width and height in pixels of rendered (source) and extrapolated (target) images, and the `alignment` of parts of
    a buffer, in bytes, or in texels, which have at least one."""

    source: tuple[int, int]
    target: tuple[int, int]
    alignment: int = LEAST_ALIGNMENT

    def aligned(self, n: int) -> int:
        """Return the first start of a part of a buffer that is not before byte, or texel, `n`."""
        return -(-n // self.alignment) * self.alignment

    def level_starts(self, levels: int) -> list[int]:
        """Return the first texel of each background level where they lie one after another, and the end."""
        return [0, *accumulate(self.aligned(math.prod(halved(self.source, level))) for level in range(levels))]

    @cache  # noqa: B019  # sizes are few, and small
    def of(self, grid: str) -> tuple[int, int]:
        """Return width and height of a grid; `BufferSpec` lists the grids."""
        return grid_of(grid).size(self)


class Layout(NamedTuple):
    """How the size of a grid follows from those of the images, in C, too: one texel per `texel` pixels of the rendered
    image (`is_of_source`) or the extrapolated one, sides rounded up to a `multiple`; `is_flat`: all in one row;
    `columns`: so many, whatever the image; at `most` so many columns and rows (0: any), and `more` beyond that.
    `levels`: so many background levels one after another, and nothing of the above."""

    is_of_source: bool = False
    texel: tuple[int, int] = (1, 1)
    multiple: int = 1
    is_flat: bool = False
    columns: int = 0
    most: tuple[int, int] = (0, 0)
    more: tuple[int, int] = (0, 0)
    levels: int = 0


# By the kind of grid; sides of the texels of those with a level are halved so often.
_LAYOUTS = {
    "once": Layout(columns=1, most=(0, 1)),
    "source": Layout(True),
    "source_blocks": Layout(True, BLOCK),
    "cells": Layout(True, (8, 8)),
    "residuals": Layout(True, (RESIDUAL_STRIDE, RESIDUAL_STRIDE)),
    "runs": Layout(True, (RUN_PIXELS, 1)),
    "level": Layout(True),
    "levels": Layout(True),
    "flat_level": Layout(True, is_flat=True),
    "cut_samples": Layout(True, columns=CUT_SAMPLES[0], most=(0, CUT_SAMPLES[1])),
    "measures": Layout(True, (RESIDUAL_STRIDE, RESIDUAL_STRIDE), more=(0, (1 + CUT_SAMPLES[1]) * RESIDUAL_ROWS)),
    "predictions": Layout(True, more=(0, 1)),
    "target": Layout(),
    "target_blocks": Layout(texel=BLOCK),
    "downsampled": Layout(texel=(DOWNSAMPLING, DOWNSAMPLING)),
    "network": Layout(texel=(2, 2), multiple=MULTIPLE),
    "list_target": Layout(is_flat=True, more=(1, 0)),
    "walk": Layout(is_flat=True, most=(WALKERS, 0)),
}


@dataclass(frozen=True)
class Grid:
    """A grid of texels or work-items: its name in `BufferSpec` without the number at its end, and this number. It is
    how often sides are halved, or the number of levels ("levels")."""

    kind: str
    level: int = 0

    @property
    def lies_on_source(self) -> bool:
        """Whether it is laid over the rendered image; else it is laid over the extrapolated one."""
        return self.layout.is_of_source

    @property
    def is_list(self) -> bool:
        """Whether it has a list of pixels (lists.h)."""
        return self.kind == "list_target"

    @property
    def texel(self) -> tuple[int, int]:
        """Width and height in pixels that a texel covers, in the image over which the grid is laid."""
        return self.layout.texel

    @property
    def layout(self) -> Layout:
        """How its size follows from the sizes of the images."""
        layout = _LAYOUTS[self.kind]
        if self.kind == "levels":
            return layout._replace(levels=self.level)
        width, height = layout.texel
        multiple = max(layout.multiple >> self.level, 1)
        return layout._replace(texel=(width << self.level, height << self.level), multiple=multiple)

    def size(self, sizes: Sizes) -> tuple[int, int]:
        """Return width and height in texels for images of `sizes`."""
        layout = self.layout
        if layout.levels:
            return sizes.level_starts(layout.levels)[-1], 1
        image = sizes.source if layout.is_of_source else sizes.target
        steps = (side * layout.multiple for side in layout.texel)
        width, height = (-(-n // step) * layout.multiple for n, step in zip(image, steps, strict=True))
        if layout.is_flat:
            width, height = width * height, 1
        made = zip((layout.columns or width, height), layout.most, layout.more, strict=True)
        width, height = (min(n, most or n) + more for n, most, more in made)
        return width, height


@cache
def grid_of(name: str) -> Grid:
    """Return the grid of that name. Raises GffeError if there is none."""
    kind = name.rstrip("0123456789")
    if kind not in _LAYOUTS:
        raise GffeError(f"there is no grid '{name}' (expected a name that BufferSpec lists)")
    return Grid(kind, int(name[len(kind) :] or 0))


def texels_over(grid: str, fine: str, x: int, y: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Return the block of texels of `grid` (x, y, width, height) over a block of texels of `fine`, which is no
    coarser."""
    side_x, side_y = (n // m for n, m in zip(grid_of(grid).texel, grid_of(fine).texel, strict=True))
    x0, y0 = x // side_x, y // side_y
    return x0, y0, (x + width - 1) // side_x + 1 - x0, (y + height - 1) // side_y + 1 - y0


def spread(texels: np.ndarray, grid: str, fine: str, x: int, y: int, width: int, height: int) -> np.ndarray:
    """Return (height, width): for each texel of a block of `fine` the one of `texels` (see `texels_over`) that covers
    it."""
    side_x, side_y = (n // m for n, m in zip(grid_of(grid).texel, grid_of(fine).texel, strict=True))
    rows, columns = np.arange(y, y + height) // side_y, np.arange(x, x + width) // side_x
    return texels[np.ix_(rows - rows[0], columns - columns[0])]


@dataclass(frozen=True)
class BufferSpec:
    """Description of one named buffer.

    `grid` is the grid of its pixels: "source" (rendered frame), "target" (extrapolated frame), "downsampled" (target /
    32, rounded up), "source_blocks" and "target_blocks" (blocks of 8×4), "level0" … (source / 2^l, rounded up),
    "levels1" … (so many of these one after another), "network" (target / 2,
    rounded up to multiples of 16), "network1" … "network4" (that / 2^l), "cells" (source / 8, rounded up) or "once" (no
    image). Some kernels have grids of their own: "residuals" (source / 4, rounded up), "runs" (31 pixels in a row of
    "source" each), "cut_samples" (so many of the rendered
    image), "measures" (a row, these and the residuals, one below the other), "predictions" ("source" and a row more),
    "flat_level0" … (the texels of a level in one row) and "walk" (those that walk a list). A list of pixels
    (lists.h) has the grid "list_target": its length, and one texel per pixel. `components` name its
    channels; a single one goes without. `view` is its meaning, and so how to show it: "color" (linear RGB), "depth"
    (view z), "motion" (pixels, from here), "place" (position in pixels), "world" (position in the view space of the
    rendered camera), "mask" (0 or 1), "label" (`labels` name its values), "scalar". `mapped`: the host works in it.
    `kept`: the one of the frame before is kept, too. `scratch`: of no interest once the stage is through. `part_of`:
    the buffer in which it lies. `planar`: on the device the channels lie one after another, each an image. `transient`:
    written in each `extrapolate` before it is read, so until the next `submit` it may lie in memory that another stage
    lends. `known_where`: a buffer of the same owner, perhaps on a coarser grid, and the least value that it has where
    this one holds anything; elsewhere it reads as 0. `packing`: its layout on the device, if not by `dtype` and
    `components`. `border`: pixels that are stored around each plane. `byte`: what all of its bytes are at first.
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
    kept: bool = False
    scratch: bool = False
    part_of: str = ""
    planar: bool = False
    transient: bool = False
    known_where: tuple[str, int] | None = None
    packing: Packing | None = None
    border: int = 0
    byte: int = 0

    @property
    def channels(self) -> int:
        return max(len(self.components), 1)

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes per pixel of its own grid, one plane, on the device."""
        return self.stored_channels * np.dtype(self.stored_dtype).itemsize

    @property
    def stored_channels(self) -> int:
        return self.packing.channels if self.packing else self.channels

    @property
    def stored_dtype(self) -> type:
        return self.packing.dtype if self.packing else self.dtype

    def size(self, sizes: Sizes) -> tuple[int, int]:
        """Return width and height in pixels or texels."""
        return sizes.of(self.grid)

    def shape(self, sizes: Sizes) -> tuple[int, ...]:
        """Return the shape of the NumPy array: (planes?, H, W, channels?)."""
        width, height = self.size(sizes)
        shape = (height, width) if self.grid != "once" else ()
        return (self.planes,) * (self.planes > 1) + shape + (self.channels,) * (self.channels > 1 or not shape)

    def host_array(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Return two views of new memory for an image of `size` (none for "once"): an array (planes?, H, W,
        channels) of the stored values, and the C-contiguous one in the device's layout."""
        shape = (self.planes,) * (self.planes > 1) + (size[1], size[0]) * (self.grid != "once")
        if not self.planar:
            array = np.empty((*shape, self.stored_channels), self.stored_dtype)
            return array, array
        flat = np.empty((self.channels, *shape), self.dtype)
        return np.moveaxis(flat, 0, -1), flat

    def values(self, stored: np.ndarray, known: np.ndarray | None, x: int = 0, y: int = 0) -> np.ndarray:
        """Return the values of a block (…, H, W, channels) from pixel (x, y) on, as read from the device; `known` (H,
        W): the buffer of `known_where` there."""
        if self.packing:
            stored = self.packing.unpack(stored, x, y, grid_of(self.grid).texel[0])
        if self.known_where:
            assert known is not None
            stored[..., known < self.known_where[1], :] = 0
        return stored

    def nbytes(self, sizes: Sizes) -> int:
        """Return the bytes of the buffer on the device."""
        return self.bytes_per_pixel * self.planes * math.prod(side + 2 * self.border for side in self.size(sizes))


RENDERED = (
    BufferSpec("color", np.float16, RGBA, "source", "color of the rendered frame, linear RGB (I)", "color"),
    BufferSpec("depth", np.float32, (), "source", "its view depth, world units, +inf sky (D)", "depth"),
    BufferSpec("motion", np.float32, XY, "source", "its motion t → t−1, pixels (V)", "motion"),
)
EXTRAPOLATED = (
    BufferSpec("color", np.float16, RGBA, "target", "color of the extrapolated frame (Ī^GAE)", "color"),
    BufferSpec("depth", np.float32, (), "target", "view depth in the target camera, world units (D̄)", "depth"),
    BufferSpec("motion", np.float32, XY, "target", "t + α → t, pixels, into the rendered image (V̄)", "motion"),
    BufferSpec("dynamic", np.uint8, (), "target", "1 where the fragment shown is dynamic", "mask"),
    BufferSpec("disoccluded", np.uint8, (), "target", "1 where no fragment of the rendered frame lands", "mask"),
    BufferSpec("filled_by", np.uint8, (), "target", "source of the pixel", "label", labels=FILLED_BY),
)


class Owner:
    """Owner of named buffers: `name`, `buffers` (their descriptions), `buffer` (by name, on the device) and `nbytes`
    allocated for them."""

    name = ""
    buffers: tuple[BufferSpec, ...] = ()

    def __init__(self, device: Device, sizes: Sizes):
        self.device, self.sizes = device, sizes
        self.buffer: dict[str, cl.Buffer] = {}
        self.nbytes = 0

    def allocate(self, specs: Iterable[BufferSpec]) -> dict[str, cl.Buffer]:
        """Return new device buffers by name, all of whose bytes are the `byte` of their description."""
        made = {}
        for spec in specs:
            made[spec.name] = buffer = self.device.buffer(spec.nbytes(self.sizes), spec.mapped)
            cl.enqueue_fill_buffer(self.device.queue, buffer, bytes([spec.byte]), 0, buffer.size)
            self.nbytes += buffer.size
        return made

    def spec(self, name: str) -> BufferSpec:
        return next(spec for spec in self.buffers if spec.name == name)

    def read(self, name: str) -> np.ndarray:
        """Copy a named buffer to the host and return its values. Raises GffeError if it was dropped."""
        spec = self.spec(name)
        stored, flat = spec.host_array(spec.size(self.sizes))
        queue = self.device.queue
        with self.device.opened.lock:
            if name not in self.buffer:
                raise GffeError(f"{self.name}.{name}: the pipeline has dropped this buffer (expected a new one's)")
            cl.enqueue_copy(queue, flat, self.buffer[name])
        known = None
        if spec.known_where:
            telling = self.spec(spec.known_where[0])
            known = spread(self.read(telling.name), telling.grid, spec.grid, 0, 0, *spec.size(self.sizes))
        return spec.values(stored, known).reshape(spec.shape(self.sizes))

    def upload(self, name: str, values: np.ndarray) -> None:
        """Copy host values, shaped as `read` gives them, into a named buffer."""
        if self.spec(name).planar:
            values = np.ascontiguousarray(np.moveaxis(values, -1, 0))
        cl.enqueue_copy(self.device.queue, self.buffer[name], values)


class ExtrapolatedBuffers(Owner):
    """The buffers of the extrapolated frame, which several stages write."""

    name = "frame"
    buffers = EXTRAPOLATED

    def __init__(self, device: Device, sizes: Sizes):
        super().__init__(device, sizes)
        self.buffer = self.allocate(self.buffers)


@dataclass
class DeviceFrame:
    """A rendered frame on the device: `color` half ×4, `depth` float, `motion` float ×2 (OpenCL buffers); `camera` in
    pixels of these images, `display_camera` in pixels of the display; `geometry_jitter` that depth and motion had,
    pixels of color; `whole`: the frame with all of its depth, where this one lacks what keeps its place."""

    color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    camera: Camera
    display_camera: Camera
    time: float
    geometry_jitter: tuple[float, float] = (0.0, 0.0)  # pixels
    whole: DeviceFrame | None = None

    @classmethod
    def allocate(
        cls,
        device: Device,
        size: tuple[int, int],
        camera,
        display_camera,
        time,
        geometry_jitter: tuple[float, float] = (0.0, 0.0),
        motion: cl.Buffer | None = None,
    ) -> DeviceFrame:
        """Return a frame with new buffers for images of `size` (width, height); `motion`: the buffer to use for
        that."""
        color, depth, moved = (size[0] * size[1] * n for n in BYTES_PER_PIXEL)
        buffers = device.buffer(color), device.buffer(depth), motion or device.buffer(moved)
        return cls(*buffers, camera, display_camera, time, geometry_jitter)

    @property
    def buffers(self) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
        return self.color, self.depth, self.motion

    @property
    def shown(self) -> DeviceFrame:
        """The frame with all of its depth."""
        return self.whole or self


def halved(size: tuple[int, int], times: int) -> tuple[int, int]:
    """Return the size halved so many times: (ceil(W / 2^times), ceil(H / 2^times))."""
    width, height = (-(-n // (1 << times)) for n in size)
    return width, height


def given_buffer(array: Any, spec: BufferSpec, sizes: Sizes, device: Device) -> cl.Buffer | PooledBuffer | None:
    """Return the device buffer of `array` for the buffer `spec`: the object itself, or the one with this handle
    (`cl_mem`), which is retained while the result is in use. None for other arrays. Raises GffeError for a buffer
    that `device` cannot use in place."""
    what = f"frame: {spec.name}"
    if isinstance(array, cl.Buffer):  # mostly
        pass
    elif isinstance(array, Array):
        if array.offset or not array.flags.c_contiguous:
            raise GffeError(f"{what}: device arrays must be C-contiguous and start at offset 0 of their buffer")
        component = next(iter(array.dtype.fields.values()))[0] if array.dtype.fields else array.dtype
        if component != spec.dtype:
            raise GffeError(f"{what}: a device array must be of {np.dtype(spec.dtype)}, got {array.dtype}")
        array = array.base_data
        if array is None:
            raise GffeError(f"{what}: the device array has no memory any more")
    elif is_handle(array):
        array = adopted(array, cl.Buffer, what)
        if array.get_info(cl.mem_info.TYPE) != cl.mem_object_type.BUFFER:
            raise GffeError(f"{what}: the handle is of an image (expected a buffer: clEnqueueCopyImageToBuffer)")
    if not isinstance(array, cl.Buffer | PooledBuffer):
        return None
    if array.get_info(cl.mem_info.CONTEXT) != device.context:
        raise GffeError(f"{what}: the device buffer belongs to another OpenCL context than the pipeline's device")
    width, height = spec.size(sizes)
    nbytes = spec.bytes_per_pixel * spec.planes * width * height
    if array.size < nbytes:
        raise GffeError(f"{what} buffer must hold {nbytes} bytes ({width}×{height}), got {array.size}")
    return array
