"""Position prediction (paper: 'Position estimation')."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.acceleration import Acceleration
from gffe_cl.engine.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.history import DYNAMIC_PIXELS

NOWHERE = constants("prediction.cl")["NOWHERE"]  # px


class PositionPrediction(Stage):
    """Predicts where every fragment will be at t + α, projected with the target camera: by the polynomial of degree m
    through m + 1 positions. m = 1 is the paper's choice, to which the acceleration of movers may be added."""

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
            "source",
            {
                "depth": "rendered.depth",
                "motion": Access("rendered.motion", DYNAMIC_PIXELS),
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": Access("history.met_depth", DYNAMIC_PIXELS),
                "history": Access("history.history", DYNAMIC_PIXELS),
                "velocity": Access("acceleration.velocity", DYNAMIC_PIXELS),
                "bend": Access("acceleration.bend", DYNAMIC_PIXELS),
                "view_velocity": Access("acceleration.view_velocity", DYNAMIC_PIXELS),
            },
            {"target_position": "prediction.target_position"},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        board.facts["bends"] = Acceleration.name in board.stages
        if not board.facts["bends"]:  # it reads nothing of them
            (predict,) = self.kernels
            nothing = dict.fromkeys(("velocity", "bend", "view_velocity"), Access("history.history", planes=0))
            self.kernels = (replace(predict, reads={**predict.reads, **nothing}),)
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        if step.target_position is not None:
            self._replace(step.target_position)
            return
        self.launch("predict_positions", step)

    def _replace(self, target_position: np.ndarray) -> None:
        values = np.array(target_position[..., :3], np.float32)
        values[~(values[..., 2] > 0)] = (NOWHERE, NOWHERE, -1)
        self.upload("target_position", values)
