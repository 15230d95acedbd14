"""Order of the stages, and state between frames."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import (
    as_float32,
    require_array,
    require_bool,
    require_exposure,
    require_frame_rate,
    require_kind,
    require_list,
    require_number,
    require_size,
    shown,
)
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.camera_prediction import POSES, predict_camera_at
from gffe_cl.engine.frame.frame_format import FrameFormat, conversion, jitter_in_color, require_render_size
from gffe_cl.engine.frame.intervals import FAR_ALPHA, MOST_ALPHA, interval_of
from gffe_cl.engine.frame.rendered_frame import (
    BadPixels,
    HostArrays,
    RenderedFrame,
    is_shown_whole,
)
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.handles import adopted_events
from gffe_cl.engine.options import MAX_ORDER, Options
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame, PresentedFrame
from gffe_cl.engine.pipeline.turns import Turns, pipeline_call
from gffe_cl.engine.pipeline.watching import Watcher
from gffe_cl.engine.stages.acceleration import Acceleration
from gffe_cl.engine.stages.background import Background
from gffe_cl.engine.stages.backward_blocks import BackwardBlocks
from gffe_cl.engine.stages.base import Board, Output, Stage, Step
from gffe_cl.engine.stages.buffers import LEAST_ALIGNMENT, RENDERED, BufferSpec, DeviceFrame, Owner, Sizes
from gffe_cl.engine.stages.color_code import ColorCode
from gffe_cl.engine.stages.composition import Composition
from gffe_cl.engine.stages.connectivity import Connectivity
from gffe_cl.engine.stages.convolutions import Convolutions
from gffe_cl.engine.stages.correction import INPUTS, ShadingCorrection
from gffe_cl.engine.stages.dilated_warp import DilatedWarp
from gffe_cl.engine.stages.frame_block import MOST_NUMBER, MOST_RESTS, see_alike
from gffe_cl.engine.stages.hidden_parts import HiddenParts
from gffe_cl.engine.stages.history import HistoryTracking
from gffe_cl.engine.stages.holes import FILLINGS, HoleFilling
from gffe_cl.engine.stages.intake import PreparedFrame, prepare
from gffe_cl.engine.stages.memory_budget import footprint, require_room
from gffe_cl.engine.stages.network_input import NetworkInput
from gffe_cl.engine.stages.prediction import PositionPrediction
from gffe_cl.engine.stages.presentation import Presentation
from gffe_cl.engine.stages.scene_cuts import SceneCuts
from gffe_cl.engine.stages.shading import ShadingInputs
from gffe_cl.engine.stages.shading_flow import ShadingFlow
from gffe_cl.engine.stages.shading_trend import ShadingTrend
from gffe_cl.engine.stages.silhouettes import Silhouettes
from gffe_cl.engine.stages.upload import Upload
from gffe_cl.engine.stages.upscaling import Upscaling
from gffe_cl.engine.stages.user_interface import UserInterface
from gffe_cl.engine.stages.warp import Warp

# In the order in which they work, on rendered frames and on new ones.
STAGES: tuple[type[Stage], ...] = (
    UserInterface,
    SceneCuts,
    HistoryTracking,
    Acceleration,
    Connectivity,
    PositionPrediction,
    BackwardBlocks,
    ColorCode,
    Warp,
    DilatedWarp,
    HiddenParts,
    Background,
    HoleFilling,
    Silhouettes,
    ShadingInputs,
    NetworkInput,
    ShadingTrend,
    ShadingFlow,
    Convolutions,
    ShadingCorrection,
    Upscaling,
)


def stages_of(options: Options) -> list[type[Stage]]:
    """Return the stages that the options ask for, in order."""
    chosen = (FILLINGS[options.hole_filling] if stage is HoleFilling else stage for stage in STAGES)
    wanted = [stage for stage in chosen if stage and stage.is_wanted(options)]
    return [stage for stage in wanted if options.warps_footprints or not stage.needs_footprints]


class Pipeline:
    """Extrapolates frames from the rendered frames submitted so far.

    Parameters
    ----------
    device : Device
    width, height : int
        Size of the extrapolated (display) image, pixels.
    options : Options
    render_size : (int, int) or None
        Width and height of the rendered images where they differ from the display's.
    format : FrameFormat or None
        Description of the buffers of rendered frames where they differ from the conventions of `RenderedFrame`.
    fps : float
        Rendered frames per second, used for α until two frames are known.
    int64_atomics : bool or None
        Force or forbid the 64-bit path of the warp; None: chosen by the device. Both give the same bits.

    Attributes
    ----------
    exposure : float
        Factor on color before display, 1e-6 to 1e6, for the shading correction network; may change from frame to
        frame.
    format : FrameFormat or None
        Description of the buffers of rendered frames. It may change from frame to frame.
    is_cut : bool
        Whether the last submitted frame was detected as an unmarked cut: it is treated as a reset.

    Raises
    ------
    GffeError
        For invalid arguments, and for images that do not fit on the device.

    Notes
    -----
    Nothing is allocated on the device or compiled after construction, but for the first uploads of host arrays, the
    first frame in another format and the first that is rendered through a window, brings overlays, or lacks motion
    beside device buffers. Device buffers must have been written on `device.queue`, or be finished, before they are
    submitted, or the events of their writers must be in `wait_for`. Do not submit a released buffer: it cannot be
    detected, and drivers crash on it.

    One thread at a time uses a pipeline, and may hand it over to another one between calls: a call during that of
    another thread raises GffeError. Frames that were made may be read on any thread, until the next one is made.

    `wait_for` of `submit`, `present` and `extrapolate` are events, pyopencl's or integer handles (`cl_event`), of the
    device's context: the work of the call begins when they are complete. Other queues can wait for the event that
    `submit` returns and for `event` of the frames made: the device's queue has been flushed by then.
    """

    def __init__(
        self,
        device: Device,
        width: int,
        height: int,
        options: Options | None = None,
        *,
        render_size: tuple[int, int] | None = None,
        format: FrameFormat | None = None,
        fps: float = 30.0,
        int64_atomics: bool | None = None,
    ):
        self.device = require_kind(device, Device, "pipeline: device", "an open Device (open_device())")
        self.turns = Turns()
        target = require_size((width, height), "pipeline: size", whole=True)
        source = target if render_size is None else require_size(render_size, "pipeline: render_size", whole=True)
        self.sizes = Sizes(source, target, max(LEAST_ALIGNMENT, device.alignment))
        self.options = Options() if options is None else require_kind(options, Options, "pipeline: options", "Options")
        self.format = format
        self.fps = require_frame_rate(fps, "pipeline: fps")
        if int64_atomics is not None:
            int64_atomics = require_bool(int64_atomics, "pipeline: int64_atomics")
        self._exposure = 1.0
        self._bad_pixels = BadPixels()  # without those that the stage `upload` still has
        self._copied_bytes = 0  # without the copies of the stage `upload`
        self._int64_atomics = int64_atomics
        self.watcher: Watcher | None = None
        self._slots: list[DeviceFrame] = []
        self._leaving: list[tuple[cl.Event, Any]] = []  # frames that the device may still read until an event
        self._reads_arrays = False  # whether NumPy arrays were used in place
        self._no_motion: cl.Buffer | None = None  # zeros, made with the first device buffers without motion
        self._begin(self.options)

    def _begin(self, options: Options) -> None:
        """Allocate buffers for `options`, and drop all frames. Raises GffeError if memory is short; then nothing has
        changed."""
        require_room(self.device, self.sizes, lambda sizes: self._allocate(sizes, options)[1])
        self.board, self._nbytes = self._allocate(self.sizes, options)
        self.options = options
        self.stages: dict[str, Any] = dict(self.board.stages)
        self.presentation: Presentation | None = None  # made with the first windowed frame
        self._upload: Upload | None = None  # made with the first NumPy arrays
        self._geometry_size = self.sizes.source  # of depth and motion of the last frame, as they were given
        self.composition: Composition | None = None  # made with the first frame that brings overlays
        self._outputs: dict[str, Output] = {}  # kept outputs of each stage
        self._current: DeviceFrame | None = None
        self._previous: DeviceFrame | None = None
        self._shown: DeviceFrame | None = None  # the current one with all of its depth
        self._times: list[float] = []  # of rendered frames since the last reset, newest first
        self._path: list[Camera] = []  # their cameras
        # Members of the frame block: the rendered frame's number, for how many intervals its camera has been the same,
        # and whether all of its colors are encoded.
        self._rest = {"number": 0, "rests": 0, "coded": 0}
        self._is_cut: bool | None = False  # None: to be decided by the samples that the device counts

    @pipeline_call
    def _allocate(self, sizes: Sizes, options: Options) -> tuple[Board, int]:
        """Return all stages on a new board with their buffers, and how many bytes these are."""
        before = self.device.allocated
        board = Board(self.device, sizes, options, self._int64_atomics)
        try:
            for stage in stages_of(options):
                stage(board)
            board.memory.place(board.turn)
            _ = board.frame  # made when it is first asked for
        except BaseException:
            board.let_go()
            raise
        return board, self.device.allocated - before

    def __del__(self):
        if getattr(self, "_reads_arrays", False):
            with suppress(cl.Error, GffeError):
                self.device.queue.finish()  # the memory of arrays must not go before
        if board := getattr(self, "board", None):
            board.let_go()

    @pipeline_call
    def change_options(self, options: Options) -> None:
        """Work with other options from the next `submit` on, which must come before the next `extrapolate`.

        Buffers are allocated again, and earlier frames are dropped, as after a reset: history and background fill up
        again. Requests of `keep` are forgotten. Sizes stay; `bad_pixels` and `copied_bytes` go on. Frames that were
        returned earlier keep their content.

        Raises GffeError for anything but `Options`, and where old and new buffers do not fit beside each other; the
        pipeline is then as it was before.
        """
        require_kind(options, Options, "change_options: options", "Options")
        self._finish()
        before, counted = self.board, (self.bad_pixels, self.copied_bytes)
        self._begin(options)
        self._bad_pixels, self._copied_bytes = counted
        before.let_go()

    def _footprint(self) -> str:
        return footprint(self.device, self.sizes, getattr(self, "_nbytes", None))

    @property
    def exposure(self) -> float:
        """Factor on color before display, 1e-6 to 1e6. Raises GffeError for others. Set it before `submit`, which
        measures how shading changed between rendered frames."""
        return self._exposure

    @exposure.setter
    def exposure(self, value: float) -> None:
        self._exposure = require_exposure(value, "pipeline: exposure")

    @property
    def format(self) -> FrameFormat | None:
        """Description of the buffers of rendered frames, None if they have the conventions of `RenderedFrame`. Set it
        before `submit`. Raises GffeError for other values, for color of another size than the render size, and for
        depth and motion that are larger or much smaller."""
        return self._format

    @format.setter
    def format(self, value: FrameFormat | None) -> None:
        if value is not None:
            require_kind(value, FrameFormat, "pipeline: format", "a FrameFormat or None")
            require_render_size(value, self.sizes.source)
        self._format = value

    @property
    @pipeline_call
    def bad_pixels(self) -> BadPixels:
        """Bad pixels of all NumPy arrays, and of buffers that were converted from a `format`, submitted so far. Waits
        for the device, which counts them."""
        if self._upload:
            self._bad_pixels += self._upload.take_bad_pixels()
        return self._bad_pixels

    @property
    def copied_bytes(self) -> int:
        """Bytes written so far for submitted NumPy arrays of color, depth and motion, by conversions to other types and
        layouts, on the host and on the device, and by copies to devices with memory of their own. Arrays that are used
        in place (`zero_copy`) and device buffers count nothing."""
        return self._copied_bytes + (self._upload.copied_bytes if self._upload else 0)

    # ---- rendered frames -------------------------------------------------------------------------------

    @pipeline_call
    def submit(
        self,
        frame: RenderedFrame,
        *,
        wait_for: Iterable[cl.Event | int] = (),
        zero_copy: bool = False,
    ) -> cl.Event:
        """Take a rendered frame and return the event that is complete when the work on it is done. Frames must come in
        order of time.

        Arrays may be NumPy arrays (copied to the device; bad pixels are added to `bad_pixels`) or device buffers, which
        are used in place: do not overwrite them before two more frames have been submitted and, from another queue or
        from the host, before the event of the second `submit` is complete. The call returns at once, but on CPUs waits
        where it copies NumPy arrays.

        Whether the frame is an unmarked cut is decided when the next frame is made, or `is_cut` is read. The host then
        waits for the first work on this frame, which counts samples, and not for the rest. The work on a cut is
        repeated, as on a reset.

        Buffers that `format` describes differently are converted before the work on the frame; they may be overwritten
        when the event of this `submit` is complete.

        `zero_copy`: on CPUs, use NumPy arrays in place as well, with the same promise not to overwrite them. They must
        have the layout of device buffers (color (H, W, 4) float16, depth float32, motion (H, W, 2) float32;
        C-contiguous) and begin at a multiple of `device.alignment`, as arrays of `device.empty` do. Depth and motion
        are used in place both or neither. Bad pixels of arrays in place are not counted. Other arrays, and all with a
        `format`, are copied: `copied_bytes` counts them.

        Raises GffeError for fields that do not match `RenderedFrame`, wrong shapes, missing motion, a time that
        does not increase, or events that cannot be waited for; the pipeline is then as it was before.
        """
        prepared = prepare(frame, self.sizes, self.device, bool(self.options.upscale), self.format)
        frame, zero_copy = prepared.frame, require_bool(zero_copy, "submit: zero_copy")
        events = adopted_events(wait_for, self.device.context, "submit: wait_for")
        if self._times and not frame.reset and frame.time <= self._times[0]:
            raise GffeError(
                f"frame: time {frame.time:g} s must be after the previous rendered frame's ({self._times[0]:g} s)"
            )
        if self.watcher:
            self.watcher.before(self, rendered=True)
        self._settle()
        self._decide_cut()
        self._wait(events)
        before = self._previous, self._current
        overlays = frame.overlays if self.options.overlays else None
        detection = self.stages.get(UserInterface.name)
        if (overlays or detection) and self.composition is None:
            self.composition = Composition(self.board)
        layers = self.composition.prepared(overlays) if self.composition else {}
        shown_before = None if frame.reset else self._shown
        self._shown = on_device = self._on_device(prepared, zero_copy)
        if detection:
            layers = detection.found(layers, on_device, shown_before, self.exposure)
        if self.composition:
            on_device = self.composition.take(layers, on_device)
        self._previous = None if frame.reset else self._current
        self._current = on_device
        self._count_rest()
        if frame.reset:
            self._times.clear()
            self._path.clear()
        self._times = [frame.time, *self._times[: POSES - 1]]
        self._path = [on_device.display_camera, *self._path[: POSES - 1]]
        for stage in self.stages.values():
            stage.swap()
        self.board.memory.place(self.board.turn)
        self._take_rendered()
        self._is_cut = None if SceneCuts.name in self.stages and self._previous else False
        if self.presentation is None and not self._shown_whole(on_device):
            self.presentation = Presentation(self.board)
        done = self._done()
        complete = cl.command_execution_status.COMPLETE
        self._leaving = [one for one in self._leaving if one[0].command_execution_status > complete]
        self._leaving.append((done, before))
        if self.watcher:
            self.watcher.submitted(self, frame, self._shown)
        return done

    def _count_rest(self) -> None:
        """Number the current frame, and count the intervals for which the rendered camera has been the same. While it
        moves, history tracking encodes all colors."""
        frame, previous, rests = self._current, self._previous, 0
        assert frame is not None
        if previous and self.options.motion and see_alike(previous.camera, frame.camera):
            rests = min(self._rest["rests"] + 1, MOST_RESTS)
        self._rest = {"number": self._rest["number"] % MOST_NUMBER + 1, "rests": rests, "coded": int(not rests)}

    def _rest_of(self, camera: Camera, is_replaced: bool) -> dict[str, int]:
        """Return `_rest`, and whether points at rest stay where they are for a new `camera`: then not all colors are
        encoded. `is_replaced`: predicted positions are the caller's."""
        copies = self.board.facts.get("copies") and self.sizes.source == self.sizes.target and not is_replaced
        stays = bool(copies and self._previous and see_alike(self._need_frame().camera, camera))
        return self._rest | {"stays": stays}

    def _take_rendered(self) -> None:
        """Enqueue the stages' work on the current frame."""
        self.board.rendered, self.board.previous = self._current, self._previous or self._current
        assert self._current is not None
        step = Step(self._current, self._previous, self._recent_times, exposure=self.exposure, given=self._rest.copy())
        for stage in self.stages.values():
            stage.rendered(step)

    def _decide_cut(self) -> None:
        """Decide whether the current frame is a cut, and work on it again as on a reset if it is."""
        if self._is_cut is None:
            self._is_cut = self.stages[SceneCuts.name].is_cut()
            if self._is_cut:
                self._leaving.append((self._done(), self._previous))
                del self._times[1:], self._path[1:]
                self._previous, self._rest["rests"] = None, 0
                self._take_rendered()

    @property
    @pipeline_call
    def is_cut(self) -> bool:
        """Whether the last submitted frame was detected as an unmarked cut, and so is treated as a reset. Waits until
        the device has compared it with the frame before."""
        self._decide_cut()
        return bool(self._is_cut)

    @pipeline_call
    def present(self, *, wait_for: Iterable[cl.Event | int] = ()) -> PresentedFrame:
        """Return the last submitted frame as displayed. It is resampled where it was rendered through a window, or
        where the frame before was and motion must be converted. Returns at once. Raises GffeError before the first
        `submit`, and for events that cannot be waited for."""
        self._need_frame()
        events = adopted_events(wait_for, self.device.context, "present: wait_for")
        self._settle()
        self._decide_cut()
        self._wait(events)
        frame, picture = self._shown, self._picture("rendered")
        assert frame is not None  # as there is a current one
        if self._needs_presentation:
            assert self.presentation is not None  # `submit` has made it
            self.presentation.present(frame, self._previous, with_color=picture is None)
            color, depth, motion = (self.presentation.buffer[name] for name in ("color", "depth", "motion"))
        else:
            color, depth, motion = frame.buffers
        color = picture or color
        if composition := self._overlaid:
            color = composition.compose(color, 0.0, rendered=True)
        where = self.device, self.sizes.target
        return PresentedFrame(frame.display_camera, frame.time, color, depth, motion, *where, _event=self._done())

    def _wait(self, events: list[cl.Event]) -> None:
        """Make all later commands wait for `events`."""
        if events:
            cl.enqueue_barrier(self.device.queue, wait_for=events)

    def _done(self) -> cl.Event:
        """Return an event that is complete when all work enqueued so far is; other queues can wait for it."""
        event = cl.enqueue_marker(self.device.queue)
        self.device.queue.flush()
        return event

    @property
    def shown_camera(self) -> Camera:
        """The display camera of the last submitted frame. Raises GffeError before the first `submit`."""
        return self._need_frame().display_camera

    @property
    def _overlaid(self) -> Composition | None:
        return self.composition if self.composition and self.composition.active else None

    @property
    def _needs_presentation(self) -> bool:
        return any(frame and not self._shown_whole(frame) for frame in (self._current, self._previous))

    def _shown_whole(self, frame: DeviceFrame) -> bool:
        return self.sizes.source == self.sizes.target and is_shown_whole(frame.camera, frame.display_camera)

    def _on_device(self, prepared: PreparedFrame, zero_copy: bool) -> DeviceFrame:
        frame, host, self._geometry_size = prepared.frame, prepared.arrays, prepared.geometry
        seen = {
            "camera": frame.camera,
            "display_camera": prepared.display_camera,
            "time": frame.time,
            "geometry_jitter": jitter_in_color(frame.geometry_jitter, self.sizes.source, prepared.geometry),
        }
        if host is None:
            return self._on_device_already(prepared, seen)
        if self._upload is None:
            self._upload = Upload(self.board)
        self._count_conversions(frame, host)
        if prepared.format:
            taken = DeviceFrame(**self._slot(seen), **seen)
            step, is_dilated = self._conversion(prepared, taken), prepared.format.motion_dilated
            self._upload.take(host, taken, step=step, is_dilated=is_dilated)
            return taken
        shared = self._upload.shared(host) if zero_copy else {}
        self._reads_arrays |= bool(shared)
        buffers = dict(shared) if len(shared) == len(RENDERED) else self._slot(seen) | shared
        taken = DeviceFrame(**buffers, **seen)
        self._upload.take(host, taken, shared)
        return taken

    def _on_device_already(self, prepared: PreparedFrame, seen: Mapping[str, Any]) -> DeviceFrame:
        """Return the frame of device buffers: with the buffers themselves, or converted ones."""
        given = prepared.buffers
        ours = prepared.format.is_ours if prepared.format else {"color": True, "geometry": True}
        ours["geometry"] &= prepared.geometry == self.sizes.source
        converted = {n: b for n, b in given.items() if not ours["color" if n == "color" else "geometry"]}
        if not converted:
            return DeviceFrame(**({} if "motion" in given else {"motion": self._zero_motion()}) | given, **seen)
        if self._upload is None:
            self._upload = Upload(self.board)
        own = self._slot(seen)
        kept = given.keys() - converted.keys()
        buffers = own | {name: given[name] for name in kept}
        if "depth" in kept and "motion" not in given:
            buffers["motion"] = self._zero_motion()
        taken = DeviceFrame(**buffers, **seen)
        assert prepared.format is not None  # else nothing is converted
        self._upload.convert(converted, taken, self._conversion(prepared, taken), prepared.format.motion_dilated)
        return taken

    def _conversion(self, prepared: PreparedFrame, taken: DeviceFrame) -> Step:
        """Return the step with the numbers that convert a frame into the buffers of `taken`."""
        previous = None if prepared.frame.reset else self._current
        jitters = taken.geometry_jitter, previous.geometry_jitter if previous else taken.geometry_jitter
        assert prepared.format is not None  # as it is only called with one
        told = prepared.types, prepared.channels
        given = conversion(prepared.format, self.sizes.source, *told, *jitters, prepared.geometry)
        return Step(taken, previous, [taken.time, *self._times], given=given)

    def _slot(self, seen: Mapping[str, Any]) -> dict[str, cl.Buffer]:
        """Return the buffers for a frame of NumPy arrays, by name. Two sets of them are used in turn."""
        if len(self._slots) < 2:
            motion = self._slots[0].motion if self._slots else None  # nothing reads that of the frame before
            self._slots.append(DeviceFrame.allocate(self.device, self.sizes.source, **seen, motion=motion))
        else:
            self._slots.append(self._slots.pop(0))
        return {spec.name: getattr(self._slots[-1], spec.name) for spec in RENDERED}

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

    # ---- extrapolated frames ---------------------------------------------------------------------------

    @property
    def _recent_times(self) -> list[float]:
        """Times of the rendered frames that stages use, in seconds."""
        return self._times[: MAX_ORDER + 1]

    @property
    @pipeline_call
    def interval(self) -> float:
        """Seconds between the last two rendered frames; 1/fps after a reset."""
        self._decide_cut()
        return self._last_interval

    @property
    def _last_interval(self) -> float:
        return interval_of(self._times, self.fps)

    @pipeline_call
    def predict_camera(self, alpha: float) -> Camera:
        """Return the predicted camera C̄ at t + α, from the last display cameras (`predict_camera_at`); after a reset
        the last one itself. Raises GffeError before the first `submit`, or if `alpha` is not a finite number."""
        self._need_frame()
        self._decide_cut()
        return self._predicted_camera(require_number(alpha, "predict_camera: alpha"))

    def _predicted_camera(self, alpha: float) -> Camera:
        time = self._times[0] + alpha * self._last_interval
        return predict_camera_at(time, self._path, self._times, self.options.camera_order)

    @pipeline_call
    def extrapolate(
        self,
        camera: Camera | None = None,
        time: float | None = None,
        *,
        wait_for: Iterable[cl.Event | int] = (),
        target_position: np.ndarray | None = None,
        seen_through: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> ExtrapolatedFrame:
        """Make the frame at `time` (seconds; default: half an interval ahead) seen by `camera` (default: the predicted
        camera), and return it. The call returns at once, unless the shading correction network works on the device's
        own processor: then it waits for the network. Otherwise the frame's `color` and `event` wait, and the next
        `submit` works meanwhile. Reading a buffer waits. With the time of the rendered frame itself and a newer camera
        it is a late warp (α = 0). It overwrites the last frame made: `wait_for` its readers on other queues.

        `target_position` (H, W, 4) float32 replaces position prediction, for experiments: x, y in target pixels, view
        depth there (−1: nothing), 0, for every pixel of the rendered frame. `seen_through` replaces depth (H, W) and
        motion (H, W, 2) float32 of the new frame, as in `ExtrapolatedFrame`, before upscaling reads them, also for
        experiments.

        Warns if the time is more than 16 intervals after the last rendered frame's: mostly it is of another clock or
        unit.

        Raises GffeError before the first `submit`, for a time before the last rendered frame's or over a million
        intervals after it, and for arguments of other types or shapes, or events that cannot be waited for.
        """
        events = adopted_events(wait_for, self.device.context, "extrapolate: wait_for")
        source = self._need_frame()
        self._decide_cut()
        interval = self._last_interval
        time = source.time + interval / 2 if time is None else require_number(time, "extrapolate: time")
        alpha = (time - source.time) / interval
        if alpha < 0:
            raise GffeError(f"extrapolate: time {time:g} s is before the last rendered frame's ({source.time:g} s)")
        if not alpha <= MOST_ALPHA:
            raise GffeError(
                f"extrapolate: time {time:g} s is more than {MOST_ALPHA:g} intervals after {source.time:g} s"
            )
        if alpha > FAR_ALPHA:  # a program may have stalled: it must not fail
            warnings.warn(
                f"extrapolate: time {time:g} s is {alpha:.0f} intervals after the last rendered frame's (expected up to"
                f" {FAR_ALPHA:g}, in seconds on the clock of the rendered frames)",
                stacklevel=3,
            )
        camera = self._predicted_camera(alpha) if camera is None else camera
        require_kind(camera, Camera, "extrapolate: camera", "a Camera or None")
        if target_position is not None:
            shape = (*reversed(self.sizes.source), 4)
            target_position = as_float32(require_array(target_position, "extrapolate: target_position", *shape))
        replaced = {"target_position": target_position, "geometry": self._geometry(seen_through)}
        if self.watcher:
            self.watcher.before(self)
        replaced["given"] = self._rest_of(camera, target_position is not None)
        step = Step(source, self._previous, self._recent_times, camera, time, alpha, self.exposure, **replaced)
        self._finish()
        self._wait(events)
        correction = self._correction
        beside = {*INPUTS, ShadingCorrection} if correction and self._previous and correction.works_beside else set()
        for stage in self.stages.values():
            if type(stage) in beside:
                continue
            stage.extrapolated(step)
            if stage.name in self._outputs:
                self._outputs[stage.name].keep(self.board.frame.buffer)
        self._rest["coded"] |= not step.given["stays"]
        if beside and correction:
            correction.begin(step)
        made = self.board.frame.buffer
        color = self._picture("extrapolated") or made["color"]
        if composition := self._overlaid:
            self._finish()
            color = composition.compose(color, alpha)
        frame = ExtrapolatedFrame(
            camera,
            time,
            color,
            made["depth"],
            made["motion"],
            self.device,
            self.sizes.target,
            alpha,
            source.time,
            **{name: made[name] for name in ("dynamic", "disoccluded", "filled_by")},
            gae=made["color"],
            _finish=self._unfinished,
            _event=self._done(),
        )
        if self.watcher:
            self.watcher.extrapolated(self, frame)
        return frame

    @property
    def _unfinished(self) -> Callable[[], None] | None:
        """Function that makes the final image of the last frame, if that still waits for the network; else None."""
        correction = self._correction
        return partial(self.turns.read, correction.finish) if correction and correction.is_begun else None

    @property
    def _correction(self) -> ShadingCorrection | None:
        return self.stages.get(ShadingCorrection.name)

    def _settle(self) -> None:
        """Wait until a thread of the network has enqueued its kernels, which belong before all others."""
        if correction := self._correction:
            correction.settle()

    def _finish(self) -> None:
        if finish := self._unfinished:
            finish()

    def _picture(self, occasion: str) -> cl.Buffer | None:
        """Return the result of the last stage that makes a picture on `occasion`, None if no stage does."""
        makers = [stage for stage in self.stages.values() if occasion in stage.pictures]
        return makers[-1].buffer[makers[-1].pictures[occasion]] if makers else None

    def _geometry(self, given: tuple[np.ndarray, np.ndarray] | None) -> dict[str, np.ndarray]:
        """Return depth and motion that replace the new frame's, by name. Raises GffeError for other shapes than
        theirs."""
        if given is None:
            return {}
        if not isinstance(given, tuple | list) or len(given) != 2:
            raise GffeError(f"extrapolate: seen_through must be (depth, motion), got {shown(given)}")
        size, what = tuple(reversed(self.sizes.target)), "extrapolate: seen_through, "
        depth, motion = (
            require_array(given[0], f"{what}depth", *size),
            require_array(given[1], f"{what}motion", *size, 2),
        )
        return {"depth": as_float32(depth), "motion": as_float32(motion)}

    def _need_frame(self) -> DeviceFrame:
        if self._current is None:
            raise GffeError("pipeline: submit a rendered frame first")
        return self._current

    # ---- looking inside --------------------------------------------------------------------------------

    @pipeline_call
    def named_buffers(self) -> Iterator[tuple[Owner, BufferSpec]]:
        """Return every named buffer that holds the present frame, with its owner: `owner.read(spec.name)` reads it, and
        its name is "<owner.name>.<spec.name>". Waits for the network.

        A stage's own result in the buffers of the extrapolated frame ("warp.color": before the background filled
        anything) is among them once `keep` asked for it.
        """
        self._decide_cut()
        self._finish()
        held: list[tuple[Owner, BufferSpec]] = [(self.board.frame, spec) for spec in self.board.frame.buffers]
        for stage in self.stages.values():
            held += ((stage, spec) for spec in stage.buffers if not spec.scratch)
            if output := self._outputs.get(stage.name):
                held += ((output, output.spec(name)) for name in output.buffer)
        if self.presentation and self._needs_presentation:
            held += ((self.presentation, spec) for spec in self.presentation.buffers)
        if composition := self._overlaid:
            held += ((composition, spec) for spec in composition.held())
        return iter(held)

    def conversions(self) -> Iterator[tuple[Owner, BufferSpec, tuple[int, int]]]:
        """Yield the buffers in which depth and motion of the last rendered frame were before they got the size of
        color, or before dilation was undone: owner, description, and width and height. Nothing else is among them."""
        is_small = self._geometry_size != self.sizes.source
        is_dilated = self.format is not None and self.format.motion_dilated
        if self._upload is None or not (is_small or is_dilated):
            return
        for spec in self._upload.buffers:
            if spec.view != "scalar" and spec.name in self._upload.buffer and (is_small or spec.name != "small_depth"):
                yield self._upload, spec, self._geometry_size

    def outputs(self) -> Iterator[tuple[str, BufferSpec]]:
        """Yield the results that `keep` can keep: the stages' names, and the buffers of the extrapolated frame that
        each writes and another one writes too."""
        writers = [(stage.name, name) for stage in self.stages.values() for name in stage.outputs()]
        several = {name for name, count in Counter(name for _, name in writers).items() if count > 1}
        for stage, name in writers:
            if name in several:
                spec = self.board.frame.spec(name)
                yield stage, replace(spec, description=f"{spec.description}, as the stage '{stage}' left it")

    @pipeline_call
    def keep(self, names: Iterable[str] | None = None) -> None:
        """Keep the outputs `names`, such as "warp.color" (None: all), from the next frame on, and no others. Outputs
        that no stage needs ("correction.refined", "shading.…") are only computed if they are among them. Names of other
        buffers are ignored. Raises GffeError for anything but a collection of texts."""
        wanted = None if names is None else set(require_list(names, str, "keep: names", "a list of texts"))
        self._finish()
        for stage in self.stages.values():
            stage.look_at(wanted)
        found: dict[str, list[BufferSpec]] = {}
        for stage, spec in self.outputs():
            found.setdefault(stage, []).append(spec)
        for stage, specs in found.items():
            chosen = {spec.name for spec in specs if wanted is None or f"{stage}.{spec.name}" in wanted}
            if chosen or stage in self._outputs:
                self._outputs.setdefault(stage, Output(self.stages[stage], specs)).choose(chosen)

    @pipeline_call
    def take_timings(self) -> dict[str, float]:
        """Return milliseconds of kernel time per stage since the last call (waits for the device). If
        onnxruntime runs the network, "network" is the wall time there, "network copies" that of copies there and back.
        Where the queue has no profiling (`Device.profiles`) only "network" is there."""
        return {stage: sum(kernels.values()) for stage, kernels in self.take_kernel_timings().items()}

    @pipeline_call
    def take_kernel_timings(self) -> dict[str, dict[str, float]]:
        """Return milliseconds of kernel time by stage and kernel since the last call (waits for the device), as
        `take_timings` does by stage."""
        self._finish()
        self.device.queue.finish()
        stages = [*self.stages.values(), *filter(None, (self.presentation, self.composition))]
        stages = stages if self.device.profiles else []
        timings = {stage.name: stage.take_kernel_milliseconds() for stage in stages}
        correction = self._correction
        network = correction.take_network_milliseconds() if correction else {}
        return timings | {name: {name: milliseconds} for name, milliseconds in network.items()}
