"""Contract of a stage, which declares its buffers and the buffers that each of its kernels reads and writes.

From the declarations come the arguments of the kernels, the stage dump, the viewer's layers, the documentation's tables
of stages and memory.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import Program, build
from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.buffers import RENDERED, BufferSpec, DeviceFrame, ExtrapolatedBuffers, Owner, Sizes
from gffe_cl.engine.stages.commands import Commands, Launch, Script
from gffe_cl.engine.stages.frame_block import FRAME, BlockWriter, block_facts
from gffe_cl.engine.stages.memory import LentMemory

_PREPARED = 256  # launches of a stage that are kept ready: those of uploads differ by where arrays begin
# Work-items of a work-group on GPUs, and on CPUs, where rows stream better and long ones cost least.
_TILE, _ROW = (16, 8), (128, 1)


@dataclass(frozen=True)
class Kernel:
    """A kernel of a stage.

    `grid` has its work-items, one per `step` pixels each way (a number, or the name of a constant of the kernel file);
    `group` of them, in a row, make a work-group, with `group_rows` rows (None: as suits the device). `below` these are
    more rows, with a work-item for each texel of that grid. `repeats` is the
    name of a number, given at the launch: so often the grid is repeated, in a third dimension. `reads` and `writes` are
    names of buffers, by the names of its arguments; {…} in them are given at the launch. Buffers that are both read and
    written are in both. A launch may give another buffer
    than the declared one if it lies alike. `choices`: values of the names in {…} that are not levels, launch by launch.
    """

    name: str
    grid: str
    reads: Mapping[str, str] = field(default_factory=dict)
    writes: Mapping[str, str] = field(default_factory=dict)
    step: tuple[int | str, int | str] = (1, 1)
    group: int | str | None = None
    group_rows: int | str = 1
    below: str = ""
    repeats: str = ""
    choices: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def buffers(self) -> dict[str, str]:
        """Names of the buffers that it reads or writes, by argument."""
        return {**self.reads, **self.writes}


class Rest(NamedTuple):
    """Knowledge of the camera at rest, members of the frame block: the rendered frame's number, for how many
    intervals its camera has been the same, whether points at rest stay where they are in the new frame, and whether all
    of the rendered frame's colors are encoded."""

    number: int = 0
    rests: int = 0
    stays: bool = False
    coded: bool = False


@dataclass
class Step:
    """Input of a stage: a rendered frame (after `submit`), or a new frame extrapolated from it.

    Attributes
    ----------
    frame : DeviceFrame
        The rendered frame.
    previous : DeviceFrame or None
        The rendered frame before; None after a reset.
    times : list of float
        Times of the rendered frames since the last reset, newest first, seconds.
    camera, time, alpha, exposure
        Of the new frame: its camera, seconds, α, and the factor on color before display.
    rest : Rest
        What is known of the camera at rest.
    given : mapping of name to numbers
        Its other members that do not follow from the above: overlays that the rendered frame brings, or those that
        convert an engine's buffers (`conversion`).
    """

    frame: DeviceFrame
    previous: DeviceFrame | None
    times: list[float]
    camera: Camera | None = None
    time: float = 0.0
    alpha: float = 0.0
    exposure: float = 1.0
    rest: Rest = field(default_factory=Rest)
    given: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.slot = "rendered" if self.camera is None else "new"  # of `FrameBlocks`
        self.key = object()  # known by: who keeps it keeps no buffers

    def block(self, board: Board) -> array[float]:
        """Return the frame block of frame.h, as words, for the stages on `board`."""
        rendered = self.frame, self.previous, self.times, self.exposure
        return board.writer.write(*rendered, self.camera, self.time, self.alpha, self.rest, self.given)


class Bindings:
    """The buffers that are bound, and what may be replayed.

    Bound are those of the rendered frame and of the one `previous` to it, which is the frame itself after a reset; and
    the results of each stage, which swap with those of the frame before. What is enqueued may be replayed while stages
    have the same buffers (`turn`); arguments that are buffers of rendered frames are set again for other ones
    (`frames`), however many sets of buffers an engine has.
    """

    def __init__(self) -> None:
        self.rendered: DeviceFrame | None = None
        self.previous: DeviceFrame | None = None
        self.frames = object()  # another one for each rendered frame
        self.turn = 0  # a bit of each stage, which changes when its buffers and those of the frame before do
        self._bits = 0  # of the stages so far
        self._scripts: dict[tuple, Script] = {}
        # By `turn`: the turn after `swap`, and the buffers of stages then, and those of the frame before.
        self._swapped: dict[int, tuple[int, list[tuple[Stage, dict, dict]]]] = {}

    def new_bit(self) -> int:
        """Return the bit in `turn` of one more stage."""
        self._bits += 1
        return 1 << (self._bits - 1)

    def show(self, frame: DeviceFrame, previous: DeviceFrame | None) -> None:
        """Bind the buffers of the rendered frame, and of the one before (None: after a reset)."""
        self.rendered, self.previous, self.frames = frame, previous or frame, object()

    def swap(self, stages: list[Stage], place: Callable[[], None]) -> None:
        """Make the results of `stages` those of the frame before, and `place` borrowed buffers. Each turn does so
        once: then it is known."""
        turn = self.turn
        if known := self._swapped.get(turn):
            self.turn, found = known
            for stage, buffer, before in found:
                stage.buffer, stage.before = buffer, before
            return
        held = [(stage, stage.buffer) for stage in stages]
        for stage, _ in held:
            stage.swap()
        place()
        found = [(stage, stage.buffer, stage.before) for stage, buffer in held if stage.buffer is not buffer]
        self._swapped[turn] = self.turn, found

    def script(self, *key: Any) -> Script | None:
        """Return what was enqueued for a step of this kind with the buffers that stages have now."""
        return self._scripts.get((self.turn, *key))

    def remember(self, script: Script, *key: Any) -> None:
        """Note what was enqueued for a step of this kind."""
        self._scripts[self.turn, *key] = script

    def forget_scripts(self) -> None:
        """Replay nothing that was enqueued so far: stages will work otherwise."""
        self._scripts.clear()

    def let_go(self) -> None:
        """Drop the references to stages and their kernels."""
        self._scripts.clear()
        self._swapped.clear()


class Board:
    """Board on which stages find each other's buffers, and on which they lend each other memory.

    `int64`: whether keys are 64 bits wide (see `NearestStage`); None: if the device has such atomics.
    """

    def __init__(self, device: Device, sizes: Sizes, options: Options | None = None, int64: bool | None = None):
        self.stages: dict[str, Any] = {}  # by name, each of its own class
        self.memory = LentMemory(sizes, self.stages)
        self.device, self.sizes, self.options = device, sizes, options or Options()
        self.int64 = device.int64_atomics if int64 is None else int64
        # Members of the frame block that do not change; stages add theirs.
        self.facts = block_facts(self.options, sizes)
        self.bindings = Bindings()
        self.commands = Commands(device)
        self.blocks = FrameBlocks(self)

    @cached_property
    def frame(self) -> ExtrapolatedBuffers:
        """Buffers of the extrapolated frame."""
        return ExtrapolatedBuffers(self.device, self.sizes)

    @cached_property
    def writer(self) -> BlockWriter:
        """The writer of frame blocks. No stage may add facts once it was used."""
        return BlockWriter(self.sizes, self.facts)

    def swap(self) -> None:
        """Make the results of all stages those of the frame before, and place borrowed buffers, before any works on a
        rendered frame."""
        self.bindings.swap([stage for stage in self.stages.values() if not stage.swaps_alone], self.memory.place)

    def perform(self, step: Step, stages: Iterable[Any], after: Callable[[Any], None] | None = None) -> cl.Event | None:
        """Do the work of `stages` on a step, and call `after` with each, or enqueue once more what they enqueued for an
        earlier step, if it may be replayed. Returns the event with which all work is complete, if there is one
        already."""
        bindings, script, stages = self.bindings, None, list(stages)
        variants = [stage.variant(step) for stage in stages]
        if after is None and None not in variants:
            key = step.slot, step.previous is None, *variants
            if found := bindings.script(*key):
                self.blocks.held[step.slot] = step.key
                found.show(bindings.frames, self.buffer)
                return self.commands.repeat(found, step.block(self))
            script = Script()
        self.commands.script = script
        try:
            for stage in stages:
                if step.slot == "rendered":
                    stage.rendered(step)
                else:
                    stage.extrapolated(step)
                if after:
                    after(stage)
        finally:
            self.commands.script = None
        if script:
            bindings.remember(script, *key)
        return None

    def __del__(self):
        self.let_go()

    def let_go(self) -> None:
        """Drop all buffers of the stages, and the references to these. Stages and board refer to each other; with this
        cycle, memory of an unused pipeline would wait for Python's cyclic garbage collector."""
        for stage in self.stages.values():
            stage.let_go()
        self.stages.clear()
        self.bindings.let_go()
        with self.device.opened.lock:
            self.memory.let_go()
        self.__dict__.pop("blocks", None)

    def buffer(self, owner: str, name: str) -> cl.Buffer:
        """Return the buffer "<owner>.<name>"; of a stage that is not there, one that is of no use. Kernels know by
        members of the frame block that they must leave it alone, but for a list's length. Raises KeyError if the owner
        has no such buffer."""
        if owner in ("rendered", "previous"):
            return getattr(getattr(self.bindings, owner), name)
        if owner == "frame":
            return self.frame.buffer[name]
        stage = self.stages.get(owner)
        return stage.own(name) if stage else self.blocks.buffer["unused"]

    def spec(self, name: str) -> BufferSpec:
        """Return the description of the buffer "<owner>.<name>"."""
        owner, _, rest = name.partition(".")
        if owner in ("rendered", "previous"):
            return next(spec for spec in RENDERED if spec.name == rest)
        owners: dict[str, Owner] = {"frame": self.frame, FrameBlocks.name: self.blocks}
        return (owners.get(owner) or self.stages[owner]).spec(rest.removesuffix("'"))


class Stage(Owner):
    """Base of all stages.

    Subclasses set `name` (of the kernel file, too), `paper` (its section that they follow), `buffers` and `kernels`,
    and override `rendered`, `extrapolated` or both. `before` holds the buffers kept of the frame before.
    """

    paper = ""
    kernels: tuple[Kernel, ...] = ()
    registered = True  # whether other stages find its buffers on the board
    swaps_alone = False  # whether it calls `swap` itself, once for each rendered frame
    builds_at_once = True  # else the stage calls `_build` before it launches anything
    needs_footprints = False  # whether it adds to the warp of footprints: a dilated warp does without
    # Which of its buffers holds the picture of the "rendered" or "extrapolated" frame as the stage leaves it; the last
    # stage that has one makes the final image. Rendered frames, of which a stage makes the picture, may be jittered.
    pictures: ClassVar[Mapping[str, str]] = {}

    def __init__(self, board: Board, **variant: int):
        super().__init__(board.device, board.sizes)
        self.board = board
        self._bit = board.bindings.new_bit()
        borrowing = [spec for spec in self.buffers if spec.transient]
        self.buffer = self.allocate(spec for spec in self.buffers if spec not in borrowing)
        self.before = self.allocate(spec for spec in self.buffers if spec.kept)
        self._kernels = {kernel.name: kernel for kernel in self.kernels}
        self._prepared: dict[tuple, Launch] = {}  # by kernel and numbers
        if self.builds_at_once:
            self._build(**variant)
        if self.registered:
            board.stages[self.name] = self
            board.memory.borrowing += [(self, spec) for spec in borrowing]

    def _build(self, **variant: int) -> None:
        """Build the kernels."""
        self.program: Program = build(self.device, self.name, **variant)
        self._changing = {
            name: {argument.name for argument in arguments if not argument.is_number}
            for name, arguments in self.program.arguments.items()
        }
        self._bringing = {
            name for name, arguments in self.program.arguments.items() if any(a.brings_frame for a in arguments)
        }
        self._check()

    @classmethod
    def is_wanted(cls, options: Options) -> bool:
        """Return whether the pipeline's options ask for this stage."""
        return True

    def look_at(self, names: set[str] | None) -> None:
        """Note that from the next frame on the buffers `names`, such as "correction.refined", are wanted (None: all of
        them). Others need not be computed."""

    def rendered(self, step: Step) -> None:
        """Work on a rendered frame, once, after it was submitted."""

    def extrapolated(self, step: Step) -> None:
        """Work on a new frame, in the order of the stages."""

    def told(self, values: Mapping[str, np.ndarray], is_rendered: bool) -> str:
        """Return what the stage did to a pixel, for its story, by the `values` of all buffers there; "": nothing."""
        return ""

    def variant(self, step: Step) -> Hashable | None:
        """Return what the stage enqueues for a step by, besides bound buffers and options; None: by more, so that it
        cannot be replayed."""
        return True

    @classmethod
    def outputs(cls) -> tuple[str, ...]:
        """Return the names of the buffers of the extrapolated frame that the stage writes."""
        written = (name for kernel in cls.kernels for name in kernel.writes.values())
        return tuple(dict.fromkeys(name.removeprefix("frame.") for name in written if name.startswith("frame.")))

    def own(self, name: str) -> cl.Buffer:
        """Return a buffer of this stage; with an apostrophe the one of the previous frame."""
        return self.before[name[:-1]] if name.endswith("'") else self.buffer[name]

    def swap(self) -> None:
        """Make the results those of the frame before."""
        if self.before:
            self.board.bindings.turn ^= self._bit
            results = {name: self.buffer[name] for name in self.before}
            self.buffer, self.before = self.buffer | self.before, results

    def launch(self, name: str, step: Step | None = None, **given: Any) -> None:
        """Enqueue a kernel over its grid, in rows of work-items.

        Arguments come by name: `frame`, the frame block of `step`, which is written before unless the kernel brings it;
        the buffers that the kernel declares; and numbers,
        or other buffers, given here. Numbers must not change from frame to frame: those are members of the frame block.
        The sides are rounded up to whole groups: kernels guard against the padding.
        """
        board, slot = self.board, None
        if step is not None:
            slot = step.slot
            if name in self._bringing:
                board.blocks.held[slot] = step.key
            elif board.blocks.held.get(slot) is not step.key:
                board.blocks.set(step)
        key = board.bindings.turn, name, slot
        if given:
            changing = self._changing[name]
            key += (*given, *(value for argument, value in given.items() if argument not in changing))
        launch = self._prepared.get(key)
        if launch is None:
            launch = self._prepare_launch(self._kernels[name], given, slot)
            if len(self._prepared) == _PREPARED:
                self._prepared.clear()
            self._prepared[key] = launch
        launch.show(board.bindings.frames, board.buffer)
        for set_arg, index, argument in launch.given:
            set_arg(index, given[argument])
        if launch.block and step is not None:
            set_arg, index = launch.block
            set_arg(index, step.block(board))
        board.commands.launch(self, launch, given)

    def let_go(self) -> None:
        """Drop the buffers, and the kernels that have them as arguments. The stage is of no use any more."""
        for known in (self._prepared, self.buffer, self.before):
            known.clear()

    def _prepare_launch(self, kernel: Kernel, given: Mapping[str, Any], slot: str | None) -> Launch:
        """Return a launch with the arguments set that do not change from one launch with the numbers in `given` and the
        frame block `slot` to the next."""
        size = self.sizes.of(kernel.grid.format(**given))
        width, height = (-(-n // self._number(step)) for n, step in zip(size, kernel.step, strict=True))
        group = _ROW if self.device.lanes > 1 else _TILE
        if kernel.group:
            group = self._number(kernel.group), self._number(kernel.group_rows)
        across = -(-width // group[0]) * group[0]
        height += -(-math.prod(self.sizes.of(kernel.below)) // across) if kernel.below else 0
        items = across, -(-height // group[1]) * group[1]
        if kernel.repeats:
            items, group = (*items, given[kernel.repeats]), (*group, 1)
        made = self.program.kernel(kernel.name)
        launch = Launch(kernel, slot, made, items, group)
        declared = kernel.buffers
        for index, argument in enumerate(self.program.arguments[kernel.name]):
            if slot and argument.is_frame_block:
                made.set_arg(index, self.board.blocks.buffer[slot])
                continue
            # pyopencl's `set_arg` takes some 50 µs to see that a struct is no buffer.
            set_arg = made.set_arg if argument.buffer else getattr(made, "_set_arg_buf", made.set_arg)
            if argument.brings_frame:
                launch.block = set_arg, index
                continue
            if argument.name not in given and argument.name not in declared:
                raise TypeError(f"kernels/{self.name}.cl, {kernel.name}: no value for argument '{argument.name}'")
            owner, _, own = declared.get(argument.name, "").format(**given).partition(".")
            if argument.is_number:
                made.set_arg(index, argument.packed(given[argument.name]))
            elif argument.name in given:
                launch.given.append((set_arg, index, argument.name))
            elif owner in ("rendered", "previous"):
                launch.of_frames.append((set_arg, index, owner, own))
            else:
                made.set_arg(index, self._buffer(f"{owner}.{own}"))
        return launch

    def values(self, kernel: Kernel, slot: str | None, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of a kernel's arguments, by name, in a launch with the arguments in `given` and the frame
        block `slot`."""
        values = {**given, "frame": self.board.blocks.buffer[slot]} if slot else dict(given)
        declared = kernel.buffers
        return {name: self._buffer(declared[name], given) for name in declared.keys() - values.keys()} | values

    def fill(self, name: str, byte: int, grid: str | None = None) -> None:
        """Enqueue setting the first texels of a buffer of this stage, as many as `grid` has, or all of them."""
        self.board.commands.fill(self, name, byte, grid or self.spec(name).grid)

    def copy(self, to: str, of: str) -> None:
        """Enqueue a copy between buffers of one size, by their names."""
        self.board.commands.copy(self, self._buffer(to), self._buffer(of))

    def _buffer(self, name: str, given: Mapping[str, Any] = {}) -> cl.Buffer:
        """Return the buffer `name` of this or another stage; {…} in it are `given`."""
        owner, _, rest = name.format(**given).partition(".")
        return self.own(rest) if owner == self.name else self.board.buffer(owner, rest)

    def _number(self, number: int | str) -> int:
        return self.program.constants[number] if isinstance(number, str) else number

    def _check(self) -> None:
        """Check that the declarations of kernels match their source."""
        for kernel in self.kernels:
            where = f"kernels/{self.name}.cl, {kernel.name}"
            assert kernel.name in self.program.arguments, f"{where}: there is no such kernel"
            arguments = self.program.arguments[kernel.name]
            buffers = {a.name: a for a in arguments if a.buffer and not a.is_frame_block}
            declared = set(kernel.reads) | set(kernel.writes)
            assert declared == set(buffers), f"{where}: declared {sorted(declared)}, takes {sorted(buffers)}"
            written = {name for name, argument in buffers.items() if not argument.read_only}
            assert written == set(kernel.writes), (
                f"{where}: declared as written {sorted(kernel.writes)}, are {sorted(written)}"
            )


def pictures_of(stages: Iterable[Stage | type[Stage]]) -> dict[str, str]:
    """Return the names of the buffers that hold the final image, by the occasion, as in `Stage.pictures`."""
    return {occasion: f"{stage.name}.{own}" for stage in stages for occasion, own in stage.pictures.items()}


class FrameBlocks(Stage):
    """Frame blocks on the device, which kernels read: that of the rendered frame and that of the new one. And memory
    that is of no use."""

    name = "frame_block"
    registered = False
    buffers = tuple(
        BufferSpec(slot, np.uint8, (), "once", f"frame block: {slot}", planes=FRAME.itemsize, scratch=True)
        for slot in ("rendered", "new", "unused")
    )
    kernels = (Kernel("set_frame", "once", group=1),)

    def __init__(self, board: Board):
        super().__init__(board)
        self.held: dict[str, object] = {}  # the step's key whose block each buffer holds

    def set(self, step: Step) -> None:
        """Enqueue writing the block of `step` into its buffer, for kernels that do not bring it."""
        self.launch("set_frame", step)

    def forget(self) -> None:
        """Make the blocks be written again before they are used."""
        self.held.clear()


class NearestStage(Stage):
    """A stage that keeps the nearest of several fragments per pixel (nearest.h).

    With 64-bit atomics one key holds depth and index; without, a second pass finds the least index among the
    nearest. Both give the same bits. A kernel that offers fragments is launched once for each of `passes`.
    """

    def __init__(self, board: Board):
        self.passes = range(1 if board.int64 else 2)
        super().__init__(board, **({"INT64_ATOMICS": 1} if board.int64 else {}))

    @staticmethod
    def keys(board: Board, prefix: str, grid: str, **more: Any) -> tuple[BufferSpec, BufferSpec]:
        """Return the buffers of keys and winners for a grid, "<prefix>keys" and "<prefix>winners"; `more`: of their
        specs."""
        about = "nearest fragment offered to each pixel: depth" + (", index" if board.int64 else "")
        dtype, winners = (np.uint64, "once") if board.int64 else (np.uint32, grid)
        return (
            BufferSpec(f"{prefix}keys", dtype, (), grid, about, scratch=True, **more),
            BufferSpec(
                f"{prefix}winners", np.uint32, (), winners, "its index, without 64-bit atomics", scratch=True, **more
            ),
        )

    def clear_keys(self, prefix: str, grid: str) -> None:
        """Enqueue clearing the keys of a grid, before fragments are offered."""
        for name in (f"{prefix}keys", f"{prefix}winners")[: len(self.passes)]:
            self.fill(name, 0xFF, grid)


def read_some_rows(device: Device, depth: cl.Buffer, size: tuple[int, int], every: int = 16) -> np.ndarray:
    """Return each `every`-th row of a depth buffer of `size` (width, height), as (ceil(H / every), W) float32."""
    width, height = size
    rows = np.empty((-(-height // every), width), np.float32)
    pitch, whole = width * rows.itemsize, height // every
    copy: Any = cl.enqueue_copy  # no overload of the stub takes rectangles
    if whole < len(rows):  # NVIDIA's driver wants whole pitches in the buffer, of the last row, too
        copy(device.queue, rows[whole:], depth, src_offset=whole * every * pitch)
    if whole:
        copy(
            device.queue,
            rows[:whole],
            depth,
            buffer_origin=(0, 0, 0),
            host_origin=(0, 0, 0),
            region=(pitch, whole, 1),
            buffer_pitches=(pitch * every, 0),
            host_pitches=(pitch, 0),
        )
    return rows
