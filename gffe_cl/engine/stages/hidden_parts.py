"""Hidden parts of movers: disocclusions that belong to a moving object, not to the background (beyond the paper)."""

from __future__ import annotations

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.backward_blocks import SPLATTED_PIXELS
from gffe_cl.engine.stages.base import Access, Kernel, Stage, Step, share_of
from gffe_cl.engine.stages.buffers import BY_HIDDEN_PART
from gffe_cl.engine.stages.warp import DISOCCLUDED

_CONSTANTS = constants("hidden_parts.cl")
HIDDEN_PARTS = share_of("hidden parts", "frame.filled_by", lambda label: label == BY_HIDDEN_PART)
_FILLED = {name: Access(f"frame.{name}", HIDDEN_PARTS) for name in ("color", "depth", "motion", "filled_by")}


class HiddenParts(Stage):
    """Decides which disocclusions are a mover's own, hidden in the rendered frame, and continues it into them."""

    name = "hidden_parts"
    needs_footprints = True
    kernels = (
        Kernel(
            "fill_hidden_parts",
            "target",
            {
                "source_depth": Access("rendered.depth", HIDDEN_PARTS),
                "source_motion": Access("rendered.motion", HIDDEN_PARTS),
                "depth_prev": Access("previous.depth", HIDDEN_PARTS),
                "block_class": "backward_blocks.block_class",
                "disoccluded": Access("frame.disoccluded", SPLATTED_PIXELS),
                "is_dynamic": Access("frame.dynamic", DISOCCLUDED),
                "color": Access("frame.color", HIDDEN_PARTS),
                "depth": Access("frame.depth", HIDDEN_PARTS),
                "motion": Access("frame.motion", HIDDEN_PARTS),
            },
            _FILLED,
            step=("RUN", "LANES"),
        ),
    )

    @property
    def reach(self) -> int:
        """Distance in target pixels within which movers are searched for."""
        return max(_CONSTANTS["LEAST_REACH"], self.sizes.target[0] // _CONSTANTS["REACH_SHARE"])

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.hidden_parts and options.motion

    def extrapolated(self, step: Step) -> None:
        before = step.previous or step.frame
        self.launch("fill_hidden_parts", step, depth_prev=before.depth)
