"""Inputs of the shading correction network (paper: 'Shading Correction Network')."""

from __future__ import annotations

import numpy as np

from gffe_cl.camera import Camera
from gffe_cl.stage import BufferSpec, Stage, int2, reprojection


class ShadingInputs(Stage):
    """The previous rendered frame warped backward to t + α, ghosts replaced, and the input mask."""

    name = "shading"
    buffers = (
        BufferSpec(
            "warped_previous",
            np.float16,
            ("R", "G", "B", "valid"),
            "target",
            "frame t−1 warped backward to t + α (I^w); valid = 0: hidden then, GAE colour instead",
            "color",
        ),
        BufferSpec("input_mask", np.float16, (), "target", "1 dynamic, 0 disoccluded, 0.5 the rest (M^input)"),
    )

    def prepare(self, frame, previous, warp: Stage, target: Camera) -> None:
        """`previous`: the rendered frame before `frame`, None after a reset: then everything is GAE colour."""
        before = previous or frame
        self.launch(
            "prepare_inputs",
            self.sizes.target,
            *int2(self.sizes.target),
            *int2(self.sizes.source),
            np.int32(previous is not None),
            *(warp.buffer[name] for name in ("color", "depth", "motion", "dynamic", "filled_by")),
            frame.motion,
            before.color,
            before.depth,
            reprojection(target, before.camera),
            self.buffer["warped_previous"],
            self.buffer["input_mask"],
        )
