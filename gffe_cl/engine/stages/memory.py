"""Memory: what stages lend each other, whether all fits on the device, and the host's access to buffers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import KEPT_BYTES_PER_PIXEL
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.buffers import BufferSpec, Owner, Sizes, grid_of

Worker = Any  # a stage (stages/base.py, which imports this module)
Lent = tuple[Worker, str]  # a stage, and its name for the memory


class LentMemory:
    """Places of borrowed buffers in lent memory. `stages`: all of a pipeline, by name, in the order of their work."""

    def __init__(self, sizes: Sizes, stages: Mapping[str, Worker]):
        self.borrowing: list[tuple[Worker, BufferSpec]] = []  # transient buffers of all stages so far
        self.lent: list[Lent] = []
        self._sizes, self._stages = sizes, stages
        self._parts: list[cl.Buffer] = []  # in the order in which they were made

    def part(self, whole: cl.Buffer, start: int, nbytes: int) -> cl.Buffer:
        """Return the part of a buffer that begins at byte `start`. It is released by `let_go`, whoever still has it:
        NVIDIA's driver (580.159) crashes unless parts that overlap, and that kernels used, are released in the reverse
        of the order in which they were made."""
        self._parts.append(whole.get_sub_region(start, nbytes))
        return self._parts[-1]

    def lend(self, stage: Worker, name: str) -> None:
        """Lend the buffer `name` of `stage` while new frames are made."""
        self.lent.append((stage, name))

    def place(self) -> None:
        """Give every borrowed buffer its place in lent memory, or memory of its own if none is lent. Call it once all
        stages exist, and after every swap, which moves what lies in memory of the frame before."""
        for stage, spec in self.borrowing:
            place = self.places[stage.name, spec.name]
            if spec.name in stage.buffer and not (place and place[0][1].endswith("'")):
                continue
            if place:
                (owner, name), start = place
                given = {spec.name: self.part(owner.own(name), start, spec.nbytes(self._sizes))}
            else:
                given = stage.allocate([spec])
            stage.buffer = stage.buffer | given

    @cached_property
    def places(self) -> dict[tuple[str, str], tuple[Lent, int] | None]:
        """Place of each borrowed buffer, largest first, but lists of pixels last, of which little is ever touched: the
        lent memory that holds it, and the first byte there. None where none fits."""
        places: dict = {}
        taken: dict[Lent, list] = {lent: [] for lent in self.lent}
        order = sorted(self.borrowing, key=lambda one: (grid_of(one[1].grid).is_list, -one[1].nbytes(self._sizes)))
        for stage, spec in order:
            nbytes, used = spec.nbytes(self._sizes), self.use(stage, spec)
            starts = {lent: _free_start(parts, nbytes, used) for lent, parts in taken.items()}
            fitting = (lent for lent, start in starts.items() if start + nbytes <= lent[0].own(lent[1]).size)
            lent = next(fitting, None)
            places[stage.name, spec.name] = lent and (lent, starts[lent])
            if lent:  # a byte more: texels of one index must not take each other's place in caches
                taken[lent].append((starts[lent], self._sizes.aligned(starts[lent] + nbytes + 1), used))
        return places

    def use(self, stage: Worker, spec: BufferSpec) -> frozenset[int]:
        """Return the numbers of the stages during whose work on a new frame a buffer is in use. The last is the last
        stage that names the buffer, or the last of all if it is of interest afterwards."""
        name, used = f"{stage.name}.{spec.name}", []
        for number, other in enumerate(self._stages.values()):
            names_it = any(name in kernel.buffers.values() for kernel in other.kernels)
            if names_it or other is stage or (used and not spec.scratch):
                used.append(number)
        return frozenset(range(used[0], used[-1] + 1))

    def let_go(self) -> None:
        """Drop the references to the stages, and release the parts of buffers."""
        for known in (self.borrowing, self.lent, self.__dict__.get("places", {})):
            known.clear()
        while self._parts:
            self._parts.pop().release()


def _free_start(parts: Iterable[tuple[int, int, frozenset[int]]], nbytes: int, used: frozenset[int]) -> int:
    """Return the first byte from which on `nbytes` are free at the time of the stages `used`; parts: from, to, used."""
    start = 0
    for begin, end, _ in sorted(part for part in parts if part[2] & used):
        if start + nbytes <= begin:
            break
        start = max(start, end)
    return start


# Bytes per pixel of all buffers, and of any one, that suffice for any options: only more is checked in detail.
_SURELY, _SURELY_AT_ONCE = 1024, 128
_TRIAL = 256  # pixels along the longer side of the images by which memory is estimated
_MARGIN = 0.97  # of the size that would fit: sides are rounded


class NoRoomError(GffeError):
    """Error for images that do not fit on the device, as estimated before anything is allocated."""


def require_room(device: Device, sizes: Sizes, allocated_for: Callable[[Sizes], tuple[int, int]]) -> None:
    """Raise a NoRoomError that names a size that fits, unless images of `sizes` fit on the device. `allocated_for`
    returns the bytes of all buffers for other sizes, and of the largest."""
    pixels = _pixels(sizes)
    if pixels * _SURELY <= device.memory and pixels * _SURELY_AT_ONCE <= device.largest_buffer:
        return
    shrink = _TRIAL / max(*sizes.source, *sizes.target)
    trial = replace(sizes, source=_scaled(sizes.source, shrink), target=_scaled(sizes.target, shrink))
    frames = KEPT_BYTES_PER_PIXEL * math.prod(sizes.source)
    before = device.allocated
    needed, at_once = (nbytes * pixels / _pixels(trial) for nbytes in allocated_for(trial))
    needed += frames
    device.allocated = before  # the trial's memory is free again
    share = min(device.memory / needed, device.largest_buffer / at_once)
    if share >= 1:
        return
    width, height = _scaled(sizes.target, _MARGIN * math.sqrt(share))
    fits = f"expected at most about {width}×{height} of this shape with these options"
    at_most = f", {_size(at_once)} at once of {_size(device.largest_buffer)}" if at_once > device.largest_buffer else ""
    raise NoRoomError(f"pipeline: {footprint(device, sizes, needed)}{at_most} ({fits})")


def footprint(device: Device, sizes: Sizes, nbytes: float | None) -> str:
    """Return the sizes of the images in words, and the share of the device's memory that they take, as far as that is
    known."""
    through = f" (rendered {sizes.source[0]}×{sizes.source[1]})" if sizes.source != sizes.target else ""
    takes = "" if nbytes is None else f" takes {_size(nbytes)}"
    return f"{sizes.target[0]}×{sizes.target[1]}{through}{takes} of the {_size(device.memory)} of {device.info.name}"


def _pixels(sizes: Sizes) -> int:
    return max(math.prod(sizes.source), math.prod(sizes.target))


def _scaled(size: tuple[int, int], factor: float) -> tuple[int, int]:
    width, height = (max(int(side * factor), 1) for side in size)
    return width, height


def _size(nbytes: float) -> str:
    return f"{nbytes / 2**30:.1f} GiB" if nbytes >= 2**30 else f"{nbytes / 2**20:.0f} MiB"


class HostView:
    """A buffer of a stage as a NumPy array on the host: `array`, between `open` and `close`.

    The array is the buffer itself, mapped. A `staged` one lies in pinned host memory instead, and is copied once: from
    the device, or to it if the host `writes` the array. Kernels that write the buffer are enqueued before `open` or
    after `close`. Kernels that read it are, too, where the host writes.
    """

    def __init__(self, owner: Owner, name: str, *, writes: bool = False, staged: bool = False):
        spec = owner.spec(name)
        self._device: Device = owner.device
        self._buffer = owner.buffer[name]  # not the owner: stages that hold each other are freed late
        self._shape, self._dtype = spec.shape(owner.sizes), np.dtype(spec.dtype)
        self._writes = writes
        self._staging = pinned_array(self._device, self._shape, self._dtype) if staged else None
        self.array: np.ndarray | None = None

    def open(self) -> list[cl.Event]:
        """Enqueue the work that makes `array` usable, and return the events to wait for before it is used."""
        queue = self._device.queue
        if self._staging is None:
            flags = cl.map_flags.WRITE_INVALIDATE_REGION if self._writes else cl.map_flags.READ
            map_buffer: Any = cl.enqueue_map_buffer  # its stub leaves the event out
            self.array, event = map_buffer(queue, self._buffer, flags, 0, self._shape, self._dtype, is_blocking=False)
            return [event]
        self.array = self._staging
        return [] if self._writes else [cl.enqueue_copy(queue, self.array, self._buffer, is_blocking=False)]

    def close(self) -> list[cl.Event]:
        """Enqueue the work that gives the buffer back to the device, and return the events of that. Keep them until
        they are complete: pyopencl waits where the event of a copy is dropped before."""
        array, self.array = self.array, None
        if array is None:
            return []
        if self._staging is None:
            memory: Any = array.base
            return [memory.release(self._device.queue)]
        return [cl.enqueue_copy(self._device.queue, self._buffer, array, is_blocking=False)] if self._writes else []


def pinned_array(device: Device, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Return a new array, not initialized, in host memory that the driver copies to and from fast: pinned, where the
    driver does so."""
    nbytes = math.prod(shape) * dtype.itemsize
    buffer = cl.Buffer(device.context, cl.mem_flags.READ_WRITE | cl.mem_flags.ALLOC_HOST_PTR, nbytes)
    flags: Any = cl.map_flags.READ | cl.map_flags.WRITE
    array, _ = cl.enqueue_map_buffer(device.queue, buffer, flags, 0, shape, dtype)
    return array
