"""Trend of shading: slow changes of light, found in the last two intervals and continued. Beyond the paper: a
candidate of the shading correction network."""

from __future__ import annotations

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.host_view import HostView

_CONSTANTS = constants("shading_trend.cl")
_CHANGES = _CONSTANTS["CHANGES"]
TREND_PLANES = 8  # of `ShadingTrend`'s `trends`


class ShadingTrend(Stage):
    """Change of encoded color on static surfaces from t − 1 to t, averaged over wide areas, and from t − 2 to t − 1;
    both carried on to t + α. A change that both share is likely to continue.

    Changes are of encoded color (see `ShadingCorrection`) between a pixel and where its surface was, static and shown,
    in the frame before; cells around count the less the farther away they are, none farther than `reach_of`.

    `is_still`: whether there is nothing for the network to correct, because in no tile of 32×32 pixels more than 8 of
    64 samples move or change by more than 1/256 (encoded). False after a reset, and without a focus mask, where the
    network makes the whole image. The device decides while it works on the rendered frame; `submit` does not wait. The
    host reads the decision where it is about to wait for the network anyway, behind all other work on the new frame: in
    the network's thread, where that runs beside the device (`ShadingCorrection.begin`). Where the network runs on the
    device (`Convolutions`) the host never does, and `is_still` is False: kernels see the decision themselves.
    """

    name = "shading_trend"
    kernels = (
        Kernel(
            "measure_changes",
            "cells",
            {
                "color": "rendered.color",
                "depth": "rendered.depth",
                "dynamic_mask": "history.dynamic_mask",
                "color_prev": "previous.color",
                "depth_prev": "previous.depth",
            },
            {
                "changes": "shading_trend.changes",
                "changed_samples": "shading_trend.changed_samples",
                "changed": "shading_trend.changed",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "find_trend",
            "cells",
            {
                "changes": "shading_trend.changes",
                "changed_samples": "shading_trend.changed_samples",
                "changed": "shading_trend.changed",
            },
            {"trend": "shading_trend.trend", "changed": "shading_trend.changed"},
            step=("LANES", 1),
        ),
        Kernel(
            "carry_trends",
            "network1",
            {
                "depth": "frame.depth",
                "trend": "shading_trend.trend",
                "trend_prev": "shading_trend.trend'",
                "changes_prev": "shading_trend.changes'",
            },
            {"trends": "shading_trend.trends"},
            step=("LANES", 1),
        ),
    )
    buffers = (
        BufferSpec(
            "changes", np.float32, (), "cells", "change of encoded color since t − 1 (1–3), and share of valid"
            " samples (4)", planes=_CHANGES, kept=True,
        ),
        BufferSpec(
            "changed_samples", np.uint8, (), "cells", "samples, of four in 8×8 pixels, that move or change by more than"
            " noise from t − 1 on",
        ),
        BufferSpec("changed", np.int32, (), "once", "1 where enough do, else there is nothing to correct", mapped=True),
        BufferSpec(
            "trend", np.float32, (), "cells", "mean change of encoded color around, from t − 1 to t (1–3), and"
            " valid share of the surroundings (4)", planes=_CHANGES, kept=True,
        ),
        BufferSpec(
            "trends", np.float32, (), "network1", "change of encoded color until t + α as the last interval has it"
            " (1–3), as the interval before has it (4–6), and valid share for the latter (7);"
            " change of brightness close by in the interval before (8); at a quarter of the resolution",
            planes=TREND_PLANES,
        ),
    )  # fmt: skip

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.corrects_shading or options.shading_inputs

    def __init__(self, board: Board):
        super().__init__(board)
        self._changed = HostView(self, "changed")
        self.never_still = False  # whether all work is to be done in any case
        self.host_decides = True  # whether the host reads the decision; else all work is enqueued
        self._known: list[cl.Event] = []  # complete when `_changed` can be read

    @property
    def is_still(self) -> bool:
        """Whether there is nothing to correct. Waits until the device has examined the rendered frame; work that was
        enqueued after that goes on."""
        for event in self._known:
            event.wait()
        changed = self._changed.array
        return changed is not None and not changed[0] and not self.never_still

    def rendered(self, step: Step) -> None:
        """Find the trend, and whether any light changes. After a reset there is none."""
        self.board.commands.call(self._close)
        if step.previous is None:
            self.fill("trend", 0)
            self.fill("changes", 0)
            return
        self.launch("measure_changes", step)
        self.launch("find_trend", step)
        options = self.board.options
        if self.host_decides and options.corrects_shading and options.focus_mask:
            self.board.commands.call(self._open)

    def _close(self) -> None:
        self._known = []
        self._changed.close()

    def _open(self) -> None:
        self._known = self._changed.open()

    def extrapolated(self, step: Step) -> None:
        """Carry both trends to the new frame, unless there is nothing to correct."""
        if not self.is_still:
            self.launch("carry_trends", step)


def spacing_of(height: int) -> int:
    """Return the distance between the cells around one that count, in an image of so many rows: at least one."""
    return max(1, height // _CONSTANTS["SPACING_SHARE"])
