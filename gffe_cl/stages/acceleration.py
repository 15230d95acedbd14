"""Acceleration of movers, for their prediction (beyond the paper: 'Position estimation')."""

from __future__ import annotations

from typing import Any

import numpy as np

from gffe_cl.buffers import BufferSpec
from gffe_cl.opencl.program import constants
from gffe_cl.stage import Access, Kernel, Stage, Step, reprojection

_CELLS = f"level{constants('cells.h')['CELL'].bit_length() - 1}"


class Acceleration(Stage):
    """How movers' velocity changes, in cells of 4×4 pixels, and how far that has lasted: prediction adds what has."""

    name = "acceleration"
    buffers = (
        BufferSpec(
            "velocity",
            np.float32,
            ("x", "y", "z", "depth"),
            _CELLS,
            "mean velocity of a cell's nearest mover, world units per interval in the view space of the rendered"
            " camera, and its view depth; 0: no mover",
            "world",
            kept=True,
        ),
        BufferSpec(
            "acceleration",
            np.float32,
            ("x", "y", "z", "trust"),
            _CELLS,
            "half the change of that velocity, world units per interval squared, and how much of it counts, 0 to 1;"
            " −1: not known",
            "world",
            kept=True,
        ),
    )
    kernels = (
        Kernel(
            "track_acceleration",
            _CELLS,
            {
                "depth": Access("rendered.depth", "dynamic"),
                "motion": Access("rendered.motion", "dynamic"),
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": Access("history.met_depth", "dynamic"),
                "velocity_prev": Access("acceleration.velocity'", "dynamic"),
                "acceleration_prev": Access("acceleration.acceleration'", "dynamic"),
            },
            {"velocity": "acceleration.velocity", "acceleration": "acceleration.acceleration"},
        ),
    )

    @classmethod
    def is_wanted(cls, options: Any) -> bool:
        return options.motion and options.acceleration and options.order == 1

    def rendered(self, step: Step) -> None:
        before = step.previous or step.frame
        intervals = -np.diff(step.times[:3])
        self.launch(
            "track_acceleration",
            ratio=intervals[0] / intervals[1] if len(intervals) > 1 else 1.0,
            to_previous=reprojection(step.frame.camera, before.camera),
            from_previous=reprojection(before.camera, step.frame.camera),
        )
