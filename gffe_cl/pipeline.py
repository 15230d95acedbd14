"""The order of the stages, and the state between frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array

from gffe_cl import inference
from gffe_cl.camera import Camera, predict_camera
from gffe_cl.errors import GffeError
from gffe_cl.frame import (
    BYTES_PER_PIXEL,
    BadPixels,
    PackedFrame,
    RenderedFrame,
    display_camera_of,
    is_shown_whole,
    pack_frame,
    require_one_pose,
)
from gffe_cl.opencl.device import Device
from gffe_cl.options import Options
from gffe_cl.stage import BufferSpec, DeviceFrame, Sizes, Stage
from gffe_cl.stages.background import Background
from gffe_cl.stages.correction import ShadingCorrection
from gffe_cl.stages.history import HistoryTracking
from gffe_cl.stages.holes import FILLINGS
from gffe_cl.stages.prediction import MAX_ORDER, PositionPrediction
from gffe_cl.stages.presentation import Presentation
from gffe_cl.stages.shading import ShadingInputs
from gffe_cl.stages.warp import Warp


@dataclass(frozen=True)
class PresentedFrame:
    """What is shown of the rendered frame at t: its display part, in display pixels.

    `color` (half ×4, linear RGB), `depth` (float, world units, +inf sky), `motion` (float ×2, pixels, t → t−1 between
    the displayed images) are device buffers that hold this frame until the next `submit`: the rendered frame's own, bit
    for bit, where all of it is shown.
    """

    camera: Camera
    time: float
    color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    _device: Device
    _size: tuple[int, int]

    def numpy(self, name: str) -> np.ndarray:
        """Copy to the host: "color" (H, W, 3) float16, "depth" (H, W) float32, "motion" (H, W, 2) float32."""
        channels, dtype = {"color": ((4,), np.float16), "depth": ((), np.float32), "motion": ((2,), np.float32)}[name]
        out = np.empty((*reversed(self._size), *channels), dtype)
        cl.enqueue_copy(self._device.queue, out, getattr(self, name))
        return out[..., :3] if name == "color" else out


@dataclass(frozen=True)
class ExtrapolatedFrame:
    """An extrapolated frame at t + α.

    `color` (half ×4, linear RGB), `depth` (float, world units, +inf sky), `motion` (float ×2, pixels,
    t + α → t, into the rendered image of t), `dynamic`, `disoccluded`, `filled_by` (uchar) are device buffers of
    the pipeline: they hold this frame until its next `extrapolate`. `gae` is the colour before shading correction, the
    same buffer as `color` where that is off.
    """

    camera: Camera
    time: float
    alpha: float
    source_time: float
    color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    dynamic: cl.Buffer
    disoccluded: cl.Buffer
    filled_by: cl.Buffer
    gae: cl.Buffer
    _warp: Stage

    def numpy(self, name: str) -> np.ndarray:
        """Copy to the host: "color", "gae" (H, W, 3) float16, "depth" (H, W) float32, "motion" (H, W, 2) float32,
        "dynamic", "disoccluded", "filled_by" (H, W) uint8."""
        if name not in ("color", "gae"):
            return self._warp.read(name)
        spec = self._warp.spec("color")
        array = np.empty(spec.shape(self._warp.sizes), spec.dtype)
        cl.enqueue_copy(self._warp.device.queue, array, getattr(self, name))
        return array[..., :3]


class Pipeline:
    """Extrapolates frames from the rendered frames submitted so far.

    Parameters
    ----------
    device : Device
    width, height : int
        Of the extrapolated (display) image, pixels.
    options : Options
    render_size : (int, int) or None
        Width and height of the rendered images where they differ from the display's.
    fps : float
        Rendered frames per second, used for α until two frames are known.
    int64_atomics : bool or None
        Force or forbid the 64-bit path of the warp; None: as the device can. Both give the same bits.

    Attributes
    ----------
    exposure : float
        Factor on colour before display, for the shading correction network; may change from frame to frame.
    bad_pixels : BadPixels
        Met so far.

    Nothing is allocated on the device or compiled after construction, but for the first uploads of host arrays and
    with the first frame that is rendered through a window.
    Device buffers must have been written on `device.queue`, or be finished, before they are submitted.
    """

    def __init__(
        self,
        device: Device,
        width: int,
        height: int,
        options: Options | None = None,
        *,
        render_size: tuple[int, int] | None = None,
        fps: float = 30.0,
        int64_atomics: bool | None = None,
    ):
        if width < 1 or height < 1:
            raise GffeError(f"pipeline: size must be positive, got {width}×{height}")
        self.device = device
        self.options = options or Options()
        self.sizes = Sizes(source=tuple(render_size or (width, height)), target=(width, height))
        self.fps = fps
        self.exposure = 1.0
        self.bad_pixels = BadPixels()
        self.history = HistoryTracking(device, self.sizes, self.options.history, self.options.static_threshold)
        self.prediction = PositionPrediction(device, self.sizes, self.options.order)
        self.warp = Warp(device, self.sizes, self.options.crack_closing, int64_atomics)
        filling = FILLINGS[self.options.hole_filling].stage
        self.holes = filling(device, self.sizes) if filling else None
        self.background = (
            Background(device, self.sizes, self.options.levels, int64_atomics) if self.options.levels else None
        )
        self.correction: ShadingCorrection | None = None
        if self.options.corrects_shading:
            network = inference.load_network(self.options.scn_model, self.options.scn_provider)
            self.correction = ShadingCorrection(device, self.sizes, network)
        with_inputs = self.options.shading_inputs or self.correction
        self.shading = ShadingInputs(device, self.sizes) if with_inputs else None
        stages = (
            self.history, self.prediction, self.warp, self.background, self.holes, self.shading, self.correction
        )  # fmt: skip
        self.stages: tuple[Stage, ...] = tuple(stage for stage in stages if stage)
        self.presentation: Presentation | None = None  # made, and added to `stages`, with the first windowed frame
        self._slots: list[DeviceFrame] = []
        self._current: DeviceFrame | None = None
        self._previous: DeviceFrame | None = None
        self._times: list[float] = []  # of rendered frames since the last reset, newest first

    # ---- rendered frames -------------------------------------------------------------------------------

    def submit(self, frame: RenderedFrame, packed: PackedFrame | None = None) -> None:
        """Take a rendered frame; frames must come in order of time.

        Arrays may be NumPy arrays (copied to the device; bad pixels are added to `bad_pixels`) or device
        buffers, which are used in place: do not overwrite them before two more frames have been submitted.
        `packed` may bring the result of `pack_frame`, done ahead on another thread.

        Raises GffeError for wrong shapes, missing motion, or a time that does not increase.
        """
        if not np.isfinite(frame.time) or (self._times and not frame.reset and frame.time <= self._times[0]):
            raise GffeError(f"frame: time {frame.time:g} s must be finite and after the previous rendered frame's")
        on_device = self._on_device(frame, packed)
        if frame.reset:
            self._times.clear()
            self._previous = None
        else:
            self._previous = self._current
        self._current = on_device
        self._times = [frame.time, *self._times[:MAX_ORDER]]
        self.history.track(self._current, self._previous if self.options.motion else None)
        self.warp.link(self._current, self.history)
        if self.background:
            self.background.collect(self._current, self._previous, self.history, self.warp)
        if self.presentation is None and not self._shown_whole(on_device):
            self.presentation = Presentation(self.device, self.sizes)
            self.stages += (self.presentation,)

    def present(self) -> PresentedFrame:
        """What is shown of the last submitted frame; resamples it where it was rendered through a window, or where the
        frame before was and motion must be converted. Returns at once. Raises GffeError before the first `submit`."""
        frame = self._need_frame()
        if self._needs_presentation:
            self.presentation.present(frame, self._previous)
            buffers = tuple(self.presentation.buffer[name] for name in ("color", "depth", "motion"))
        else:
            buffers = frame.buffers
        return PresentedFrame(frame.display_camera, frame.time, *buffers, self.device, self.sizes.target)

    @property
    def _needs_presentation(self) -> bool:
        return any(frame and not self._shown_whole(frame) for frame in (self._current, self._previous))

    def _shown_whole(self, frame: DeviceFrame) -> bool:
        return self.sizes.source == self.sizes.target and is_shown_whole(frame.camera, frame.display_camera)

    def _on_device(self, frame: RenderedFrame, packed: PackedFrame | None) -> DeviceFrame:
        display_camera = display_camera_of(frame, self.sizes.source, self.sizes.target)
        require_one_pose(frame.camera, display_camera)
        given = [_as_buffer(array) for array in (frame.color, frame.depth, frame.motion)]
        width, height = self.sizes.source
        if all(given):
            for name, buffer, bytes_per_pixel in zip(("color", "depth", "motion"), given, BYTES_PER_PIXEL, strict=True):
                if buffer.size < bytes_per_pixel * width * height:
                    raise GffeError(
                        f"frame: {name} buffer must hold {bytes_per_pixel * width * height} bytes ({width}×{height}),"
                        f" got {buffer.size}"
                    )
            return DeviceFrame(*given, frame.camera, display_camera, frame.time)
        if any(given):
            raise GffeError("frame: color, depth and motion must be all NumPy arrays or all device buffers")
        packed = packed or pack_frame(frame, height, width)
        self.bad_pixels += packed.bad
        if len(self._slots) < 2:
            cameras = (frame.camera, display_camera, frame.time)
            self._slots.append(DeviceFrame.allocate(self.device, self.sizes.source, *cameras))
        else:
            self._slots.append(self._slots.pop(0))
        slot = self._slots[-1]
        slot.upload(self.device, packed)
        return DeviceFrame(*slot.buffers, frame.camera, display_camera, frame.time)

    # ---- extrapolated frames ---------------------------------------------------------------------------

    @property
    def interval(self) -> float:
        """Seconds between the last two rendered frames; 1/fps after a reset."""
        return self._times[0] - self._times[1] if len(self._times) > 1 else 1.0 / self.fps

    def predict_camera(self, alpha: float) -> Camera:
        """C̄ at t + α from the last two display cameras; the last one itself after a reset."""
        self._need_frame()
        if self._previous is None:
            return self._current.display_camera
        return predict_camera(self._previous.display_camera, self._current.display_camera, alpha)

    def extrapolate(
        self,
        camera: Camera | None = None,
        time: float | None = None,
        *,
        target_position: np.ndarray | None = None,
    ) -> ExtrapolatedFrame:
        """Make the frame at `time` (seconds; default: half an interval ahead) seen by `camera` (default:
        the predicted camera). Returns at once, unless it waits for the shading correction network; reading a buffer
        waits.

        `target_position` (H, W, 4) float32 replaces position prediction, for experiments: x, y in target
        pixels, view depth there (−1: nothing), 0, for every pixel of the rendered frame.

        Raises GffeError before the first `submit`, or for a time before the last rendered frame.
        """
        source = self._need_frame()
        time = source.time + self.interval / 2 if time is None else float(time)
        alpha = (time - source.time) / self.interval
        if not (np.isfinite(alpha) and alpha >= 0):
            raise GffeError(f"extrapolate: time {time:g} s is before the last rendered frame's ({source.time:g} s)")
        camera = camera or self.predict_camera(alpha)
        if target_position is None:
            self.prediction.predict(source, self.history, self._times, camera, time)
        elif np.shape(target_position) != (*reversed(self.sizes.source), 4):
            raise GffeError(
                f"extrapolate: target_position must have shape {(*reversed(self.sizes.source), 4)},"
                f" got {np.shape(target_position)}"
            )
        else:
            self.prediction.upload("target_position", np.ascontiguousarray(target_position, np.float32))
        self.warp.warp(source, self.history, self.prediction, camera)
        if self.background:
            self.background.project(source, self.warp, camera)
        if self.holes:
            self.holes.fill_holes(source, self.warp, camera)
        if self.shading:
            self.shading.prepare(source, self._previous, self.warp, camera)
        made, final = self.warp.buffer, self.warp.buffer["color"]
        if self.correction:
            final = self.correction.buffer["color"]
            if self._previous is None:
                self.correction.skip(self.warp)
            else:
                self.correction.correct(self.warp, self.shading, alpha, self.exposure, self.options.focus_mask)
        buffers = {name: made[name] for name in ("depth", "motion", "dynamic", "disoccluded", "filled_by")}
        return ExtrapolatedFrame(
            camera, time, alpha, source.time, color=final, gae=made["color"], **buffers, _warp=self.warp
        )

    def _need_frame(self) -> DeviceFrame:
        if self._current is None:
            raise GffeError("extrapolate: submit a rendered frame first")
        return self._current

    # ---- looking inside --------------------------------------------------------------------------------

    def named_buffers(self) -> Iterator[tuple[Stage, BufferSpec]]:
        """Every named buffer of every stage that works on the present frame; read one with `stage.read(spec.name)`."""
        for stage in self.stages:
            if stage is self.presentation and not self._needs_presentation:
                continue
            for spec in stage.buffers:
                yield stage, spec

    def take_timings(self) -> dict[str, float]:
        """Milliseconds of kernel time per stage since the last call (waits for the device); with shading correction
        "network" is the wall time in the network."""
        self.device.queue.finish()
        timings = {stage.name: stage.take_milliseconds() for stage in self.stages}
        return timings | ({"network": self.correction.take_network_milliseconds()} if self.correction else {})


def _as_buffer(array: Any) -> cl.Buffer | None:
    if isinstance(array, cl.Buffer):
        return array
    if isinstance(array, cl.array.Array):
        if array.offset or not array.flags.c_contiguous:
            raise GffeError("frame: device arrays must be C-contiguous and start at offset 0 of their buffer")
        return array.base_data
    return None
