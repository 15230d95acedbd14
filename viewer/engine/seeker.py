"""Bringing the pipeline to any slot: going on from where it is, or warming up a new one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame, host_arrays
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import DeviceFrame, Sizes
from gffe_cl.engine.stages.shading import FocusMask
from gffe_cl.engine.stages.upload import Upload
from . import names
from .buffers import Moment, Shot
from .explain.motion_trail import Passed
from .invalid import invalid_pixels
from .messages import Recipe
from .sources.source import FrameSource

WARM_UP = 8  # rendered frames submitted before the one that is wanted


class Seeker:
    """A pipeline and its position in the sequence. `check` is called before each rendered frame, and may raise to
    stop."""

    def __init__(self, device: Device, source: FrameSource, check: Callable[[], None]):
        self.device, self.source, self._check = device, source, check
        self.cuts: set[int] = set()  # rendered frames that were found to be cuts so far
        self.progress = 0, 0  # rendered frames of the last `go_to` that are submitted, and all of them
        self._options: Options | None = None
        self._versions = ("", "")  # of kernels and weights
        self._ring: list[DeviceFrame] = []  # buffers for host frames: the pipeline uses two in place
        self.drop()

    def drop(self) -> None:
        """Forget the pipeline; the next slot makes a new one."""
        self.pipeline: Pipeline | None = None
        self.shot: Shot | None = None
        self.truth: np.ndarray | None = None  # of the shot, (H, W, 3), if it was asked for
        self.bad_pixels = BadPixels()
        self.invalid: np.ndarray | None = None  # pixels of the frame submitted last: a mask, see `invalid_pixels`
        self.stored: RenderedFrame | None = None  # the frame submitted last, as an engine stored it, ...
        self.converted: RenderedFrame | None = None  # ... and in our conventions
        self._at: int | None = None  # the frame submitted last
        self._frame: RenderedFrame | None = None
        self._before: Camera | None = None  # render camera of the frame before
        self.passed: deque[Passed] = deque(maxlen=self.source.held)  # submitted frames, the newest first
        self._presented = None
        self._focus: FocusMask | None = None  # made when it is asked for

    @property
    def _running(self) -> Pipeline:
        assert self.pipeline is not None  # `go_to` made it
        return self.pipeline

    def prepare(self, recipe: Recipe) -> None:
        setup, versions = recipe.setup, (recipe.kernels, recipe.weights)
        others = (setup.options, versions) != (self._options, self._versions)
        if self.source.configure(setup.window, setup.n, setup.options.upscale) or others:
            self.drop()
            self.cuts = set()
        self._options, self._versions = setup.options, versions

    def steps_to(self, k: int) -> float:
        """Return the rendered frames to submit until frame `k` is the last one; infinity if all begins anew."""
        at = self._at
        return k - at if at is not None and at <= k <= at + WARM_UP else math.inf

    def go_to(self, k: int, alpha: float) -> list[str]:
        """Submit the missing frames up to rendered frame `k`, with a new pipeline unless that is a little ahead.
        Unreadable frames other than `k` are left out; returns messages about them."""
        source, at = self.source, self._at
        if at is not None and math.isfinite(self.steps_to(k)) and not source.outdated(k, alpha):
            frames = range(max(at + 1, source.reset_before(k)), k + 1)
        else:
            frames = range(max(k - WARM_UP, source.reset_before(k), 0), k + 1)
            self._restart()
        notes = []
        for done, m in enumerate(frames):
            self.progress = done, len(frames)
            self._check()
            try:
                self._submit(m, last=m == k)
            except GffeError as error:
                if m == k:
                    raise
                notes.append(f"rendered frame {m} is left out: {error}")
                self._restart()
        self.progress = len(frames), len(frames)
        if frames:
            self._presented = self._running.present()
        return notes

    def shoot(self, k: int, alpha: float) -> Shot:
        """Make the slot at `alpha` after rendered frame `k`, which was submitted last, and return it."""
        pipeline, frame, shown, self.truth = self._running, self._frame, self._presented, None
        assert frame is not None and shown is not None  # `go_to` came first
        buffers = {
            names.RENDERED_COLOR: frame.color,
            names.RENDERED_DEPTH: frame.depth,
            names.RENDERED_MOTION: frame.motion,
        }
        cameras = (frame.camera, shown.camera, self._before)
        if alpha:
            made = pipeline.extrapolate(self.source.camera(k, alpha), self.source.time(k, alpha))
            buffers[names.FINAL] = made.color
            if "correction" in pipeline.stages:
                buffers[names.GAE] = made.gae
            self.shot = Shot(Moment(k, alpha, made.time, made.camera, *cameras), buffers)
        else:
            buffers[names.FINAL] = shown.color
            if self.source.has_truth:
                buffers[names.TRUTH] = shown.color
            self.shot = Shot(Moment(k, 0.0, frame.time, shown.camera, *cameras), buffers)
        return self.shot

    def find_focus(self, truth: np.ndarray) -> None:
        """Add "focus_truth" to the shot, an extrapolated one; `truth`: (H, W, 4) float16."""
        if self._focus is None:
            self._focus = FocusMask(self._running.board)
            self._true_color = self.device.buffer(truth.nbytes)
        cl.enqueue_copy(self.device.queue, self._true_color, truth)
        self._focus.make(self._true_color, self.source.exposure)
        assert self.shot is not None
        self.shot.buffers[names.FOCUS_TRUTH] = self._focus.buffer["focus_truth"]

    def _restart(self) -> None:
        self.drop()  # before as much is allocated again
        source = self.source
        self.pipeline = Pipeline(
            self.device, source.width, source.height, self._options, render_size=source.render_size, fps=source.fps,
            format=source.format,
        )  # fmt: skip
        if not self._ring or self._ring[0].color.size != 8 * source.render_size[0] * source.render_size[1]:
            self._ring = []
            self._upload = Upload(Board(self.device, Sizes(source.render_size, source.render_size)))
        source.restart()

    def _submit(self, m: int, last: bool) -> None:
        source, before = self.source, self._frame
        frame, self.stored = source.rendered(m), source.stored(m)
        host = host_arrays(frame) if isinstance(frame.color, np.ndarray) else None  # else it is on the device
        if host and self.stored is None:
            if len(self._ring) < 3:
                self._ring.append(DeviceFrame.allocate(self.device, source.render_size, None, None, 0.0))
            else:
                self._ring.append(self._ring.pop(0))
            color, depth, motion = self._ring[-1].buffers
            self._upload.take(host, DeviceFrame(color, depth, motion, frame.camera, frame.shown_camera, frame.time))
            frame = replace(frame, color=color, depth=depth, motion=motion)
        pipeline = self._running
        if last:
            pipeline.take_timings()  # of the warm-up: not this slot's
        pipeline.exposure = self.source.exposure
        pipeline.submit(self.stored or frame)
        if self.stored:  # the pipeline has converted it
            self.converted, on_device = frame, pipeline.board.rendered
            assert on_device is not None  # as it was submitted
            color, depth, motion = on_device.buffers
            frame = replace(frame, color=color, depth=depth, motion=motion)
        self._at, self._frame = m, frame
        if pipeline.is_cut:
            self.cuts.add(m)
        self._before = before.camera if before and not (frame.reset or pipeline.is_cut) else None
        pixels: Any = host or frame
        if host is not None and host.motion is None:
            pixels = host.in_device_layout()
        self.passed.appendleft(
            Passed(
                m, frame.camera, frame.shown_camera, source.render_size, pixels.depth, pixels.motion,
                self._before is None,
            )
        )  # fmt: skip
        self.bad_pixels = host.bad if self.stored and host else self._upload.take_bad_pixels() if host else BadPixels()
        self.invalid = invalid_pixels(host) if host and last and self.bad_pixels else None
