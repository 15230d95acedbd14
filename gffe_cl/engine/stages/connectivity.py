"""Connectivity of a rendered frame: which neighboring pixels show one surface (for 'Warping' and the background)."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.stages.background import Background
from gffe_cl.engine.stages.base import Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

_COLLECTING = {
    "levels_state": "background.state",
    "keys": "background.level_keys",
    "winners": "background.level_winners",
}


class Connectivity(NearestStage):
    """Links pixels of one surface that are equally static or dynamic, and shows the background those whose color
    cannot hold another one's."""

    name = "connectivity"
    needs_footprints = True
    buffers = (
        BufferSpec(
            "links", np.uint8, (), "source", "neighbors of the same surface: 1 right, 2 down, 4 left, 8 up", "label"
        ),
    )
    kernels = (
        Kernel(
            "find_links",
            "source",
            {"depth": "rendered.depth", "dynamic_mask": "history.dynamic_mask", "last_stir": "history.last_stir"},
            {"links": "connectivity.links"} | _COLLECTING,
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        board.facts["collects"] = Background.is_wanted(board.options)
        super().__init__(board)

    def rendered(self, step: Step) -> None:
        self.launch("find_links", step)
