"""Flow of shading between the warped previous frame and the new one, and its confidence. Beyond the paper: a
candidate of the shading correction network."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.inference.model_interface import CANDIDATE_PLANES
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Access, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.shading_trend import ShadingTrend

_CONSTANTS = constants("shading_flow.cl")
_LEVELS, _STEPS, _PRODUCTS = (_CONSTANTS[name] for name in ("FLOW_LEVELS", "FLOW_STEPS", "PRODUCTS"))
_DIFFERENCES = _CONSTANTS["DIFFERENCES"]
assert _CONSTANTS["CANDIDATES"] == CANDIDATE_PLANES


class ShadingFlow(Stage):
    """Finds the flow from the extrapolated frame into the warped previous one, by least squares (Lucas and Kanade,
    1981), coarse to fine, over encoded brightness; and makes the network's inputs from flow and trend.

    Level l of a pyramid has 1/2^l of the sides of the network's frames; level 1, the finest, is a quarter of the
    display. Sums are over some 6×6 pixels of each level. The flow of every second pixel is found.
    """

    name = "shading_flow"
    buffers = (
        BufferSpec(
            "colors", np.float32, (), "network1", "encoded GAE color at a quarter of the resolution",
            planes=3, scratch=True,
        ),
        *(
            BufferSpec(
                f"brightness{level}", np.float32, (), f"network{level}", "mean code of the GAE frame (1) and of the"
                f" warped previous one (2), level {level}", planes=2, scratch=True,
            )
            for level in range(1, _LEVELS + 1)
        ),
        *(
            BufferSpec(
                f"flow{level}", np.float32, (), f"network{level}", "flow from the GAE frame into the warped previous"
                f" one, x (1) and y (2), in pixels of level {level - 1}", planes=2, scratch=level > 2,
            )
            for level in range(2, _LEVELS + 2)
        ),
        BufferSpec(
            "texture", np.float32, (), "network1", "how far detail of brightness within 2×2 pixels of half the"
            " resolution is that of the previous frame, 0 to 1: texture of the surface",
        ),
        BufferSpec(
            "warped", np.float32, (), "network1", "brightness of the previous frame moved along the flow, of any level",
            scratch=True,
        ),
        BufferSpec(
            "products", np.float32, (), "network2", "products of gradients and differences, of any level",
            planes=_PRODUCTS, scratch=True,
        ),
        BufferSpec(
            "differences", np.float32, (), "network2", "mean squared difference of brightness nearby: in place (1) and"
            " along the flow (2); of its change from the previous interval's change: in place (3) and along the"
            " flow (4)",
            planes=_DIFFERENCES,
        ),
        BufferSpec(
            "candidates", np.float32, (), "network1", "inputs of the network in addition to its frames: flow / 4"
            " (1, 2), 4 × root of both differences (3, 4) and their ratio (5), 4 × change along the flow until t + α"
            " (6–8), 4 × trends (9–12),"
            " 4 × difference of brightness (13), agreement with the previous trend (14), valid share (15), α (16)",
            planes=CANDIDATE_PLANES, mapped=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "halve_frames",
            "network1",
            {"frames": Access("network_input.frames", planes=6)},
            {
                "colors": "shading_flow.colors",
                "brightness": "shading_flow.brightness1",
                "texture": "shading_flow.texture",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "halve_brightness",
            "network{level}",
            {"fine": "shading_flow.brightness{finer}"},
            {"brightness": "shading_flow.brightness{level}"},
            step=("LANES", 1),
        ),
        Kernel(
            "double_flow",
            "network{coarser}",
            {"coarse": "shading_flow.flow{coarsest}"},
            {"flow": "shading_flow.flow{coarser}"},
            step=("LANES", 1),
        ),
        Kernel(
            "warp_brightness",
            "network{level}",
            {"brightness": "shading_flow.brightness{level}", "flow": "shading_flow.flow{coarser}"},
            {"warped": "shading_flow.warped"},
            step=("LANES", 1),
        ),
        Kernel(
            "sum_products",
            "network{coarser}",
            {"brightness": "shading_flow.brightness{level}", "warped": "shading_flow.warped"},
            {"products": "shading_flow.products"},
            step=("LANES", 1),
        ),
        Kernel(
            "step_flow",
            "network{coarser}",
            {"products": "shading_flow.products", "flow": "shading_flow.flow{coarser}"},
            {"flow": "shading_flow.flow{coarser}"},
            step=("LANES", 1),
        ),
        Kernel(
            "sum_differences",
            "network2",
            {
                "brightness": "shading_flow.brightness1",
                "warped": "shading_flow.warped",
                "coarser": "shading_flow.brightness2",
                "flow": "shading_flow.flow2",
                "trends": Access("shading_trend.trends", planes=1),
            },
            {"products": Access("shading_flow.products", planes=_DIFFERENCES)},
            step=("LANES", 1),
        ),
        Kernel(
            "blur_differences",
            "network2",
            {"products": Access("shading_flow.products", planes=_DIFFERENCES)},
            {"differences": "shading_flow.differences"},
            step=("LANES", 1),
        ),
        Kernel(
            "find_candidates",
            "network1",
            {
                "colors": "shading_flow.colors",
                "brightness": "shading_flow.brightness1",
                "flow": "shading_flow.flow2",
                "differences": "shading_flow.differences",
                "trends": "shading_trend.trends",
            },
            {"candidates": "shading_flow.candidates"},
            step=("LANES", 1),
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.corrects_shading

    def extrapolated(self, step: Step) -> None:
        """Find the flow, coarsest level first, and fill `candidates`; nothing after a reset and in still frames."""
        if step.previous is None or self.board.stages[ShadingTrend.name].is_still:
            return
        self.launch("halve_frames", step)
        for level in range(2, _LEVELS + 1):
            self.launch("halve_brightness", step, level=level, finer=level - 1)
        self.fill(f"flow{_LEVELS + 1}", 0)
        for level in range(_LEVELS, 0, -1):
            at = {"level": level, "coarser": level + 1}
            if level < _LEVELS:
                self.launch("double_flow", step, **at, coarsest=level + 2)
            for _ in range(_STEPS):
                self.launch("warp_brightness", step, **at)
                self.launch("sum_products", step, **at)
                self.launch("step_flow", step, **at)
        self.launch("warp_brightness", step, level=1, coarser=2)
        self.launch("sum_differences", step)
        self.launch("blur_differences", step)
        self.launch("find_candidates", step)
