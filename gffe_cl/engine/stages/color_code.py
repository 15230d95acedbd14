"""Color code: the values of colors that are interpolated and mixed (beyond the paper, which mixes in linear light)."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, BufferSpec

_OFFSET = 0.5  # of color_code.h, at exposure 1


class ColorCode(Stage):
    """Encodes the rendered frame's colors: like a square root where it is dark, linear where it is bright. History
    tracking does so while the camera moves; while it rests, this stage encodes those that a new frame mixes."""

    name = "color_code"
    buffers = (
        BufferSpec(
            "codes", np.float16, RGBA, "source",
            "colors in the code for interpolation, as far as they are mixed; NaN is 0, infinities are clamped", "color",
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "encode_colors",
            "source",
            {"color": "rendered.color", "block_class": "backward_blocks.block_class"},
            {"codes": "color_code.codes"},
            step=("LANES", "BLOCK_HEIGHT"),
        ),
    )  # fmt: skip

    def __init__(self, board: Board):
        board.facts["code_offset"] = _OFFSET if board.options.resampling == "perceptual" else 0.0
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        *_, coded = step.rest
        if not coded:  # what is exported asks the frame block
            self.launch("encode_colors", step)
