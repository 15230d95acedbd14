"""Hidden parts of movers: disocclusions that belong to a moving object, not to the background (beyond the paper)."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.backward_blocks import SPLATTED_PIXELS
from gffe_cl.engine.stages.base import Access, Board, Kernel, NearestStage, Step, share_of
from gffe_cl.engine.stages.buffers import BY_HIDDEN_PART, BY_REAPPEARING, BufferSpec
from gffe_cl.engine.stages.history import DYNAMIC_PIXELS
from gffe_cl.engine.stages.warp import DISOCCLUDED, OPEN_LIST

_CONSTANTS = constants("hidden_parts.cl")
HIDDEN_PARTS = share_of("hidden parts", "frame.filled_by", lambda label: label == BY_HIDDEN_PART)
REAPPEARING = share_of("reappearing", "frame.filled_by", lambda label: label == BY_REAPPEARING)
_FILLED = {name: Access(f"frame.{name}", HIDDEN_PARTS) for name in ("color", "depth", "motion", "filled_by")}


def _keys() -> dict[str, Access]:
    return {name: Access(f"warp.{name}", REAPPEARING) for name in ("keys", "winners")}


_OFFERING = {
    "depth": Access("rendered.depth", REAPPEARING),
    "motion": Access("rendered.motion", REAPPEARING),
    "met_depth": Access("history.met_depth", REAPPEARING),
    "target_position": Access("prediction.target_position", REAPPEARING),
    "shown_depth": Access("frame.depth", REAPPEARING),
} | _keys()


class HiddenParts(NearestStage):
    """Decides which disocclusions are a mover's own, hidden in the rendered frame, and continues it into them. Shows
    parts that come out from behind static surfaces."""

    name = "hidden_parts"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "edges", np.uint32, (), "list_source", "pixels at edges of movers that something hides",
            scratch=True, transient=True,
        ),
        BufferSpec(
            "offered", np.uint32, (), "list_target", "pixels to which parts that reappear are offered",
            scratch=True, transient=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "fill_hidden_parts",
            "walk",
            {
                "source_depth": Access("rendered.depth", HIDDEN_PARTS),
                "source_motion": Access("rendered.motion", HIDDEN_PARTS),
                "depth_prev": Access("previous.depth", HIDDEN_PARTS),
                "open": OPEN_LIST,
                "disoccluded": Access("frame.disoccluded", SPLATTED_PIXELS),
                "is_dynamic": Access("frame.dynamic", DISOCCLUDED),
                "color": Access("frame.color", HIDDEN_PARTS),
                "depth": Access("frame.depth", HIDDEN_PARTS),
                "motion": Access("frame.motion", HIDDEN_PARTS),
            },
            _FILLED | {name: Access(f"hidden_parts.{name}", planes=0) for name in ("edges", "offered")},
            group="WALK_GROUP",
        ),
        Kernel(
            "list_edges",
            "flat_level0",
            _OFFERING | {"dynamic_mask": "history.dynamic_mask", "links": Access("connectivity.links", DYNAMIC_PIXELS)},
            {"edges": Access("hidden_parts.edges", REAPPEARING)} | _keys(),
            step=("SCAN_BYTES", 1),
            group="SCAN_GROUP",
        ),
        Kernel(
            "offer_reappearing",
            "walk",
            _OFFERING
            | {
                "dynamic_mask": Access("history.dynamic_mask", REAPPEARING),
                "links": Access("connectivity.links", REAPPEARING),
                "depth_prev": Access("previous.depth", REAPPEARING),
                "edges": Access("hidden_parts.edges", REAPPEARING),
            },
            {
                "filled_by": Access("frame.filled_by", REAPPEARING),
                "offered": Access("hidden_parts.offered", REAPPEARING),
            }
            | _keys(),
            group="WALK_GROUP",
        ),
        Kernel(
            "fill_reappearing",
            "walk",
            {
                "source_motion": Access("rendered.motion", REAPPEARING),
                "met_depth": Access("history.met_depth", REAPPEARING),
                "target_position": Access("prediction.target_position", REAPPEARING),
                "depth_prev": Access("previous.depth", REAPPEARING),
                "color_prev": Access("previous.color", REAPPEARING),
                "offered": Access("hidden_parts.offered", REAPPEARING),
            }
            | _keys(),
            {name: Access(f"frame.{name}", REAPPEARING) for name in ("color", "depth", "motion")}
            | {"is_dynamic": Access("frame.dynamic", REAPPEARING)},
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
        before = step.previous or step.frame
        self.launch("fill_hidden_parts", step, depth_prev=before.depth)
        if not self.board.options.reappearing:
            return
        self.launch("list_edges", step)
        for offer_pass in self.passes:
            self.launch("offer_reappearing", step, depth_prev=before.depth, **{"pass": offer_pass})
        self.launch("fill_reappearing", step, depth_prev=before.depth, color_prev=before.color)
