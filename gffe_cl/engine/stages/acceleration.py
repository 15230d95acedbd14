"""Acceleration of movers, for their prediction (beyond the paper: 'Position estimation')."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pyopencl as cl

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Board, Kernel, Stage, Step
from gffe_cl.engine.stages.buffers import BufferSpec
from gffe_cl.engine.stages.pixel_formats import TRUSTED

_CELLS = f"level{constants('mover_grid.h')['MOVER_CELL'].bit_length() - 1}"


class Acceleration(Stage):
    """Tracks the change of movers' velocity in cells of 4×4 pixels, as far as it has lasted. Prediction adds the
    change, rotated as it rotated before and interpolated between cells."""

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
            packing=TRUSTED,
        ),
        BufferSpec(
            "bend",
            np.float32,
            ("x", "y", "z", "trust"),
            _CELLS,
            "change of that acceleration in the next interval, as far as it counts, and the same trust: positions gain"
            " α (α + 1) (trust · acceleration + (α + 2) / 3 · this); trust −1: the mover spins, and this is the"
            " velocity of its center",
            "world",
            kept=True,
            packing=TRUSTED,
        ),
        BufferSpec(
            "view_velocity",
            np.float32,
            ("x", "y", "z", "trust"),
            _CELLS,
            "mean velocity of that mover in view space, world units per interval; trust 1: the camera carries it, and"
            " it moves on there, not in the world",
            "world",
            kept=True,
            packing=TRUSTED,
        ),
    )
    kernels = (
        Kernel(
            "track_acceleration",
            _CELLS,
            {
                "depth": "rendered.depth",
                "motion": "rendered.motion",
                "dynamic_mask": "history.dynamic_mask",
                "met_depth": "history.met_depth",
                "velocity_prev": "acceleration.velocity'",
                "acceleration_prev": "acceleration.acceleration'",
                "bend_prev": "acceleration.bend'",
                "view_velocity_prev": "acceleration.view_velocity'",
            },
            {
                "velocity": "acceleration.velocity",
                "acceleration": "acceleration.acceleration",
                "bend": "acceleration.bend",
                "view_velocity": "acceleration.view_velocity",
            },
        ),
    )

    def allocate(self, specs: Iterable[BufferSpec]) -> dict[str, cl.Buffer]:
        """Return new device buffers by name. All are parts of one buffer, so that the history can be lent."""
        specs = list(specs)
        made = super().allocate(spec for spec in specs if not spec.part_of)
        for spec in specs:
            if spec.part_of:
                start, nbytes = self.starts[spec.name], spec.nbytes(self.sizes)
                made[spec.name] = self.board.memory.part(made["memory"], start, nbytes)
        return made

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        return options.motion and options.acceleration and options.order == 1

    def __init__(self, board: Board):
        self.starts, nbytes = {}, 0
        for spec in self.buffers:
            self.starts[spec.name] = nbytes
            nbytes += board.sizes.aligned(spec.nbytes(board.sizes))
        memory = BufferSpec("memory", np.uint8, (), "once", "of all", planes=nbytes, kept=True, scratch=True)
        self.buffers = (*(replace(spec, part_of="memory") for spec in self.buffers), memory)
        super().__init__(board)
        board.memory.lend(self, "memory'", at_once=True)

    def rendered(self, step: Step) -> None:
        self.launch("track_acceleration", step)
