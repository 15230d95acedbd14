"""Hidden parts of movers: disocclusions that belong to a moving object, not to the background (beyond the paper)."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

_CONSTANTS = constants("hidden_parts.cl")
_FILLED = {name: f"frame.{name}" for name in ("color", "depth", "motion", "filled_by")}
_KEYS = {name: f"warp.{name}" for name in ("keys", "winners")}
_OFFERING = {
    "dynamic_mask": "history.dynamic_mask",
    "links": "connectivity.links",
    "met_depth": "history.met_depth",
    "target_position": "prediction.target_position",
} | _KEYS


class HiddenParts(NearestStage):
    """Decides which disocclusions are a mover's own, hidden in the rendered frame, and continues it into them. Shows
    parts that come out from behind static surfaces."""

    name = "hidden_parts"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "offered", np.uint32, (), "list_target", "pixels to which parts that reappear are offered",
            scratch=True, transient=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "fill_hidden_parts",
            "flat_level0",
            {
                "source_depth": "rendered.depth",
                "source_motion": "rendered.motion",
                "source_color": "rendered.color",
                "depth_prev": "previous.depth",
                "open": "warp.open",
                "disoccluded": "frame.disoccluded",
                "is_dynamic": "frame.dynamic",
                "color": "frame.color",
                "depth": "frame.depth",
                "motion": "frame.motion",
            }
            | _OFFERING,
            _FILLED | _KEYS | {"offered": "hidden_parts.offered"},
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
        Kernel(
            "offer_reappearing",
            "flat_level0",
            _OFFERING
            | {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "depth_prev": "previous.depth",
                "shown_depth": "frame.depth",
            },
            {
                "filled_by": "frame.filled_by",
                "offered": "hidden_parts.offered",
            }
            | _KEYS,
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
        Kernel(
            "fill_reappearing",
            "walk",
            {
                "source_motion": "rendered.motion",
                "target_position": "prediction.target_position",
                "color_prev": "previous.color",
                "offered": "hidden_parts.offered",
            }
            | _KEYS,
            {name: f"frame.{name}" for name in ("color", "depth", "motion")} | {"is_dynamic": "frame.dynamic"},
            group="WALK_GROUP",
        ),
    )

    def __init__(self, board: Board):
        if not board.options.reappearing:
            self.kernels = self.kernels[:1]
        super().__init__(board)

    @property
    def reach(self) -> int:
        """Distance in target pixels within which movers are searched for."""
        return max(_CONSTANTS["MOVER_REACH"], self.sizes.target[0] // _CONSTANTS["MOVER_REACH_SHARE"])

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.hidden_parts and options.motion

    def extrapolated(self, step: Step) -> None:
        reappearing = self.board.options.reappearing
        self.launch("fill_hidden_parts", step, reappear=reappearing)
        for offer_pass in self.passes if reappearing else ():
            self.launch("offer_reappearing", step, **{"pass": offer_pass})
        if reappearing:
            self.launch("fill_reappearing", step)
