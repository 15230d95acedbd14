"""History tracking with the static test (paper: 'Motion estimation', appendix Algorithm 1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gffe_cl.opencl.device import Device
from gffe_cl.stage import BufferSpec, Sizes, Stage, int2, reprojection

# Bounds of the automatic static threshold ε, in pixels.
THRESHOLD_LOW, THRESHOLD_HIGH = 0.25, 4.0
_STRIDE = 4
_BINS = 64


class HistoryTracking(Stage):
    """Which fragments move, and where they were.

    Inputs: depth and motion of the rendered frame, depth of the previous one, both cameras.
    """

    name = "history"
    buffers = (
        BufferSpec("dynamic_mask", np.uint8, (), "source", "1 where the static test failed (M^dyn)", "mask"),
        BufferSpec(
            "history",
            np.float32,
            ("x", "y", "z", "known"),
            "source",
            "positions P_1 … P_{k−1} in the view space of the rendered camera, world units; known = 0: P_0 instead",
            "world",
        ),
        BufferSpec("static_threshold_squared", np.float32, (), "once", "ε², px²"),
        BufferSpec(
            "residual_histogram",
            np.int32,
            tuple(f"bin{b}" for b in range(_BINS)),
            "once",
            "squared static residual, and its squared change over 8 px; two bins per octave",
            planes=2,
        ),
    )

    def __init__(self, device: Device, sizes: Sizes, positions: int, static_threshold: float | None):
        """`positions`: k ≥ 2, P_0 included. `static_threshold`: ε in pixels, None to follow the data."""
        self.positions = positions
        self.automatic = static_threshold is None
        self.buffers = tuple(
            replace(spec, planes=positions - 1) if spec.name == "history" else spec for spec in self.buffers
        )
        super().__init__(device, sizes)
        self._previous = self.allocate(spec for spec in self.buffers if spec.name in ("dynamic_mask", "history"))
        if static_threshold is not None:
            self.upload("static_threshold_squared", np.array([static_threshold**2], np.float32))

    def track(self, current, previous) -> None:
        """Algorithm 1 for `current`; `previous` is None after a reset: then everything is static.

        Both have `.depth`, `.motion` (device buffers) and `.camera`.
        """
        for name, buffer in self._previous.items():
            self._previous[name], self.buffer[name] = self.buffer[name], buffer
        before = previous or current
        to_previous = reprojection(current.camera, before.camera)
        if self.automatic and previous is not None:
            self.fill(self.buffer["residual_histogram"], 0)
            width, height = self.sizes.source
            self.launch(
                "residual_histogram",
                (-(-width // _STRIDE), -(-height // _STRIDE)),
                *int2(self.sizes.source),
                current.depth,
                current.motion,
                to_previous,
                self.buffer["residual_histogram"],
            )
            self.launch(
                "noise_threshold",
                (1, 1),
                self.buffer["residual_histogram"],
                np.float32(THRESHOLD_LOW),
                np.float32(THRESHOLD_HIGH),
                self.buffer["static_threshold_squared"],
                group=1,
            )
        self.launch(
            "track_history",
            self.sizes.source,
            *int2(self.sizes.source),
            np.int32(self.positions),
            np.int32(previous is not None),
            current.depth,
            current.motion,
            before.depth,
            self._previous["dynamic_mask"],
            self._previous["history"],
            to_previous,
            reprojection(before.camera, current.camera),
            self.buffer["static_threshold_squared"],
            self.buffer["dynamic_mask"],
            self.buffer["history"],
        )
