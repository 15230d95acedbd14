"""Temporal anti-aliasing and upsampling, of rendered and generated frames alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, XY, BufferSpec
from gffe_cl.engine.stages.correction import ShadingCorrection

_LOCK_FRAMES = constants("upscaling.cl")["LOCK_FRAMES"]  # a greater lock is that of a thin feature
_YCOCG = ("Y", "Co", "Cg", "A")


class Upscaling(Stage):
    """Gathers rendered frames, jittered and small, over time into a history at the display's size.

    Rendered frames are displayed from the history. Generated frames are resampled from it and do not change it: they
    are made from samples that it already holds.
    """

    name = "upscaling"
    pictures: ClassVar[Mapping[str, str]] = {"rendered": "history", "extrapolated": "color"}
    buffers = (
        BufferSpec(
            "compressed", np.float16, _YCOCG, "source", "the rendered frame's color, tone-mapped YCoCg; A: share of"
            " its place that was not hidden before", scratch=True,
        ),
        BufferSpec(
            "dilated", np.float32, XY, "source", "motion of the nearest surface around; NaN where nothing is known",
            "motion",
        ),
        BufferSpec(
            "surprise", np.float16, _YCOCG, "source", "how far it is beyond the history around; A: 1 where there is"
            " any", scratch=True,
        ),
        BufferSpec(
            "mean", np.float16, _YCOCG, "source", "mean color of 3×3 pixels, tone-mapped YCoCg; A: error of the"
            " history, in deviations", scratch=True,
        ),
        BufferSpec(
            "deviation", np.float16, _YCOCG, "source", "its standard deviation; A: light that the history lacks",
            scratch=True,
        ),
        BufferSpec(
            "history", np.float16, RGBA, "target", "the rendered frame as displayed: samples gathered over time",
            "color", kept=True,
        ),
        BufferSpec(
            "lock", np.uint8, (), "target", "frames in which the history was right, at rest, 8 at most; above: a thin"
            " feature is kept", kept=True,
        ),
        BufferSpec("rejected", np.uint8, (), "target", "share of the history that was not believed, in 255ths"),
        BufferSpec(
            "color", np.float16, RGBA, "target", "the generated frame, seen through the history", "color"
        ),
    )  # fmt: skip

    kernels = (
        Kernel(
            "compare",
            "source",
            {
                "color": "rendered.color",
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "previous_depth": "previous.depth",
                "history": "upscaling.history'",
            },
            {
                "out_compressed": "upscaling.compressed",
                "out_dilated": "upscaling.dilated",
                "out_surprise": "upscaling.surprise",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "survey",
            "source",
            {"compressed": "upscaling.compressed", "surprise": "upscaling.surprise"},
            {"out_mean": "upscaling.mean", "out_deviation": "upscaling.deviation"},
            step=("LANES", 1),
        ),
        Kernel(
            "accumulate",
            "target",
            {
                **{name: f"upscaling.{name}" for name in ("compressed", "dilated", "mean", "deviation")},
                **{name: f"upscaling.{name}'" for name in ("history", "lock")},
            },
            {
                **{f"out_{name}": f"upscaling.{name}" for name in ("history", "lock")},
                "rejected": "upscaling.rejected",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "generate",
            "target",
            {
                **{name: f"frame.{name}" for name in ("depth", "motion", "disoccluded")},
                "gae": "frame.color",
                "color": "correction.color",
                "history": "upscaling.history",
            },
            {"out_color": "upscaling.color"},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        self.corrected = ShadingCorrection.name in board.stages
        if not self.corrected:
            *others, generate = self.kernels
            self.kernels = (*others, replace(generate, reads={**generate.reads, "color": "frame.color"}))
        super().__init__(board)

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.upscale > 0

    def told(self, values: Mapping[str, np.ndarray], is_rendered: bool) -> str:
        if not is_rendered:
            if values["frame.disoccluded"][0]:
                return "Upscaling: no history here, its own color is shown."
            return "Upscaling: seen through the history of the rendered frame."
        weight, refused = float(values["upscaling.history"][3]), float(values["upscaling.rejected"][0]) / 255
        lock = int(values["upscaling.lock"][0])
        locked = f" At rest it was right for {lock} frames." if lock else ""
        if lock > _LOCK_FRAMES:
            locked = " A thin feature that samples miss at times is kept."
        said = f"Rendered frame, gathered over time: {weight:.1f} samples; {refused:.0%} of the history was refused."
        return said + locked

    def rendered(self, step: Step) -> None:
        """Add the rendered frame to the history."""
        for kernel in ("compare", "survey", "accumulate"):
            self.launch(kernel, step)

    def extrapolated(self, step: Step) -> None:
        self.launch("generate", step, corrected=self.corrected)
