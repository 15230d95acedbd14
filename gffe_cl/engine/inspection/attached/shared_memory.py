"""Shared memory between a program and the viewer: anonymous files, gone with the last process that has them."""

from __future__ import annotations

import fcntl
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    require_exposure,
    require_frame_rate,
    require_number,
    require_size,
    require_whole,
    shown,
)
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.inspection.attached.encoding import NUMERIC, decoded, encoded
from gffe_cl.engine.stages.buffers import DeviceFrame

_PAGE = mmap.PAGESIZE
_ABOUT = 16 << 10  # bytes of a frame's description
_BYTES = (8, 4, 8)  # per pixel: color, depth, motion
_MOST_BYTES = 512 << 20  # of recorded frames
_LEAST_FRAMES = 3


class SharedBlock:
    """`nbytes` of memory that other processes can map by `descriptor`. Raises OSError without memory."""

    def __init__(self, nbytes: int):
        self.nbytes = _rounded(nbytes)
        self.descriptor = os.memfd_create("gffe-cl", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.posix_fallocate(self.descriptor, 0, self.nbytes)  # missing memory fails now, not by a signal later
            fcntl.fcntl(self.descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
            flags = mmap.MAP_SHARED | mmap.MAP_POPULATE  # page faults would come while a frame is made
            self.memory = mmap.mmap(self.descriptor, self.nbytes, flags)
        except BaseException:
            os.close(self.descriptor)
            raise

    def __del__(self):
        if getattr(self, "memory", None) is not None:
            os.close(self.descriptor)


def mapped(descriptor: int) -> mmap.mmap:
    """Return the memory of another process's block, to read. The caller still has to close the descriptor. Raises
    OSError for a file that is no such block: reading one that shrinks would end this process."""
    if not fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK:
        raise OSError("not sealed")
    return mmap.mmap(descriptor, 0, prot=mmap.PROT_READ)


# ---- images ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Placed:
    """Place of an image in a block."""

    offset: int
    dtype: str
    shape: tuple[int, ...]

    def __post_init__(self):
        if np.dtype(self.dtype).kind not in NUMERIC:
            raise GffeError(f"attach: image has the type {shown(self.dtype)} (expected numbers)")

    def array(self, memory: mmap.mmap) -> np.ndarray:
        """Return the image at this place of the memory, not a copy. Raises ValueError or TypeError where it does not
        lie in the memory."""
        return np.ndarray(self.shape, self.dtype, memory, self.offset)


def placed(images: Mapping[str, np.ndarray]) -> tuple[dict[str, Placed], int]:
    """Return places for images one after the other, and the bytes that they take."""
    places, offset = {}, 0
    for name, image in images.items():
        places[name] = Placed(offset, image.dtype.str, image.shape)
        offset += _rounded(image.nbytes)
    return places, offset


def _rounded(nbytes: int) -> int:
    return max(-(-nbytes // _PAGE), 1) * _PAGE


# ---- recorded frames ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RecordingPlan:
    """Layout of `count` frames of `size`, one after the other in a block; `display`: width and height of displayed
    frames."""

    count: int
    size: tuple[int, int]
    display: tuple[int, int]
    fps: float

    def __post_init__(self):
        require_whole(self.count, "attach: recorded frames", 1, 1 << 16)
        for size in (self.size, self.display):
            require_size(size, "attach: size of recorded frames", whole=True)
        require_frame_rate(self.fps, "attach: fps")

    @classmethod
    def of(cls, wanted: int, size: tuple[int, int], display: tuple[int, int], fps: float) -> RecordingPlan:
        """Return a plan for the `wanted` frames, or for as many as fit into memory."""
        fitting = cls(1, size, display, fps)
        return cls(max(min(wanted, _MOST_BYTES // fitting.nbytes), _LEAST_FRAMES), size, display, fps)

    @property
    def pixels(self) -> int:
        return self.size[0] * self.size[1]

    @property
    def stride(self) -> int:
        """Bytes from one frame to the next."""
        return _rounded(64 + _ABOUT) + _rounded(sum(_BYTES) * self.pixels)

    @property
    def nbytes(self) -> int:
        return self.count * self.stride

    def head(self, memory: mmap.mmap, slot: int) -> np.ndarray:
        """Return (3,) uint64: number of the last change begun, of the last change finished, and bytes of the frame's
        description. If the first two differ, the frame is being written."""
        return np.ndarray(3, np.uint64, memory, slot * self.stride)

    def about(self, memory: mmap.mmap, slot: int) -> np.ndarray:
        return np.ndarray(_ABOUT, np.uint8, memory, slot * self.stride + 64)

    def images(self, memory: mmap.mmap, slot: int) -> list[np.ndarray]:
        """Return the recorded images color (H, W, 4) float16, depth (H, W) and motion (H, W, 2) float32, not copied."""
        width, height = self.size
        offset, found = slot * self.stride + _rounded(64 + _ABOUT), []
        for nbytes, dtype, channels in zip(_BYTES, ("f2", "f4", "f4"), ((4,), (), (2,)), strict=True):
            found.append(np.ndarray((height, width, *channels), dtype, memory, offset))
            offset += nbytes * self.pixels
        return found


@dataclass
class About:
    """A recorded frame without its pixels. `cameras`: of the frames extrapolated from it, by their times."""

    number: int
    time: float
    camera: Camera
    display_camera: Camera
    reset: bool
    exposure: float
    cameras: dict[float, Camera]

    def __post_init__(self):
        require_whole(self.number, "attach: frame number", 0)
        require_number(self.time, "attach: time")
        require_exposure(self.exposure)


class Recorder:
    """The program's side of a recording: it keeps the last rendered frames in shared memory. The device copies them
    there on a queue of its own while the program continues. A frame counts once its copy has finished."""

    def __init__(self, plan: RecordingPlan):
        self.plan, self.block = plan, SharedBlock(plan.nbytes)
        self._about: About | None = None
        self._slot, self._copies = 0, []
        self._queue: cl.CommandQueue | None = None

    def take(self, number: int, frame: RenderedFrame, on_device: DeviceFrame, queue: cl.CommandQueue, reset: bool,
             exposure: float) -> None:  # fmt: skip
        """Record rendered frame `number`."""
        self.finish()
        self._slot = number % self.plan.count
        self._head[0] += 1
        images = self.plan.images(self.block.memory, self._slot)
        self._queue = self._queue or cl.CommandQueue(queue.context, queue.device)
        there = [cl.enqueue_marker(queue)]
        queue.flush()
        self._copies = [
            cl.enqueue_copy(self._queue, image, buffer, is_blocking=False, wait_for=there)
            for image, buffer in zip(images, on_device.buffers, strict=True)
        ]
        self._queue.flush()
        cameras = on_device.camera, on_device.display_camera
        self._about = About(number, frame.time, *cameras, reset, exposure, {})
        self._say()

    def made(self, time: float, camera: Camera) -> None:
        """Record the camera of a frame that was extrapolated from the last rendered one for this time."""
        if self._about is None:
            return
        done = not self._copies
        if done:
            self._head[0] += 1
        self._about.cameras[time] = camera
        self._say()
        if done:
            self._head[1] = self._head[0]
        elif all(copy.command_execution_status == cl.command_execution_status.COMPLETE for copy in self._copies):
            self.finish()

    def finish(self) -> None:
        """Wait for the copies of the last frame."""
        if self._copies:
            cl.wait_for_events(self._copies)
            self._copies = []
            self._head[1] = self._head[0]

    @property
    def _head(self) -> np.ndarray:
        return self.plan.head(self.block.memory, self._slot)

    def _say(self) -> None:
        said = encoded(self._about)
        if len(said) > _ABOUT:  # very many frames were made from one
            return
        self.plan.about(self.block.memory, self._slot)[: len(said)] = np.frombuffer(said, np.uint8)
        self._head[2] = len(said)


def recorded(plan: RecordingPlan, memory: mmap.mmap) -> list[tuple[About, list[np.ndarray]]]:
    """Return copies of the last recorded frames with their images, the consecutive ones up to the newest. The program
    may continue writing, or be dead."""
    found: dict[int, tuple[About, list[np.ndarray]]] = {}
    for slot in range(plan.count):
        before = plan.head(memory, slot).copy()
        if not before[0] or before[0] != before[1]:
            continue
        said = plan.about(memory, slot)[: int(before[2])].tobytes()
        images = [image.copy() for image in plan.images(memory, slot)]
        if plan.head(memory, slot)[0] != before[0]:
            continue  # it was written meanwhile
        try:
            about = decoded(said, About)
        except GffeError:
            continue  # the program died meanwhile
        found[about.number] = about, images
    number, kept = max(found, default=0), []
    while number in found:
        kept.append(found[number])
        number -= 1
    return kept[::-1]
