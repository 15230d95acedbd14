"""Color code: the values of colors that are interpolated and mixed (beyond the paper, which mixes in linear light)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gffe_cl.engine.stages.base import Access, Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, BufferSpec

_OFFSET = 0.5  # of color_code.h, at exposure 1


class ColorCode(Stage):
    """Encodes the rendered frame's colors: like a square root where it is dark, linear where it is bright."""

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
        if not board.facts.get("copies"):  # it reads nothing of them
            (encode,) = self.kernels
            nothing = Access("rendered.color", planes=0)
            self.kernels = (replace(encode, reads={**encode.reads, "block_class": nothing}),)
        board.facts["code_offset"] = _OFFSET if board.options.resampling == "perceptual" else 0.0
        super().__init__(board)

    def extrapolated(self, step: Step) -> None:
        self.launch("encode_colors", step)
