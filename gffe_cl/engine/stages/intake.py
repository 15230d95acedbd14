"""Intake of rendered frames: everything about a frame is checked here before any work on it begins, and then brought to
the device."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

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
    HostArrays,
    RenderedFrame,
    checked_frame,
    described_arrays,
    display_camera_of,
    host_arrays,
    require_motion,
    require_one_pose,
    type_of,
)
from gffe_cl.engine.frame.window import without_jitter
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.base import Board, Step
from gffe_cl.engine.stages.buffers import RENDERED, RGBA, BufferSpec, DeviceFrame, Owner, Sizes, given_buffer
from gffe_cl.engine.stages.measures import UserInterface
from gffe_cl.engine.stages.presentation import Composition
from gffe_cl.engine.stages.upload import Upload

_NAMES = tuple(spec.name for spec in RENDERED)


@dataclass
class PreparedFrame:
    """A rendered frame without structural faults.

    Attributes
    ----------
    frame : RenderedFrame
        As given, with `time` and `reset` as Python values.
    display_camera : Camera
        In pixels of the display.
    buffers : dict of str to cl.Buffer
        Device buffers of color, depth and motion, the latter missing if a reset has none; empty for NumPy arrays.
    arrays : HostArrays or None
        NumPy arrays as `Upload` takes them; None for device buffers.
    geometry : (int, int)
        Width and height of depth and motion.
    format : FrameFormat or None
        The description of its buffers; also of geometry that only the frame says to be smaller.
    types : dict of str to str or None
        With a `FrameFormat`: the types of the values given, by name as `TYPES` has them; None for missing motion.
    channels : dict of str to int
        With a `FrameFormat`: the channels of the values given.
    zero_copy : bool
        Whether arrays are to be used in place.
    """

    frame: RenderedFrame
    display_camera: Camera
    buffers: dict[str, cl.Buffer]
    arrays: HostArrays | None
    geometry: tuple[int, int]
    format: FrameFormat | None
    types: dict[str, str | None] = field(default_factory=dict)
    channels: dict[str, int] = field(default_factory=dict)
    zero_copy: bool = False


def prepare(
    frame: RenderedFrame,
    sizes: Sizes,
    device: Device,
    jittered: bool = False,
    format: FrameFormat | None = None,
    zero_copy: bool = False,
    earlier: DeviceFrame | None = None,
) -> PreparedFrame:
    """Return `frame` ready to be taken by a pipeline of `sizes` on `device`. If it is `jittered`, a display camera that
    is not given is the rendered one without jitter. `format` describes its buffers if they differ from ours. Buffers of
    an `earlier` frame of the pipeline are known to be right.

    Raises GffeError for a structural fault: invalid values, shapes or types, buffers that the device cannot use, motion
    missing although the frame is no reset, or two cameras of different poses.
    """
    frame = checked_frame(frame)
    zero_copy = zero_copy is not False and require_bool(zero_copy, "submit: zero_copy")
    plain = frame
    if jittered and frame.display_camera is None:
        plain = replace(frame, camera=without_jitter(frame.camera, sizes.source))
    display_camera = display_camera_of(plain, sizes.source, sizes.target)
    require_one_pose(frame.camera, display_camera)
    geometry = sizes.source
    if format is not None or frame.geometry_size is not None:
        geometry = require_render_size(format, sizes.source, frame.geometry_size)
        if geometry != sizes.source and format is None:
            format = FrameFormat()
    if format is None:
        if earlier and all(map(operator.is_, (frame.color, frame.depth, frame.motion), earlier.buffers)):
            buffers = dict(zip(_NAMES, earlier.buffers, strict=True))
            return PreparedFrame(frame, display_camera, buffers, None, geometry, None)
        buffers = _given(frame, RENDERED, sizes, sizes, device)
    else:
        buffers = _given(frame, described_specs(format), sizes, replace(sizes, source=geometry), device)
    arrays = types = channels = None
    if not any(buffers.values()):
        buffers, width, height = {}, *sizes.source
        if format is None:
            arrays = host_arrays(frame, height, width)
        else:
            arrays = described_arrays(frame, sizes.source, geometry)
            given = {spec.name: getattr(arrays, spec.name) for spec in RENDERED}
            types = {name: None if array is None else type_of(array) for name, array in given.items()}
            channels = {"color": arrays.color.shape[2], "motion": 2}
    else:
        if buffers["color"] and buffers["depth"] and require_motion(frame) is None:
            del buffers["motion"]
        if other := next((name for name, buffer in buffers.items() if not buffer), None):
            raise GffeError(
                "frame: color, depth and motion must be all NumPy arrays or all device buffers,"
                f" got {other} as {shown(getattr(frame, other))}"
            )
        if format:
            types = {s.name: getattr(format, f"{s.name}_type") if s.name in buffers else None for s in RENDERED}
            channels = {"color": format.color_channels, "motion": format.motion_channels}
    return PreparedFrame(
        frame, display_camera, buffers, arrays, geometry, format, types or {}, channels or {}, zero_copy
    )


def _given(
    frame: RenderedFrame,
    specs: Iterable[BufferSpec],
    sizes: Sizes,
    small: Sizes,
    device: Device,
) -> dict[str, Any]:
    """Return the device buffers that a frame gives, by name, with None for arrays. `small`: the sizes with those of
    depth and motion."""
    return {
        spec.name: given_buffer(getattr(frame, spec.name), spec, sizes if spec.name == "color" else small, device)
        for spec in specs
    }


def described_specs(format: FrameFormat) -> tuple[BufferSpec, ...]:
    """Return the descriptions of color, depth and motion as device buffers of an engine."""
    color, depth, motion = RENDERED
    letters = {"color": RGBA[: format.color_channels], "depth": (), "motion": "xyzw"[: format.motion_channels]}
    return tuple(
        replace(spec, dtype=TYPES[getattr(format, f"{spec.name}_type")][0], components=tuple(letters[spec.name]))
        for spec in (color, depth, motion)
    )


def _three(buffers: Mapping[str, cl.Buffer]) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
    return buffers["color"], buffers["depth"], buffers["motion"]


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
        self, prepared: PreparedFrame, previous: DeviceFrame | None, times: list[float], before: DeviceFrame | None,
        exposure: float,
    ) -> tuple[DeviceFrame, DeviceFrame]:  # fmt: skip
        """Enqueue what brings a frame to the device. Return it for the stages, without what keeps its place, and whole.
        `previous`, `before`: the frame before in these forms, None after a reset; `times`: those of the frames before,
        newest first, seconds. Raises GffeError for overlays of wrong shapes."""
        board = self._board
        assert board is not None  # `begin` was called
        overlays, detection = prepared.frame.overlays, board.stages.get(UserInterface.name)
        if not board.options.overlays:
            overlays = None
        if self.composition is None and (overlays or detection):
            self.composition = Composition(board)
        layers = self.composition.prepared(overlays) if self.composition else {}
        shown = self._on_device(prepared, previous, times)
        if detection:
            layers = detection.found(layers, shown, before, exposure)
        return (self.composition.take(layers, shown) if self.composition else shown), shown

    def leave(self, done: cl.Event, frames: Any) -> None:
        """Keep `frames` until `done` is complete."""
        complete = cl.command_execution_status.COMPLETE
        self._leaving = [one for one in self._leaving if one[0].command_execution_status > complete]
        self._leaving.append((done, frames))

    @property
    def overlaid(self) -> Composition | None:
        """The stage that lays overlays over pictures, if the last frame brought any."""
        return self.composition if self.composition and self.composition.active else None

    def _on_device(self, prepared: PreparedFrame, previous: DeviceFrame | None, times: list[float]) -> DeviceFrame:
        """Enqueue what brings a frame to the device, and return it there. Parameters are those of `take`."""
        frame, self.geometry = prepared.frame, prepared.geometry
        jitter = frame.geometry_jitter
        if jitter is not NO_JITTER:
            jitter = jitter_in_color(jitter, self.sizes.source, prepared.geometry)
        seen = frame.camera, prepared.display_camera, frame.time, jitter
        if prepared.arrays is None:
            return self._of_buffers(prepared, seen, previous, times)
        upload, host = self._uploading(), prepared.arrays
        self._count_conversions(frame, host)
        if prepared.format:
            color, depth, motion = self._slot()
            taken = DeviceFrame(color, depth, motion, *seen)
            upload.take(host, taken, step=self._conversion(prepared, taken, previous, times),
                        is_dilated=prepared.format.motion_dilated)  # fmt: skip
            return taken
        shared = upload.shared(host) if prepared.zero_copy else {}
        self.reads_arrays |= bool(shared)
        color, depth, motion = _three(shared) if len(shared) == len(RENDERED) else self._slot(shared)
        taken = DeviceFrame(color, depth, motion, *seen)
        upload.take(host, taken, shared)
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
        self, prepared: PreparedFrame, seen: tuple, previous: DeviceFrame | None, times: list[float]
    ) -> DeviceFrame:
        """Return the frame of device buffers: with the buffers themselves, or converted ones."""
        given, format = prepared.buffers, prepared.format
        if format is None:
            return DeviceFrame(given["color"], given["depth"], given.get("motion") or self._zero_motion(), *seen)
        ours = format.is_ours
        ours["geometry"] &= prepared.geometry == self.sizes.source
        converted = {n: b for n, b in given.items() if not ours["color" if n == "color" else "geometry"]}
        kept = {name: buffer for name, buffer in given.items() if name not in converted}
        if "depth" in kept and "motion" not in given:
            kept["motion"] = self._zero_motion()
        if not converted:
            color, depth, motion = _three(kept)
            return DeviceFrame(color, depth, motion, *seen)
        color, depth, motion = self._slot(kept)
        taken = DeviceFrame(color, depth, motion, *seen)
        step = self._conversion(prepared, taken, previous, times)
        self._uploading().convert(converted, taken, step, format.motion_dilated)
        return taken

    def _conversion(
        self, prepared: PreparedFrame, taken: DeviceFrame, previous: DeviceFrame | None, times: list[float]
    ) -> Step:
        """Return the step with the numbers that convert a frame into the buffers of `taken`."""
        jitters = taken.geometry_jitter, previous.geometry_jitter if previous else taken.geometry_jitter
        assert prepared.format is not None  # as it is only called with one
        told = prepared.types, prepared.channels
        given = conversion(prepared.format, self.sizes.source, *told, *jitters, prepared.geometry)
        return Step(taken, previous, [taken.time, *times], given=given)

    def _slot(self, instead: Mapping[str, cl.Buffer] = {}) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
        """Return buffers of its own for a frame, but for those given `instead`, by name. Two sets are used in turn."""
        if len(self._slots) < 2:
            motion = self._slots[0].motion if self._slots else None  # nothing reads that of the frame before
            made = DeviceFrame.allocate(self.device, self.sizes.source, None, None, 0.0, motion=motion)
            self._slots.append(made)
        else:
            self._slots.append(self._slots.pop(0))
        return _three({spec.name: getattr(self._slots[-1], spec.name) for spec in RENDERED} | dict(instead))

    def _count_conversions(self, frame: RenderedFrame, host: HostArrays) -> None:
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
