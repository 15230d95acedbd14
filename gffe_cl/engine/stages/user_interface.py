"""Detection of a user interface in the color of rendered frames: of what stays in place although vectors move it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyopencl as cl

from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec, DeviceFrame


class UserInterface(Stage):
    """Finds pixels that stay in place although vectors move them, and adds them to `Overlays.fixed_mask`.

    The evidence is that of the frames since the last reset.
    """

    name = "user_interface"
    buffers = (
        BufferSpec("evidence", np.uint8, (), "source", "pairs of frames in which the color stayed in place", "scalar"),
        BufferSpec("mask", np.uint8, (), "source", "1 where the rendered pixel stays in place, given or found", "mask"),
    )
    kernels = (
        Kernel(
            "count_evidence",
            "source",
            {
                "color": "rendered.color",
                "color_prev": "previous.color",
                "depth": "rendered.depth",
                "depth_prev": "previous.depth",
                "motion": "rendered.motion",
                "evidence": "user_interface.evidence",
            },
            {"evidence": "user_interface.evidence"},
        ),
        Kernel(
            "mark_user_interface",
            "source",
            {"evidence": "user_interface.evidence", "given_mask": "user_interface.mask"},
            {"mask": "user_interface.mask"},
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.ui_detection

    def found(
        self,
        layers: Mapping[str, np.ndarray | cl.Buffer],
        frame: DeviceFrame,
        previous: DeviceFrame | None,
        exposure: float,
    ) -> dict[str, np.ndarray | cl.Buffer]:
        """Return the layers of `frame`, as of `Composition.prepared`, with what was found in `fixed_mask`. `previous`:
        the frame before, None after a reset. Both have all of their depth."""
        given = layers.get("fixed_mask")
        if isinstance(given, np.ndarray):
            cl.enqueue_copy(self.device.queue, self.buffer["mask"], given)
            given = self.buffer["mask"]
        before = previous or frame
        brought = {"has_overlays": given is not None}
        step = Step(frame, previous, [frame.time], exposure=exposure, given=brought)
        self.launch(
            "count_evidence", step, color=frame.color, color_prev=before.color, depth=frame.depth,
            depth_prev=before.depth, motion=frame.motion,
        )  # fmt: skip
        self.launch("mark_user_interface", step, given_mask=self.buffer["mask"] if given is None else given)
        return {**layers, "fixed_mask": self.buffer["mask"]}
