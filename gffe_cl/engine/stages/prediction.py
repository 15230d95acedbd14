"""Position prediction (paper: 'Position estimation')."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.acceleration import Acceleration
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

NOWHERE = constants("prediction.cl")["NOWHERE"]  # px


class PositionPrediction(NearestStage):
    """Predicts where every fragment will be at t + α, projected with the target camera: by the polynomial of degree m
    through m + 1 positions. m = 1 is the paper's choice, to which the acceleration of movers may be added. Prepares
    the keys of the dilated warp, which follows."""

    name = "prediction"
    buffers = (
        BufferSpec(
            "target_position",
            np.float32,
            ("x", "y", "depth"),
            "source",
            "predicted position of each fragment: x, y in target pixels (−1e9: nowhere), view depth (−1)",
            "place",
            planar=True,
            transient=True,
        ),
    )
    kernels = (
        Kernel(
            "predict_positions",
            "predictions",
            {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": "history.met_depth",
                "history": "history.history",
                "velocity": "acceleration.velocity",
                "acceleration": "acceleration.acceleration",
                "bend": "acceleration.bend",
                "view_velocity": "acceleration.view_velocity",
            },
            {
                "target_position": "prediction.target_position",
                "keys": "dilated_warp.keys",
                "winners": "dilated_warp.winners",
            },
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        board.facts["bends"] = Acceleration.name in board.stages
        board.facts["dilates"] = self.dilates = not board.options.warps_footprints
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        if step.target_position is not None:
            self._replace(step.target_position)
            if self.dilates:
                self.board.stages["dilated_warp"].clear_keys("", "target")
            return
        self.launch("predict_positions", step)

    def _replace(self, target_position: np.ndarray) -> None:
        values = np.array(target_position[..., :3], np.float32)
        values[~(values[..., 2] > 0)] = (NOWHERE, NOWHERE, -1)
        self.upload("target_position", values)
