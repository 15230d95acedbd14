"""Inputs of the shading correction network, and the mask it learns (paper: 'Shading Correction Network')."""

from __future__ import annotations

import numpy as np
import pyopencl as cl

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


class FocusMask(Stage):
    """Where shading is wrong, by ground truth: for training and measuring, not part of the pipeline."""

    name = "shading"
    buffers = (
        BufferSpec(
            "focus_truth", np.uint8, (), "target", "static, and unlike the truth around (M_focus: SMAPE > 0.5)", "mask"
        ),
    )

    def make(self, color: cl.Buffer, truth: cl.Buffer, dynamic: cl.Buffer, exposure: float) -> None:
        """`color` and `truth`: half ×4, linear RGB; `dynamic`: uchar; `exposure`: the sequence's."""
        focus_truth = self.buffer["focus_truth"]
        size = self.sizes.target
        self.launch("focus_mask", size, *int2(size), np.float32(exposure), color, truth, dynamic, focus_truth)
