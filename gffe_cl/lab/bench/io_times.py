"""Measurement of transfers of NumPy arrays to and from a device, compared with plain copies of the same bytes (`gffe
bench --io`)."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.rendered_frame import RenderedFrame, host_arrays
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.pipeline.made_frame import PresentedFrame
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.upload import Upload

FORMS = (("float32", 3), ("float32", 4), ("float16", 3), ("float16", 4))  # of colors
WARM_UP = 2  # turns that do not count


@dataclass
class IoTimes:
    """Median milliseconds of one frame. `upload`: color, depth and motion checked, copied and converted, and bad pixels
    counted; `download`: color as a new array; `copy_in`, `copy_out`: plain copies of the same bytes between existing
    arrays and buffers. `zero_copy`: as `upload`, of aligned arrays that are used in place where they can be; `mapped`:
    color mapped for reading, and unmapped. `ratio`: of upload and download to the plain copies, the median of the
    ratios within a turn. `copied`, `zero_copied`: bytes written on the way in, as `Pipeline.copied_bytes` counts."""

    width: int
    height: int
    color: str
    upload: float
    copy_in: float
    download: float
    copy_out: float
    zero_copy: float
    mapped: float
    ratio: float
    copied: int
    zero_copied: int


def measure_io(device: Device, frame: RenderedFrame, turns: int, on_turn: Callable[[], None]) -> list[IoTimes]:
    """Time each form of colors in `turns` turns, on the arrays of `frame`, and return the medians."""
    height, width = np.shape(frame.depth)
    rgba = host_arrays(frame).in_device_layout().color
    found = []
    for dtype, channels in FORMS:
        timed = _Turn(device, replace(frame, color=np.ascontiguousarray(rgba[..., :channels], dtype)))
        times = []
        for turn in range(WARM_UP + turns):
            taken = timed(backward=turn % 2 == 1)  # the second measurement finds the arrays in caches
            if turn >= WARM_UP:
                times.append(taken)
                on_turn()
        medians = (statistics.median(part) * 1e3 for part in zip(*times, strict=True))
        ratio = statistics.median((up + down) / (copy_in + copy_out) for up, copy_in, down, copy_out, *_ in times)
        name, copied = f"{dtype} {'RGBA'[:channels]}", {"copied": timed.copied, "zero_copied": timed.zero_copied}
        found.append(IoTimes(width, height, name, *medians, ratio=ratio, **copied))
    return found


class _Turn:
    """Timer that runs each part once, in either order: seconds of upload, plain copies in, download, plain copy out,
    upload without copies, mapping. `copied` and `zero_copied`: bytes of the last uploads."""

    def __init__(self, device: Device, frame: RenderedFrame):
        height, width = np.shape(frame.depth)
        self._device, self._frame = device, frame
        self._upload = Upload(Board(device, Sizes((width, height), (width, height))))
        self._taken = DeviceFrame.allocate(device, (width, height), frame.camera, frame.shown_camera, frame.time)
        ready = cl.enqueue_marker(device.queue)
        where = device, (width, height)
        self._shown = PresentedFrame(frame.camera, frame.time, *self._taken.buffers, *where, _event=ready)
        arrays = (frame.color, frame.depth, frame.motion)
        color, depth, motion = (_aligned(device, array) for array in arrays)
        self._aligned_frame = replace(frame, color=color, depth=depth, motion=motion)
        self.copied = self.zero_copied = 0
        self._copies = [(device.buffer(array.nbytes), array) for array in arrays]
        self._out = np.empty((height, width, 4), np.float16)

    def __call__(self, backward: bool) -> list[float]:
        parts = [self._upload_frame, self._copy_in, self._download, self._copy_out, self._share_frame, self._map]
        return [self._seconds(part) for part in reversed(parts)][::-1] if backward else [*map(self._seconds, parts)]

    def _seconds(self, part: Callable[[], object]) -> float:
        start = time.perf_counter()
        part()
        self._device.queue.finish()
        return time.perf_counter() - start

    def _upload_frame(self) -> None:
        before = self._upload.copied_bytes
        self._upload.take(host_arrays(self._frame), self._taken)
        self._upload.take_bad_pixels()
        self.copied = self._upload.copied_bytes - before

    def _share_frame(self) -> None:
        before, arrays = self._upload.copied_bytes, host_arrays(self._aligned_frame)
        shared = self._upload.shared(arrays)
        self._upload.take(arrays, replace(self._taken, **shared), shared)
        self._upload.take_bad_pixels()
        self.zero_copied = self._upload.copied_bytes - before

    def _map(self) -> None:
        with self._shown.mapped("color"):
            pass

    def _copy_in(self) -> None:
        for buffer, array in self._copies:
            cl.enqueue_copy(self._device.queue, buffer, array)

    def _download(self) -> None:
        self._shown.numpy("color")

    def _copy_out(self) -> None:
        cl.enqueue_copy(self._device.queue, self._out, self._taken.color)


def _aligned(device: Device, array: np.ndarray) -> np.ndarray:
    made = device.empty(array.shape, array.dtype)
    made[...] = array
    return made
