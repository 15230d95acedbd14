"""Runners on a device: our pipeline as a method of the table, and the cheapest method that moves motion vectors with a
depth test, to compare with on the same runtime."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import build
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.timing.footage import uploaded
from gffe_cl.lab.table.footage import Footage, Moment, Shot

_GROUP = 64  # work-items of a work-group, in a row
_EVENTS = 64  # kept at most


class DeviceRunner:
    """A method at work on a device. `milliseconds` of the device per rendered frame with one new one; of pipelines with
    the network."""

    def __init__(self):
        self._submitted: float | None = None
        self.milliseconds: list[float] = []

    def submit(self, shot: Shot) -> None:
        """Take the next rendered frame, whose buffers may lie on the device."""
        self._submitted = None

    def finish(self) -> None:
        """Wait for the device. Its work since `submit` counts for each new frame."""
        taken = self._taken()
        self._submitted = taken if self._submitted is None else self._submitted

    def make(self, moment: Moment) -> np.ndarray:
        """Return the picture of a moment: (H, W, 3) linear."""
        color = self.color_of(self.extrapolated(moment))
        assert self._submitted is not None  # `finish` was called
        self.milliseconds.append(self._submitted + self._taken())
        return color

    def extrapolated(self, moment: Moment) -> Any:
        """Enqueue the work for a moment and return its frame on the device."""
        raise NotImplementedError

    def color_of(self, made: Any) -> np.ndarray:
        """Return the color of a frame from `extrapolated`: (H, W, 3) float16, linear."""
        raise NotImplementedError

    def _taken(self) -> float:
        """Wait for the device and return the milliseconds of its work since the last call."""
        raise NotImplementedError


class PipelineRunner(DeviceRunner):
    """The project's pipeline with the options of a method. `window`: rule of the rendering window; `knows_camera`:
    whether the new frame's camera is given."""

    def __init__(self, options: Options, window: str, knows_camera: bool, footage: Footage, device: Device):
        super().__init__()
        size, render_size = (footage.width, footage.height), footage.render_size(window)
        self.pipeline = Pipeline(device, *size, options, render_size=render_size, fps=footage.fps)
        self.pipeline.exposure = footage.exposure
        self._known = knows_camera

    def submit(self, shot: Shot) -> None:
        super().submit(shot)
        self.pipeline.submit(shot.frame)

    def present(self) -> np.ndarray:
        """Return the displayed rendered frame; windows make it a little softer."""
        return self.pipeline.present().numpy("color")

    def extrapolated(self, moment: Moment) -> ExtrapolatedFrame:
        return self.pipeline.extrapolate(moment.camera if self._known else None, moment.time)

    def color_of(self, made: ExtrapolatedFrame) -> np.ndarray:
        return made.numpy("color")

    def _taken(self) -> float:
        return sum(self.pipeline.take_timings().values())


class DilateSplat(DeviceRunner):
    """Continues motion vectors of t at constant speed, in the manner of Mob-FGSR (Yang et al., SIGGRAPH 2024): see
    `kernels/baselines/dilate_splat.cl`. `int64`: whether kernels use 64-bit atomics (None: where the
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
