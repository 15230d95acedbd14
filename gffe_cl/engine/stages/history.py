"""History tracking with the static test (paper: 'Motion estimation', appendix Algorithm 1)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.stages.base import Access, Board, Kernel, Stage, Step, share_of
from gffe_cl.engine.stages.buffers import CUT_SAMPLES, RESIDUAL_STRIDE, BufferSpec
from gffe_cl.engine.stages.color_code import CODED_AT_ONCE
from gffe_cl.engine.stages.scene_cuts import SceneCuts

_CONSTANTS = constants("history.cl")
_SAMPLED = RESIDUAL_STRIDE**-2
_CUTS = CUT_SAMPLES[0] * CUT_SAMPLES[1] / (1920 * 1080)  # of the pixels at 1080p: the samples are as many at any size
_CLASSES = ("x", "negative_x", "y", "negative_y")
STATIC, DYNAMIC, FIXED_TO_CAMERA = (_CONSTANTS[name] for name in ("STATIC", "DYNAMIC", "FIXED_TO_CAMERA"))


DYNAMIC_PIXELS = share_of("dynamic", "history.dynamic_mask")
QUANTIZED_SAMPLES = share_of("quantized", "history.motion_steps", lambda steps: np.any(steps) * _SAMPLED)


class HistoryTracking(Stage):
    """Tracks which fragments move, and where they were in the frames before."""

    name = "history"
    buffers = (
        BufferSpec(
            "dynamic_mask",
            np.uint8,
            (),
            "source",
            "where the static test failed (M^dyn), and camera-fixed fragments",
            "label",
            labels=((STATIC, "static"), (DYNAMIC, "dynamic"), (FIXED_TO_CAMERA, "fixed to the camera")),
        ),
        BufferSpec(
            "met_depth",
            np.float32,
            (),
            "source",
            "view depth in the frame before of a dynamic fragment's surface, where its motion points to (gives P_1);"
            " 0: static, or not known",
            "depth",
            known_where=("dynamic_mask", 1),
        ),
        BufferSpec(
            "history",
            np.float32,
            ("x", "y", "z", "known"),
            "source",
            "for k > 2 only: positions P_1 … P_{k−1} of dynamic fragments in the view space of the rendered camera,"
            " world units; known = 0: static, or P_0 instead",
            "world",
            known_where=("dynamic_mask", 1),
        ),
        BufferSpec(
            "last_stir",
            np.int32,
            (),
            "source_blocks",
            "number of the last rendered frame in which something moved within 2 px of a block",
            scratch=True,
        ),
        BufferSpec("static_threshold_squared", np.float32, (), "once", "ε², px²"),
        BufferSpec(
            "motion_steps",
            np.float32,
            _CLASSES,
            "once",
            "steps of quantized motion vectors by component and sign, px; 0: not quantized",
        ),
        BufferSpec(
            "quantization_error",
            np.float32,
            _CLASSES,
            "once",
            "largest error of quantized motion vectors by component and sign, px; ε is added to it; 0: not quantized",
        ),
        BufferSpec(
            "residual_histogram",
            np.int32,
            tuple(f"bin{b}" for b in range(_CONSTANTS["RESIDUAL_BINS"])),
            "once",
            "squared static residual, and its squared change over 8 px, two bins per octave; steps of motion by"
            " component and sign, eight bins per octave",
            planes=_CONSTANTS["HISTOGRAMS"],
        ),
        BufferSpec(
            "pending",
            np.int32,
            (),
            "once",
            "the histograms while they are counted, and how many work-groups have added to them",
            planes=_CONSTANTS["HISTOGRAMS"] * _CONSTANTS["RESIDUAL_BINS"] + 1,
            scratch=True,
        ),
    )
    kernels = (
        Kernel(
            "measure_samples",
            "measures",
            {
                "color": Access("rendered.color", 4 * _CUTS),
                "depth": Access("rendered.depth", _SAMPLED + _CUTS),
                "motion": Access("rendered.motion", _SAMPLED + _CUTS),
                "color_prev": Access("previous.color", 4 * _CUTS),
                "depth_prev": Access("previous.depth", 4 * _CUTS),
                "pending": "history.pending",
            },
            {
                "cut_counts": "scene_cuts.counts",
                "pending": "history.pending",
                "histogram": "history.residual_histogram",
                "threshold_squared": "history.static_threshold_squared",
                "motion_steps": "history.motion_steps",
            },
            step=("LANES", "RESIDUAL_ROWS"),
            group="COUNT_GROUP",
        ),
        Kernel(
            "refine_threshold",
            "residuals",
            {
                "depth": Access("rendered.depth", QUANTIZED_SAMPLES),
                "motion": Access("rendered.motion", QUANTIZED_SAMPLES),
                "pending": "history.pending",
                "motion_steps": "history.motion_steps",
            },
            {
                "pending": "history.pending",
                "threshold_squared": "history.static_threshold_squared",
                "quantization_error": "history.quantization_error",
            },
            step=("LANES", "RESIDUAL_ROWS"),
            group="COUNT_GROUP",
        ),
        Kernel(
            "track_history",
            "source",
            {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "depth_prev": Access("previous.depth", DYNAMIC_PIXELS),
                "dynamic_prev": Access("history.dynamic_mask'", DYNAMIC_PIXELS, planes=0),
                "history_prev": Access("history.history'", DYNAMIC_PIXELS, planes=0),
                "threshold_squared": "history.static_threshold_squared",
                "quantization_error": "history.quantization_error",
                "color": Access("rendered.color", CODED_AT_ONCE),
            },
            {
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": Access("history.met_depth", DYNAMIC_PIXELS),
                "history": Access("history.history", DYNAMIC_PIXELS),
                "last_stir": Access("history.last_stir", DYNAMIC_PIXELS),
                "codes": Access("color_code.codes", CODED_AT_ONCE),
            },
            step=("LANES", 1),
        ),
    )

    def __init__(self, board: Board):
        self.positions = board.facts["positions"] = board.options.history
        self.detects = board.facts["detects"] = SceneCuts.name in board.stages
        if not self.detects:  # it counts nothing for them
            measure, *others = self.kernels
            nothing: dict[str, Any] = {"cut_counts": Access("history.pending", planes=0)}
            self.kernels = (replace(measure, writes={**measure.writes, **nothing}), *others)
        if self.positions > 2:  # only then are positions stored, and is anything kept of the frame before
            *others, track = self.kernels
            planes = {"dynamic_prev": 1, "history_prev": self.positions - 2}
            declared: Any = track.reads  # these two are no plain names
            reads = {name: replace(declared[name], planes=count) for name, count in planes.items()}
            self.kernels = (*others, replace(track, reads={**track.reads, **reads}))
            changes: dict[str, dict[str, Any]] = {
                "dynamic_mask": {"kept": True},
                "history": {"kept": True, "planes": self.positions - 1},
            }
        else:
            changes = {"history": {"grid": "once", "scratch": True, "known_where": None}}
        self.buffers = tuple(replace(spec, **changes.get(spec.name, {})) for spec in self.buffers)
        super().__init__(board)
        threshold = board.options.static_threshold
        self.automatic = board.facts["automatic"] = threshold is None and board.options.motion
        self._measured: object | None = None  # the key of the last step whose samples were measured
        if threshold is not None:
            self.upload("static_threshold_squared", np.array([threshold**2], np.float32))

    def measure(self, step: Step) -> None:
        """Count the samples of a cut, and find the automatic threshold, of a rendered frame with a previous one, unless
        that is done."""
        if self._measured is not step.key and (self.automatic or self.detects):
            self._measured = step.key
            self.launch("measure_samples", step)

    def rendered(self, step: Step) -> None:
        """Run Algorithm 1. Without a previous frame, or without motion estimation, everything is static."""
        previous = step.previous if self.board.options.motion else None
        before = previous or step.frame
        if self.automatic and previous is not None:
            self.measure(step)
            self.launch("refine_threshold", step)
        kept = "'" if self.positions > 2 else ""  # else it reads nothing of them
        self.launch(
            "track_history",
            step,
            depth_prev=before.depth,
            dynamic_prev=self.own("dynamic_mask" + kept),
            history_prev=self.own("history" + kept),
        )
