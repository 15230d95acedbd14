"""Upload: rendered frames from the host (beyond the paper, which renders on the device)."""

from __future__ import annotations

import ctypes
import mmap
from typing import Any

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
            "bad_pixels", np.uint8, (), "runs",
            "bad pixels in runs of 31 or 248: colors that are not finite, clamped colors, depths, motion", planes=4,
            scratch=True,
        ),
    )  # fmt: skip
    kernels = (
        *(
            Kernel(
                name,
                "runs",
                {"given": "upload.given"},
                {"color": "rendered.color", "bad_pixels": Access("upload.bad_pixels", planes=2)},
                step=("LANES", 1),
            )
            for name in ("take_floats", "take_halves")
        ),
        Kernel(
            "take_geometry",
            "runs",
            {"given_depth": "rendered.depth", "given_motion": "rendered.motion"},
            {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "bad_pixels": Access("upload.bad_pixels", planes=2),
            },
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        self._alignment = self.device.queue.device.mem_base_addr_align // 8
        self._in_place = self.device.info.kind == "cpu" and self._alignment <= mmap.PAGESIZE
        self._counted: BadPixels | None = BadPixels()  # None: the device is counting

    def take(self, arrays: HostArrays, frame: DeviceFrame) -> None:
        """Enqueue all of it, into the buffers of `frame`. The arrays may be changed afterwards."""
        step, queue, color, motion = Step(frame, None, [frame.time]), self.device.queue, arrays.color, arrays.motion
        if not self._in_place and "given" not in self.buffer:
            self.buffer |= self.allocate([self.spec("given")])
        kernel = "take_halves" if color.dtype == np.float16 else "take_floats"
        given, start = self._given(color, self.buffer.get("given"))
        self.launch(kernel, step, given=given, start=start, channels=color.shape[2], color=frame.color)
        given_depth, depth_start = self._given(arrays.depth, frame.depth)
        if motion is None:
            cl.enqueue_fill_buffer(queue, frame.motion, b"\0", 0, frame.motion.size)
        given_motion, motion_start = (frame.motion, 0) if motion is None else self._given(motion, frame.motion)
        self.launch(
            "take_geometry", step,
            given_depth=given_depth, depth_start=depth_start, given_motion=given_motion, motion_start=motion_start,
            depth=frame.depth, motion=frame.motion,
        )  # fmt: skip
        if self._in_place:
            queue.finish()  # kernels read the arrays
        self._counted = arrays.known_bad

    def bad_pixels(self) -> BadPixels:
        """Those of the last frame taken; waits for the device."""
        if self._counted is None:
            self._counted = BadPixels(*self.read("bad_pixels").reshape(4, -1).sum(1, dtype=np.int64).tolist())
        return self._counted

    def _given(self, array: np.ndarray, buffer: Any) -> tuple[cl.Buffer, int]:
        """The array for kernels to read, and at which of its values it begins: copied into `buffer`, or where it is.

        Runtimes copy what does not begin at an aligned address. So it begins at the last one before the array, which is
        in the same page of memory.
        """
        if not self._in_place:
            cl.enqueue_copy(self.device.queue, buffer, array)
            return buffer, 0
        before = array.ctypes.data % self._alignment
        memory = (ctypes.c_ubyte * (before + array.nbytes)).from_address(array.ctypes.data - before)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return cl.Buffer(self.device.context, flags, hostbuf=memory), before // array.itemsize
