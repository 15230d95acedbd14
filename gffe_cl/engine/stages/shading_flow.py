"""Flow of shading between the warped previous frame and the new one, and its confidence. Beyond the paper: a
candidate of the shading correction network, and what the image follows where it explains the last interval."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.inference.layers import CANDIDATE_PLANES
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.shading_trend import ShadingTrend

_CONSTANTS = constants("shading_flow.cl")
_LEVELS, _STEPS, _DIFFERENCES = (_CONSTANTS[name] for name in ("FLOW_LEVELS", "FLOW_STEPS", "DIFFERENCES"))
assert _CONSTANTS["CANDIDATES"] == CANDIDATE_PLANES


def _tiled(name: str, grid: str, reads: dict, writes: dict) -> Kernel:
    """Return a kernel whose work-groups work in local memory on tiles of a grid."""
    return Kernel(name, grid, reads, writes, group="TILE_WIDTH", group_rows="TILE_HEIGHT")


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
        BufferSpec(
            "brightness0", np.float32, (), "network", "mean code of the GAE frame (1) and of the warped previous one"
            " (2), half resolution", planes=2, scratch=True,
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
        BufferSpec("begun", np.float32, (), "network2", "the flow between steps, of any level", planes=2, scratch=True),
        BufferSpec(
            "no_flow", np.float32, (), f"network{_LEVELS + 1}", "zeros, with which it begins", planes=2, scratch=True
        ),
        BufferSpec(
            "differences", np.float32, (), "network2", "mean squared difference of brightness nearby: in place (1) and"
            " along the flow (2); of its change from the previous interval's change: in place (3) and along the"
            " flow (4)",
            planes=_DIFFERENCES,
        ),
        BufferSpec(
            "followed", np.float32, (), "network1", "1 where the image follows the flow: this explains the last"
            " interval, and motion vectors do not",
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
            {"frames": "network_input.frames"},
            {
                "colors": "shading_flow.colors",
                "brightness0": "shading_flow.brightness0",
                "brightness": "shading_flow.brightness1",
                "texture": "shading_flow.texture",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "halve_brightness",
            "network3",
            {"brightness1": "shading_flow.brightness1", "brightness2": "shading_flow.brightness2"},
            {"brightness2": "shading_flow.brightness2", "brightness3": "shading_flow.brightness3"},
            step=("LANES", 1),
        ),
        _tiled(
            "step_flow",
            "network{coarser}",
            {"brightness": "shading_flow.brightness{level}", "begun": "shading_flow.{from}"},
            {"flow": "shading_flow.{to}"},
        ),
        _tiled(
            "find_differences",
            "network2",
            {
                "brightness": "shading_flow.brightness1",
                "coarser": "shading_flow.brightness2",
                "flow": "shading_flow.flow2",
                "trends": "shading_trend.trends",
            },
            {"differences": "shading_flow.differences"},
        ),
        _tiled(
            "find_followed",
            "network1",
            {
                "frames": "network_input.frames",
                "brightness": "shading_flow.brightness0",
                "flow": "shading_flow.flow2",
                "changed": "shading_trend.changed",
            },
            {"followed": "shading_flow.followed"},
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
        self.launch("halve_brightness", step)
        begun = "no_flow"
        for level in range(_LEVELS, 0, -1):
            for number in range(_STEPS):
                made = "begun" if (_STEPS - number) % 2 == 0 else f"flow{level + 1}"
                doubles = int(number == 0 and level < _LEVELS)
                given = {"level": level, "coarser": level + 1, "doubles": doubles, "from": begun, "to": made}
                self.launch("step_flow", step, **given)
                begun = made
        self.launch("find_differences", step)
        if self.board.options.image_flow:
            self.launch("find_followed", step)
        self.launch("find_candidates", step)
