"""Surfaces of a rendered frame: which neighbouring pixels show one surface (for 'Warping' and the background)."""

from __future__ import annotations

import numpy as np

from gffe_cl.buffers import BufferSpec
from gffe_cl.stage import Kernel, Stage, Step


class Surfaces(Stage):
    """Links pixels of one surface that are equally static or dynamic."""

    name = "surfaces"
    buffers = (
        BufferSpec(
            "links", np.uint8, (), "source", "neighbours of the same surface: 1 right, 2 down, 4 left, 8 up", "label"
        ),
    )
    kernels = (
        Kernel(
            "link_surfaces",
            "source",
            {"depth": "rendered.depth", "dynamic_mask": "history.dynamic_mask"},
            {"links": "surfaces.links"},
        ),
    )

    def rendered(self, step: Step) -> None:
        self.launch("link_surfaces")
