"""Warp with crack closing and sub-pixel resampling (paper: 'Warping')."""

from __future__ import annotations

import numpy as np

from gffe_cl.camera import Camera
from gffe_cl.opencl.device import Device
from gffe_cl.stage import RGBA, XY, BufferSpec, NearestStage, Sizes, Stage, int2, zoom

BY_HOLE_FILLING = 255  # in `filled_by`
FILLED_BY = (
    (0, "its own fragment"),
    *((1 + level, f"background level {level}") for level in range(4)),
    (254, "crack closing"),
    (BY_HOLE_FILLING, "hole filling"),
)


class Warp(NearestStage):
    """Splats every fragment's footprint, nearest first, and resamples the rendered frame."""

    name = "warp"
    buffers = (
        BufferSpec(
            "links", np.uint8, (), "source", "neighbours of the same surface: 1 right, 2 down, 4 left, 8 up", "label"
        ),
        BufferSpec("color", np.float16, RGBA, "target", "colour of the extrapolated frame (Ī^GAE)", "color"),
        BufferSpec("depth", np.float32, (), "target", "view depth in the target camera, world units (D̄)", "depth"),
        BufferSpec("motion", np.float32, XY, "target", "t + α → t, pixels, into the rendered image (V̄)", "motion"),
        BufferSpec("dynamic", np.uint8, (), "target", "1 where the fragment shown is dynamic", "mask"),
        BufferSpec("disoccluded", np.uint8, (), "target", "1 where no fragment of the rendered frame lands", "mask"),
        BufferSpec("filled_by", np.uint8, (), "target", "what the pixel comes from", "label", labels=FILLED_BY),
        BufferSpec(
            "mixed",
            np.uint8,
            (),
            "target",
            "1 where the fragment's colour was mixed with a silhouette's that moves away, and its neighbour's is shown",
            "mask",
        ),
    )

    def __init__(self, device: Device, sizes: Sizes, close_cracks: bool = True, int64: bool | None = None):
        """`int64`: use 64-bit atomics; None: if the device has them."""
        super().__init__(device, sizes, int64)
        self.close_cracks = close_cracks
        self._keys = self.key_buffers(sizes.target[0] * sizes.target[1])

    def link(self, frame, history: Stage) -> None:
        """Find the surfaces of a rendered frame; once per rendered frame."""
        self.launch(
            "link_surfaces",
            self.sizes.source,
            *int2(self.sizes.source),
            frame.depth,
            history.buffer["dynamic_mask"],
            self.buffer["links"],
        )

    def warp(self, frame, history: Stage, prediction: Stage, target: Camera) -> None:
        sizes = (*int2(self.sizes.source), *int2(self.sizes.target))
        target_position = prediction.buffer["target_position"]
        self.clear_keys(self._keys, self.sizes.target)
        for splat_pass in self.passes:
            self.launch(
                "splat",
                self.sizes.source,
                *sizes,
                np.int32(self.close_cracks),
                np.int32(splat_pass),
                zoom(frame.camera, target),
                frame.depth,
                self.buffer["links"],
                target_position,
                *self._keys,
            )
        self.launch(
            "resolve",
            self.sizes.target,
            *sizes,
            zoom(frame.camera, target),
            *self._keys,
            frame.color,
            frame.depth,
            history.buffer["dynamic_mask"],
            self.buffer["links"],
            target_position,
            *(self.buffer[n] for n in ("color", "depth", "motion", "dynamic", "disoccluded", "filled_by", "mixed")),
        )
