"""Soft silhouettes: edges of movers stay antialiased as in the rendered frame; and fine detail (not in the paper)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGB9E5, RGBA, BufferSpec

_CONSTANTS = constants("layers.h")
LAYERS = tuple(
    (_CONSTANTS[name], about)
    for name, about in (
        ("NO_LAYER", "no step of depth whose sides move apart"),
        ("FAR", "the far side of one"),
        ("NEAR", "the near side of one"),
    )
)


class Silhouettes(Stage):
    """Unmixes the pixels at silhouettes of the rendered frame, while the warp splats, and blends them with the surface
    behind in the new frame."""

    name = "silhouettes"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "layer", np.uint8, (), "source", "sides of a step of depth that move apart", "label", labels=LAYERS,
            transient=True,
        ),
        BufferSpec(
            "behind", np.float16, RGBA, "source", "color of the far side at such steps", "color", scratch=True,
            transient=True, packing=RGB9E5,
        ),
        BufferSpec(
            "share", np.uint8, (), "source", "there, 255 times the near side's share of the pixel", scratch=True,
            transient=True,
        ),
        BufferSpec(
            "marked", np.uint8, (), "target_blocks", "1 where fragments go that lie at such steps", "mask"
        ),
        BufferSpec(
            "coverage", np.uint8, (), "target", "1 + 254 times the share of the nearer surface; 0: left as it was",
            transient=True, known_where=("marked", 1),
        ),
        BufferSpec(
            "softened", np.float16, RGBA, "target", "new colors at silhouettes", "color", scratch=True, transient=True,
            packing=RGB9E5,
        ),
        BufferSpec("soft", np.uint32, (), "list_target", "pixels at silhouettes", scratch=True, transient=True),
    )  # fmt: skip
    kernels = (
        Kernel(
            "soften",
            "target",
            {
                "marked": "silhouettes.marked",
                "depth": "frame.depth",
                "motion": "frame.motion",
                "layer": "silhouettes.layer",
                "filled_by": "frame.filled_by",
                "color": "frame.color",
                "behind": "silhouettes.behind",
                "share": "silhouettes.share",
                "codes": "color_code.codes",
                "target_position": "prediction.target_position",
            },
            {
                "coverage": "silhouettes.coverage",
                "softened": "silhouettes.softened",
                "soft": "silhouettes.soft",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "apply_softened",
            "walk",
            {
                "soft": "silhouettes.soft",
                "softened": "silhouettes.softened",
            },
            {"color": "frame.color"},
            step=("LANES", 1),
            group="WALK_GROUP",
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.soft_silhouettes

    def extrapolated(self, step: Step) -> None:
        for kernel in ("soften", "apply_softened"):
            self.launch(kernel, step)


class Detail(Stage):
    """Sharpens what lies between pixels of the rendered frame, so that new frames have its fine detail (not in the
    paper)."""

    name = "detail"
    pictures: ClassVar[Mapping[str, str]] = {"extrapolated": "color"}
    buffers = (BufferSpec("color", np.float16, RGBA, "target", "the final image with finer detail", "color"),)
    kernels = (
        Kernel(
            "sharpen",
            "target",
            {"color": "correction.color", "motion": "frame.motion"},
            {"out_color": "detail.color"},
        ),
    )

    def __init__(self, board: Board):
        if not board.options.corrects_shading:
            self.kernels = tuple(replace(k, reads={**k.reads, "color": "frame.color"}) for k in self.kernels)
        super().__init__(board)

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.detail and not options.upscale

    def extrapolated(self, step: Step) -> None:
        self.launch("sharpen", step)
