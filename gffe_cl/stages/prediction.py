"""Position prediction (paper: 'Position estimation')."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gffe_cl.opencl.program import constants
from gffe_cl.stages.acceleration import Acceleration
from gffe_cl.stages.base import Access, Board, Kernel, Stage, Step, reprojection
from gffe_cl.stages.buffers import BufferSpec

MAX_ORDER = 5
_WEIGHTS = 8  # that the kernel takes of each order
NOWHERE = constants("prediction.cl")["NOWHERE"]  # px


class PositionPrediction(Stage):
    """Where every fragment will be at t + α, projected with the target camera: by the polynomial of degree m through
    m + 1 positions; m = 1 is the paper's choice, to which the acceleration of movers may be added."""

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
                "motion": Access("rendered.motion", "dynamic"),
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": Access("history.met_depth", "dynamic"),
                "history": Access("history.history", "dynamic"),
                "velocity": Access("acceleration.velocity", "dynamic"),
                "bend": Access("acceleration.bend", "dynamic"),
            },
            {"target_position": "prediction.target_position"},
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        self.bends = Acceleration.name in board.stages
        if not self.bends:  # it reads nothing of them
            (predict,) = self.kernels
            nothing = dict.fromkeys(("velocity", "bend"), Access("history.history", planes=0))
            self.kernels = (replace(predict, reads={**predict.reads, **nothing}),)
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        if step.target_position is not None:
            self._replace(step.target_position)
            return
        before = step.previous or step.frame
        self.launch(
            "predict_positions",
            order=min(self.board.options.order, len(step.times) - 1),
            bends=self.bends,
            alpha=step.alpha,
            polynomial=padded(polynomial_weights(step.times, step.time, MAX_ORDER)),
            from_previous=reprojection(before.camera, step.frame.camera),
            to_target=reprojection(step.frame.camera, step.camera),
        )

    def _replace(self, target_position: np.ndarray) -> None:
        values = np.array(target_position[..., :3], np.float32)
        values[~(values[..., 2] > 0)] = (NOWHERE, NOWHERE, -1)
        self.upload("target_position", values)


def polynomial_weights(times: Sequence[float], time: float, max_order: int) -> np.ndarray:
    """Lagrange weights of P_i − P_0 at `time`, for every order that `times` (newest first) allow.

    Returns
    -------
    (max_order, max_order) float32
        [o − 1, i − 1]: the weight of (P_i − P_0), i ≤ o, in the polynomial of order o. Order 1 gives −α.
    """
    weights = np.zeros((max_order, max_order), np.float32)
    for order in range(1, min(max_order, len(times) - 1) + 1):
        nodes = [node - times[0] for node in times[: order + 1]]
        for i in range(1, order + 1):
            others = nodes[:i] + nodes[i + 1 :]
            weights[order - 1, i - 1] = math.prod((time - times[0] - other) / (nodes[i] - other) for other in others)
    return weights


def padded(weights: np.ndarray) -> np.ndarray:
    """Rows of `_WEIGHTS`: float8 in the kernel."""
    return np.pad(weights, ((0, 0), (0, _WEIGHTS - weights.shape[1])))
