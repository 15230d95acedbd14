"""Dilated warp: the warp of the preset "performance", which carries the motion of the nearest of 3×3 pixels."""

from __future__ import annotations

from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.warp import NEW_FRAME

_KEYS = {"keys": "dilated_warp.keys", "winners": "dilated_warp.winners"}


class DilatedWarp(NearestStage):
    """Carries every pixel's place to where the nearest surface around it moves, and resamples the rendered frame from
    there. Every pixel is filled. Position prediction has emptied the keys."""

    name = "dilated_warp"
    kernels = (
        Kernel(
            "splat_dilated",
            "source",
            {"depth": "rendered.depth", "target_position": "prediction.target_position"} | _KEYS,
            _KEYS,
            step=("LANES", 1),
        ),
        Kernel(
            "resample_dilated",
            "target",
            {
                "color": "rendered.color",  # where nothing moves
                "codes": "color_code.codes",
                "dynamic_mask": "history.dynamic_mask",
                "target_position": "prediction.target_position",
                "sharpness": "sharpness.sharpness",
            }
            | _KEYS,
            NEW_FRAME,
            step=("LANES", 1),
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return not options.warps_footprints

    def __init__(self, board: Board):
        self.buffers = self.keys(board, "", "target", transient=True)
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        for splat_pass in self.passes:
            self.launch("splat_dilated", step, **{"pass": splat_pass})
        self.launch("resample_dilated", step)
