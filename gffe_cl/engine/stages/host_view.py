"""Access of the host to device buffers, without waiting."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.buffers import Owner


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
