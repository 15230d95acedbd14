"""Choice and opening of OpenCL devices.

Only devices that probing found to work are opened (`probing`). The default is the fastest in the probe, GPU or CPU;
`GFFE_DEVICE` overrides it. Objects of other libraries are taken as pyopencl's, or as the integer handles of C
(`cl_context`, `cl_event` …).
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from mmap import PAGESIZE
from typing import Any, TypeVar
from weakref import WeakValueDictionary

import numpy as np
import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError, Unique, how_to_install
from gffe_cl.engine.core.validation import environment_number, require_bool, require_kind, require_whole, scalar, shown
from gffe_cl.engine.opencl import probing
from gffe_cl.engine.opencl.probing import (
    DeviceInfo,
    describe,
    floats_are_faster,
    try_exact_division,
    try_int64_atomics,
)
from gffe_cl.engine.opencl.runtimes import ask_for_huge_pages, prepare_runtimes, why_no_platform

HOW_TO_GET_ONE = (
    f"install one with {how_to_install('intel')} (x86-64 CPU, no root), "
    "`apt install pocl-opencl-icd` (any CPU), or your GPU vendor's driver; `gffe devices --refresh` tries again"
)
_WHERE_IT_IS = (
    "see `gffe devices --refresh`; where a program uses pyopencl before gffe_cl,"
    " call gffe_cl.prepare_runtimes() first of all"
)
_ABOUT_AS_FAST = 1.5  # times slower: the default among such devices must not depend on noise
_OF_MEMORY = {
    cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE,
    cl.status_code.OUT_OF_RESOURCES,
    cl.status_code.OUT_OF_HOST_MEMORY,
    cl.status_code.INVALID_BUFFER_SIZE,
}
# A handle is the address of an object of the driver; nothing lies in the first page of memory.
_LEAST_HANDLE, _MOST_HANDLE = 1 << 12, (1 << 64) - 1

Kind = TypeVar("Kind", cl.Context, cl.CommandQueue, cl.Event, cl.Buffer)


def select(infos: list[DeviceInfo], wanted: str) -> list[DeviceInfo]:
    """Return the devices that `wanted` means: an index ("0:1"), a kind ("gpu"), part of the platform's name or version
    ("intel", "pocl"), or else part of the device's name ("xeon")."""
    wanted = wanted.strip().lower()
    if not any(letter.isalpha() for letter in wanted):
        return [info for info in infos if info.index == wanted]
    for texts in (
        lambda info: (info.index, info.kind),
        lambda info: f"{info.platform} {info.version}".lower(),
        lambda info: info.name.lower(),
    ):
        found = [info for info in infos if wanted in texts(info)]
        if found:
            return found
    return []


_LARGE = 4 << 20  # bytes of a buffer that is worth huge pages
_process = os.getpid()  # kept up to date: asking the system before every command would take long


def _note_process() -> None:
    global _process
    _process = os.getpid()
    for opened in (*_opened.values(), *_adopted.values()):
        opened.lock = threading.RLock()  # another thread of the parent may have it


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_process)


@dataclass
class Opened:
    """State that all `Device`s of one OpenCL device share in this process. Drivers keep some KiB of every loaded
    program, even after release, so reopening a device reuses it."""

    context: cl.Context | None  # None: not made before it is used, in the process that uses it
    programs: dict = field(default_factory=dict)  # built so far, by program.build
    int64_atomics: bool | None = None  # None: not tried yet
    float_sums: bool | None = None  # None: not tried yet
    constants: dict[bytes, cl.Buffer] = field(default_factory=dict)  # that nobody changes, by what they hold: a hash
    exact_division: bool | None = None  # of a context that was adopted; None: not tried yet
    process: int | None = None  # that has the driver's threads, which do not live on in forked children; None: no one
    # For making the context, mapping a buffer (PoCL 3.1 crashes where two threads map the same one), and for reading
    # buffers that another thread may release.
    lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self):
        if self.context is not None:
            self.process = _process


_opened: dict[str, Opened] = {}  # by `DeviceInfo.index`
# Of contexts that others made, by the handles of context and device, as long as a `Device` uses them.
_adopted: WeakValueDictionary[tuple[int, int], Opened] = WeakValueDictionary()


class Device(Unique):
    """An opened OpenCL device: context, in-order queue, capabilities.

    Attributes
    ----------
    info : DeviceInfo
    context : pyopencl.Context
    queue : pyopencl.CommandQueue
        Queue that works in order. It has profiling only if that was asked for, or if it came from an engine with it.
    profiles : bool
        Whether the queue has profiling; without there are no timings (`Pipeline.take_timings`).
    alignment : int
        Alignment in bytes: kernels can use host memory in place that begins at a multiple of it.
    works_in_host_memory : bool
        Whether kernels can use NumPy arrays where they are: on CPUs.
    shares_memory : bool
        Whether host and device share memory: CPUs and integrated GPUs.
    allocated : int
        Bytes of the buffers made by `buffer` so far.
    opened : Opened
        State that all objects of one OpenCL device share.

    Notes
    -----
    Devices are made by `open_device`, or by `Device.from_context` in an engine's own context.
    """

    def __init__(
        self,
        cl_device: cl.Device,
        info: DeviceInfo,
        opened: Opened | None = None,
        queue: cl.CommandQueue | None = None,
        profiling: bool = False,
    ):
        self.info = require_kind(info, DeviceInfo, "device: info")
        self.cl_device = require_kind(cl_device, cl.Device, "device: cl_device", "a pyopencl.Device (see open_device)")
        if opened is not None:
            require_kind(opened, Opened, "device: opened")
        self.opened = opened or Opened(cl.Context([cl_device]))
        self.allocated = 0
        self.programs = self.opened.programs
        if queue is not None:
            require_kind(queue, cl.CommandQueue, "device: queue")
        self.profiles = require_bool(profiling, "device: profiling")
        if queue is not None:
            self.profiles = bool(queue.properties & cl.command_queue_properties.PROFILING_ENABLE)
        self._queue = queue
        if self.opened.context is not None and queue is None:
            self._queue = self._new_queue(self.opened.context)

    @classmethod
    def from_context(cls, context: Any, queue: Any = None, profiling: bool = False) -> Device:
        """Return a device that uses the OpenCL context and queue of an engine: its buffers can be submitted, and its
        events waited for.

        Parameters
        ----------
        context : pyopencl.Context or int
            The engine's context, or its handle (`cl_context`). It is retained as long as the device, or something made
            with it, is in use; the caller keeps its own reference.
        queue : pyopencl.CommandQueue, int or None
            A queue of this context, or its handle (`cl_command_queue`), that works in order, with or without profiling.
            All work is enqueued there. None: a new queue, in a context of one device; then order the work by events
            (`wait_for` of `Pipeline.submit`, `event` of the frames made).
        profiling : bool
            Whether a new queue has profiling, which `Pipeline.take_timings` needs.

        Raises
        ------
        GffeError
            For a queue that works out of order or belongs to another context, for a context of several devices without
            a queue, and where the driver fails. A number that is no handle cannot be recognized: drivers crash on it.

        Notes
        -----
        The device is not probed in a child process, as the engine uses it already.
        """
        context = adopted(context, cl.Context, "from_context: context")
        try:
            found, queue = _checked_queue(context, queue)
            key = context.int_ptr, found.int_ptr
            opened = _adopted.get(key)
            if opened is None:
                opened = _adopted[key] = Opened(context)
            _require_process(opened, found.name.strip())
            info = describe("–", found.platform, found)
            if opened.exact_division is None:
                opened.exact_division = try_exact_division(context, queue or cl.CommandQueue(context, found))
        except cl.Error as error:
            raise GffeError(f"from_context: the driver fails: {' '.join(str(error).split())[:200]}") from None
        info.works, info.exact_division = True, opened.exact_division
        return cls(found, info, opened, queue, profiling)

    def __repr__(self):
        return f"<Device {self.info.index} {self.info.name} ({self.info.platform})>"

    @property
    def context(self) -> cl.Context:
        """The context. Raises GffeError in a forked child if the parent has it."""
        return self.queue.context if self.opened.context is None else self.opened.context

    @property
    def queue(self) -> cl.CommandQueue:
        """The in-order queue. Raises GffeError in a forked child if the parent has the context."""
        if self.opened.process != _process:
            self.require_process()
        return self._queue or self._begin()

    def _begin(self) -> cl.CommandQueue:
        """Make the context, if no other device has, and the queue. Returns the queue."""
        self.opened.process = _process
        with self.opened.lock:
            try:
                self.opened.context = self.opened.context or cl.Context([self.cl_device])
                self._queue = self._queue or self._new_queue(self.opened.context)
            except cl.Error as error:
                raise GffeError(f"{self.info.name}: cannot be opened: {error} ({_WHERE_IT_IS})") from None
        return self._queue

    def _new_queue(self, context: cl.Context) -> cl.CommandQueue:
        if self.profiles:
            return cl.CommandQueue(context, self.cl_device, cl.command_queue_properties.PROFILING_ENABLE)
        return cl.CommandQueue(context, self.cl_device)

    def require_process(self) -> None:
        """Raise GffeError in a forked child if the parent has used the device: drivers wait forever there."""
        _require_process(self.opened, self.info.name)

    @cached_property
    def lanes(self) -> int:
        """Pixels per work-item in dense kernels (simd.h): 8 on CPUs, 1 on everything else, or `GFFE_LANES`. Mesa's
        llvmpipe itself runs a work-item in each lane, as GPUs do: for 8 pixels each it would compile for minutes."""
        is_wide = self.info.kind == "cpu" and self.info.platform != "rusticl"
        return environment_number("GFFE_LANES", (1, 8)) or (8 if is_wide else 1)

    @cached_property
    def exact_division(self) -> bool:
        """Whether plain division is correctly rounded on this device; if not, kernels correct it (`divide` of
        common.h)."""
        return self.info.exact_division

    @cached_property
    def int64_atomics(self) -> bool:
        """Whether a 64-bit atomic minimum builds and gives the right result on this device."""
        if self.opened.int64_atomics is None:
            self.opened.int64_atomics = try_int64_atomics(self.context, self.queue)
        return self.opened.int64_atomics

    @cached_property
    def float_sums(self) -> bool:
        """Whether sums of products of bytes are faster in floats than in integers on this device, with the same
        result; or `GFFE_FLOAT_SUMS` (0 or 1)."""
        forced = os.environ.get("GFFE_FLOAT_SUMS")
        if forced:
            return bool(int(forced))
        if self.opened.float_sums is None:
            self.opened.float_sums = floats_are_faster(self.context, self.queue)
        return self.opened.float_sums

    @cached_property
    def memory(self) -> int:
        """Bytes of device memory, as the driver reports them."""
        return int(self.cl_device.global_mem_size)

    @cached_property
    def largest_buffer(self) -> int:
        """Bytes that a buffer may have, as the driver reports them; often less than `memory`."""
        return int(self.cl_device.max_mem_alloc_size)

    @cached_property
    def alignment(self) -> int:
        """Alignment in bytes: kernels can use host memory in place that begins at a multiple of it (`empty`)."""
        return max(int(self.cl_device.mem_base_addr_align) // 8, 1)

    @cached_property
    def works_in_host_memory(self) -> bool:
        """Whether kernels can use NumPy arrays where they are: on CPUs."""
        return self.info.kind == "cpu" and self.alignment <= PAGESIZE

    @cached_property
    def shares_memory(self) -> bool:
        """Whether host and device share memory, so that mapping copies nothing: as the driver reports, or
        `GFFE_SHARED_MEMORY` (0 or 1)."""
        forced = environment_number("GFFE_SHARED_MEMORY", (0, 1))
        return bool(self.cl_device.host_unified_memory if forced is None else forced)

    def empty(self, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        """Return a new NumPy array, not initialized, that begins at a multiple of `alignment`, so that
        `Pipeline.submit` can use it with `zero_copy`. Raises GffeError for a `shape` or `dtype` that NumPy does not
        take."""
        try:
            dtype = np.dtype(dtype)
            if dtype.hasobject:
                raise TypeError("Python objects cannot lie on a device")
            wanted = np.broadcast_shapes(shape)
            nbytes = math.prod(wanted) * dtype.itemsize
            memory = np.empty(nbytes + self.alignment, np.uint8)
            start = -memory.ctypes.data % self.alignment
            return memory[start : start + nbytes].view(dtype).reshape(wanted)
        except (TypeError, ValueError, MemoryError, OverflowError) as error:
            raise GffeError(f"empty: no array of shape {shown(shape)}: {str(error)[:120]}") from None

    def buffer(self, nbytes: int, mapped: bool = False) -> cl.Buffer:
        """Return a new read-write device buffer of `nbytes` (at least 1). With `mapped` the host can work in it without
        a copy, if host and device share memory. Raises GffeError if `nbytes` is no number of bytes, or the device
        cannot allocate them."""
        size = max(require_whole(nbytes, "device: nbytes", 0, 2**63 - 1), 1)
        mapped = require_bool(mapped, "device: mapped")
        self.require_process()
        most = min(self.memory, self.largest_buffer)
        if size > most:  # NVIDIA's driver refuses nothing until it is used
            raise GffeError(
                f"{self.info.name}: cannot allocate {size / 2**20:.0f} MiB at once, {most / 2**20:.0f} at most"
            )
        try:
            for_host = cl.mem_flags.ALLOC_HOST_PTR if mapped and self.shares_memory else 0
            made = cl.Buffer(self.context, cl.mem_flags.READ_WRITE | for_host, size)
            if self.works_in_host_memory and size >= _LARGE:
                self._ask_for_huge_pages(made)
            self.allocated += size
            return made
        except cl.Error as error:
            raise GffeError(f"{self.info.name}: cannot allocate {nbytes / 2**20:.0f} MiB: {error}") from None

    def _ask_for_huge_pages(self, buffer: cl.Buffer) -> None:
        """Find out where the new `buffer` lies, and ask for huge pages there. On a queue of its own: the device may be
        at work."""
        queue = cl.CommandQueue(self.context, self.cl_device)
        flags = cl.map_flags.WRITE_INVALIDATE_REGION
        array, _ = cl.enqueue_map_buffer(queue, buffer, flags, 0, (buffer.size,), np.dtype(np.uint8))
        ask_for_huge_pages(array.ctypes.data, buffer.size)
        array.base.release(queue)
        queue.finish()


def list_devices(refresh: bool = False) -> list[DeviceInfo]:
    """Return every OpenCL device with the result of probing it. Probing happens with `refresh`, or if no result is
    stored for the installed drivers. Never raises for a broken driver: its devices have `works == False`. Where a
    driver crashes or hangs while devices are listed, that is the only entry, and names the drivers' files."""
    return known_devices(require_bool(refresh, "list_devices: refresh"))[0]


def known_devices(refresh: bool = False) -> tuple[list[DeviceInfo], float | None]:
    """Return what `list_devices` does, and how many seconds ago the devices were probed; None if just now."""
    prepare_runtimes()
    key = probing.fingerprint()
    probed = (None if refresh else probing.recall(key)) or probing.probe()
    if probed.age is None:
        probing.keep(key, probed)
    return probed.devices, probed.age


def open_device(wanted: str | None = None, profiling: bool = False) -> Device:
    """Open and return the device that matches `wanted` (an index, a kind or part of a name), or the default one. With
    `profiling` its queue times commands (`Pipeline.take_timings`), which costs the host some time for each of them.

    Raises GffeError if no device works or none matches, `wanted` is no text, or `profiling` no bool.
    """
    if wanted is not None:
        require_kind(wanted, str, "open_device: wanted", 'a text such as "0:1", "gpu" or "intel"')
    profiling = require_bool(profiling, "open_device: profiling")
    origin = "" if wanted else "GFFE_DEVICE: "
    wanted = wanted or os.environ.get("GFFE_DEVICE") or None
    infos, age = known_devices()
    try:
        return open_info(_choose(infos, wanted, origin), profiling)
    except GffeError:
        if age is None or any(opened.process not in (None, _process) for opened in _opened.values()):
            raise
    return open_info(_choose(list_devices(refresh=True), wanted, origin), profiling)


@lru_cache(maxsize=1)
def device_of_process(name: str | None) -> Device:
    """Return the device of that name with `profiling`, opened once: of a process that works for a long time."""
    return open_device(name, profiling=True)


def _choose(infos: list[DeviceInfo], wanted: str | None, origin: str) -> DeviceInfo:
    working = [info for info in infos if info.works]
    if not working:
        raise none_works(infos)
    chosen = working if wanted is None else select(working, wanted)
    if not chosen:
        raise GffeError(
            f"{origin}no working device matches '{wanted}' (there is: "
            + ", ".join(f"{info.index} {info.platform} / {info.name}" for info in working)
            + ")"
        )
    return best_of(chosen)


def none_works(infos: list[DeviceInfo], kind: str | None = None) -> GffeError:
    """Return the error for devices of which none works."""
    reason = None if infos else why_no_platform()
    if reason:
        return GffeError(f"no OpenCL device runs a kernel: {reason}")
    seen = "; ".join(f"{info.name}: {info.problem}" for info in infos)
    what = f"no OpenCL device{f' of kind {kind}' if kind else ''} runs a kernel"
    return GffeError(f"{what} ({seen or 'no OpenCL platform found'}): {HOW_TO_GET_ONE}")


def best_of(infos: list[DeviceInfo]) -> DeviceInfo:
    """Return the default among devices that work: the fastest in the probe, whatever its kind. Of those that are about
    as fast a GPU comes first, which leaves the CPU to the network, and PoCL last; then the first in the list."""
    fastest = max(info.megapixels_per_second for info in infos)
    near = [info for info in infos if info.megapixels_per_second * _ABOUT_AS_FAST >= fastest]
    return min(near, key=lambda info: (info.kind != "gpu", "pocl" in info.version.lower()))


def open_info(info: DeviceInfo, profiling: bool = False) -> Device:
    """Open a device that `list_devices` returned, as `open_device` does. Opening it again shares context and kernels
    until a driver error loses them. Raises GffeError if it is not there or cannot be opened."""
    platform, device = (int(part) for part in info.index.split(":"))
    if known := _opened.get(info.index):
        _require_process(known, info.name)
    try:
        found = cl.get_platforms()[platform].get_devices()[device]
        told = found.name.strip(), found.platform.version.strip(), found.driver_version.strip()
        if told != (info.name, info.version, info.driver):
            raise GffeError(f"device {info.index} is {told[0]}, not {info.name} ({_WHERE_IT_IS})")
        opened = known or Opened(None if _forks_when_opened(found) else cl.Context([found]))
        made = Device(found, info, opened, profiling=profiling)
        _opened[info.index] = opened
        return made
    except IndexError:
        raise GffeError(f"{info.name} ({info.platform}): there is no device {info.index} ({_WHERE_IT_IS})") from None
    except cl.Error as error:
        raise GffeError(f"{info.name} ({info.platform}): cannot be opened: {error} ({_WHERE_IT_IS})") from None


def _forks_when_opened(device: cl.Device) -> bool:
    """Return whether children forked after the device was found can use it, as long as there is no context. Intel's
    CPU runtime starts its threads with the first context; PoCL does when its devices are listed. Other drivers are not
    known."""
    return bool(device.type & cl.device_type.CPU) and "intel" in device.platform.name.lower()


def _require_process(opened: Opened, name: str) -> None:
    """Raise GffeError if another process, of which this one was forked, has the driver's threads."""
    if opened.process not in (None, _process):
        raise GffeError(
            f"{name}: the device was opened before this process was forked (expected multiprocessing's start method"
            " 'spawn', or a device that only the child opens)"
        )


def _checked_queue(context: cl.Context, queue: Any) -> tuple[cl.Device, cl.CommandQueue | None]:
    """Return the device that `Device.from_context` works with, and `queue`, checked, or None. Raises GffeError for a
    queue that it cannot use."""
    if queue is None:
        if len(context.devices) != 1:
            raise GffeError(f"from_context: the context has {len(context.devices)} devices (expected a queue of one)")
        return context.devices[0], None
    queue = adopted(queue, cl.CommandQueue, "from_context: queue")
    if queue.context != context:
        raise GffeError("from_context: the queue belongs to another OpenCL context")
    if queue.properties & cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE:
        raise GffeError(
            "from_context: the queue works out of order (expected one that works in order, or queue=None and events)"
        )
    return queue.device, queue


def forget_opened(device: Device) -> None:
    """Make the next call open the OpenCL device again, because its context may be unusable."""
    known: Any
    for known in (_opened, _adopted):
        for key in [key for key, opened in known.items() if opened is device.opened]:
            del known[key]


def device_fault(device: Device, work: str, footprint: Callable[[], str], error: cl.Error) -> GffeError:
    """Return a driver's `error` in one line with a remedy, and forget the device. `footprint` is the text about sizes
    and memory."""
    forget_opened(device)
    advice = (
        "is out of memory, or lost (expected smaller images, fewer background levels, or less else on it)"
        if error.code in _OF_MEMORY
        else "is lost, or its driver has failed (expected it to answer)"
    )
    reason = " ".join(str(error).split())[:120]
    return GffeError(
        f"{device.info.name}: {work} failed: {reason}; {footprint()}: the device {advice};"
        " open the device and a new pipeline to go on"
    )


@contextmanager
def device_faults(device: Device, work: str, footprint: Callable[[], str]) -> Iterator[None]:
    """Turn driver errors within its block `work` into `device_fault`."""
    try:
        yield
    except cl.Error as error:
        raise device_fault(device, work, footprint, error) from error


def is_handle(value: Any) -> bool:
    """Return whether `value` is an integer that may be a handle. Drivers crash on an invalid address, and no call
    can check it beforehand."""
    number = scalar(value)
    return isinstance(number, int) and not isinstance(number, bool) and _LEAST_HANDLE <= number <= _MOST_HANDLE


def adopted(value: Any, kind: type[Kind], what: str) -> Any:
    """Return `value` as a pyopencl object of `kind`. The object of a handle is retained, and released when Python has
    no reference to the result any more; the caller keeps its own reference. Raises GffeError for anything else."""
    if isinstance(value, kind):
        return value
    if is_handle(value):
        return kind.from_int_ptr(scalar(value), retain=True)
    raise GffeError(f"{what} must be a pyopencl.{kind.__name__} or the integer handle of one, got {shown(value)}")


def adopted_events(values: Any, context: cl.Context, what: str) -> list[cl.Event]:
    """Return events to wait for, given as pyopencl's or as handles. Raises GffeError unless all are of `context`, and
    none has failed."""
    if isinstance(values, tuple) and not values:  # mostly
        return []
    try:
        listed = [None] if isinstance(values, str | bytes) else list(values)
    except TypeError:
        raise GffeError(f"{what} must be a list of OpenCL events, got {shown(values)}") from None
    events: list[Any] = [adopted(value, cl.Event, f"{what}[{number}]") for number, value in enumerate(listed)]
    for number, event in enumerate(events):
        try:
            its_context, status = event.context, event.command_execution_status
        except cl.Error as error:  # some drivers do not keep the context of an event
            raise GffeError(f"{what}[{number}]: the driver rejects it: {str(error)[:120]}") from None
        if its_context != context:
            raise GffeError(f"{what}[{number}] belongs to another OpenCL context than the pipeline's device")
        if status < 0:
            raise GffeError(f"{what}[{number}] has failed (OpenCL error {status})")
    return events


def wait_for_all(queue: cl.CommandQueue, events: list[cl.Event]) -> None:
    """Make all later commands of the queue wait for `events`."""
    if events:
        cl.enqueue_barrier(queue, wait_for=events)


def marker(queue: cl.CommandQueue) -> cl.Event:
    """Return an event that is complete when all work enqueued so far is; other queues can wait for it."""
    event = cl.enqueue_marker(queue)
    queue.flush()
    return event
