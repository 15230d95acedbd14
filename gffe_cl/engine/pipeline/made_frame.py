"""Frames that the pipeline made, on the device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import Any
from weakref import finalize

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError, Unique
from gffe_cl.engine.core.validation import require_choice
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.device import Device, device_faults
from gffe_cl.engine.stages.buffers import EXTRAPOLATED, RGBA, BufferSpec, Sizes

_SPECS = {spec.name: spec for spec in EXTRAPOLATED}
_LIKE = {"gae": "color", "expected_error": "dynamic"}  # buffers with the description of another one


@dataclass(frozen=True)
class MadeFrame(Unique):
    """Result of the pipeline, on the device: buffers that hold it until the next frame is made.

    `camera` in display pixels, `time` in seconds; `color` (half ×4, linear RGB), `depth` (float, world units, +inf sky)
    and `motion` (float ×2, pixels). `event` (pyopencl.Event) is complete when the buffers hold the frame: wait for it,
    or have commands of other queues wait for it; `event.int_ptr` is its handle (`cl_event`).
    """

    camera: Camera
    time: float
    color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    _device: Device
    _size: tuple[int, int]
    event: cl.Event = field(kw_only=True)

    def numpy(self, name: str) -> np.ndarray:
        """Copy a buffer to the host, by the attribute's name, and return it: colors (H, W, 3) float16, "depth" (H, W)
        float32, "motion" (H, W, 2) float32, all others (H, W) uint8. Raises GffeError for other names, and where the
        device fails."""
        spec = self._spec(name)
        out = np.empty(self._shape(spec), spec.dtype)
        with device_faults(self._device, f'reading "{name}"', lambda: f"{self._size[0]}×{self._size[1]}"):
            cl.enqueue_copy(self._device.queue, out, getattr(self, name))
        return out[..., :3] if spec.components == RGBA else out

    @contextmanager
    def mapped(self, name: str) -> Iterator[np.ndarray]:
        """Yield, in a `with` block, the buffer's own memory in the form that `numpy` returns, to read. On CPUs nothing
        is copied; on other devices the driver may copy. Leave the block before the next frame is made; the array must
        not be used afterwards. Raises GffeError as `numpy` does."""
        array, release = self._map(name)
        array.flags.writeable = False
        try:
            yield array
        finally:
            release()

    def dlpack(self, name: str) -> np.ndarray:
        """Return a buffer in the form that `numpy` returns, for other libraries to take by DLPack without a further
        copy: `torch.from_dlpack(frame.dlpack("color"))`. On CPUs it is the buffer's own memory, to read until the next
        frame is made; elsewhere it is a copy on the host. Raises GffeError as `numpy` does."""
        if not self._device.works_in_host_memory:
            return self.numpy(name)
        array, release = self._map(name)
        finalize(array, release)
        return array

    def _map(self, name: str) -> tuple[np.ndarray, Callable[[], None]]:
        """Return a mapped buffer in the form that `numpy` returns, and the function that ends the mapping."""
        spec: Any = self._spec(name)
        queue, lock = self._device.queue, self._device.opened.lock
        with device_faults(self._device, f'mapping "{name}"', lambda: f"{self._size[0]}×{self._size[1]}"), lock:
            buffer, flags = getattr(self, name), cl.map_flags.READ
            array, _ = cl.enqueue_map_buffer(queue, buffer, flags, 0, self._shape(spec), spec.dtype)
        memory: Any = array.base

        def release() -> None:
            with lock:
                memory.release(queue)

        return array[..., :3] if spec.components == RGBA else array, release

    def _spec(self, name: str) -> BufferSpec:
        names = [n for n in (*_SPECS, *_LIKE) if n in {field.name for field in fields(self)}]
        chosen = require_choice(name, names, "frame: name")
        if chosen == "expected_error" and getattr(self, chosen) is None:
            raise GffeError("frame: expected_error was not made (expected Options(expected_error=True))")
        return _SPECS[_LIKE.get(chosen, chosen)]

    def _shape(self, spec: BufferSpec) -> tuple[int, ...]:
        return spec.shape(Sizes(self._size, self._size))


class PresentedFrame(MadeFrame):
    """A rendered frame as displayed: its display part at time t, in display pixels. `motion` is t → t−1 between the
    displayed images. The buffers are the rendered frame's own where all of it is shown."""


@dataclass(frozen=True)
class ExtrapolatedFrame(MadeFrame):
    """An extrapolated frame at t + α.

    `motion` is t + α → t, into the rendered image of t; `dynamic`, `disoccluded`, `filled_by` (uchar). `gae` is the
    color before shading correction and overlays, the same buffer as `color` where these are off. `expected_error`
    (uchar; None without that option): the expected root-mean-square error of a pixel's display values before shading
    correction and overlays, in quarters of an 8-bit level. `numpy(name)` copies one of them to the host, `mapped(name)`
    reads it in place in a `with` block; `event` is complete when they hold the frame.
    """

    alpha: float
    source_time: float
    dynamic: cl.Buffer
    disoccluded: cl.Buffer
    filled_by: cl.Buffer
    gae: cl.Buffer
    expected_error: cl.Buffer | None = None
