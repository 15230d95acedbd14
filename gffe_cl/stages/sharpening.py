"""Contrast-adaptive sharpening of what upscaling shows; its history is never sharpened."""

from __future__ import annotations

import numpy as np

from gffe_cl.buffers import RGBA, BufferSpec
from gffe_cl.stage import Kernel, Stage, Step
from gffe_cl.stages.upscaling import Upscaling


class Sharpening(Stage):
    """What is shown of a rendered frame, and of a new one, with more contrast between neighbours that differ little."""

    name = "sharpening"
    buffers = (
        BufferSpec("rendered", np.float16, RGBA, "target", "the rendered frame as displayed, sharpened", "color"),
        BufferSpec("color", np.float16, RGBA, "target", "the generated frame, sharpened", "color"),
    )
    kernels = (Kernel("sharpen", "target", {"color": ""}, {"out_color": ""}, step=("LANES", 1)),)

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.upscale > 0 and options.upscale_sharpening > 0

    def rendered(self, step: Step) -> None:
        self._sharpen("history", "rendered")

    def extrapolated(self, step: Step) -> None:
        self._sharpen("color", "color")

    def _sharpen(self, shown: str, into: str) -> None:
        upscaling = self.board.stages[Upscaling.name]
        self.launch("sharpen", color=upscaling.buffer[shown], out_color=self.buffer[into])
