"""Choosing and probing OpenCL devices.

A device counts only after a kernel has been built and run on it, in a child process, because a driver may
crash there. One that crashes while its devices are listed is found by listing each vendor's in a child of its own, and
hidden from this process. The default is a GPU that passes, else the fastest device that does; `GFFE_DEVICE` overrides
it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

import pyopencl as cl

from gffe_cl.errors import GffeError
from gffe_cl.opencl.runtimes import (
    HIDE_INSTALLED,
    VENDORS,
    hide_vendors,
    installed_runtimes_are_exposed,
    only_vendors,
    vendors,
)

HOW_TO_GET_ONE = (
    "install one with `pip install 'gffe-cl[intel]'` (x86-64 CPU, no root), "
    "`apt install pocl-opencl-icd` (any CPU), or your GPU vendor's driver"
)
_PROBE_SECONDS = 120
_LIST_SECONDS = 30  # of one vendor
_PROBED = "probed"  # last line of a child: what happens after it is no device's fault
_crashing: dict[str, DeviceInfo] = {}  # vendors that are hidden, by the name of their `.icd` file


@dataclass
class DeviceInfo:
    """What probing found out about one OpenCL device."""

    index: str  # "platform:device"; "–" of a driver that crashes before it has told its devices
    name: str
    platform: str
    version: str  # of the platform; names PoCL, which calls itself "Portable Computing Language"
    driver: str
    kind: str  # "gpu", "cpu" or "other"
    works: bool = False
    problem: str = ""  # why it does not work
    lacks: list[str] = field(default_factory=list)
    megapixels_per_second: float = 0.0  # of the probe kernel; only for ranking


def select(infos: list[DeviceInfo], wanted: str) -> list[DeviceInfo]:
    """The devices that `wanted` means: an index ("0:1"), a kind ("gpu"), part of the platform's name or
    version ("intel", "pocl"), or else part of the device's name ("xeon")."""
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


class Device:
    """An opened OpenCL device: context, in-order profiling queue, capabilities.

    Attributes
    ----------
    info : DeviceInfo
    context : pyopencl.Context
    queue : pyopencl.CommandQueue
    allocated : int
        Bytes of the buffers made by `buffer` so far.
    """

    def __init__(self, cl_device: cl.Device, info: DeviceInfo):
        self.info = info
        self.cl_device = cl_device
        self.context = cl.Context([cl_device])
        self.allocated = 0
        self.programs: dict = {}  # built so far, by program.build
        self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)

    def __repr__(self):
        return f"<Device {self.info.index} {self.info.name} ({self.info.platform})>"

    @cached_property
    def lanes(self) -> int:
        """Pixels per work-item in dense kernels (wide.h): 8 on CPUs, 1 on everything else, or `GFFE_LANES`."""
        return int(os.environ.get("GFFE_LANES") or (8 if self.info.kind == "cpu" else 1))

    @cached_property
    def int64_atomics(self) -> bool:
        """Whether a 64-bit atomic minimum builds and gives the right answer here."""
        return _try_int64_atomics(self.context, self.queue)

    def buffer(self, nbytes: int, mapped: bool = False) -> cl.Buffer:
        """A new read-write device buffer of `nbytes` (at least 1); `mapped`: where the host can work in it."""
        size = max(int(nbytes), 1)
        try:
            flags = cl.mem_flags.READ_WRITE | (cl.mem_flags.ALLOC_HOST_PTR if mapped else 0)
            made = cl.Buffer(self.context, flags, size)
            self.allocated += size
            return made
        except cl.Error as error:
            raise GffeError(f"{self.info.name}: cannot allocate {nbytes / 2**20:.0f} MiB: {error}") from None


def list_devices() -> list[DeviceInfo]:
    """Probe every OpenCL device. Never raises for a broken driver; such devices have `works == False`, and a driver
    that crashes or hangs while its devices are listed is one entry with the name of its `.icd` file."""
    found, failure = _probe_in_child()
    if failure:
        crashing = _crashing_vendors()
        if not crashing:  # none does alone
            return [DeviceInfo("–", "unknown", "all drivers together", "", "", "other", problem=failure)]
        _crashing.update(crashing)
        hide_vendors(set(crashing))
        found, _ = _probe_in_child()
    return found + list(_crashing.values())


def open_device(wanted: str | None = None) -> Device:
    """Open the device that matches `wanted` (see `select`), or the default one.

    Raises GffeError if no device works or none matches.
    """
    wanted = wanted or os.environ.get("GFFE_DEVICE") or None
    infos = list_devices()
    working = [info for info in infos if info.works]
    if not working:
        seen = "; ".join(f"{info.name}: {info.problem}" for info in infos) or "no OpenCL platform found"
        raise GffeError(f"no OpenCL device runs a kernel ({seen}): {HOW_TO_GET_ONE}")
    chosen = working if wanted is None else select(working, wanted)
    if not chosen:
        raise GffeError(
            f"no working device matches '{wanted}' (there is: "
            + ", ".join(f"{info.index} {info.platform} / {info.name}" for info in working)
            + ")"
        )
    return open_info(best_of(chosen))


def best_of(infos: list[DeviceInfo]) -> DeviceInfo:
    """The default among devices that work: a GPU, else the fastest."""
    return max(infos, key=lambda info: (info.kind == "gpu", info.megapixels_per_second))


def open_info(info: DeviceInfo) -> Device:
    """Open the device that `list_devices` described."""
    platform, device = (int(part) for part in info.index.split(":"))
    return Device(cl.get_platforms()[platform].get_devices()[device], info)


def _cl_devices() -> list[tuple[str, cl.Platform, cl.Device]]:
    found = []
    try:
        platforms = cl.get_platforms()
    except cl.Error:
        return found
    for p, platform in enumerate(platforms):
        try:
            devices = platform.get_devices()
        except cl.Error:
            continue
        found += [(f"{p}:{d}", platform, device) for d, device in enumerate(devices)]
    return found


def _probe_in_child() -> tuple[list[DeviceInfo], str]:
    """Probe in a child process; when it dies, blame the device it was at and go on after it. The devices, and why they
    could not be listed ("" if they could)."""
    found: dict[str, DeviceInfo] = {}
    while True:
        output, failure = _run_child(sorted(found), _PROBE_SECONDS)
        current = None
        for line in output.splitlines():
            if line.startswith("{"):
                info = DeviceInfo(**json.loads(line))
                found[info.index] = info
                current = None if info.works or info.problem else info
        if not failure or current is None:
            failure = "" if _PROBED in output.splitlines() else failure
            return sorted(found.values(), key=lambda info: info.index), failure
        current.problem = failure


def _crashing_vendors() -> dict[str, DeviceInfo]:
    """The vendors whose devices cannot be listed, by the name of their `.icd` file; each is tried alone."""
    crashing = {}
    for icd in vendors():
        output, failure = _run_child(["--list"], _LIST_SECONDS, {VENDORS: str(only_vendors([icd]))})
        if _PROBED not in output.splitlines():
            library = icd.read_text().strip()
            problem = f"{failure} while it is listed: {library} is left out"
            crashing[icd.name] = DeviceInfo("–", Path(library).name, icd.name, "", "", "other", problem=problem)
    return crashing


def _run_child(arguments: list[str], seconds: float, variables: dict[str, str] | None = None) -> tuple[str, str]:
    """What this module prints as a program, and how it failed ("" if it did not)."""
    # Without the working folder on the path, where a file may have the name of a module of Python's.
    run = "runpy.run_module('gffe_cl.opencl.device', None, '__main__', True)"
    start = f"import runpy, sys; sys.path.append({str(Path(__file__).parents[2])!r}); {run}"
    command = [sys.executable, "-P", "-c", start, *arguments]
    hidden = {} if installed_runtimes_are_exposed() else {HIDE_INSTALLED: "1"}
    environment = os.environ | hidden | (variables or {})
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=seconds, env=environment)
    except subprocess.TimeoutExpired as error:
        output = error.stdout.decode() if isinstance(error.stdout, bytes) else (error.stdout or "")
        return output, f"driver hangs ({seconds:g} s)"
    return child.stdout, f"driver crashed (exit code {child.returncode})" if child.returncode else ""


def _probe(index: str, platform: cl.Platform, device: cl.Device) -> None:
    kind = "gpu" if device.type & cl.device_type.GPU else "cpu" if device.type & cl.device_type.CPU else "other"
    info = DeviceInfo(
        index,
        device.name.strip(),
        platform.name.strip(),
        platform.version.strip(),
        device.driver_version.strip(),
        kind,
    )
    print(json.dumps(asdict(info)), flush=True)  # names the culprit should the driver crash now
    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        info.megapixels_per_second = _run_probe_kernel(context, queue)
        info.works = True
        if not _try_int64_atomics(context, queue):
            info.lacks.append("64-bit atomics (two-pass warp instead)")
        if not device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT:
            info.lacks.append("correctly rounded division (done in software)")
        if not device.image_support:
            info.lacks.append("images (not needed)")
    except Exception as error:  # whatever a driver throws
        info.problem = " ".join(str(error).split())[:200] or type(error).__name__
    print(json.dumps(asdict(info)), flush=True)


_PROBE_SOURCE = """
#pragma OPENCL FP_CONTRACT OFF
__kernel void probe(__global const float *a, __global half *b, const int n) {
    const int i = get_global_id(0);
    if (i >= n) return;
    float x = a[i];
    for (int k = 0; k < 32; ++k) x = x * 0.5f + 1.0f / (1.0f + x * x);
    vstore_half_rte(a[i] < 2.0f ? a[i] : x, i, b);
}
"""

_INT64_SOURCE = """
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable
__kernel void least(__global ulong *a) {
    const ulong i = get_global_id(0);
    atom_min(a + (i & 1), ((63ul - i) << 33) | i);
}
"""


def _run_probe_kernel(context, queue) -> float:
    import numpy as np

    n = 1 << 18 if "oclgrind" not in os.environ.get("LD_PRELOAD", "") else 64
    host = np.linspace(0.0, 4.0, n, dtype=np.float32)
    flags = cl.mem_flags
    a = cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=host)
    b = cl.Buffer(context, flags.WRITE_ONLY, 2 * n)
    with quiet_builds():
        kernel = cl.Kernel(cl.Program(context, _PROBE_SOURCE).build(), "probe")
    times = []
    for _ in range(5):
        event = kernel(queue, (n,), None, a, b, np.int32(n))
        event.wait()
        times.append(event.profile.end - event.profile.start)
    out = np.empty(n, np.float16)
    cl.enqueue_copy(queue, out, b)
    if not np.array_equal(out[host < 2], host[host < 2].astype(np.float16)):
        raise RuntimeError("a trivial kernel gives wrong results")
    return n / max(min(times[1:]), 1) * 1e3


@contextmanager
def quiet_builds():
    """Hides drivers' remarks on builds that succeed, unless PYOPENCL_COMPILER_OUTPUT=1 asks for them."""
    with warnings.catch_warnings():
        if not os.environ.get("PYOPENCL_COMPILER_OUTPUT"):
            warnings.simplefilter("ignore", cl.CompilerWarning)
        yield


def _try_int64_atomics(context, queue) -> bool:
    import numpy as np

    try:
        with quiet_builds():
            kernel = cl.Kernel(cl.Program(context, _INT64_SOURCE).build(), "least")
        out = np.full(2, np.iinfo(np.uint64).max, np.uint64)
        buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=out)
        kernel(queue, (64,), None, buffer)
        cl.enqueue_copy(queue, out, buffer)
    except (cl.Error, RuntimeError):
        return False
    return out.tolist() == [(1 << 33) | 62, 63]


if __name__ == "__main__":
    for _index, _platform, _device in _cl_devices():
        if _index not in sys.argv[1:] and "--list" not in sys.argv[1:]:
            _probe(_index, _platform, _device)
    print(_PROBED, flush=True)
