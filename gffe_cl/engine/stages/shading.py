"""Inputs of the shading correction network (paper: 'Shading Correction Network')."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

# Inputs of kernels that look up the previous rendered frame at pixels of the new one (warped_previous.h).
SEEN = {
    "color": "frame.color",
    "depth": "frame.depth",
    "out_motion": "frame.motion",
    "is_dynamic": "frame.dynamic",
    "disoccluded": "frame.disoccluded",
    "motion": "rendered.motion",
    "color_prev": "previous.color",
    "depth_prev": "previous.depth",
}


class ShadingInputs(Stage):
    """Warps the previous rendered frame backward to t + α, replaces ghosts, and makes the input mask.

    The results are only for the viewer and for dumps. The network's own inputs come from the same functions, without
    the images at full size.
    """

    name = "shading"
    buffers = (
        BufferSpec(
            "warped_previous",
            np.float16,
            ("R", "G", "B", "valid"),
            "target",
            "frame t−1 warped backward to t + α (I^w); valid = 0: hidden then, GAE color instead",
            "color",
        ),
        BufferSpec("input_mask", np.float16, (), "target", "1 dynamic, 0 disoccluded, 0.5 the rest (M^input)"),
    )
    kernels = (
        Kernel(
            "prepare_inputs",
            "target",
            SEEN,
            {"warped_previous": "shading.warped_previous", "input_mask": "shading.input_mask"},
        ),
    )
    is_looked_at = True

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.shading_inputs

    def look_at(self, names: set[str] | None) -> None:
        self.is_looked_at = names is None or any(f"{self.name}.{spec.name}" in names for spec in self.buffers)

    def extrapolated(self, step: Step) -> None:
        """Fill the inputs. After a reset everything is GAE color."""
        if not self.is_looked_at:
            return
        self.launch("prepare_inputs", step)
