"""The trend of shading: what lights do slowly, found in the last two intervals and carried on. Beyond the paper: a
candidate that the shading correction network may choose."""

from __future__ import annotations

import math

import numpy as np

from gffe_cl.buffers import BufferSpec
from gffe_cl.inference import TREND_PLANES
from gffe_cl.opencl.program import constants
from gffe_cl.stage import Access, Board, Kernel, Stage, Step, reprojection
from gffe_cl.stages.law import color_law

_CONSTANTS = constants("trend.cl")
_CHANGES = _CONSTANTS["CHANGES"]
_SAMPLED = 1 / _CONSTANTS["SAMPLE_STRIDE"] ** 2
WIDTH = 1 / 34  # σ of the neighbourhood, in heights of the image
_REACH = 3  # σ


class Trend(Stage):
    """How encoded colour changed on static surfaces from t − 1 to t, a mean over wide areas, and from t − 2 to t − 1;
    both carried on to t + α. What both agree on is likely to go on.

    Changes are of encoded colour (see `ShadingCorrection`) between a pixel and where its surface was, static and shown,
    in the frame before; a Gaussian of σ = H/34 weighs them. Made for the network that takes it (`needed`), and for
    whoever looks at it.
    """

    name = "trend"
    kernels = (
        Kernel(
            "measure_changes",
            "cells",
            {
                "color": Access("rendered.color", _SAMPLED),
                "depth": Access("rendered.depth", _SAMPLED),
                "dynamic_mask": Access("history.dynamic_mask", _SAMPLED),
                "color_prev": Access("previous.color", 4 * _SAMPLED),
                "depth_prev": Access("previous.depth", 4 * _SAMPLED),
            },
            {"changes": "trend.changes"},
            step=("LANES", 1),
        ),
        Kernel(
            "blur_rows", "cells", {"weights": "trend.weights", "changes": "trend.changes"}, {"blurred": "trend.blurred"}
        ),
        Kernel(
            "find_trend", "cells", {"weights": "trend.weights", "blurred": "trend.blurred"}, {"trend": "trend.trend"}
        ),
        Kernel(
            "carry_trends",
            "network",
            {"depth": Access("frame.depth", 1 / 4), "trend": "trend.trend", "trend_prev": "trend.trend'"},
            {"trends": "trend.trends"},
            step=("LANES", 1),
        ),
    )
    needed = False
    is_looked_at = True
    _made_at: float | None = None  # time of the frame that `trend` is of

    def __init__(self, board: Board):
        sigma = board.sizes.source[1] * WIDTH / _CONSTANTS["CELL"]
        self.reach = math.ceil(_REACH * sigma)
        self.buffers = (
            BufferSpec(
                "changes", np.float32, (), "cells", "change of encoded colour since t − 1 (1–3), and share of samples"
                " that tell (4)", planes=_CHANGES, scratch=True,
            ),
            BufferSpec(
                "blurred", np.float32, (), "cells", "the same, blurred along rows", planes=_CHANGES, scratch=True
            ),
            BufferSpec(
                "trend", np.float32, (), "cells", "mean change of encoded colour around, from t − 1 to t (1–3), and"
                " share of the surroundings that tells (4)", planes=_CHANGES, kept=True,
            ),
            BufferSpec(
                "trends", np.float32, (), "network", "change of encoded colour until t + α as the last interval has it"
                " (1–3), as the interval before has it (4–6), and share of the surroundings that tells of the last (7);"
                " half resolution", planes=TREND_PLANES, mapped=True,
            ),
            BufferSpec("weights", np.float32, (), "once", "of cells, by distance", planes=self.reach + 1, scratch=True),
        )  # fmt: skip
        super().__init__(board)
        weights = np.exp(-0.5 * (np.arange(self.reach + 1) / sigma) ** 2)
        self.upload("weights", (weights / (2 * weights.sum() - 1)).astype(np.float32))

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.corrects_shading or options.shading_inputs

    @property
    def is_made(self) -> bool:
        return self.needed or (self.is_looked_at and self.board.options.shading_inputs)

    def look_at(self, names: set[str] | None) -> None:
        self.is_looked_at = names is None or any(f"{self.name}.{spec.name}" in names for spec in self.buffers)

    def rendered(self, step: Step) -> None:
        """Find the trend; after a reset there is none."""
        if not self.is_made:
            return
        if self._made_at not in step.times[1:2]:
            self.fill("trend", 0)
            self.swap()  # nothing is known of the interval before
        self._made_at = step.times[0]
        if step.previous is None:
            self.fill("trend", 0)
            return
        to_previous = reprojection(step.frame.camera, step.previous.camera)
        self.launch("measure_changes", law=color_law(step.exposure), to_previous=to_previous)
        self.launch("blur_rows", reach=self.reach)
        self.launch("find_trend", reach=self.reach)

    def extrapolated(self, step: Step) -> None:
        """Carry both trends on to the new frame."""
        if not self.is_made:
            return
        before = step.previous or step.frame
        self.launch(
            "carry_trends",
            alpha=step.alpha,
            to_source=reprojection(step.camera, step.frame.camera),
            to_previous=reprojection(step.camera, before.camera),
        )
