"""Upload: rendered frames from the host (beyond the paper, which renders on the device)."""

from __future__ import annotations

import numpy as np
import pyopencl as cl

from gffe_cl.frame.rendered_frame import BadPixels, HostArrays
from gffe_cl.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.stages.buffers import RGBA, BufferSpec, DeviceFrame


class Upload(Stage):
    """Copies NumPy arrays to the device, converts their colors to half and counts bad pixels."""

    name = "upload"
    registered = False
    buffers = (
        BufferSpec(
            "given", np.float32, RGBA, "source", "colors as the host has them: float or half, 3 or 4 channels", "color",
            scratch=True, transient=True,
        ),
        BufferSpec(
            "bad_pixels", np.uint8, (), "columns",
            "bad pixels in each column of 64: colors that are not finite, clamped colors, depths, motion", planes=4,
            scratch=True,
        ),
    )  # fmt: skip
    _takes = {
        "reads": {"given": "upload.given"},
        "writes": {"color": "rendered.color", "bad_pixels": Access("upload.bad_pixels", planes=2)},
        "step": ("LANES", 1),
    }
    kernels = (
        Kernel("take_floats", "columns", **_takes),
        Kernel("take_halves", "columns", **_takes),
        Kernel(
            "count_geometry",
            "columns",
            {"depth": "rendered.depth", "motion": "rendered.motion"},
            {"bad_pixels": Access("upload.bad_pixels", planes=2)},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        self._in_place = self.device.info.kind == "cpu"  # kernels read the host's arrays where they are
        self._counted: BadPixels | None = BadPixels()  # None: the device is counting

    def take(self, arrays: HostArrays, frame: DeviceFrame) -> None:
        """Enqueue all of it, into the buffers of `frame`. The arrays may be changed afterwards."""
        step = Step(frame, None, [frame.time])
        kernel = "take_halves" if arrays.color.dtype == np.float16 else "take_floats"
        given = self._given(arrays.color)
        self.launch(kernel, step, given=given, channels=arrays.color.shape[2], color=frame.color)
        if arrays.motion is None:
            cl.enqueue_fill_buffer(self.device.queue, frame.motion, np.uint8(0), 0, frame.motion.size)
        else:
            cl.enqueue_copy(self.device.queue, frame.motion, arrays.motion)
        cl.enqueue_copy(self.device.queue, frame.depth, arrays.depth)  # waits for the kernel, too
        self.launch("count_geometry", step, depth=frame.depth, motion=frame.motion)
        self._counted = arrays.known_bad

    def bad_pixels(self) -> BadPixels:
        """Those of the last frame taken; waits for the device."""
        if self._counted is None:
            self._counted = BadPixels(*self.read("bad_pixels").reshape(4, -1).sum(1, dtype=np.int64).tolist())
        return self._counted

    def _given(self, color: np.ndarray) -> cl.Buffer:
        """The host's array for kernels to read."""
        if self._in_place:
            flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
            return cl.Buffer(self.device.context, flags, hostbuf=color)
        if "given" not in self.buffer:
            self.buffer |= self.allocate([self.spec("given")])
        cl.enqueue_copy(self.device.queue, self.buffer["given"], color)
        return self.buffer["given"]
