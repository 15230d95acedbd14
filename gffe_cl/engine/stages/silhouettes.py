"""Soft silhouettes: edges of movers stay antialiased as in the rendered frame (not in the paper)."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import RGBA, BufferSpec
from gffe_cl.engine.stages.pixel_formats import RGB9E5

_CONSTANTS = constants("silhouettes.cl")
LAYERS = tuple(
    (_CONSTANTS[name], about)
    for name, about in (
        ("NO_LAYER", "no step of depth whose sides move apart"),
        ("FAR", "the far side of one"),
        ("NEAR", "the near side of one"),
    )
)


class Silhouettes(Stage):
    """Unmixes the pixels at silhouettes of the rendered frame, and blends them with the surface behind in the new
    frame. The list of open pixels holds the soft ones now: there are no open ones any more."""

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
    )  # fmt: skip
    kernels = (
        Kernel(
            "find_layers",
            "source",
            {
                "links": "connectivity.links",
                "smooth": "backward_blocks.smooth",
                "depth": "rendered.depth",
                "target_position": "prediction.target_position",
                "codes": "color_code.codes",
            },
            {
                "layer": "silhouettes.layer",
                "behind": "silhouettes.behind",
                "share": "silhouettes.share",
                "marked": "silhouettes.marked",
                "soft": "warp.open",
            },
            step=("LANES", 1),
        ),
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
                "soft": "warp.open",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "apply_softened",
            "walk",
            {
                "soft": "warp.open",
                "softened": "silhouettes.softened",
            },
            {"color": "frame.color"},
            group="WALK_GROUP",
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.soft_silhouettes

    def extrapolated(self, step: Step) -> None:
        for kernel in ("find_layers", "soften", "apply_softened"):
            self.launch(kernel, step)
