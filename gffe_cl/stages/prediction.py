"""Position prediction (paper: 'Position estimation')."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gffe_cl.camera import Camera
from gffe_cl.opencl.device import Device
from gffe_cl.stage import BufferSpec, Sizes, Stage, int2, reprojection

MAX_ORDER = 4


class PositionPrediction(Stage):
    """Where every fragment will be at t + α, projected with the target camera."""

    name = "prediction"
    buffers = (
        BufferSpec(
            "target_position",
            np.float32,
            ("x", "y", "depth", "unused"),
            "source",
            "predicted position of each fragment: x, y in target pixels, view depth (−1: nothing to splat), 0",
            "place",
        ),
    )

    def __init__(self, device: Device, sizes: Sizes, order: int):
        """`order`: m, the degree of the polynomial through m + 1 positions; 1 is the paper's choice."""
        self.order = order
        super().__init__(device, sizes)

    def predict(self, frame, history: Stage, times: Sequence[float], target: Camera, time: float) -> None:
        """`times`: of the rendered frames, newest first (seconds); `time`: of the target frame."""
        self.launch(
            "predict_positions",
            self.sizes.source,
            *int2(self.sizes.source),
            np.int32(min(self.order, len(times) - 1)),
            frame.depth,
            history.buffer["dynamic_mask"],
            history.buffer["history"],
            polynomial_weights(times, time, MAX_ORDER),
            reprojection(frame.camera, target),
            self.buffer["target_position"],
        )


def polynomial_weights(times: Sequence[float], time: float, max_order: int) -> np.ndarray:
    """Lagrange weights of P_i − P_0 at `time`, for every order that `times` (newest first) allow.

    Returns
    -------
    (max_order, max_order) float32
        [o − 1, i − 1]: the weight of (P_i − P_0), i ≤ o, in the polynomial of order o. Order 1 gives −α.
    """
    weights = np.zeros((max_order, max_order), np.float32)
    for order in range(1, min(max_order, len(times) - 1) + 1):
        nodes = np.asarray(times[: order + 1], np.float64) - times[0]
        for i in range(1, order + 1):
            others = np.delete(nodes, i)
            weights[order - 1, i - 1] = np.prod((time - times[0] - others) / (nodes[i] - others))
    return weights
