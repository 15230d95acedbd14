"""Upload: rendered frames from the host (beyond the paper, which renders on the device)."""

from __future__ import annotations

import ctypes
from collections.abc import Container
from dataclasses import fields
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.frame.rendered_frame import BadPixels, HostArrays
from gffe_cl.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.stages.buffers import RENDERED, RGBA, BufferSpec, DeviceFrame

_KINDS = len(fields(BadPixels))


class Upload(Stage):
    """Copies NumPy arrays to the device, converts their colors to half and counts bad pixels.

    `copied_bytes`: of all frames taken, bytes written on the way of the arrays: copies to a device with memory of its
    own, and what kernels store."""

    name = "upload"
    registered = False
    buffers = (
        BufferSpec(
            "given", np.float32, RGBA, "source", "colors as the host has them: float or half, 3 or 4 channels", "color",
            scratch=True, transient=True,
        ),
        BufferSpec(
            "bad_pixels", np.uint8, (), "runs",
            "bad pixels in runs of 31 or 248, by the fields of `BadPixels`", planes=_KINDS,
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
                "bad_pixels": Access("upload.bad_pixels", planes=4),
            },
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        self._in_place = self.device.works_in_host_memory
        self._counted: BadPixels | None = BadPixels()  # None: the device is counting
        self.copied_bytes = 0

    def take(self, arrays: HostArrays, frame: DeviceFrame, shared: Container[str] = ()) -> None:
        """Enqueue all of it, into the buffers of `frame`, but for those that are `shared`. The other arrays may be
        changed afterwards; only in them bad pixels are counted."""
        copied = [spec.name for spec in RENDERED if spec.name not in shared]
        if 0 < len(copied) < len(RENDERED):
            self.fill("bad_pixels", 0)
        if "color" in copied:
            self._take_color(arrays.color, frame)
        if "depth" in copied:
            self._take_geometry(arrays, frame)
        if copied and self._in_place:
            self.device.queue.finish()  # kernels read the arrays
        self._counted = arrays.known_bad if copied else arrays.known_bad or BadPixels()

    def shared(self, arrays: HostArrays) -> dict[str, cl.Buffer]:
        """Those of the arrays that kernels can use where they are, by name, depth and motion both or neither: on a CPU,
        in the layout of `RENDERED`, and beginning at an aligned address. The buffers keep the arrays alive."""
        given = {spec.name: getattr(arrays, spec.name) for spec in RENDERED}
        alike = {spec.name for spec in RENDERED if self._in_place and self._lies_alike(given[spec.name], spec)}
        if not {"depth", "motion"} <= alike:
            alike -= {"depth", "motion"}
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return {name: cl.Buffer(self.device.context, flags, hostbuf=given[name]) for name in alike}

    def _lies_alike(self, array: np.ndarray | None, spec: BufferSpec) -> bool:
        if array is None or array.dtype != spec.dtype or array.shape != spec.shape(self.sizes):
            return False
        return array.ctypes.data % self.device.alignment == 0

    def _take_color(self, color: np.ndarray, frame: DeviceFrame) -> None:
        if not self._in_place and "given" not in self.buffer:
            self.buffer |= self.allocate([self.spec("given")])
        kernel = "take_halves" if color.dtype == np.float16 else "take_floats"
        given, start = self._given(color, self.buffer.get("given"))
        step = Step(frame, None, [frame.time])
        self.launch(kernel, step, given=given, start=start, channels=color.shape[2], color=frame.color)
        self.copied_bytes += frame.color.size

    def _take_geometry(self, arrays: HostArrays, frame: DeviceFrame) -> None:
        motion = arrays.motion
        given_depth, depth_start = self._given(arrays.depth, frame.depth)
        if motion is None:
            cl.enqueue_fill_buffer(self.device.queue, frame.motion, b"\0", 0, frame.motion.size)
        given_motion, motion_start = (frame.motion, 0) if motion is None else self._given(motion, frame.motion)
        self.launch(
            "take_geometry", Step(frame, None, [frame.time]),
            given_depth=given_depth, depth_start=depth_start, given_motion=given_motion, motion_start=motion_start,
            depth=frame.depth, motion=frame.motion,
        )  # fmt: skip
        if self._in_place:
            self.copied_bytes += arrays.depth.nbytes + (0 if motion is None else motion.nbytes)

    def bad_pixels(self) -> BadPixels:
        """Those of the last frame taken; waits for the device."""
        if self._counted is None:
            self._counted = BadPixels(*self.read("bad_pixels").reshape(_KINDS, -1).sum(1, dtype=np.int64).tolist())
        return self._counted

    def _given(self, array: np.ndarray, buffer: Any) -> tuple[cl.Buffer, int]:
        """The array for kernels to read, and at which of its values it begins: copied into `buffer`, or where it is.

        Runtimes copy what does not begin at an aligned address. So it begins at the last one before the array, which is
        in the same page of memory.
        """
        if not self._in_place:
            cl.enqueue_copy(self.device.queue, buffer, array)
            self.copied_bytes += array.nbytes
            return buffer, 0
        before = array.ctypes.data % self.device.alignment
        memory = (ctypes.c_ubyte * (before + array.nbytes)).from_address(array.ctypes.data - before)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return cl.Buffer(self.device.context, flags, hostbuf=memory), before // array.itemsize
