"""The contract of a stage: it declares the buffers it makes, and what each of its kernels reads and writes.

From the declarations come the arguments of the kernels, the stage dump, the viewer's layers, the documentation's tables
of stages and memory, and the bytes per pixel that must move (`gffe bench`).

A buffer is called "<owner>.<name>": "rendered.depth" and "previous.depth" are of the rendered frame and of the one
before, "frame.color" of the extrapolated frame, all others of the stage that makes them: "history.dynamic_mask". An
apostrophe means what a stage kept of the frame before, as in the paper: "history.history'".
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pyopencl as cl

from gffe_cl.camera import Camera
from gffe_cl.frame import BYTES_PER_PIXEL, PackedFrame
from gffe_cl.inference import MULTIPLE
from gffe_cl.opencl.device import Device
from gffe_cl.opencl.program import Program, build, constants

_EVENTS = 1024  # kept per stage for whoever asks for timings
_ROW = 64  # work-items of a work-group, all in one row: rows stream better than squares on CPUs

RGBA = ("R", "G", "B", "A")
XY = ("x", "y")

_LABELS = constants("common.h")
BY_HOLE_FILLING, BY_NOTHING = _LABELS["BY_HOLE_FILLING"], _LABELS["BY_NOTHING"]
BY_WARP, BY_CRACK_CLOSING = _LABELS["BY_WARP"], _LABELS["BY_CRACK_CLOSING"]
FILLED_BY = (
    (BY_WARP, "its own fragment"),
    *((1 + level, f"background level {level}") for level in range(4)),
    (BY_NOTHING, "nothing"),
    (BY_CRACK_CLOSING, "crack closing"),
    (BY_HOLE_FILLING, "hole filling"),
)


@dataclass(frozen=True)
class Sizes:
    """Width and height in pixels of rendered (source) and extrapolated (target) images."""

    source: tuple[int, int]
    target: tuple[int, int]

    def of(self, grid: str) -> tuple[int, int]:
        """Width and height of a grid, see `BufferSpec`."""
        if grid.startswith("mip"):
            return halved(self.target, int(grid[3:]))
        if grid.startswith("level"):
            return halved(self.source, int(grid[5:]))
        return {
            "source": self.source,
            "target": self.target,
            "blocks": halved(self.target, 5),
            "network": tuple(-(-n // MULTIPLE) * MULTIPLE for n in halved(self.target, 1)),
            "once": (1, 1),
        }[grid]


@dataclass(frozen=True)
class BufferSpec:
    """One named buffer.

    `grid` says whose pixels it has: "source" (rendered frame), "target" (extrapolated frame), "blocks"
    (target / 32, rounded up), "level0" … (source / 2^l, rounded up), "mip1" … (target / 2^l, rounded up), "network"
    (target / 2, rounded up to multiples of 16) or "once" (no image). `components` name its channels; a single one goes
    without. `view` says what it means, and so how to show it: "color" (linear RGB), "depth" (view z), "motion" (pixels,
    from here), "place" (position in pixels), "world" (position in the view space of the rendered camera), "mask" (0 or
    1), "label" (`labels` name its values), "scalar". `mapped`: the host works in it. `kept`: that of the frame before
    is kept too. `scratch`: of no interest once the stage is through.
    """

    name: str
    dtype: type
    components: tuple[str, ...]
    grid: str
    description: str
    view: str = "scalar"
    planes: int = 1
    labels: tuple[tuple[int, str], ...] = ()
    mapped: bool = False
    kept: bool = False
    scratch: bool = False

    @property
    def channels(self) -> int:
        return max(len(self.components), 1)

    @property
    def bytes_per_pixel(self) -> int:
        """Of its own grid, one plane."""
        return self.channels * np.dtype(self.dtype).itemsize

    def size(self, sizes: Sizes) -> tuple[int, int]:
        """Width and height in pixels or texels."""
        return sizes.of(self.grid)

    def shape(self, sizes: Sizes) -> tuple[int, ...]:
        """Shape of the NumPy array: (planes?, H, W, channels?)."""
        width, height = self.size(sizes)
        shape = (height, width) if self.grid != "once" else ()
        return (self.planes,) * (self.planes > 1) + shape + (self.channels,) * (self.channels > 1 or not shape)

    def nbytes(self, sizes: Sizes) -> int:
        return int(np.prod(self.shape(sizes))) * np.dtype(self.dtype).itemsize


RENDERED = (
    BufferSpec("color", np.float16, RGBA, "source", "colour of the rendered frame, linear RGB (I)", "color"),
    BufferSpec("depth", np.float32, (), "source", "its view depth, world units, +inf sky (D)", "depth"),
    BufferSpec("motion", np.float32, XY, "source", "its motion t → t−1, pixels (V)", "motion"),
)
EXTRAPOLATED = (
    BufferSpec("color", np.float16, RGBA, "target", "colour of the extrapolated frame (Ī^GAE)", "color"),
    BufferSpec("depth", np.float32, (), "target", "view depth in the target camera, world units (D̄)", "depth"),
    BufferSpec("motion", np.float32, XY, "target", "t + α → t, pixels, into the rendered image (V̄)", "motion"),
    BufferSpec("dynamic", np.uint8, (), "target", "1 where the fragment shown is dynamic", "mask"),
    BufferSpec("disoccluded", np.uint8, (), "target", "1 where no fragment of the rendered frame lands", "mask"),
    BufferSpec("filled_by", np.uint8, (), "target", "what the pixel comes from", "label", labels=FILLED_BY),
    BufferSpec(
        "mixed", np.uint8, (), "target",
        "1 where the fragment's colour was mixed with a silhouette's that moves away, and its neighbour's is shown",
        "mask",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Access:
    """What a kernel reads or writes through one argument.

    `buffer` is its name; {…} in it are given at the launch. `share` says of which share of the buffer's pixels, by a
    counter of `evaluation.traffic.SHARES` or as a number; `planes` of how many planes, None for all.
    """

    buffer: str
    share: str | float = 1.0
    planes: int | None = None


@dataclass(frozen=True)
class Kernel:
    """A kernel of a stage.

    `grid` has its work-items, one per `step` pixels each way (a number, or the name of a constant of the kernel file).
    `reads` and `writes` go by the names of its arguments; what is read and written is in both. "" stands for a buffer
    that each launch gives.
    """

    name: str
    grid: str
    reads: Mapping[str, Access | str] = field(default_factory=dict)
    writes: Mapping[str, Access | str] = field(default_factory=dict)
    step: tuple[int | str, int | str] = (1, 1)
    group: int | str = _ROW

    def accesses(self) -> Iterator[tuple[str, str, Access]]:
        """("reads" or "writes", argument, access) of each."""
        for kind in ("reads", "writes"):
            for argument, access in getattr(self, kind).items():
                yield kind, argument, access if isinstance(access, Access) else Access(access)


class Owner:
    """Who has named buffers: `name`, `buffers` (their descriptions) and `buffer` (by name, on the device)."""

    name = ""
    buffers: tuple[BufferSpec, ...] = ()

    def __init__(self, device: Device, sizes: Sizes):
        self.device, self.sizes = device, sizes
        self.buffer: dict[str, cl.Buffer] = {}

    def allocate(self, specs: Iterable[BufferSpec]) -> dict[str, cl.Buffer]:
        """New device buffers by name, all bits zero."""
        made = {spec.name: self.device.buffer(spec.nbytes(self.sizes), spec.mapped) for spec in specs}
        for buffer in made.values():
            cl.enqueue_fill_buffer(self.device.queue, buffer, np.uint8(0), 0, buffer.size)
        return made

    def spec(self, name: str) -> BufferSpec:
        return next(spec for spec in self.buffers if spec.name == name)

    def read(self, name: str) -> np.ndarray:
        """Copy a named buffer to the host."""
        spec = self.spec(name)
        out = np.empty(spec.shape(self.sizes), spec.dtype)
        cl.enqueue_copy(self.device.queue, out, self.buffer[name])
        return out

    def upload(self, name: str, values: np.ndarray) -> None:
        """Copy host values into a named buffer."""
        cl.enqueue_copy(self.device.queue, self.buffer[name], values)


class ExtrapolatedBuffers(Owner):
    """The buffers of the extrapolated frame, which several stages write."""

    name = "frame"
    buffers = EXTRAPOLATED

    def __init__(self, device: Device, sizes: Sizes):
        super().__init__(device, sizes)
        self.buffer = self.allocate(self.buffers)


class Output(Owner):
    """What a stage left in the buffers of the extrapolated frame, kept where somebody asks for it."""

    def __init__(self, stage: Stage, specs: Iterable[BufferSpec]):
        super().__init__(stage.device, stage.sizes)
        self.name, self.buffers = stage.name, tuple(specs)

    def choose(self, names: set[str]) -> None:
        """Keep the buffers `names` from now on, and no others."""
        specs = [spec for spec in self.buffers if spec.name in names and spec.name not in self.buffer]
        self.buffer = {name: b for name, b in self.buffer.items() if name in names} | self.allocate(specs)

    def keep(self, of: Mapping[str, cl.Buffer]) -> None:
        """Enqueue copies of what is chosen."""
        for name, buffer in self.buffer.items():
            cl.enqueue_copy(self.device.queue, buffer, of[name])


@dataclass
class DeviceFrame:
    """A rendered frame on the device: `color` half ×4, `depth` float, `motion` float ×2 (OpenCL buffers); `camera` in
    pixels of these images, `display_camera` in pixels of the display."""

    color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    camera: Camera
    display_camera: Camera
    time: float

    @classmethod
    def allocate(cls, device: Device, size: tuple[int, int], camera, display_camera, time) -> DeviceFrame:
        """New buffers for images of `size` (width, height)."""
        pixels = size[0] * size[1]
        return cls(*(device.buffer(pixels * n) for n in BYTES_PER_PIXEL), camera, display_camera, time)

    def upload(self, device: Device, packed: PackedFrame) -> None:
        """Copy host arrays in."""
        for buffer, array in zip(self.buffers, (packed.color, packed.depth, packed.motion), strict=True):
            cl.enqueue_copy(device.queue, buffer, array)

    @property
    def buffers(self) -> tuple[cl.Buffer, cl.Buffer, cl.Buffer]:
        return self.color, self.depth, self.motion


@dataclass
class Step:
    """What a stage works on: a rendered frame (after `submit`), or a new frame extrapolated from it.

    Attributes
    ----------
    frame : DeviceFrame
        The rendered frame.
    previous : DeviceFrame or None
        The rendered frame before; None after a reset, and where motion estimation is off.
    times : list of float
        Of the rendered frames since the last reset, newest first, seconds.
    camera, time, alpha, exposure
        Of the new frame: its camera, seconds, α, and the factor on colour before display.
    """

    frame: DeviceFrame
    previous: DeviceFrame | None
    times: list[float]
    camera: Camera | None = None
    time: float = 0.0
    alpha: float = 0.0
    exposure: float = 1.0


class Board:
    """Where stages find each other's buffers.

    `int64`: whether keys are 64 bits wide (see `NearestStage`); None: if the device has such atomics.
    """

    def __init__(self, device: Device, sizes: Sizes, options: Any = None, int64: bool | None = None):
        self.device, self.sizes, self.options = device, sizes, options
        self.int64 = device.int64_atomics if int64 is None else int64
        self.stages: dict[str, Stage] = {}
        self.rendered: DeviceFrame | None = None
        self.previous: DeviceFrame | None = None  # the rendered frame itself where there is none before

    @cached_property
    def frame(self) -> ExtrapolatedBuffers:
        """The extrapolated frame."""
        return ExtrapolatedBuffers(self.device, self.sizes)

    def buffer(self, name: str) -> cl.Buffer:
        """Of that name. KeyError if no stage has it."""
        owner, _, rest = name.partition(".")
        if owner in ("rendered", "previous"):
            return getattr(getattr(self, owner), rest)
        if owner == "frame":
            return self.frame.buffer[rest]
        stage = self.stages[owner]
        return stage.before[rest[:-1]] if rest.endswith("'") else stage.buffer[rest]

    def spec(self, name: str) -> BufferSpec:
        owner, _, rest = name.partition(".")
        if owner in ("rendered", "previous"):
            return next(spec for spec in RENDERED if spec.name == rest)
        return (self.frame if owner == "frame" else self.stages[owner]).spec(rest.removesuffix("'"))


class Stage(Owner):
    """Base of all stages.

    Subclasses set `name` (kernel file and module too), `buffers` and `kernels`, and override `rendered`, `extrapolated`
    or both. `events` holds the latest profiling events since the last `take_events`; `before` what is kept of the frame
    before.
    """

    kernels: tuple[Kernel, ...] = ()
    registered = True  # whether other stages find its buffers on the board

    def __init__(self, board: Board, **variant: int):
        super().__init__(board.device, board.sizes)
        self.board = board
        self.program: Program = build(self.device, self.name, **variant)
        self.events: deque[tuple[str, cl.Event]] = deque(maxlen=_EVENTS)
        self.launches: list[tuple[Kernel, dict]] | None = None  # with what was given, while somebody counts
        self.buffer = self.allocate(self.buffers)
        self.before = self.allocate(spec for spec in self.buffers if spec.kept)
        self._kernels = {kernel.name: kernel for kernel in self.kernels}
        self._check()
        if self.registered:
            board.stages[self.name] = self

    @classmethod
    def is_wanted(cls, options: Any) -> bool:
        """Whether the pipeline's options ask for this stage."""
        return True

    def rendered(self, step: Step) -> None:
        """Work on a rendered frame, once, after it was submitted."""

    def extrapolated(self, step: Step) -> None:
        """Work on a new frame."""

    @classmethod
    def outputs(cls) -> tuple[str, ...]:
        """Names of the buffers of the extrapolated frame that the stage writes."""
        written = (access.buffer for kernel in cls.kernels for kind, _, access in kernel.accesses() if kind == "writes")
        return tuple(dict.fromkeys(name.removeprefix("frame.") for name in written if name.startswith("frame.")))

    def swap(self) -> None:
        """What was made becomes what is kept of the frame before."""
        for name, buffer in self.before.items():
            self.before[name], self.buffer[name] = self.buffer[name], buffer

    def launch(self, name: str, size: tuple[int, int] | None = None, **given: Any) -> None:
        """Enqueue a kernel over its grid, or over `size` (width, height), in rows of work-items.

        Arguments come by name: those given here, the buffers that the kernel declares, sizes (`source_width`,
        `target_height`, `network_width` …; `level_width`: of the grid itself) and options. The width is rounded up to
        whole groups: kernels guard against the padding.
        """
        kernel = self._kernels[name]
        if self.launches is not None:
            self.launches.append((kernel, given))
        size = size or self.sizes.of(kernel.grid.format(**given))
        values = {"level_width": size[0], "level_height": size[1]} | given
        for _, argument, access in kernel.accesses():
            if argument not in given:
                values[argument] = self._buffer(access.buffer, given)
        for argument in self.program.arguments[name]:
            if argument.name not in values:
                values[argument.name] = self._scalar(argument.name)
        width, height = (-(-n // self._number(step)) for n, step in zip(size, kernel.step, strict=True))
        group = self._number(kernel.group)
        grid = (-(-width // group) * group, height)
        self.events.append((name, self.program.launch(self.device.queue, name, grid, (group, 1), values)))

    def fill(self, name: str, byte: int, nbytes: int | None = None) -> None:
        """Enqueue setting the first `nbytes` bytes of a buffer of this stage, or all of them."""
        buffer = self.buffer[name]
        nbytes = nbytes or buffer.size
        if self.launches is not None:
            share = nbytes / self.spec(name).nbytes(self.sizes)
            self.launches.append((Kernel("fill", "once", writes={"": Access(f"{self.name}.{name}", share)}), {}))
        event = cl.enqueue_fill_buffer(self.device.queue, buffer, np.uint8(byte), 0, nbytes)
        self.events.append(("fill", event))

    def copy(self, to: str, of: str) -> None:
        """Enqueue a copy between buffers of one size, by their names."""
        to, of = self._buffer(to, {}), self._buffer(of, {})
        self.events.append(("copy", cl.enqueue_copy(self.device.queue, to, of)))

    def take_milliseconds(self) -> float:
        """Kernel time since events were last taken; the device must have finished."""
        return sum(e.profile.end - e.profile.start for _, e in self.take_events()) * 1e-6

    def take_events(self) -> list[tuple[str, cl.Event]]:
        events = list(self.events)
        self.events.clear()
        return events

    def _buffer(self, name: str, given: Mapping[str, Any]) -> cl.Buffer:
        name = name.format(**given) if "{" in name else name
        owner, _, rest = name.partition(".")
        if owner == self.name:
            return self.before[rest[:-1]] if rest.endswith("'") else self.buffer[rest]
        return self.board.buffer(name)

    def _scalar(self, name: str) -> Any:
        """The value of an argument that is a size or an option."""
        grid, _, side = name.rpartition("_")
        if side in ("width", "height"):
            return self.sizes.of(grid)[side == "height"]
        if not hasattr(self.board.options, name):
            raise TypeError(f"kernels/{self.name}.cl: no value for argument '{name}'")
        return getattr(self.board.options, name)

    def _number(self, number: int | str) -> int:
        return self.program.constants[number] if isinstance(number, str) else number

    def _check(self) -> None:
        """What the kernels declare must be what their source says."""
        for kernel in self.kernels:
            where = f"kernels/{self.name}.cl, {kernel.name}"
            assert kernel.name in self.program.arguments, f"{where}: there is no such kernel"
            buffers = {a.name: a for a in self.program.arguments[kernel.name] if a.buffer}
            declared = set(kernel.reads) | set(kernel.writes)
            assert declared == set(buffers), f"{where}: declared {sorted(declared)}, takes {sorted(buffers)}"
            written = {name for name, argument in buffers.items() if not argument.read_only}
            assert written == set(kernel.writes), (
                f"{where}: declared as written {sorted(kernel.writes)}, are {sorted(written)}"
            )


class NearestStage(Stage):
    """A stage that keeps the nearest of several fragments per pixel (nearest.h).

    With 64-bit atomics one key holds depth and index; without, a second pass finds the least index among the
    nearest. Both give the same bits. A kernel that offers fragments is launched once for each of `passes`.
    """

    def __init__(self, board: Board):
        self.passes = range(1 if board.int64 else 2)
        super().__init__(board, **({"INT64_ATOMICS": 1} if board.int64 else {}))

    @staticmethod
    def keys(board: Board, prefix: str, grid: str) -> tuple[BufferSpec, BufferSpec]:
        """The buffers of keys and winners for a grid, "<prefix>keys" and "<prefix>winners"."""
        about = "nearest fragment offered to each pixel: depth" + (", index" if board.int64 else "")
        dtype, winners = (np.uint64, "once") if board.int64 else (np.uint32, grid)
        return (
            BufferSpec(f"{prefix}keys", dtype, (), grid, about, scratch=True),
            BufferSpec(f"{prefix}winners", np.uint32, (), winners, "its index, without 64-bit atomics", scratch=True),
        )

    def clear_keys(self, prefix: str, size: tuple[int, int]) -> None:
        """Enqueue emptying the keys of an image of (width, height), before fragments are offered."""
        pixels = math.prod(size)
        self.fill(f"{prefix}keys", 0xFF, pixels * (8 if self.board.int64 else 4))
        if not self.board.int64:
            self.fill(f"{prefix}winners", 0xFF, pixels * 4)


def read_some_rows(device: Device, depth: cl.Buffer, size: tuple[int, int], every: int = 16) -> np.ndarray:
    """(ceil(H / every), W) float32: each `every`-th row of a depth buffer of `size` (width, height)."""
    width, height = size
    rows = np.empty((-(-height // every), width), np.float32)
    pitch = width * rows.itemsize
    cl.enqueue_copy(
        device.queue,
        rows,
        depth,
        buffer_origin=(0, 0, 0),
        host_origin=(0, 0, 0),
        region=(pitch, len(rows), 1),
        buffer_pitches=(pitch * every, 0),
        host_pitches=(pitch, 0),
    )
    return rows


def zoom(source: Camera, target: Camera) -> np.ndarray:
    """(2,) float32: target pixels per source pixel of what is equally far from both cameras."""
    return np.array([target.fx / source.fx, target.fy / source.fy], np.float32)


def halved(size: tuple[int, int], times: int) -> tuple[int, int]:
    """(ceil(W / 2^times), ceil(H / 2^times))."""
    return tuple(-(-n // (1 << times)) for n in size)


def reprojection(source: Camera, target: Camera) -> np.ndarray:
    """The `Reprojection` struct of common.h, composed in float64: source view space → target view space."""
    matrix = source.to_view_of(target)
    packed = np.zeros((6, 4), np.float32)
    packed[:3] = matrix[:3]
    packed[3] = source.intrinsics
    packed[4] = (1 / source.fx, 1 / source.fy, source.cx, source.cy)
    packed[5] = target.intrinsics
    return packed
