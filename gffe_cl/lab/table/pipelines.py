"""Runners on a device: our pipeline as a method of the table, and variants that upscale otherwise than the pipeline
does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.frame_block import mapping
from gffe_cl.lab.table.datasets import Footage, Moment, Shot
from gffe_cl.lab.table.image_space import pixel_centers


class DeviceRunner:
    """A method at work on a device. `milliseconds` of the device per rendered frame with one new one; of pipelines with
    the network."""

    def __init__(self):
        self._submitted: float | None = None
        self.milliseconds: list[float] = []

    def submit(self, shot: Shot) -> None:
        """Take the next rendered frame, whose buffers may lie on the device."""
        self._submitted = None

    def finish(self) -> None:
        """Wait for the device. Its work since `submit` counts for each new frame."""
        taken = self._taken()
        self._submitted = taken if self._submitted is None else self._submitted

    def make(self, moment: Moment) -> np.ndarray:
        """Return the picture of a moment: (H, W, 3) linear."""
        color = self.color_of(self.extrapolated(moment))
        assert self._submitted is not None  # `finish` was called
        self.milliseconds.append(self._submitted + self._taken())
        return color

    def extrapolated(self, moment: Moment) -> Any:
        """Enqueue the work for a moment and return its frame on the device."""
        raise NotImplementedError

    def color_of(self, made: Any) -> np.ndarray:
        """Return the color of a frame from `extrapolated`: (H, W, 3) float16, linear."""
        raise NotImplementedError

    def _taken(self) -> float:
        """Wait for the device and return the milliseconds of its work since the last call."""
        raise NotImplementedError


class PipelineRunner(DeviceRunner):
    """The project's pipeline with the options of a method, with upscaling if frames are smaller than the display.
    `window`: rule of the rendering window; `knows_camera`: whether the new frame's camera is given; `pipeline`: its
    own."""

    upscales = True

    def __init__(self, options: Options, window: str, knows_camera: bool, footage: Footage, device: Device):
        super().__init__()
        size, render_size = (footage.width, footage.height), footage.render_size(window)
        options = replace(options, upscale=footage.upscale if self.upscales else 0.0)
        self.pipeline = Pipeline(
            device, *size, options, render_size=render_size, fps=footage.fps, format=footage.encoding.format
        )
        self.pipeline.exposure = footage.exposure
        self._known = knows_camera

    def submit(self, shot: Shot) -> None:
        super().submit(shot)
        self.pipeline.submit(shot.frame)

    def present(self) -> np.ndarray:
        """Return the displayed rendered frame; windows make it a little softer."""
        return self.pipeline.present().numpy("color")

    def extrapolated(self, moment: Moment) -> ExtrapolatedFrame:
        return self.pipeline.extrapolate(self.camera_of(moment), moment.time)

    def color_of(self, made: ExtrapolatedFrame) -> np.ndarray:
        return made.numpy("color")

    def camera_of(self, moment: Moment):
        """Return the camera of the new frame; None: the pipeline predicts it."""
        return moment.camera if self._known else None

    def pipelines(self) -> tuple[Pipeline, ...]:
        return (self.pipeline,)

    def _taken(self) -> float:
        return sum(sum(pipeline.take_timings().values()) for pipeline in self.pipelines())


class Resampled(PipelineRunner):
    """Resamples rendered frames (cubic), and extrapolates new ones from them without upscaling."""

    upscales = False


class RenderedUpscaled(PipelineRunner):
    """Upscales rendered frames alone; new ones are shown as they are extrapolated from the small frames."""

    def color_of(self, made):
        correction = self.pipeline.stages.get(ShadingCorrection.name)
        return correction.read("color")[..., :3] if correction else made.numpy("gae")


class UpscaledFirst(PipelineRunner):
    """Upscales before extrapolation: new frames are extrapolated from upscaled frames, all at the display's size."""

    def __init__(self, options: Options, window: str, knows_camera: bool, footage: Footage, device: Device):
        super().__init__(options, window, knows_camera, footage, device)
        self._shown = Pipeline(device, footage.width, footage.height, options, fps=footage.fps)
        self._shown.exposure = footage.exposure

    def submit(self, shot):
        super().submit(shot)
        shown = self.pipeline.present()
        buffers = (shown.numpy(name) for name in ("color", "depth", "motion"))
        self._shown.submit(RenderedFrame(*buffers, camera=shown.camera, time=shown.time, reset=shot.frame.reset))

    def extrapolated(self, moment):
        return self._shown.extrapolate(self.camera_of(moment), moment.time)

    def pipelines(self):
        return self.pipeline, self._shown


class TrueMotion(PipelineRunner):
    """Pipeline with the true position of every fragment: an upper bound for position prediction."""

    def extrapolated(self, moment):
        assert moment.true_positions is not None  # see Method.needs
        return self.pipeline.extrapolate(self.camera_of(moment), moment.time, target_position=moment.true_positions())


class TrueGeometry(PipelineRunner):
    """Upscaling with exact depth and motion of the new frame: its remaining error is not the warp's."""

    def submit(self, shot):
        super().submit(shot)
        self._to_render = mapping(self.pipeline.shown_camera, shot.frame.camera)

    def extrapolated(self, moment):
        guide = moment.guide
        assert guide is not None  # see Method.needs
        here = pixel_centers(*guide.depth.shape)
        place = (here + np.nan_to_num(guide.motion)) * self._to_render[:2] + self._to_render[2:]
        geometry = guide.depth, (place - here).astype(np.float32)
        return self.pipeline.extrapolate(self.camera_of(moment), moment.time, seen_through=geometry)
