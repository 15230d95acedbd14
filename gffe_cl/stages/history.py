"""History tracking with the static test (paper: 'Motion estimation', appendix Algorithm 1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gffe_cl.buffers import BufferSpec
from gffe_cl.opencl.program import constants
from gffe_cl.stage import Access, Board, Kernel, Stage, Step, reprojection

# Bounds of the automatic static threshold ε, in pixels.
THRESHOLD_LOW, THRESHOLD_HIGH = 0.25, 4.0
_CONSTANTS = constants("history.cl")
_SAMPLED = _CONSTANTS["RESIDUAL_STRIDE"] ** -2


class HistoryTracking(Stage):
    """Which fragments move, and where they were."""

    name = "history"
    buffers = (
        BufferSpec("dynamic_mask", np.uint8, (), "source", "1 where the static test failed (M^dyn)", "mask", kept=True),
        BufferSpec(
            "history",
            np.float32,
            ("x", "y", "z", "known"),
            "source",
            "positions P_1 … P_{k−1} in the view space of the rendered camera, world units; known = 0: P_0 instead",
            "world",
            kept=True,
        ),
        BufferSpec("static_threshold_squared", np.float32, (), "once", "ε², px²"),
        BufferSpec(
            "residual_histogram",
            np.int32,
            tuple(f"bin{b}" for b in range(_CONSTANTS["RESIDUAL_BINS"])),
            "once",
            "squared static residual, and its squared change over 8 px; two bins per octave",
            planes=2,
        ),
    )
    kernels = (
        Kernel(
            "residual_histogram",
            "source",
            {"depth": Access("rendered.depth", _SAMPLED), "motion": Access("rendered.motion", _SAMPLED)},
            {"histogram": "history.residual_histogram"},
            step=("RESIDUAL_STRIDE", "RESIDUAL_STRIDE"),
        ),
        Kernel(
            "noise_threshold",
            "once",
            {"histogram": "history.residual_histogram"},
            {"threshold_squared": "history.static_threshold_squared"},
            group=1,
        ),
        Kernel(
            "track_history",
            "source",
            {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "depth_prev": Access("previous.depth", "dynamic"),
                "dynamic_prev": Access("history.dynamic_mask'", "dynamic"),
                "history_prev": Access("history.history'", "dynamic"),
                "threshold_squared": "history.static_threshold_squared",
            },
            {"dynamic_mask": "history.dynamic_mask", "history": "history.history"},
        ),
    )

    def __init__(self, board: Board):
        self.positions = board.options.history
        self.buffers = tuple(
            replace(spec, planes=self.positions - 1) if spec.name == "history" else spec for spec in self.buffers
        )
        super().__init__(board)
        threshold = board.options.static_threshold
        self.automatic = threshold is None
        if not self.automatic:
            self.upload("static_threshold_squared", np.array([threshold**2], np.float32))

    def rendered(self, step: Step) -> None:
        """Algorithm 1; without a previous frame, or without motion estimation, everything is static."""
        self.swap()
        previous = step.previous if self.board.options.motion else None
        before = previous or step.frame
        to_previous = reprojection(step.frame.camera, before.camera)
        if self.automatic and previous is not None:
            self.fill("residual_histogram", 0)
            self.launch("residual_histogram", to_previous=to_previous)
            self.launch("noise_threshold", low=THRESHOLD_LOW, high=THRESHOLD_HIGH)
        self.launch(
            "track_history",
            positions=self.positions,
            has_previous=previous is not None,
            depth_prev=before.depth,
            to_previous=to_previous,
            from_previous=reprojection(before.camera, step.frame.camera),
        )
