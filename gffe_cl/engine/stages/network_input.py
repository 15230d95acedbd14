"""Frames as the shading correction network sees them (paper: 'Shading Correction Network')."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.inference.layers import INPUT_PLANES
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.shading import SEEN
from gffe_cl.engine.stages.shading_trend import ShadingTrend


class NetworkInput(Stage):
    """Encodes the extrapolated frame and the warped previous one at half resolution, with inverse depth and input mask.

    The code of color c is e(c) = ln(1 + μ x) / ln(1 + μ), x = exposure · c / 8. A still frame has none of it, unless
    the viewer asks for it.
    """

    name = "network_input"
    buffers = (
        BufferSpec(
            "frames", np.float32, (), "network", "inputs of the network: encoded GAE color (1–3), encoded warped"
            " previous frame (4–6), inverse depth (7), input mask (8); half resolution",
            planes=INPUT_PLANES, mapped=True,
        ),
        BufferSpec("median_depth", np.float32, (), "once", "of the finite depths of 64×36 pixels, to 1/256"),
    )  # fmt: skip
    kernels = (
        Kernel(
            "find_median",
            "once",
            {"depth": "frame.depth"},
            {"median_depth": "network_input.median_depth"},
            group="SCANNERS",
        ),
        Kernel(
            "network_input",
            "network",
            {
                **SEEN,
                "median_depth": "network_input.median_depth",
            },
            {"planes": "network_input.frames"},
            step=("LANES", 1),
        ),
    )

    _looked_at = False

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.corrects_shading

    def look_at(self, names: set[str] | None) -> None:
        self._looked_at = names is None or any(name.startswith(f"{self.name}.") for name in names)

    def extrapolated(self, step: Step) -> None:
        """Fill `frames`. After a reset there is no input."""
        if step.previous is None or (self.board.stages[ShadingTrend.name].is_still and not self._looked_at):
            return
        self.launch("find_median", step)
        self.launch("network_input", step)
