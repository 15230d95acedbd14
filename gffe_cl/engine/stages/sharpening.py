"""Contrast-adaptive sharpening of upscaled frames. The history of upscaling is never sharpened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, BufferSpec


class Sharpening(Stage):
    """Sharpening of displayed frames, rendered and new: more contrast between neighbors that differ little."""

    name = "sharpening"
    pictures: ClassVar[Mapping[str, str]] = {"rendered": "rendered", "extrapolated": "color"}
    buffers = (
        BufferSpec("rendered", np.float16, RGBA, "target", "the rendered frame as displayed, sharpened", "color"),
        BufferSpec("color", np.float16, RGBA, "target", "the generated frame, sharpened", "color"),
    )
    kernels = (
        Kernel(
            "sharpen",
            "target",
            {"color": "upscaling.{shown}"},
            {"out_color": "sharpening.{sharpened}"},
            step=("LANES", 1),
            choices={"shown": ("history", "color"), "sharpened": ("rendered", "color")},
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.upscale > 0 and options.upscale_sharpening > 0

    def rendered(self, step: Step) -> None:
        self.launch("sharpen", step, shown="history", sharpened="rendered")

    def extrapolated(self, step: Step) -> None:
        self.launch("sharpen", step, shown="color", sharpened="color")
