"""Intake of rendered frames: what hangs on the pipeline is checked here before any work on a frame begins, and then it
is brought to the device."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_bool, shown
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import (
    NO_JITTER,
    TYPES,
    FrameFormat,
    conversion,
    jitter_in_color,
    require_render_size,
)
from gffe_cl.engine.frame.rendered_frame import (
    BadPixels,
    RenderedFrame,
    described_arrays,
    display_camera_of,
    host_arrays,
    require_motion,
    require_one_pose,
    type_of,
)
from gffe_cl.engine.frame.window import without_jitter
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.base import Board, Step, pictures_of
from gffe_cl.engine.stages.buffers import RENDERED, RGBA, BufferSpec, DeviceFrame, Owner, Sizes, given_buffer
from gffe_cl.engine.stages.measures import UserInterface
from gffe_cl.engine.stages.presentation import Composition
from gffe_cl.engine.stages.upload import Upload


def described_specs(format: FrameFormat) -> tuple[BufferSpec, ...]:
    """Return the descriptions of color, depth and motion as device buffers of an engine."""
    color, depth, motion = RENDERED
    letters = {"color": RGBA[: format.color_channels], "depth": (), "motion": "xyzw"[: format.motion_channels]}
    return tuple(
        replace(spec, dtype=TYPES[getattr(format, f"{spec.name}_type")][0], components=tuple(letters[spec.name]))
        for spec in (color, depth, motion)
    )


class About(NamedTuple):
    """Properties of a frame beside its buffers, by the fields of `DeviceFrame`."""

    camera: Camera
    display_camera: Camera
    time: float
    geometry_jitter: tuple[float, float]


class Told(NamedTuple):
    """Types of the values given, by name as `TYPES` has them, None for missing motion; and their channels."""

    types: dict[str, str | None]
    channels: dict[str, int]


_Convert = Callable[[DeviceFrame], Step]  # the step with the numbers that convert a frame into these buffers


def _told_by_arrays(arrays: RenderedFrame) -> Told:
    given = {spec.name: getattr(arrays, spec.name) for spec in RENDERED}
    types = {name: None if array is None else type_of(array) for name, array in given.items()}
    return Told(types, {"color": arrays.color.shape[2], "motion": 2})


def _told_by(format: FrameFormat, given: Container[str]) -> Told:
    types = {s.name: getattr(format, f"{s.name}_type") if s.name in given else None for s in RENDERED}
    return Told(types, {"color": format.color_channels, "motion": format.motion_channels})


class Intake:
    """Intake of a pipeline: brings rendered frames into device buffers in the layout of `RENDERED`, and takes from them
    what keeps its place on the display.

    Device buffers in that layout are used in place, and so are NumPy arrays on CPUs, on request. All others are copied
    or converted into buffers of its own, two sets in turn.

    `geometry`: width and height of depth and motion of the last frame, as they were given. `reads_arrays`: whether
    NumPy arrays were used in place. `composition` holds overlays, None until a frame brings some.
    """

    def __init__(self, device: Device, sizes: Sizes):
        self.device, self.sizes, self.geometry = device, sizes, sizes.source
        self.reads_arrays = False
        self._board: Board | None = None
        self._upload: Upload | None = None  # made with the first arrays, or buffers to convert
        self._bad_pixels, self._copied_bytes = BadPixels(), 0  # without those that the stage `upload` still has
        self._slots: list[DeviceFrame] = []
        self._no_motion: cl.Buffer | None = None  # zeros, made with the first device buffers without motion
        self.composition: Composition | None = None
        self._leaving: list[tuple[cl.Event, Any]] = []  # frames that the device may still read until an event

    def begin(self, board: Board) -> None:
        """Work for the stages on `board` from now on. Counts go on."""
        self._bad_pixels, self._copied_bytes = self.bad_pixels, self.copied_bytes
        self._board, self._upload, self.geometry, self.composition = board, None, self.sizes.source, None

    @property
    def bad_pixels(self) -> BadPixels:
        """Bad pixels of all frames so far; waits for the device."""
        if self._upload:
            self._bad_pixels += self._upload.take_bad_pixels()
        return self._bad_pixels

    @property
    def copied_bytes(self) -> int:
        return self._copied_bytes + (self._upload.copied_bytes if self._upload else 0)

    def take(
        self,
        frame: RenderedFrame,
        previous: DeviceFrame | None,
        times: list[float],
        *,
        format: FrameFormat | None = None,
        exposure: float = 1.0,
        zero_copy: bool = False,
    ) -> DeviceFrame:
        """Enqueue what brings a frame to the device, and return it there for the stages, without what keeps its place,
        which its `whole` has. `previous`: the frame before, None after a reset; `times`: those of the frames before,
        newest first, seconds; `format`: of its buffers, if it differs from ours; `zero_copy`: whether arrays are to be
        used in place.

        Raises GffeError, and enqueues nothing, for a structural fault: wrong shapes or types, buffers that the device
        cannot use, motion missing although the frame is no reset, or two cameras of different poses.
        """
        board = self._board
        assert board is not None  # `begin` was called
        zero_copy = zero_copy is not False and require_bool(zero_copy, "submit: zero_copy")
        display_camera = self._display_camera(frame, board)
        geometry = self.sizes.source
        if format is not None or frame.geometry_size is not None:
            geometry = require_render_size(format, self.sizes.source, frame.geometry_size)
            if geometry != self.sizes.source and format is None:
                format = FrameFormat()
        given = self._given(frame, format, geometry)
        arrays = None if given else self._arrays(frame, format, geometry)
        overlays, detection = frame.overlays if board.options.overlays else None, board.stages.get(UserInterface.name)
        if self.composition is None and (overlays or detection):
            self.composition = Composition(board)
        layers = self.composition.prepared(overlays) if self.composition else {}

        self.geometry, jitter = geometry, frame.geometry_jitter
        if jitter is not NO_JITTER:
            jitter = jitter_in_color(jitter, self.sizes.source, geometry)
        about = About(frame.camera, display_camera, frame.time, jitter)
        convert = None
        if format:
            told = _told_by_arrays(arrays) if arrays else _told_by(format, given)
            convert = partial(self._conversion, format, told, previous, times)
        if arrays:
            self._count_conversions(frame, arrays)
            shown = self._of_arrays(arrays, about, convert, format, zero_copy)
        else:
            shown = self._of_buffers(given, about, convert, format)
        if detection:
            layers = detection.found(layers, shown, previous and previous.shown, exposure)
        taken = self.composition.take(layers, shown) if self.composition else shown
        if taken is not shown:
            taken.whole = shown
        return taken

    def _display_camera(self, frame: RenderedFrame, board: Board) -> Camera:
        """Return the display camera, in pixels of the display. If frames may be jittered, one that is not given is the
        rendered one without jitter."""
        plain = frame
        if frame.display_camera is None and "rendered" in pictures_of(board.stages.values()):
            plain = replace(frame, camera=without_jitter(frame.camera, self.sizes.source))
        display_camera = display_camera_of(plain, self.sizes.source, self.sizes.target)
        require_one_pose(frame.camera, display_camera)
        return display_camera

    def _given(
        self, frame: RenderedFrame, format: FrameFormat | None, geometry: tuple[int, int]
    ) -> dict[str, cl.Buffer]:
        """Return the device buffers that a frame gives, by name, without missing motion; nothing for NumPy arrays."""
        small = self.sizes if geometry == self.sizes.source else replace(self.sizes, source=geometry)
        buffers: dict[str, Any] = {
            spec.name: given_buffer(
                getattr(frame, spec.name), spec, self.sizes if spec.name == "color" else small, self.device
            )
            for spec in (described_specs(format) if format else RENDERED)
        }
        if not any(buffers.values()):
            return {}
        if buffers["color"] and buffers["depth"] and require_motion(frame) is None:
            del buffers["motion"]
        if other := next((name for name, buffer in buffers.items() if not buffer), None):
            raise GffeError(
                "frame: color, depth and motion must be all NumPy arrays or all device buffers,"
                f" got {other} as {shown(getattr(frame, other))}"
            )
        return buffers

    def _arrays(self, frame: RenderedFrame, format: FrameFormat | None, geometry: tuple[int, int]) -> RenderedFrame:
        """Return the frame with its NumPy arrays as `Upload` takes them."""
        width, height = self.sizes.source
        return described_arrays(frame, self.sizes.source, geometry) if format else host_arrays(frame, height, width)

    def leave(self, done: cl.Event, frames: Any) -> None:
        """Keep `frames` until `done` is complete."""
        complete = cl.command_execution_status.COMPLETE
        self._leaving = [one for one in self._leaving if one[0].command_execution_status > complete]
        self._leaving.append((done, frames))

    @property
    def overlaid(self) -> Composition | None:
        """The stage that lays overlays over pictures, if the last frame brought any."""
        return self.composition if self.composition and self.composition.active else None

    def _of_arrays(
        self, arrays: RenderedFrame, about: About, convert: _Convert | None, format: FrameFormat | None, in_place: bool
    ) -> DeviceFrame:
        """Enqueue the upload of NumPy arrays, and return the frame on the device."""
        upload = self._uploading()
        shared = upload.shared(arrays) if in_place and not format else {}
        self.reads_arrays |= bool(shared)
        taken = DeviceFrame(**(shared if len(shared) == len(RENDERED) else self._slot(shared)), **about._asdict())
        step = convert(taken) if convert else None
        upload.take(arrays, taken, shared, step, is_dilated=bool(format and format.motion_dilated))
        return taken

    def conversions(self, format: FrameFormat | None) -> Iterator[tuple[Owner, BufferSpec, tuple[int, int]]]:
        """Yield what `Pipeline.conversions` does, for frames of a `format`."""
        upload, is_small = self._upload, self.geometry != self.sizes.source
        if upload is None or not (is_small or (format and format.motion_dilated)):
            return
        for spec in upload.buffers:
            if spec.view != "scalar" and spec.name in upload.buffer and (is_small or spec.name != "small_depth"):
                yield upload, spec, self.geometry

    def _uploading(self) -> Upload:
        if self._upload is None:
            assert self._board is not None  # `begin` was called
            self._upload = Upload(self._board)
        return self._upload

    def _of_buffers(
        self, given: dict[str, cl.Buffer], about: About, convert: _Convert | None, format: FrameFormat | None
    ) -> DeviceFrame:
        """Return the frame of device buffers: with the buffers themselves, or converted ones."""
        ours = format.is_ours if format else {"color": True, "geometry": True}
        ours["geometry"] &= self.geometry == self.sizes.source
        converted = {n: b for n, b in given.items() if not ours["color" if n == "color" else "geometry"]}
        kept = {name: buffer for name, buffer in given.items() if name not in converted}
        if "depth" in kept and "motion" not in given:
            kept["motion"] = self._zero_motion()
        if not (converted and convert and format):
            return DeviceFrame(**kept, **about._asdict())
        taken = DeviceFrame(**self._slot(kept), **about._asdict())
        self._uploading().convert(converted, taken, convert(taken), format.motion_dilated)
        return taken

    def _conversion(
        self,
        format: FrameFormat,
        told: Told,
        previous: DeviceFrame | None,
        times: list[float],
        taken: DeviceFrame,
    ) -> Step:
        """Return the step with the numbers that convert a frame into the buffers of `taken`."""
        jitters = taken.geometry_jitter, previous.geometry_jitter if previous else taken.geometry_jitter
        given = conversion(format, self.sizes.source, told.types, told.channels, *jitters, self.geometry)
        return Step(taken, previous, [taken.time, *times], given=given)

    def _slot(self, instead: Mapping[str, cl.Buffer] = {}) -> dict[str, cl.Buffer]:
        """Return buffers of its own for a frame, but for those given `instead`, by name. Two sets are used in turn."""
        if len(self._slots) < 2:
            motion = self._slots[0].motion if self._slots else None  # nothing reads that of the frame before
            made = DeviceFrame.allocate(self.device, self.sizes.source, None, None, 0.0, motion=motion)
            self._slots.append(made)
        else:
            self._slots.append(self._slots.pop(0))
        return {spec.name: getattr(self._slots[-1], spec.name) for spec in RENDERED} | dict(instead)

    def _count_conversions(self, frame: RenderedFrame, host: RenderedFrame) -> None:
        """Count the bytes of arrays that the host converted to another type or layout."""
        for spec in RENDERED:
            array, made = getattr(frame, spec.name), getattr(host, spec.name)
            if made is not None and not (isinstance(array, np.ndarray) and np.may_share_memory(array, made)):
                self._copied_bytes += made.nbytes

    def _zero_motion(self) -> cl.Buffer:
        zeros = self._no_motion
        if zeros is None:
            self._no_motion = zeros = self.device.buffer(RENDERED[2].nbytes(self.sizes))
            cl.enqueue_fill_buffer(self.device.queue, zeros, b"\0", 0, zeros.size)
        return zeros
