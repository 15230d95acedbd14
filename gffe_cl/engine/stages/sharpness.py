"""Sharpness with which rendered frames are resampled, measured on them (beyond the paper: 'Warping')."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

_SUMS = ("explained", "changed")


class Sharpness(Stage):
    """Resamples the frame before at a lattice of samples, and measures how much sharper than Catmull-Rom's cubic
    it has to be to show this frame's colors. Warps resample the rendered frame as sharply."""

    name = "sharpness"
    buffers = (
        BufferSpec("sharpness", np.float32, (), "once", "how much sharper edges are than interpolated ones, 0 to 2"),
        BufferSpec(
            "evidence", np.float32, _SUMS, "once",
            "differences between rendered frames that sharpness explains, and what it changes: sums of squares, white"
            " being 1, in which earlier frames count less and less",
        ),
        BufferSpec(
            "pending", np.int32, (*_SUMS, "added"), "once",
            "these sums while they are added up, and how many work-groups have added to them", scratch=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "measure_sharpness",
            "cut_samples",
            {
                "color": "rendered.color",
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "dynamic_mask": "history.dynamic_mask",
                "color_prev": "previous.color",
                "depth_prev": "previous.depth",
                "pending": "sharpness.pending",
                "evidence": "sharpness.evidence",
            },
            {
                "pending": "sharpness.pending",
                "evidence": "sharpness.evidence",
                "sharpness": "sharpness.sharpness",
            },
            group="SAMPLES_X",
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.sharpness

    def rendered(self, step: Step) -> None:
        """Measure it. Without a previous frame it is 0."""
        self.launch("measure_sharpness", step)
