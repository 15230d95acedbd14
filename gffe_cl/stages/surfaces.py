"""Surfaces of a rendered frame: which neighbouring pixels show one surface (for 'Warping' and the background)."""

from __future__ import annotations

import numpy as np

from gffe_cl.buffers import BufferSpec
from gffe_cl.stage import Kernel, Stage, Step


class Surfaces(Stage):
    """Links pixels of one surface that are equally static or dynamic, and tells those that show nothing of another."""

    name = "surfaces"
    buffers = (
        BufferSpec(
            "links", np.uint8, (), "source", "neighbours of the same surface: 1 right, 2 down, 4 left, 8 up", "label"
        ),
        BufferSpec(
            "unmixed", np.uint8, (), "source", "1 where no pixel within 2 px is dynamic or nearer: the background may"
            " collect its colour", "mask",
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "find_surfaces",
            "source",
            {"depth": "rendered.depth", "dynamic_mask": "history.dynamic_mask"},
            {"links": "surfaces.links", "unmixed": "surfaces.unmixed"},
            step=("LANES", 1),
        ),
    )

    def rendered(self, step: Step) -> None:
        self.launch("find_surfaces")
