"""Order of the stages, and state between frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from threading import RLock
from typing import Any

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError, Unique
from gffe_cl.engine.core.validation import (
    require_bool,
    require_exposure,
    require_frame_rate,
    require_kind,
    require_list,
    require_number,
    require_size,
)
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.frame_format import FrameFormat, require_render_size
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame
from gffe_cl.engine.opencl.device import Device, adopted_events, marker, wait_for_all
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.frames import DisplayedFrames, RenderedFrames, checked_moment
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame, PresentedFrame
from gffe_cl.engine.pipeline.outputs import Outputs, board_of
from gffe_cl.engine.pipeline.turns import pipeline_call
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import LEAST_ALIGNMENT, BufferSpec, Owner, Sizes
from gffe_cl.engine.stages.commands import milliseconds_of
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.intake import Intake
from gffe_cl.engine.stages.measures import SceneCuts
from gffe_cl.engine.stages.memory import footprint, require_room


class Pipeline(Unique):
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
        Factor on color before display, 1e-6 to 1e6; may change from frame to frame. It counts from the next `submit`
        on. Colors are mixed and corrected as bright as they are displayed: colors four times as bright need a quarter
        of the exposure, and then give the same frames, four times as bright.
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
        self.turn = RLock()  # of the thread that calls
        target = require_size((width, height), "pipeline: size", whole=True)
        source = target if render_size is None else require_size(render_size, "pipeline: render_size", whole=True)
        self.sizes = Sizes(source, target, max(LEAST_ALIGNMENT, device.alignment))
        self.options = Options() if options is None else require_kind(options, Options, "pipeline: options", "Options")
        self.format = format
        self.fps = require_frame_rate(fps, "pipeline: fps")
        forced = int64_atomics
        self._int64_atomics = None if forced is None else require_bool(forced, "pipeline: int64_atomics")
        self._exposure = 1.0
        # Called with each submitted frame, and whether the one before was found to be a cut. It must not raise.
        self.watcher: Callable[[Pipeline, RenderedFrame, bool], None] | None = None
        self.intake = Intake(device, self.sizes)
        self._begin(self.options)

    def _begin(self, options: Options) -> None:
        """Allocate buffers for `options`, and drop all frames. Raises GffeError if memory is short; then nothing has
        changed."""
        require_room(self.device, self.sizes, lambda sizes: self._allocate(sizes, options)[1:])
        self.board, self._nbytes, _ = self._allocate(self.sizes, options)
        self.options = options
        self.stages: dict[str, Any] = dict(self.board.stages)
        self._correction: ShadingCorrection | None = self.stages.get(ShadingCorrection.name)
        self._outputs = Outputs(self.board, self.stages)
        self.frames = RenderedFrames(self.board, self.fps)
        self.display = DisplayedFrames(self.board, self.frames)
        self.intake.begin(self.board)
        self._is_cut: bool | None = False  # None: to be decided by the samples that the device counts

    @pipeline_call
    def _allocate(self, sizes: Sizes, options: Options) -> tuple[Board, int, int]:
        """Return all stages on a new board with their buffers, and how many bytes these and the largest of them are."""
        before = self.device.allocated
        board = board_of(self.device, sizes, options, self._int64_atomics)
        largest = max(buffer.size for stage in board.stages.values() for buffer in stage.buffer.values())
        return board, self.device.allocated - before, largest

    def __del__(self):
        if (intake := getattr(self, "intake", None)) and intake.reads_arrays:
            with suppress(cl.Error, GffeError):
                self.device.queue.finish()  # the memory of arrays must not go before
        if board := getattr(self, "board", None):
            board.let_go()

    @pipeline_call
    def change_options(self, options: Options) -> None:
        """Work with other options. Requests of `keep` are forgotten; sizes stay; `bad_pixels` and `copied_bytes` go on.

        They count from the next `submit` on, which must come before the next `extrapolate`: buffers are allocated
        again, and earlier frames are dropped, as after a reset. History and background fill up again. Frames that were
        returned earlier keep their content.

        Raises GffeError for anything but `Options`, and where old and new buffers do not fit beside each other; the
        pipeline is then as it was before.
        """
        require_kind(options, Options, "change_options: options", "Options")
        before = self.board
        self._begin(options)
        before.let_go()

    def _footprint(self) -> str:
        return footprint(self.device, self.sizes, getattr(self, "_nbytes", None))

    @property
    def exposure(self) -> float:
        """Factor on color before display, 1e-6 to 1e6. Raises GffeError for others. Set it before `submit`; the frame
        keeps it, and so do new frames made from it."""
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
        return self.intake.bad_pixels

    @property
    def copied_bytes(self) -> int:
        """Bytes written so far for submitted NumPy arrays of color, depth and motion, by conversions to other types and
        layouts, on the host and on the device, and by copies to devices with memory of their own. Arrays that are used
        in place (`zero_copy`) and device buffers count nothing."""
        return self.intake.copied_bytes

    # ---- rendered frames -------------------------------------------------------------------------------

    @pipeline_call
    def submit(
        self, frame: RenderedFrame, *, wait_for: Iterable[cl.Event | int] = (), zero_copy: bool = False
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
        if not isinstance(frame, RenderedFrame):
            require_kind(frame, RenderedFrame, "frame")
        events = adopted_events(wait_for, self.device.context, "submit: wait_for")
        if not frame.reset:
            self.frames.require_later(frame.time)
        self._decide_cut()
        was_cut = bool(self._is_cut)
        wait_for_all(self.device.queue, events)
        board, frames = self.board, self.frames
        before = frames.previous, frames.current
        previous, exposure = None if frame.reset else frames.current, self._exposure
        taken = self.intake.take(
            frame, previous, frames.times, format=self.format, exposure=exposure, zero_copy=zero_copy
        )
        frames.take(taken, frame.reset, exposure)
        board.swap()
        board.bindings.show(taken, frames.previous)
        worked = self._take_rendered()
        self._is_cut = None if SceneCuts.name in self.stages and frames.previous else False
        self.display.prepare()
        done = worked or marker(self.device.queue)
        self.intake.leave(done, before)
        if self.watcher:
            self.watcher(self, frame, was_cut)
        return done

    def _take_rendered(self) -> cl.Event | None:
        """Enqueue the stages' work on the current frame. Returns the event of `Board.perform`."""
        return self.board.perform(self.frames.step(), self.stages.values())

    def _decide_cut(self) -> None:
        """Decide whether the current frame is a cut, and work on it again as on a reset if it is."""
        if self._is_cut is None:
            self._is_cut = self.stages[SceneCuts.name].is_cut()
            if self._is_cut:
                self.intake.leave(marker(self.device.queue), self.frames.previous)
                self.frames.forget()
                self.board.bindings.show(self.frames.needed, None)
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
        frame = self.frames.needed
        events = adopted_events(wait_for, self.device.context, "present: wait_for")
        self._decide_cut()
        wait_for_all(self.device.queue, events)
        picture = self._outputs.picture("rendered")
        color, depth, motion = self.display.show(with_color=picture is None)
        color = picture or color
        if composition := self.intake.overlaid:
            color = composition.compose(color, 0.0, rendered=True)
        return PresentedFrame(
            frame.display_camera,
            frame.time,
            color,
            depth=depth,
            motion=motion,
            _device=self.device,
            _size=self.sizes.target,
            event=marker(self.device.queue),
        )

    @property
    def shown_camera(self) -> Camera:
        """The display camera of the last submitted frame. Raises GffeError before the first `submit`."""
        return self.frames.needed.display_camera

    # ---- extrapolated frames ---------------------------------------------------------------------------

    @property
    @pipeline_call
    def interval(self) -> float:
        """Seconds between the last two rendered frames; 1/fps after a reset."""
        self._decide_cut()
        return self.frames.interval

    @pipeline_call
    def predict_camera(self, alpha: float) -> Camera:
        """Return the predicted camera C̄ at t + α, from the last display cameras (`predict_camera_at`); after a reset
        the last one itself. Raises GffeError before the first `submit`, or if `alpha` is not a finite number."""
        _ = self.frames.needed
        self._decide_cut()
        return self.frames.predicted_camera(require_number(alpha, "predict_camera: alpha"))

    @pipeline_call
    def extrapolate(
        self,
        camera: Camera | None = None,
        time: float | None = None,
        *,
        wait_for: Iterable[cl.Event | int] = (),
    ) -> ExtrapolatedFrame:
        """Make the frame at `time` (seconds; default: half an interval ahead) seen by `camera` (default: the predicted
        camera), and return it. Live programs pass their newest camera, read just before. The call returns at once,
        unless onnxruntime runs the shading correction network: then it waits for the network. Reading a buffer waits.
        With the time of the rendered frame itself and a newer camera it is a late warp (α = 0). It overwrites the last
        frame made: `wait_for` its readers on other queues.

        Warns if the time is more than 16 intervals after the last rendered frame's: mostly it is of another clock or
        unit.

        Raises GffeError before the first `submit`, for a time before the last rendered frame's or over a million
        intervals after it, and for arguments of other types or shapes, or events that cannot be waited for.
        """
        events = adopted_events(wait_for, self.device.context, "extrapolate: wait_for")
        board, frames = self.board, self.frames
        self._decide_cut()
        step = checked_moment(camera, time, frames)
        wait_for_all(self.device.queue, events)
        keep = self._outputs.keep if self._outputs.kept else None
        worked = self.board.perform(step, self.stages.values(), keep)
        frames.note_made(step)
        gae, depth, motion, dynamic, disoccluded, filled_by = self.board.frame.buffer.values()
        color = self._outputs.picture("extrapolated") or gae
        if composition := self.intake.overlaid:
            color, worked = composition.compose(color, step.alpha), None
        assert step.camera is not None
        return ExtrapolatedFrame(
            step.camera,
            step.time,
            color,
            depth=depth,
            motion=motion,
            dynamic=dynamic,
            disoccluded=disoccluded,
            filled_by=filled_by,
            gae=gae,
            expected_error=board.buffer("shading", "expected_error") if board.options.expected_error else None,
            alpha=step.alpha,
            source_time=step.frame.time,
            _device=self.device,
            _size=self.sizes.target,
            event=worked or marker(self.device.queue),
        )

    # ---- looking inside --------------------------------------------------------------------------------

    @pipeline_call
    def named_buffers(self) -> Iterator[tuple[Owner, BufferSpec]]:
        """Return every named buffer that holds the present frame, with its owner: `owner.read(spec.name)` reads it, and
        its name is "<owner.name>.<spec.name>".

        A stage's own result in the buffers of the extrapolated frame ("warp.color": before the background filled
        anything) is among them once `keep` asked for it.
        """
        self._decide_cut()
        return iter([*self._outputs.held([self.display.resampling, self.intake.overlaid])])

    def conversions(self) -> Iterator[tuple[Owner, BufferSpec, tuple[int, int]]]:
        """Return the buffers in which depth and motion of the last rendered frame were before they got the size of
        color, or before dilation was undone: owner, description, and width and height. Nothing else is among them."""
        return self.intake.conversions(self.format)

    def outputs(self) -> Iterator[tuple[str, BufferSpec]]:
        """Return the results that `keep` can keep: the stages' names, and the buffers of the extrapolated frame that
        each writes and another one writes too."""
        return self._outputs.available()

    @pipeline_call
    def keep(self, names: Iterable[str] | None = None) -> None:
        """Keep the outputs `names`, such as "warp.color" (None: all), from the next frame on, and no others. Outputs
        that no stage needs ("correction.refined", "shading.…") are only computed if they are among them. Names of other
        buffers are ignored. Raises GffeError for anything but a collection of texts."""
        wanted = None if names is None else set(require_list(names, str, "keep: names", "a list of texts"))
        self._outputs.choose(wanted)

    @pipeline_call
    def take_timings(self) -> dict[str, float]:
        """Return milliseconds of kernel time per stage since the last call (waits for the device). If
        onnxruntime runs the network, "network" is the wall time there, "network copies" that of copies there and back.

        Raises GffeError where the device's queue has no profiling: open the device with `profiling=True`.
        """
        return {stage: sum(kernels.values()) for stage, kernels in self._taken_timings("take_timings").items()}

    @pipeline_call
    def take_kernel_timings(self) -> dict[str, dict[str, float]]:
        """Return milliseconds of kernel time by stage and kernel since the last call (waits for the device), as
        `take_timings` does by stage."""
        return self._taken_timings("take_kernel_timings")

    def _taken_timings(self, what: str) -> dict[str, dict[str, float]]:
        if not self.device.profiles:
            raise GffeError(
                f"{what}: the device's queue has no profiling (expected open_device(profiling=True), or such a queue)"
            )
        self.device.queue.finish()
        taken, correction = milliseconds_of(self.board.commands.take_events()), self._correction
        others = filter(None, (self.display.presentation, self.intake.composition))
        names = [*self.stages, *(stage.name for stage in others)]
        network = correction.take_network_milliseconds() if correction else {}
        return {name: taken.get(name, {}) for name in names} | {name: {name: ms} for name, ms in network.items()}
