"""Recorder of the stages' launches: the stages run while nothing is enqueued.

Launches name their grids, and numbers that change from frame to frame are members of the frame block. So the same is
launched for images of any size and in all circumstances; tests compare C with Python in others than those here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import OVERLAYS
from gffe_cl.engine.inference.network import OPENCL, load_network
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.outputs import stages_of
from gffe_cl.engine.stages.base import Board, FrameBlocks, Stage, Step, pictures_of
from gffe_cl.engine.stages.buffers import BufferSpec, DeviceFrame, Sizes
from gffe_cl.engine.stages.commands import Commands, Launch
from gffe_cl.engine.stages.correction import ShadingCorrection
from gffe_cl.engine.stages.measures import SceneCuts
from gffe_cl.engine.stages.presentation import Composition, Presentation
from gffe_cl.engine.stages.upload import Upload

MOST_PIXELS = 16384  # each way, of the images that C takes
# Rendered and extrapolated images: as wide as C takes them, for there are levels that others do not have.
_SIZES = Sizes((13003, 3), (MOST_PIXELS, 5))
_GEOMETRY = "depth", "motion"
_WITH_FIRST = "rendered", "extrapolated", "present"  # occasions that differ without a frame before


@dataclass(frozen=True)
class Given:
    """An argument of a launch, by its `name` there: the name of a `buffer`, the bytes of a `constant`, or the frame
    block."""

    name: str
    buffer: str | None = None
    constant: bytes | None = None
    is_frame_block: bool = False


@dataclass(frozen=True)
class Operation:
    """Enqueued operation: `kind` is "LAUNCH" of a `kernel` over a `grid`, so often as `repeats` says, with `arguments`,
    "FILL" of a buffer with a `byte`, as many of its texels as `grid` has, or "COPY" from `source`."""

    kind: str
    stage: str
    kernel: str = ""
    grid: str = "once"
    repeats: int = 1
    arguments: tuple[Given, ...] = ()
    buffer: str = ""
    byte: int = 0
    source: str = ""

    def buffers(self) -> set[str]:
        """Return the names of all buffers that the operation reads or writes."""
        return {name for name in (self.buffer, self.source, *(given.buffer for given in self.arguments)) if name}


@dataclass
class Launches:
    """Recorded operations by occasion: `operations["rendered"]` after a rendered frame, "rendered_first" after one
    without a previous frame, and so on (`_Rehearsal.perform`); the `buffers` by their full names, `initial` contents of
    those that are no images, memory that is `lent` while frames are extrapolated, and the stages in order."""

    operations: dict[str, list[Operation]]
    buffers: dict[str, BufferSpec]
    initial: dict[str, bytes]
    lent: set[str]
    stages: dict[str, Any]
    facts: Mapping[str, Any]


class _Tape(Commands):
    """Commands that are recorded, and not enqueued. `names` are those of the buffers, by identity."""

    def __init__(self):
        self.operations: list[Operation] = []
        self.names: dict[int, str] = {}

    def launch(self, stage: Stage, launch: Launch, given: Mapping[str, Any]) -> None:
        kernel, arguments = launch.declared, []
        values = stage.values(kernel, launch.slot, given)
        for argument in stage.program.arguments[kernel.name]:
            if argument.brings_frame:
                arguments.append(Given(argument.name, is_frame_block=True))
                continue
            value = argument.packed(values[argument.name])
            if isinstance(value, cl.Buffer):
                arguments.append(Given(argument.name, buffer=self._name(value)))
            else:
                arguments.append(Given(argument.name, constant=np.asarray(value).tobytes()))
        grid, repeats = kernel.grid.format(**given), values[kernel.repeats] if kernel.repeats else 1
        self.operations.append(Operation("LAUNCH", stage.name, kernel.name, grid, repeats, tuple(arguments)))

    def fill(self, stage: Stage, name: str, byte: int, grid: str) -> None:
        buffer = self._name(stage.buffer[name])
        self.operations.append(Operation("FILL", stage.name, grid=grid, buffer=buffer, byte=byte))

    def copy(self, stage: Stage, to: cl.Buffer, of: cl.Buffer) -> None:
        self.operations.append(Operation("COPY", stage.name, buffer=self._name(to), source=self._name(of)))

    def call(self, function: Callable[[], Any]) -> None:
        """Record nothing: the C host has its own code for that."""

    def take(self) -> list[Operation]:
        taken, self.operations = self.operations, []
        return taken

    def _name(self, buffer: cl.Buffer) -> str:
        return self.names[id(buffer)]


class _Rehearsal:
    """The stages, with a tape."""

    def __init__(self, device: Device, options: Options, int64: bool):
        self.tape = _Tape()
        self.board = Board(device, _SIZES, options, int64)
        chosen = {stage.name: stage for stage in stages_of(options)}
        self.stages: dict[str, Any] = {
            name: stage(self.board, load=False) if stage is ShadingCorrection else stage(self.board)
            for name, stage in chosen.items()
        }
        self.board.memory.place()
        others: dict[str, Any] = {stage.name: stage(self.board) for stage in (Presentation, Composition, Upload)}
        others[Upload.name].allocate_small()
        others[FrameBlocks.name] = self.board.blocks
        self.all = self.stages | others
        if correction := self.stages.get(ShadingCorrection.name):
            correction.use(load_network(options.scn_model, OPENCL))
        self.board.commands = self.tape

    def perform(self, first: bool) -> dict[str, list[Operation]]:
        """Return the operations of each occasion, after a frame or as of the `first` one."""
        step, composition, stages = self._step(first), self.all[Composition.name], self.stages.values()
        rendered, shown = replace(step, camera=None), self.board.device.buffer(1)
        # The frame with its full depth. For other stages, overlays fixed in place are removed from it.
        whole = replace(step.frame, depth=self.board.device.buffer(1))
        self.board.bindings.show(step.frame, step.previous)
        self._learn_names()
        self.tape.names |= {id(shown): "shown.color", id(whole.depth): "shown.depth"}
        composition.swap()  # `take` swaps, too
        composition.take({name: composition.buffer[name] for name in OVERLAYS}, whole)
        found = {"leave_out": self.tape.take()}
        composition.layers = {name: composition.buffer[name] for name in OVERLAYS}
        present, with_color = self.all[Presentation.name].present, "rendered" not in pictures_of(stages)
        for occasion, work in (
            ("cut", lambda: [stage.rendered(rendered) for stage in stages if stage.name == SceneCuts.name]),
            ("rendered", lambda: [stage.rendered(rendered) for stage in stages if stage.name != SceneCuts.name]),
            ("extrapolated", lambda: [stage.extrapolated(step) for stage in stages]),
            ("present", lambda: present(step.frame, step.previous, with_color=with_color)),
            ("compose", lambda: composition.compose(shown, step.alpha)),
            ("compose_rendered", lambda: composition.compose(shown, 0.0, rendered=True)),
            ("convert_color", lambda: self._convert(rendered, "color")),
            ("convert_geometry", lambda: self._convert(rendered, *_GEOMETRY)),
            ("convert_small", lambda: self._convert(rendered, *_GEOMETRY, is_small=True)),
            ("convert_dilated", lambda: self._convert(rendered, *_GEOMETRY, is_dilated=True)),
            ("convert_small_dilated", lambda: self._convert(rendered, *_GEOMETRY, is_small=True, is_dilated=True)),
        ):
            if occasion != "rendered":  # after "cut", which writes the block
                self.board.blocks.forget()
            work()
            found[occasion] = self.tape.take()
        return {f"{occasion}_first": found[occasion] for occasion in _WITH_FIRST} if first else found

    def _convert(self, step: Step, *names: str, is_small: bool = False, is_dilated: bool = False) -> None:
        width, height = (0, 0) if is_small else _SIZES.source
        step = replace(step, given={"geometry_width": width, "geometry_height": height})
        places = {name: (self._engine[name], 0) for name in names}
        self.all[Upload.name].convert_places(places, step.frame, step, is_dilated)

    def _step(self, first: bool) -> Step:
        """Return a step of any cameras and times."""
        cameras = [Camera(np.eye(4), 40.0 + k, 50.0, 8.0, 8.0) for k in range(5)]
        device = self.board.device
        frame, previous = (DeviceFrame.allocate(device, (1, 1), *cameras[k : k + 2], time=0.0) for k in (0, 2))
        return Step(frame, None if first else previous, [0.1] if first else [0.1, 0.0], cameras[4], 0.2, 0.5)

    def _learn_names(self) -> None:
        """Record the names of all buffers. Without a previous frame, its buffers are the rendered frame's."""
        owners = {"frame": self.board.frame} | self.all
        named = {f"{owner}.{name}": b for owner, own in owners.items() for name, b in own.buffer.items()}
        named |= {f"{name}.{b}'": buffer for name, stage in self.all.items() for b, buffer in stage.before.items()}
        named |= {f"overlays.{name}": self.all[Composition.name].buffer[name] for name in OVERLAYS}
        self._engine = {name: self.board.device.buffer(1) for name in ("color", "depth", "motion")}  # in its own format
        named |= {f"engine.{name}": buffer for name, buffer in self._engine.items()}
        for frame in ("previous", "rendered"):
            for name in ("color", "depth", "motion"):
                named[f"{frame}.{name}"] = getattr(getattr(self.board.bindings, frame), name)
        self.tape.names = {id(buffer): name for name, buffer in named.items()}


def record(device: Device, options: Options, int64: bool) -> Launches:
    """Return the operations of a pipeline with these options. `int64`: whether keys take 64-bit atomics.

    Raises GffeError with the detection of user interfaces, and for a network that OpenCL kernels cannot run.
    """
    if options.ui_detection:
        raise GffeError("export: user interface detection is not exported (expected a mask in the overlays, or none)")
    rehearsal = _Rehearsal(device, options, int64)
    operations = rehearsal.perform(first=True) | rehearsal.perform(first=False)
    buffers = {
        f"{owner.name}.{spec.name}": spec
        for owner in (rehearsal.board.frame, *rehearsal.all.values())
        for spec in owner.buffers
    }
    lent = {f"{stage.name}.{name}" for stage, name in rehearsal.board.memory.lent}
    return Launches(operations, buffers, _initial(rehearsal), lent, rehearsal.all, rehearsal.board.facts)


def _initial(rehearsal: _Rehearsal) -> dict[str, bytes]:
    """Return the initial values, by name, of buffers that are no images, where they are not zero: weights."""
    found = {}
    for stage in rehearsal.stages.values():
        for spec in stage.buffers:
            if spec.grid == "once" and not spec.part_of:
                values, buffer = np.empty(spec.nbytes(_SIZES), np.uint8), stage.buffer[spec.name]
                cl.enqueue_copy(stage.device.queue, values, buffer)
                if values.any():
                    found[rehearsal.tape.names[id(buffer)]] = values.tobytes()
    return found
