"""Hidden parts of movers: disocclusions that belong to a moving object, not to the background (beyond the paper)."""

from __future__ import annotations

from gffe_cl.opencl.program import constants
from gffe_cl.stages.base import Access, Kernel, Stage, Step

_CONSTANTS = constants("hidden_parts.cl")
_FILLED = {name: Access(f"frame.{name}", "hidden parts") for name in ("color", "depth", "motion", "filled_by")}


class HiddenParts(Stage):
    """Decides which disocclusions are a mover's own, hidden in the rendered frame, and continues it into them."""

    name = "hidden_parts"
    kernels = (
        Kernel(
            "fill_hidden_parts",
            "target",
            {
                "source_depth": Access("rendered.depth", "hidden parts"),
                "block_class": "backward_blocks.block_class",
                "disoccluded": Access("frame.disoccluded", "splatted"),
                "is_dynamic": Access("frame.dynamic", "disoccluded"),
                "color": Access("frame.color", "hidden parts"),
                "depth": Access("frame.depth", "hidden parts"),
                "motion": Access("frame.motion", "hidden parts"),
            },
            _FILLED,
            step=("RUN", "LANES"),
        ),
    )

    @property
    def reach(self) -> int:
        """Target pixels in which movers are looked for."""
        return max(_CONSTANTS["LEAST_REACH"], self.sizes.target[0] // _CONSTANTS["REACH_SHARE"])

    @classmethod
    def is_wanted(cls, options) -> bool:
        return options.hidden_parts and options.motion

    def extrapolated(self, step: Step) -> None:
        self.launch("fill_hidden_parts", step)
