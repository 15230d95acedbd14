"""What the stages launch: taken down from the stages themselves, which run with several probes, sizes, cameras and
times, while nothing is enqueued. What agrees in all of them is a constant; what does not must be a named value of
`values`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.core.errors import GffeError
from gffe_cl.export.values import MOST_PIXELS, Named, launch_sizes
from gffe_cl.frame.camera import Camera
from gffe_cl.frame.rendered_frame import OVERLAYS
from gffe_cl.opencl.device import Device
from gffe_cl.pipeline.options import Options
from gffe_cl.pipeline.pipeline import stages_of
from gffe_cl.stages.base import Board, Kernel, Stage, Step
from gffe_cl.stages.buffers import BufferSpec, DeviceFrame, Sizes
from gffe_cl.stages.composition import Composition
from gffe_cl.stages.correction import ShadingCorrection
from gffe_cl.stages.presentation import Presentation
from gffe_cl.stages.scene_cuts import SceneCuts
from gffe_cl.stages.upscaling import Upscaling

# Rendered and extrapolated images: tiny, middling and wide, all sides different, so that no size looks like another;
# and as large as C takes them, for there are levels that others do not have.
_SIZES = (
    ((51, 29), (67, 39)), ((640, 50), (701, 101)), ((1203, 41), (1603, 61)),
    ((13003, 3), (MOST_PIXELS, 5)), ((2, 14001), (3, MOST_PIXELS)),
)  # fmt: skip
# The overlays that frames bring.
_LAYERS = (
    ("fixed_mask", "ui"), ("fixed_mask", "effects", "effects_motion"), ("effects", "ui"), ("ui",), ("effects",),
)  # fmt: skip
_SMALL = 4096  # bytes of a buffer that may hold something from the start


@dataclass(frozen=True)
class Given:
    """An argument of a launch: the name of a `buffer`, the bytes of a `constant`, or the frame block."""

    buffer: str | None = None
    constant: bytes | None = None
    is_frame_block: bool = False


@dataclass(frozen=True)
class Operation:
    """What a stage enqueues: `kind` is "LAUNCH" of a `kernel` over a `size` with `arguments`, "FILL" of a buffer with a
    `byte`, as many as `size` has of its texels, "COPY" from `source`, or "NETWORK", where the network runs."""

    kind: str
    stage: str
    kernel: str = ""
    size: Named | None = None
    arguments: tuple[Given, ...] = ()
    buffer: str = ""
    byte: int = 0
    source: str = ""

    def buffers(self) -> set[str]:
        """The names of all that it reads or writes."""
        return {name for name in (self.buffer, self.source, *(given.buffer for given in self.arguments)) if name}


@dataclass
class _Raw:
    """An operation as one probe has it, `numbers` and `size` in figures."""

    operation: Operation
    size: tuple[int, int] | int = 0
    numbers: list[bytes | None] = field(default_factory=list)


@dataclass
class Plan:
    """What is to be done, by occasion: `operations["rendered"]` after a rendered frame, "rendered_first" after one
    without a frame before, "extrapolated", "present", "cut", "leave_out" and "compose" likewise; the `buffers` by their
    full names, `initial` contents of small ones, memory that is `lent` while frames are extrapolated, and the stages in
    order."""

    operations: dict[str, list[Operation]]
    buffers: dict[str, BufferSpec]
    initial: dict[str, bytes]
    lent: set[str]
    stages: dict[str, Stage]
    facts: Mapping[str, Any]


class _Tape:
    """The `Recorder` of one probe's stages."""

    def __init__(self):
        self.raw: list[_Raw] = []
        self.names: dict[int, str] = {}

    def launched(self, stage: Stage, kernel: Kernel, size: tuple[int, int], given: Mapping[str, Any]) -> None:
        arguments, numbers = [], []
        for argument in stage.program.arguments[kernel.name]:
            value = argument.packed(given[argument.name])
            is_buffer = isinstance(value, cl.Buffer)
            is_block = argument.type == "Frame"
            arguments.append(Given(buffer=self._name(value)) if is_buffer else Given(is_frame_block=is_block))
            numbers.append(None if is_buffer or is_block else np.asarray(value).tobytes())
        operation = Operation("LAUNCH", stage.name, kernel.name, arguments=tuple(arguments))
        self.raw.append(_Raw(operation, size, numbers))

    def filled(self, stage: Stage, buffer: cl.Buffer, byte: int, nbytes: int) -> None:
        self.raw.append(_Raw(Operation("FILL", stage.name, buffer=self._name(buffer), byte=byte), nbytes))

    def copied(self, stage: Stage, to: cl.Buffer, of: cl.Buffer) -> None:
        self.raw.append(_Raw(Operation("COPY", stage.name, buffer=self._name(to), source=self._name(of))))

    def network(self, stage: Stage) -> None:
        self.raw.append(_Raw(Operation("NETWORK", stage.name)))

    def take(self) -> list[_Raw]:
        taken, self.raw = self.raw, []
        return taken

    def _name(self, buffer: cl.Buffer) -> str:
        return self.names[id(buffer)]


class _Rehearsal:
    """The stages of one size, with a tape."""

    def __init__(self, device: Device, options: Options, sizes: Sizes, int64: bool):
        self.sizes, self.tape = sizes, _Tape()
        self.board = Board(device, sizes, options, int64)
        chosen = {stage.name: stage for stage in stages_of(options)}
        self.stages = {
            name: stage(self.board, load=False) if stage is ShadingCorrection else stage(self.board)
            for name, stage in chosen.items()
        }
        self.board.lend()
        self.all = self.stages | {stage.name: stage(self.board) for stage in (Presentation, Composition)}
        for stage in self.all.values():
            stage.recorder = self.tape
        if correction := self.stages.get(ShadingCorrection.name):
            correction.infer = lambda alpha: self.tape.network(correction)

    def perform(self, number: int, first: bool) -> dict[str, list[_Raw]]:
        """What is enqueued on each occasion, in one set of circumstances."""
        step, composition = self._step(number, first), self.all[Composition.name]
        shown = self.board.device.buffer(1)
        self.board.rendered, self.board.previous = step.frame, step.previous or step.frame
        self._learn_names()
        self.tape.names[id(shown)] = "shown.color"
        composition.swap()  # `take` swaps, too
        composition.take({name: composition.buffer[name] for name in OVERLAYS}, self._shown(step.frame))
        found = {"leave_out": self.tape.take()}
        composition.layers = {name: composition.buffer[name] for name in _LAYERS[number]}
        for occasion, work in (
            ("rendered", lambda: [stage.rendered(step) for stage in self.stages.values()]),
            ("extrapolated", lambda: [stage.extrapolated(step) for stage in self.stages.values()]),
            ("present", lambda: self._present(step)),
            ("cut", lambda: self._look_for_cut(step)),
            ("compose", lambda: composition.compose(shown, step.alpha)),
            ("compose_rendered", lambda: composition.compose(shown, 0.0, rendered=True)),
        ):
            work()
            found[occasion] = self.tape.take()
        return found

    def _shown(self, frame: DeviceFrame) -> DeviceFrame:
        """The frame with all of its depth, of which what stays in place is left out for other stages."""
        shown = replace(frame, depth=self.board.device.buffer(1))
        self.tape.names[id(shown.depth)] = "shown.depth"
        return shown

    def _present(self, step: Step) -> None:
        self.all[Presentation.name].present(step.frame, step.previous, with_color=Upscaling.name not in self.stages)

    def _look_for_cut(self, step: Step) -> None:
        if detection := self.stages.get(SceneCuts.name):
            detection.is_cut(step.frame, step.previous)

    def _step(self, number: int, first: bool) -> Step:
        """Circumstances of which no two have a number in common."""
        rng = np.random.default_rng([number, first])
        frame, previous = (self._frame(rng) for _ in range(2))
        times = np.cumsum(-rng.uniform(0.01, 0.1, (1, 2, 3, 6, 4, 5)[0 if first else 1 + number])).tolist()
        time = times[0] + rng.uniform(0.01, 0.1)
        camera, alpha, exposure = self._camera(rng), rng.uniform(0.1, 0.9), rng.uniform(0.2, 5)
        return Step(frame, None if first else previous, times, camera, time, alpha, exposure)

    def _frame(self, rng: np.random.Generator) -> DeviceFrame:
        pose = self._camera(rng).world_to_view
        render, display = (self._camera(rng, pose) for _ in range(2))
        return DeviceFrame.allocate(self.board.device, (1, 1), render, display, 0.0)

    @staticmethod
    def _camera(rng: np.random.Generator, pose: np.ndarray | None = None) -> Camera:
        camera = Camera.from_pose(*rng.normal(size=(3, 3)), *rng.uniform(20, 900, 4))
        return camera if pose is None else replace(camera, world_to_view=pose)

    def _learn_names(self) -> None:
        """Names of all buffers; where there is no frame before, its buffers are the rendered frame's."""
        owners = {"frame": self.board.frame} | self.all
        named = {f"{owner}.{name}": b for owner, own in owners.items() for name, b in own.buffer.items()}
        named |= {f"{name}.{b}'": buffer for name, stage in self.all.items() for b, buffer in stage.before.items()}
        named |= {f"overlays.{name}": self.all[Composition.name].buffer[name] for name in OVERLAYS}
        for frame in ("previous", "rendered"):
            for name in ("color", "depth", "motion"):
                named[f"{frame}.{name}"] = getattr(getattr(self.board, frame), name)
        self.tape.names = {id(buffer): name for name, buffer in named.items()}


def record(device: Device, options: Options, int64: bool) -> Plan:
    """What a pipeline of these options enqueues, `int64`: with 64-bit atomics.

    Raises GffeError where that depends on sizes or circumstances in a way that the exported C does not know.
    """
    rehearsals = [_Rehearsal(device, options, Sizes(*sizes), int64) for sizes in _SIZES]
    known = _Known([rehearsal.sizes for rehearsal in rehearsals])
    operations = {}
    for first in (True, False):
        performed = [rehearsal.perform(number, first) for number, rehearsal in enumerate(rehearsals)]
        for occasion in performed[0]:
            takes = [raw[occasion] for raw in performed]
            operations[occasion + "_first" * first] = _explained(takes, known, rehearsals)
    buffers = {
        f"{owner.name}.{spec.name}": spec
        for rehearsal in rehearsals
        for owner in (rehearsal.board.frame, *rehearsal.all.values())
        for spec in owner.buffers
    }
    lent = {f"{stage.name}.{name}" for stage, name in rehearsals[0].board.lent}
    return Plan(operations, buffers, _initial(rehearsals[0]), lent, rehearsals[0].all, rehearsals[0].board.facts)


def _explained(takes: list[list[_Raw]], known: _Known, rehearsals: list[_Rehearsal]) -> list[Operation]:
    """The operations that agree with what every probe enqueues: all of them, but for those on buffers that images of
    its sizes do not have."""
    whole = [raw.operation for raw in max(takes, key=len)]
    has = [set(rehearsal.tape.names.values()) for rehearsal in rehearsals]
    made = [[raw.operation for raw in take] for take in takes]
    expected = [[operation for operation in whole if operation.buffers() <= names] for names in has]
    if made != expected:
        differ = [name for name in rehearsals[0].all if _of(name, made) != _of(name, expected)]
        raise GffeError(
            f"export: what is launched depends on the size of the image ({', '.join(differ)}), which C does not know"
            " (expected other options)"
        )
    rest = [iter(take) for take in takes]
    return [
        _named([next(take) if operation.buffers() <= names else None for take, names in zip(rest, has, strict=True)],
               operation, known, rehearsals[0])
        for operation in whole
    ]  # fmt: skip


def _of(stage: str, made: list[list[Operation]]) -> list[list[Operation]]:
    return [[operation for operation in one if operation.stage == stage] for one in made]


class _Known:
    """The sizes of launches that C knows, each for images of every size; `found`: what it was, None where nothing was
    launched."""

    def __init__(self, sizes: list[Sizes]):
        self.sizes = [(named, [size(one) for one in sizes]) for named, size in launch_sizes()]

    def size(self, what: str, found: list[tuple[int, int] | None]) -> Named:
        return _first(what, (named for named, sizes in self.sizes if _agree(sizes, found)))

    def texels(self, what: str, found: list[int | None]) -> Named:
        """A size by its number of texels."""
        return _first(what, (named for named, sizes in self.sizes if _agree(map(math.prod, sizes), found)))


def _agree(known: Iterable[Any], found: Iterable[Any]) -> bool:
    return all(wanted is None or value == wanted for value, wanted in zip(known, found, strict=True))


def _first(what: str, candidates: Iterator[Named]) -> Named:
    for named in candidates:
        return named
    raise _unknown(what)


def _unknown(what: str) -> GffeError:
    return GffeError(f"export: {what} depends on something that exported C does not know")


def _named(raws: list[_Raw | None], operation: Operation, known: _Known, rehearsal: _Rehearsal) -> Operation:
    """An operation with names in place of figures; `raws`: of every probe that has it."""
    if operation.kind == "FILL":
        owner, _, name = operation.buffer.partition(".")
        spec = rehearsal.all[owner].spec(name)
        texels = [raw and raw.size / (spec.bytes_per_pixel * spec.planes) for raw in raws]
        return replace(operation, size=known.texels(operation.buffer, texels))
    if operation.kind != "LAUNCH":
        return operation
    where = f"kernels/{operation.stage}.cl, {operation.kernel}"
    arguments, declared = [], rehearsal.all[operation.stage].program.arguments[operation.kernel]
    for k, (argument, given) in enumerate(zip(declared, operation.arguments, strict=True)):
        numbers = [raw and raw.numbers[k] for raw in raws]
        if given.buffer is not None or given.is_frame_block:
            arguments.append(given)
        elif len(different := set(numbers) - {None}) == 1:
            arguments.append(Given(constant=different.pop()))
        else:  # it belongs into the frame block
            raise _unknown(f"{where}: argument '{argument.name}'")
    size = known.size(f"{where}: its size", [raw and raw.size for raw in raws])
    return replace(operation, size=size, arguments=tuple(arguments))


def _initial(rehearsal: _Rehearsal) -> dict[str, bytes]:
    """What small buffers hold from the start, if that is not zeros."""
    found = {}
    for name, stage in rehearsal.stages.items():
        for spec in stage.buffers:
            if spec.grid == "once" and not spec.part_of and spec.nbytes(rehearsal.sizes) <= _SMALL:
                values = np.empty(spec.nbytes(rehearsal.sizes), np.uint8)
                cl.enqueue_copy(stage.device.queue, values, stage.buffer[spec.name])
                if values.any():
                    found[f"{name}.{spec.name}"] = values.tobytes()
    return found
