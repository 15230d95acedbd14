"""Order of the stages, all of them on a board, and their results, kept on request."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from types import EllipsisType
from typing import Any

import pyopencl as cl

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.background import Background, Projection
from gffe_cl.engine.stages.base import Board, Stage, pictures_of
from gffe_cl.engine.stages.buffers import BufferSpec, Owner, Sizes
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.history import Acceleration, HistoryTracking, Lattices, PositionPrediction
from gffe_cl.engine.stages.holes import FILLINGS, HiddenParts, HoleFilling
from gffe_cl.engine.stages.measures import SceneCuts, UserInterface
from gffe_cl.engine.stages.network import Convolutions, NetworkInput
from gffe_cl.engine.stages.shading import ShadingFlow, ShadingInputs, ShadingTrend
from gffe_cl.engine.stages.silhouettes import Detail, Silhouettes
from gffe_cl.engine.stages.warp import BackwardBlocks, ColorCode, Connectivity, DilatedWarp, Warp
from gffe_cl.engine.upscaling.stage import Upscaling

# In the order in which they work, on rendered frames and on new ones.
STAGES: tuple[type[Stage], ...] = (
    UserInterface,
    SceneCuts,
    Lattices,
    HistoryTracking,
    Acceleration,
    Connectivity,
    PositionPrediction,
    BackwardBlocks,
    ColorCode,
    Warp,
    DilatedWarp,
    HiddenParts,
    Background,
    Projection,
    HoleFilling,
    Silhouettes,
    ShadingInputs,
    NetworkInput,
    ShadingTrend,
    ShadingFlow,
    Convolutions,
    ShadingCorrection,
    Detail,
    Upscaling,
)


def stages_of(options: Options) -> list[type[Stage]]:
    """Return the stages that the options ask for, in order."""
    chosen = (FILLINGS[options.hole_filling] if stage is HoleFilling else stage for stage in STAGES)
    wanted = [stage for stage in chosen if stage and stage.is_wanted(options)]
    return [stage for stage in wanted if options.warps_footprints or not stage.needs_footprints]


def board_of(device: Device, sizes: Sizes, options: Options, int64: bool | None) -> Board:
    """Return a board with all stages that the options ask for, and their buffers. `int64` is that of `Board`."""
    board = Board(device, sizes, options, int64)
    with ExitStack() as on_failure:
        on_failure.callback(board.let_go)
        for stage in stages_of(options):
            stage(board)
        board.memory.place()
        _ = board.frame  # made when it is first asked for
        on_failure.pop_all()
    return board


class Output(Owner):
    """Copy of a stage's result in the buffers of the extrapolated frame."""

    def __init__(self, stage: Stage, specs: Iterable[BufferSpec]):
        super().__init__(stage.device, stage.sizes)
        self.name, self.buffers = stage.name, tuple(specs)

    def choose(self, names: set[str]) -> None:
        """Keep the buffers `names` from now on, and no others."""
        specs = [spec for spec in self.buffers if spec.name in names and spec.name not in self.buffer]
        self.buffer = {name: b for name, b in self.buffer.items() if name in names} | self.allocate(specs)

    def keep(self, of: Mapping[str, cl.Buffer]) -> None:
        """Enqueue copies of the chosen buffers."""
        for name, buffer in self.buffer.items():
            cl.enqueue_copy(self.device.queue, buffer, of[name])


class Outputs:
    """Outputs of the `stages` on `board`: `kept` are those that are kept, by stage."""

    def __init__(self, board: Board, stages: Mapping[str, Stage]):
        self._board, self._stages = board, stages
        self.kept: dict[str, Output] = {}
        self._pictures = pictures_of(stages.values())
        self._wanted: set[str] | EllipsisType | None = ...  # not chosen yet

    def available(self) -> Iterator[tuple[str, BufferSpec]]:
        """Yield what `Pipeline.outputs` does."""
        writers = [(stage.name, name) for stage in self._stages.values() for name in stage.outputs()]
        several = {name for name, count in Counter(name for _, name in writers).items() if count > 1}
        for stage, name in writers:
            if name in several:
                spec = self._board.frame.spec(name)
                yield stage, replace(spec, description=f"{spec.description}, as the stage '{stage}' left it")

    def held(self, others: Iterable[Any]) -> Iterator[tuple[Owner, BufferSpec]]:
        """Yield the buffers that hold the present frame, with their owners: of the frame, the stages, their outputs,
        and of `others` (None: nothing)."""
        yield from ((self._board.frame, spec) for spec in self._board.frame.buffers)
        for stage in self._stages.values():
            yield from ((stage, spec) for spec in stage.buffers if not spec.scratch)
            if output := self.kept.get(stage.name):
                yield from ((output, output.spec(name)) for name in output.buffer)
        for other in filter(None, others):
            yield from ((other, spec) for spec in other.held())

    def keep(self, stage: Stage) -> None:
        """Enqueue copies of the results of a stage that has worked."""
        if output := self.kept.get(stage.name):
            output.keep(self._board.frame.buffer)

    def picture(self, occasion: str) -> cl.Buffer | None:
        """Return the result of the last stage that makes a picture on `occasion`, None if no stage does."""
        found = self._pictures.get(occasion)
        return self._board.buffer(*found.split(".")) if found else None

    def choose(self, wanted: set[str] | None) -> None:
        """Keep the outputs `wanted` (None: all) from the next frame on, and no others."""
        if wanted == self._wanted:
            return
        self._wanted = wanted if wanted is None else set(wanted)
        self._board.bindings.forget_scripts()
        for stage in self._stages.values():
            stage.look_at(wanted)
        found: dict[str, list[BufferSpec]] = {}
        for stage, spec in self.available():
            found.setdefault(stage, []).append(spec)
        for stage, specs in found.items():
            chosen = {spec.name for spec in specs if wanted is None or f"{stage}.{spec.name}" in wanted}
            if chosen:
                self.kept.setdefault(stage, Output(self._stages[stage], specs)).choose(chosen)
            else:
                self.kept.pop(stage, None)
