"""Connectivity of a rendered frame: which neighboring pixels show one surface (for 'Warping' and the background)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gffe_cl.engine.stages.background import OPEN, PUSHED, Background
from gffe_cl.engine.stages.base import Access, Board, Kernel, NearestStage, Step
from gffe_cl.engine.stages.buffers import BufferSpec

_COLLECTING = {
    "state": Access("background.state_0"),
    "fill_keys": Access("background.even_keys", OPEN),
    "fill_winners": Access("background.even_winners", OPEN),
    "push_keys": Access("background.odd_keys", PUSHED),
    "push_winners": Access("background.odd_winners", PUSHED),
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
            group="GROUP",
        ),
    )

    def __init__(self, board: Board):
        self.collects = Background.is_wanted(board.options)
        board.facts["collects"] = self.collects
        if not self.collects:  # it writes nothing of them
            (find,) = self.kernels
            nothing = dict.fromkeys(_COLLECTING, Access("connectivity.links", planes=0))
            self.kernels = (replace(find, writes={**find.writes, **nothing}),)
        super().__init__(board)

    def rendered(self, step: Step) -> None:
        self.launch("find_links", step)
