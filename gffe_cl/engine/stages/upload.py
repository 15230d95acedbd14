"""Upload: rendered frames from the host, or in an engine's formats (beyond the paper, which renders on the device)."""

from __future__ import annotations

import ctypes
from collections.abc import Container, Mapping
from dataclasses import fields

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RENDERED, XY, BufferSpec, DeviceFrame
from gffe_cl.engine.stages.memory import pinned_array

_MOST_BYTES = 28  # per pixel: color float × 4, depth float, motion float × 2
_PLACES = 2  # that the host fills in turn

_KINDS = len(fields(BadPixels))
_TYPES = constants("upload.cl")


class Upload(Stage):
    """Copies NumPy arrays to the device, converts their colors to half and counts bad pixels. Converts arrays and
    device buffers that a `FrameFormat` describes, undoes dilation of motion, and spreads depth and motion that are
    smaller than color over it.

    CPUs read the arrays where they lie. For other devices the arrays are gathered in pinned memory, and copied from
    there at once, while the host continues: there are two such places, in turn.

    `copied_bytes`: bytes written for the arrays of all frames taken: copies to a device with memory of its own, and
    results that kernels store.
    """

    name = "upload"
    registered = False
    buffers = (
        BufferSpec(
            "given", np.uint8, (), "source", "color, depth and motion as the host has them, one after another",
            planes=_MOST_BYTES, scratch=True, transient=True,
        ),
        BufferSpec(
            "small_depth", np.float32, (), "source", "depth that is smaller than color, converted", "depth",
            scratch=True, transient=True,
        ),
        BufferSpec(
            "small_motion", np.float32, XY, "source",
            "motion that is smaller than color or dilated, in pixels of color", "motion",
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
                {"color": "rendered.color", "bad_pixels": "upload.bad_pixels"},
                step=("LANES", 1),
            )
            for name in ("take_color", "convert_color")
        ),
        *(
            Kernel(
                name,
                "runs",
                {"given_depth": "rendered.depth", "given_motion": "rendered.motion"},
                {
                    "depth": "rendered.depth",
                    "motion": "rendered.motion",
                    "bad_pixels": "upload.bad_pixels",
                },
                step=("LANES", 1),
            )
            for name in ("take_geometry", "convert_geometry")
        ),
        Kernel(
            "undo_dilation",
            "source",
            {"depth": "rendered.depth", "dilated": "upload.small_motion"},
            {"motion": "rendered.motion"},
            step=("LANES", 1),
        ),
        Kernel(
            "spread_geometry",
            "source",
            {"color": "rendered.color", "small_depth": "upload.small_depth", "small_motion": "upload.small_motion"},
            {"depth": "rendered.depth", "motion": "rendered.motion"},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        super().__init__(board)
        self._in_place = self.device.works_in_host_memory
        self._size = dict(zip(("width", "height"), self.sizes.source, strict=True))
        self._bad = BadPixels()  # of the frames whose counts have come since they were taken
        self._counts: list[tuple[np.ndarray, cl.Event]] = []  # on their way from the device, the oldest first
        self._staging: list[tuple[np.ndarray, cl.Event]] = []  # places, and the copies from them, the oldest first
        self.copied_bytes = 0

    def take(
        self,
        arrays: RenderedFrame,
        frame: DeviceFrame,
        shared: Container[str] = (),
        step: Step | None = None,
        is_dilated: bool = False,
    ) -> None:
        """Enqueue the upload of `arrays` into the buffers of `frame`, except those that are `shared`. The other arrays
        may be changed afterwards; only in them bad pixels are counted. `step`: with the numbers that convert arrays
        which a `FrameFormat` describes; `is_dilated`: whether it says that motion is."""
        copied = [spec.name for spec in RENDERED if spec.name not in shared]
        if 0 < len(copied) < len(RENDERED) or (step and self._is_small(step)):
            self.fill("bad_pixels", 0)
        given = {name: array for name in copied if (array := getattr(arrays, name)) is not None}
        if self._in_place:
            places = {name: self._in_memory(array) for name, array in given.items()}
        else:
            places = self._copy(given)
        if step:
            self.convert_places(places, frame, step, is_dilated)
        elif "color" in copied:
            self._take_color(arrays.color, *places["color"], frame.color)
        if "depth" in copied and not step:
            self._take_geometry(places, frame)
        if copied and self._in_place:
            self.device.queue.finish()  # kernels read the arrays
        if arrays._known_bad:
            self._bad += arrays._known_bad
        elif copied:
            self._count()

    def convert(self, given: Mapping[str, cl.Buffer], frame: DeviceFrame, step: Step, is_dilated: bool = False) -> None:
        """Enqueue the conversion of device buffers that a `FrameFormat` describes, color or depth and motion or all,
        into those of `frame`, and count their bad pixels. `step` has the numbers; `is_dilated`: whether motion is."""
        if not {"color", "depth"} <= given.keys() or self._is_small(step):
            self.fill("bad_pixels", 0)
        self.convert_places({name: (buffer, 0) for name, buffer in given.items()}, frame, step, is_dilated)
        self._count()

    def convert_places(
        self, places: Mapping[str, tuple[cl.Buffer, int]], frame: DeviceFrame, step: Step, is_dilated: bool = False
    ) -> None:
        """Enqueue the conversion of values that begin at an index of a buffer, by name, into the buffers of `frame`;
        bad pixels are counted on the device. `is_dilated`: whether motion is."""
        if "color" in places:
            given, start = places["color"]
            self.launch("convert_color", step, given=given, start=start, color=frame.color)
        if "depth" not in places:
            return
        given_depth, depth_start = places["depth"]
        given_motion, motion_start = places.get("motion", (frame.motion, 0))  # then its type is none
        is_small, depth, motion = self._is_small(step), frame.depth, frame.motion
        if is_small or is_dilated:
            self.allocate_small()
        if is_small:
            depth, motion = self.buffer["small_depth"], self.buffer["small_motion"]
        # The motion of the other size has room for dilated motion until that is undone.
        converted = motion if not is_dilated else frame.motion if is_small else self.buffer["small_motion"]
        self.launch(
            "convert_geometry",
            step,
            given_depth=given_depth,
            depth_start=depth_start,
            given_motion=given_motion,
            motion_start=motion_start,
            depth=depth,
            motion=converted,
        )
        if is_dilated:
            self.launch("undo_dilation", step, depth=depth, dilated=converted, motion=motion)
        if is_small:
            self.launch("spread_geometry", step, color=frame.color, depth=frame.depth, motion=frame.motion)

    def allocate_small(self) -> None:
        """Allocate the buffers for depth and motion that are smaller than color or dilated, unless they are there."""
        if "small_depth" not in self.buffer:
            self.buffer |= self.allocate([self.spec("small_depth"), self.spec("small_motion")])

    def _is_small(self, step: Step) -> bool:
        """Return whether depth and motion are smaller than color."""
        return (step.given["geometry_width"], step.given["geometry_height"]) != self.sizes.source

    def shared(self, arrays: RenderedFrame) -> dict[str, cl.Buffer]:
        """Return those of the arrays that kernels can use in place, by name, depth and motion both or neither: on a
        CPU, in the layout of `RENDERED`, and beginning at an aligned address. The buffers keep the arrays alive."""
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

    def _take_color(self, color: np.ndarray, given: cl.Buffer, start: int, made: cl.Buffer) -> None:
        kind = _TYPES[color.dtype.name.upper()]
        self.launch(
            "take_color", **self._size, given=given, start=start, type=kind, channels=color.shape[2], color=made
        )
        self.copied_bytes += made.size

    def _take_geometry(self, places: Mapping[str, tuple[cl.Buffer, int]], frame: DeviceFrame) -> None:
        if "motion" not in places:
            cl.enqueue_fill_buffer(self.device.queue, frame.motion, b"\0", 0, frame.motion.size)
        given_depth, depth_start = places["depth"]
        given_motion, motion_start = places.get("motion", (frame.motion, 0))
        self.launch(
            "take_geometry",
            **self._size,
            given_depth=given_depth,
            depth_start=depth_start,
            given_motion=given_motion,
            motion_start=motion_start,
            depth=frame.depth,
            motion=frame.motion,
        )
        self.copied_bytes += frame.depth.size + (frame.motion.size if "motion" in places else 0)

    def take_bad_pixels(self) -> BadPixels:
        """Return the counts of bad pixels of the frames taken since the last call; waits for the device."""
        while self._counts:
            self._add_oldest()
        taken, self._bad = self._bad, BadPixels()
        return taken

    def _count(self) -> None:
        """Enqueue a copy of the counts to the host, and add those that have come."""
        counts = np.empty(self.spec("bad_pixels").shape(self.sizes), np.uint8)
        event = cl.enqueue_copy(self.device.queue, counts, self.buffer["bad_pixels"], is_blocking=False)
        self._counts.append((counts, event))
        complete = cl.command_execution_status.COMPLETE
        while self._counts and self._counts[0][1].command_execution_status == complete:
            self._add_oldest()

    def _add_oldest(self) -> None:
        counts, event = self._counts.pop(0)
        event.wait()
        self._bad += BadPixels(*counts.reshape(_KINDS, -1).sum(1, dtype=np.int64).tolist())

    def _in_memory(self, array: np.ndarray) -> tuple[cl.Buffer, int]:
        """Return a buffer of the array in place, for kernels to read, and the index of its first value there.

        Runtimes copy arrays that do not begin at an aligned address. So the buffer begins at the last one before the
        array, which is in the same page of memory.
        """
        before = array.ctypes.data % self.device.alignment
        memory = (ctypes.c_ubyte * (before + array.nbytes)).from_address(array.ctypes.data - before)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return cl.Buffer(self.device.context, flags, hostbuf=memory), before // array.itemsize

    def _copy(self, arrays: Mapping[str, np.ndarray]) -> dict[str, tuple[cl.Buffer, int]]:
        """Enqueue one copy of all `arrays` to the device. Return by name the buffer, and the index of the array's first
        value there."""
        if "given" not in self.buffer:
            self.buffer |= self.allocate([self.spec("given")])
        given, places, end = self.buffer["given"], {}, 0
        for name in reversed([*arrays]):  # the widest type first: each begins where its type may
            places[name] = slice(end, end := end + arrays[name].nbytes)
        staging = self._free_staging(end)
        for name, place in places.items():
            staging[place] = arrays[name].reshape(-1).view(np.uint8)
        if arrays:
            event = cl.enqueue_copy(self.device.queue, given, staging[:end], is_blocking=False)
            self._staging.append((staging, event))
            self.copied_bytes += end
        return {name: (given, place.start // arrays[name].itemsize) for name, place in places.items()}

    def _free_staging(self, nbytes: int) -> np.ndarray:
        """Return pinned memory of at least `nbytes` that no copy reads any more."""
        if len(self._staging) == _PLACES:
            staging, copied = self._staging.pop(0)
            copied.wait()
            if staging.nbytes >= nbytes:
                return staging
        return pinned_array(self.device, (nbytes,), np.dtype(np.uint8))
