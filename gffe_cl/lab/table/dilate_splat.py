"""Extrapolation by dilated and splatted motion vectors on an OpenCL device, to compare with on the same runtime.

It is the cheapest method that moves vectors with a depth test, in the manner of Mob-FGSR (Yang et al., SIGGRAPH 2024):
see `kernels/baselines/dilate_splat.cl`.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import build
from gffe_cl.engine.timing.footage import uploaded
from gffe_cl.lab.table.datasets import Footage, Moment, Shot
from gffe_cl.lab.table.pipelines import DeviceRunner

_GROUP = 64  # work-items of a work-group, in a row
_EVENTS = 64  # kept at most


class DilateSplat(DeviceRunner):
    """Continues motion vectors of t at constant speed. `int64`: whether kernels use 64-bit atomics (None: where the
    device has them); results have the same bits without. Frames of NumPy arrays are uploaded when they are
    submitted."""

    def __init__(self, footage: Footage, device: Device, int64: bool | None = None):
        super().__init__()
        int64 = device.int64_atomics if int64 is None else int64
        self._device, self._width, self._height = device, footage.width, footage.height
        self._program = build(device, "baselines/dilate_splat", **({"INT64_ATOMICS": 1} if int64 else {}))
        self._passes = 1 if int64 else 2
        pixels = self._width * self._height
        self._offers = [device.buffer(8 * pixels)] if int64 else [device.buffer(4 * pixels) for _ in range(2)]
        self._color = device.buffer(8 * pixels)
        self._events: deque[cl.Event] = deque(maxlen=_EVENTS)

    def submit(self, shot: Shot) -> None:
        super().submit(shot)
        on_device = isinstance(shot.frame.color, cl.Buffer)
        self._frame = shot.frame if on_device else uploaded(self._device, shot.frame)

    def extrapolated(self, moment: Moment) -> cl.Buffer:
        """Enqueue the work for a moment and return the buffer of its color, half ×4; it holds until the next call."""
        frame = self._frame
        values = {"width": self._width, "height": self._height, "alpha": moment.alpha}
        values |= {"depth": frame.depth, "motion": frame.motion, "color": frame.color, "out_color": self._color}
        values |= {"keys": self._offers[0], "winners": self._offers[-1]}
        for buffer in self._offers:
            self._events.append(cl.enqueue_fill_buffer(self._device.queue, buffer, b"\xff", 0, buffer.size))
        for number in range(self._passes):
            self._launch("splat", values | {"pass": number})
        self._launch("warp", values)
        return self._color

    def color_of(self, made: cl.Buffer) -> np.ndarray:
        color = np.empty((self._height, self._width, 4), np.float16)
        cl.enqueue_copy(self._device.queue, color, made)
        return color[..., :3]

    def _launch(self, kernel: str, values: dict) -> None:
        columns = -(-self._width // (self._device.lanes * _GROUP)) * _GROUP
        size, group = (columns, self._height), (_GROUP, 1)
        self._events.append(self._program.launch(self._device.queue, kernel, size, group, values))

    def _taken(self) -> float:
        self._device.queue.finish()
        events = list(self._events)
        self._events.clear()
        return sum(event.profile.end - event.profile.start for event in events) * 1e-6
