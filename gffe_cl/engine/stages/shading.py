"""Shading between frames, for the shading correction network (paper: 'Shading Correction Network'): the warped previous
frame, slow changes of light that go on, and the flow of shading."""

from __future__ import annotations

import numpy as np
import pyopencl as cl

from gffe_cl.engine.inference.layers import CANDIDATE_PLANES
from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.memory import HostView

# Inputs of kernels that look up the previous rendered frame at pixels of the new one (warped_previous.h).
SEEN = {
    "color": "frame.color",
    "depth": "frame.depth",
    "out_motion": "frame.motion",
    "is_dynamic": "frame.dynamic",
    "disoccluded": "frame.disoccluded",
    "motion": "rendered.motion",
    "color_prev": "previous.color",
    "depth_prev": "previous.depth",
}


class ShadingInputs(Stage):
    """Warps the previous rendered frame backward to t + α, replaces ghosts, makes the input mask, and estimates the
    error of each pixel of the new frame before shading correction.

    The network's own inputs come from the same functions, without the images at full size. The expected error follows
    from contrast, from the change since t − 1 at the surface, and from the stage that filled the pixel.
    """

    name = "shading"
    paper = "Shading Correction Network"
    buffers = (
        BufferSpec(
            "warped_previous", np.float16, ("R", "G", "B", "valid"), "target", "frame t−1 warped backward to t + α"
            " (I^w); valid = 0: hidden then, GAE color instead", "color",
        ),
        BufferSpec("input_mask", np.float16, (), "target", "1 dynamic, 0 disoccluded, 0.5 the rest (M^input)"),
        BufferSpec(
            "expected_error", np.uint8, (), "target", "expected root-mean-square error of display values, in quarters"
            " of an 8-bit level",
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "prepare_inputs",
            "target",
            SEEN,
            {"warped_previous": "shading.warped_previous", "input_mask": "shading.input_mask"},
        ),
        Kernel(
            "expect_error",
            "target",
            {
                **{name: f"frame.{name}" for name in ("color", "disoccluded", "filled_by")},
                "warped_previous": "shading.warped_previous",
            },
            {"expected_error": "shading.expected_error"},
            step=("LANES", 1),
        ),
    )
    is_looked_at = True

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.shading_inputs or options.expected_error

    def look_at(self, names: set[str] | None) -> None:
        own = {f"{self.name}.{spec.name}" for spec in self.buffers}
        self.is_looked_at = names is None or self.board.options.expected_error or not own.isdisjoint(names)

    def extrapolated(self, step: Step) -> None:
        """Fill the buffers. After a reset everything is GAE color."""
        if self.is_looked_at:
            self.launch("prepare_inputs", step)
            self.launch("expect_error", step)


_SHADING_TREND_CONSTANTS = constants("shading_trend.cl")
_CHANGES = _SHADING_TREND_CONSTANTS["CHANGES"]
TREND_PLANES = 8  # of `ShadingTrend`'s `trends`


class ShadingTrend(Stage):
    """Change of encoded color on static surfaces from t − 1 to t, averaged over wide areas, and from t − 2 to t − 1;
    both carried on to t + α. A change that both share is likely to continue.

    Changes are of encoded color (see `ShadingCorrection`) between a pixel and where its surface was, static and shown,
    in the frame before; cells around count the less the farther away they are, none farther than `reach_of`.

    `is_still`: whether there is nothing for the network to correct, because in no tile of 32×32 pixels more than 8 of
    64 samples move or change by more than 1/256 (encoded). False after a reset, and without a focus mask, where the
    network makes the whole image. The device decides while it works on the rendered frame; `submit` does not wait. The
    host reads the decision where it is about to wait for the network anyway, behind all other work on the new frame.
    Where the network runs on the device (`Convolutions`) the host never does, and `is_still` is False: kernels see the
    decision themselves.
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
    return max(1, height // _SHADING_TREND_CONSTANTS["SPACING_SHARE"])


_SHADING_FLOW_CONSTANTS = constants("shading_flow.cl")
_LEVELS, _STEPS, _DIFFERENCES = (_SHADING_FLOW_CONSTANTS[name] for name in ("FLOW_LEVELS", "FLOW_STEPS", "DIFFERENCES"))
assert _SHADING_FLOW_CONSTANTS["CANDIDATES"] == CANDIDATE_PLANES


def _tiled(name: str, grid: str, reads: dict, writes: dict) -> Kernel:
    """Return a kernel whose work-groups work in local memory on tiles of a grid."""
    return Kernel(name, grid, reads, writes, group="TILE_WIDTH", group_rows="TILE_HEIGHT")


class ShadingFlow(Stage):
    """Finds the flow from the extrapolated frame into the warped previous one, by least squares (Lucas and Kanade,
    1981), coarse to fine, over encoded brightness; and makes the network's inputs from flow and trend.

    Level l of a pyramid has 1/2^l of the sides of the network's frames; level 1, the finest, is a quarter of the
    display. Sums are over some 6×6 pixels of each level. The flow of every second pixel is found.
    """

    name = "shading_flow"
    buffers = (
        BufferSpec(
            "colors", np.float32, (), "network1", "encoded GAE color at a quarter of the resolution",
            planes=3, scratch=True,
        ),
        BufferSpec(
            "brightness0", np.float32, (), "network", "mean code of the GAE frame (1) and of the warped previous one"
            " (2), half resolution", planes=2, scratch=True,
        ),
        *(
            BufferSpec(
                f"brightness{level}", np.float32, (), f"network{level}", "mean code of the GAE frame (1) and of the"
                f" warped previous one (2), level {level}", planes=2, scratch=True,
            )
            for level in range(1, _LEVELS + 1)
        ),
        *(
            BufferSpec(
                f"flow{level}", np.float32, (), f"network{level}", "flow from the GAE frame into the warped previous"
                f" one, x (1) and y (2), in pixels of level {level - 1}", planes=2, scratch=level > 2,
            )
            for level in range(2, _LEVELS + 2)
        ),
        BufferSpec(
            "texture", np.float32, (), "network1", "how far detail of brightness within 2×2 pixels of half the"
            " resolution is that of the previous frame, 0 to 1: texture of the surface",
        ),
        BufferSpec("begun", np.float32, (), "network2", "the flow between steps, of any level", planes=2, scratch=True),
        BufferSpec(
            "no_flow", np.float32, (), f"network{_LEVELS + 1}", "zeros, with which it begins", planes=2, scratch=True
        ),
        BufferSpec(
            "differences", np.float32, (), "network2", "mean squared difference of brightness nearby: in place (1) and"
            " along the flow (2); of its change from the previous interval's change: in place (3) and along the"
            " flow (4)",
            planes=_DIFFERENCES,
        ),
        BufferSpec(
            "followed", np.float32, (), "network1", "1 where the image follows the flow: this explains the last"
            " interval, and motion vectors do not",
        ),
        BufferSpec(
            "candidates", np.float32, (), "network1", "inputs of the network in addition to its frames: flow / 4"
            " (1, 2), 4 × root of both differences (3, 4) and their ratio (5), 4 × change along the flow until t + α"
            " (6–8), 4 × trends (9–12),"
            " 4 × difference of brightness (13), agreement with the previous trend (14), valid share (15), α (16)",
            planes=CANDIDATE_PLANES, mapped=True,
        ),
    )  # fmt: skip
    kernels = (
        Kernel(
            "halve_frames",
            "network1",
            {"frames": "network_input.frames"},
            {
                "colors": "shading_flow.colors",
                "brightness0": "shading_flow.brightness0",
                "brightness": "shading_flow.brightness1",
                "texture": "shading_flow.texture",
            },
            step=("LANES", 1),
        ),
        Kernel(
            "halve_brightness",
            "network3",
            {"brightness1": "shading_flow.brightness1", "brightness2": "shading_flow.brightness2"},
            {"brightness2": "shading_flow.brightness2", "brightness3": "shading_flow.brightness3"},
            step=("LANES", 1),
        ),
        _tiled(
            "step_flow",
            "network{coarser}",
            {"brightness": "shading_flow.brightness{level}", "begun": "shading_flow.{from}"},
            {"flow": "shading_flow.{to}"},
        ),
        _tiled(
            "find_differences",
            "network2",
            {
                "brightness": "shading_flow.brightness1",
                "coarser": "shading_flow.brightness2",
                "flow": "shading_flow.flow2",
                "trends": "shading_trend.trends",
            },
            {"differences": "shading_flow.differences"},
        ),
        _tiled(
            "find_followed",
            "network1",
            {
                "frames": "network_input.frames",
                "brightness": "shading_flow.brightness0",
                "flow": "shading_flow.flow2",
                "changed": "shading_trend.changed",
            },
            {"followed": "shading_flow.followed"},
        ),
        Kernel(
            "find_candidates",
            "network1",
            {
                "colors": "shading_flow.colors",
                "brightness": "shading_flow.brightness1",
                "flow": "shading_flow.flow2",
                "differences": "shading_flow.differences",
                "trends": "shading_trend.trends",
            },
            {"candidates": "shading_flow.candidates"},
            step=("LANES", 1),
        ),
    )

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.corrects_shading

    def extrapolated(self, step: Step) -> None:
        """Find the flow, coarsest level first, and fill `candidates`; nothing after a reset and in still frames."""
        if step.previous is None or self.board.stages[ShadingTrend.name].is_still:
            return
        self.launch("halve_frames", step)
        self.launch("halve_brightness", step)
        begun = "no_flow"
        for level in range(_LEVELS, 0, -1):
            for number in range(_STEPS):
                made = "begun" if (_STEPS - number) % 2 == 0 else f"flow{level + 1}"
                doubles = int(number == 0 and level < _LEVELS)
                given = {"level": level, "coarser": level + 1, "doubles": doubles, "from": begun, "to": made}
                self.launch("step_flow", step, **given)
                begun = made
        self.launch("find_differences", step)
        if self.board.options.image_flow:
            self.launch("find_followed", step)
        self.launch("find_candidates", step)
