"""Probing of OpenCL devices, in child processes, as a driver may crash or hang; the results, stored between processes.

A device counts only after a kernel has been built and run on it. Probing takes half a second, and its figures depend on
the load. There is one stored file for each state of drivers and machine (`fingerprint`). A folder that cannot be read
or written is no error.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import pyopencl as cl

from gffe_cl.engine.core.files import read_bounded
from gffe_cl.engine.opencl.runtimes import NO_CACHE, VENDORS, driver_variables, keep_file, kept_folder, vendors

HANGS = "driver hangs"  # how a failure begins where time was up
_MOST_SLOWDOWN = 10.0
_NICENESS = 1.25  # less processor time per step of niceness, of Linux's scheduler
_FILE = "devices-{}.json"
_MOST_FILES = 16
_MOST_BYTES = 1 << 20
_HOUR = 3600.0
_NODES = ("/dev/dri/*", "/dev/nvidia*", "/dev/kfd", "/dev/dxg", "/dev/mali*")
_KERNEL_DRIVERS = ("/proc/driver/nvidia/version", "/sys/module/amdgpu/version", "/sys/module/i915/srcversion")
_LIBRARIES = ("/usr/lib/*-linux-gnu*", "/usr/lib64", "/usr/lib", "/usr/local/lib*")
# Time limits; beyond them a driver hangs.
_FIRST_SECONDS = 6.0  # for all devices in one child process
_LIST_SECONDS = 6.0  # for listing all devices
_DEVICE_SECONDS = 8.0  # for one device alone
_RANKING_SECONDS = (
    0.2  # of repeating the kernel, and the copy: other processes disturb single runs, and GPUs begin with low clocks
)
_BYTES_PER_PIXEL = 96  # that the probe copies: GAE reads and writes about as many
_PROBED = "probed"  # last line of a child process: later failures are no device's fault


@dataclass
class DeviceInfo:
    """Result of probing one OpenCL device."""

    # "platform:device"; "–" where drivers crash before they list devices, and for `Device.from_context`.
    index: str
    name: str
    platform: str
    version: str  # of the platform; names PoCL, which calls itself "Portable Computing Language"
    driver: str
    kind: str  # "gpu", "cpu" or "other"
    works: bool = False
    problem: str = ""  # why it does not work
    lacks: list[str] = field(default_factory=list)
    exact_division: bool = False  # found out by trying
    megapixels_per_second: float = 0.0  # of the probe, arithmetic and memory; only for ranking


@dataclass
class Probed:
    """Result of probing. `age`: seconds since then; None if it was just now. `time`: when it was stored."""

    devices: list[DeviceInfo] = field(default_factory=list)
    age: float | None = None
    time: float = 0.0


_failed: dict[str, tuple[Probed, bool]] = {}  # what this process found, with failures that later ones try again


def probe() -> Probed:
    """Probe every OpenCL device and return the results.

    One child tries all devices, one after the other. Only if that one fails, each device is tried in a child of its
    own. Drivers of which one crashes or hangs while devices are listed cannot be told apart: none of them works.
    """
    output, _ = _run_child([], _FIRST_SECONDS)
    if _is_whole(output):
        return Probed(_told(output))
    output, failure = _run_child(["--list"], _LIST_SECONDS)
    if _is_whole(output):
        return Probed([_probe_alone(info) for info in _told(output)])
    files = ", ".join(str(icd) for icd in vendors())
    problem = f"{failure} while devices are listed (expected {VENDORS} to name a folder of sound drivers; now: {files})"
    return Probed([DeviceInfo("–", "unknown", "all drivers together", "", "", "other", problem=problem)])


def _cl_devices() -> list[tuple[str, cl.Platform, cl.Device]]:
    found = []
    try:
        platforms = cl.get_platforms()
    except cl.Error:
        return found
    for p, owner in enumerate(platforms):
        try:
            devices = owner.get_devices()
        except cl.Error:
            continue
        found += [(f"{p}:{d}", owner, device) for d, device in enumerate(devices)]
    return found


def _is_whole(output: str) -> bool:
    return _PROBED in output.splitlines()


def _told(output: str) -> list[DeviceInfo]:
    """Return the last report of a child process on each device."""
    found = [DeviceInfo(**json.loads(line)) for line in output.splitlines() if line.startswith("{")]
    return sorted({info.index: info for info in found}.values(), key=lambda info: info.index)


def _probe_alone(info: DeviceInfo) -> DeviceInfo:
    """Probe one device in a child process of its own, and return the result."""
    output, failure = _run_child([info.index], _DEVICE_SECONDS)
    (found,) = _told(output) or [info]
    if not found.works:
        found.problem = found.problem or failure or "driver does not list it again"
    return found


def _run_child(arguments: list[str], seconds: float) -> tuple[str, str]:
    """Return the output of this module run as a program, and how it failed ("" if it did not)."""
    return run_child("gffe_cl.engine.opencl.probing", arguments, seconds)


def describe(index: str, owner: cl.Platform, device: cl.Device) -> DeviceInfo:
    """Return the properties of a device that its driver reports; nothing is tried."""
    kind = "gpu" if device.type & cl.device_type.GPU else "cpu" if device.type & cl.device_type.CPU else "other"
    return DeviceInfo(
        index,
        device.name.strip(),
        owner.name.strip(),
        owner.version.strip(),
        device.driver_version.strip(),
        kind,
    )


def _probe(info: DeviceInfo, device: cl.Device) -> None:
    try:
        context = cl.Context([device])
        queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        info.megapixels_per_second = _run_probe_kernel(context, queue)
        info.works = True
        if not try_int64_atomics(context, queue):
            info.lacks.append("64-bit atomics (two-pass warp instead)")
        info.exact_division = try_exact_division(context, queue)
        if not info.exact_division:
            info.lacks.append("correctly rounded division (done in software)")
        if not device.image_support:
            info.lacks.append("images (not needed)")
    except (cl.Error, RuntimeError, ValueError, MemoryError) as error:
        info.problem = " ".join(build_log(error).split())[:200] or type(error).__name__
    print(json.dumps(asdict(info)), flush=True)


def build_log(error: Exception) -> str:
    """Return the compiler's output in the error of a build, without the text of OpenCL and pyopencl around it."""
    noise = ("clBuildProgram failed", "Build on", "(options:", "(source saved", "Compilation ")
    lines = [line for line in str(error).splitlines() if line.strip() and not line.startswith(noise)]
    return "\n".join(lines) or str(error)


# Arithmetic like that of GAE: four chains of additions and multiplications per pixel. CPUs get 16 pixels per work-item,
# as their compilers make vectors of such loops only where the source has them.
_PROBE_SOURCE = """
#pragma OPENCL FP_CONTRACT OFF
__kernel __attribute__((vec_type_hint(FLOATS))) void probe(__global const FLOATS *given, __global half *out) {
    const int i = get_global_id(0);
    FLOATS p = given[i], q = 0.5f * p, r = 0.25f * p, s = 0.125f * p;
    for (int k = 0; k < 128; ++k) {
        p = p * 0.5f + fabs(q - 0.25f);
        q = q * 0.5f + fabs(r - 0.5f);
        r = r * 0.5f + (s < 0.75f ? s : 0.75f);
        s = s * 0.5f + (p < 1.25f ? p : 1.25f);
    }
    STORE(given[i] < 2.0f ? given[i] : p + q + r + s, i, out);
}
"""
_LANES_OF_CPU = 16

INT64_SOURCE = """
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable
__kernel void least(__global ulong *a) {
    const ulong i = get_global_id(0);
    atom_min(a + (i & 1), ((63ul - i) << 33) | i);
}
"""
# Divides and takes roots of numbers of either sign over twelve orders of magnitude, as scalars and as vectors, and
# compares integer mantissas: found[0] becomes 0 where a result is not correctly rounded, and found[1] in any case.
DIVISION_SOURCE = """
uint scrambled(uint k) {
    k = (k ^ k >> 16) * 0x7feb352du;
    k = (k ^ k >> 15) * 0x846ca68bu;
    return k ^ k >> 16;
}
float number(uint k) { return as_float((scrambled(k) & 0x807fffffu) | (107u + scrambled(~k) % 40u) << 23); }
long mantissa(float x) { return (as_uint(x) & 0x7fffffu) | 0x800000u; }
int exponent(float x) { return (int)(as_uint(x) >> 23 & 255u) - 127; }
bool is_quotient(float q, float a, float b) {
    const int less = mantissa(a) < mantissa(b);
    const long rest = (mantissa(a) << (23 + less)) - mantissa(q) * mantissa(b);
    return 2 * abs(rest) <= (ulong)mantissa(b) && exponent(q) == exponent(a) - exponent(b) - less
           && (as_uint(q) ^ as_uint(a) ^ as_uint(b)) >> 31 == 0u;
}
bool is_root(float r, float x) {
    const int odd = exponent(x) & 1;
    const long rest = (mantissa(x) << (23 + odd)) - mantissa(r) * mantissa(r);
    return abs(rest) <= (ulong)mantissa(r) && 2 * exponent(r) == exponent(x) - odd && as_uint(r) >> 31 == 0u;
}
__kernel void divide(__global ulong *found) {
    float a[8], b[8], quotients[8], roots[8];
    for (int k = 0; k < 8; ++k) {
        a[k] = number(2 * (8 * get_global_id(0) + k));
        b[k] = number(2 * (8 * get_global_id(0) + k) + 1);
    }
    vstore8(vload8(0, a) / vload8(0, b), 0, quotients);
    vstore8(sqrt(fabs(vload8(0, a))), 0, roots);
    bool is_right = is_quotient(a[0] / b[0], a[0], b[0]);
    for (int k = 0; k < 8; ++k)
        is_right = is_right && is_quotient(quotients[k], a[k], b[k]) && is_root(roots[k], a[k]);
    if (!is_right) found[0] = 0;
    found[1] = 0;
}
"""
ALL_ONES = (1 << 64) - 1
# Kernels that show a capability: its name, source, work-items, and what they make of two numbers of ones.
TRIALS = {
    "int64_atomics": ("least", INT64_SOURCE, 64, ((1 << 33) | 62, 63)),
    "exact_division": ("divide", DIVISION_SOURCE, 1 << 16, (ALL_ONES, 0)),
}


def _run_probe_kernel(context, queue) -> float:
    """Return megapixels per second of a kernel and a copy, each at its fastest."""
    import numpy as np

    on_cpu, simulated = bool(queue.device.type & cl.device_type.CPU), "oclgrind" in os.environ.get("LD_PRELOAD", "")
    lanes = _LANES_OF_CPU if on_cpu else 1
    # Enough for a GPU; on CPUs less, as other processes disturb long runs more. Copies are beyond most caches.
    pixels, copied = (64, 64) if simulated else (1 << 14 if on_cpu else 1 << 18, 1 << 18)
    host = np.linspace(0.0, 4.0, pixels, dtype=np.float32)
    flags, wide = cl.mem_flags, str(lanes) if lanes > 1 else ""
    given = cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=host)
    out = cl.Buffer(context, flags.WRITE_ONLY, 2 * pixels)
    with quiet_builds():
        program = _built(queue, _PROBE_SOURCE, f"-DFLOATS=float{wide}", f"-DSTORE=vstore_half{wide}_rte")
        kernel = cl.Kernel(program, "probe")
    one, other = (cl.Buffer(context, flags.READ_WRITE, _BYTES_PER_PIXEL * copied) for _ in range(2))
    for buffer in (one, other):
        cl.enqueue_fill_buffer(queue, buffer, b"\1", 0, buffer.size)  # reading memory that nobody wrote is faster
    kernel_time = _fastest(lambda: kernel(queue, (pixels // lanes,), None, given, out))
    copy_time = _fastest(lambda: cl.enqueue_copy(queue, other, one))
    found = np.empty(pixels, np.float16)
    cl.enqueue_copy(queue, found, out)
    if not np.array_equal(found[host < 2], host[host < 2].astype(np.float16)):
        raise RuntimeError("a trivial kernel gives wrong results")
    return 1e3 / (kernel_time / pixels + copy_time / copied)


def _fastest(enqueue: Callable[[], cl.Event]) -> int:
    """Return nanoseconds of the fastest of several runs of a command, without the first."""
    times, end = [], time.perf_counter() + _RANKING_SECONDS * slowdown()
    while len(times) < 3 or time.perf_counter() < end:
        event = enqueue()
        event.wait()
        times.append(event.profile.end - event.profile.start)
    return max(min(times[1:]), 1)


def _built(queue: cl.CommandQueue, source: str, *options: str) -> cl.Program:
    options = ("-w", *rounding_options(queue.device), *options)
    return cl.Program(queue.context, source).build([*options], devices=[queue.device], cache_dir=NO_CACHE)


def rounding_options(device: cl.Device) -> tuple[str, ...]:
    """Return the build options that make division and square roots correctly rounded, if the device can: NVIDIA's are
    good to a few units in the last place without."""
    can = device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT
    return ("-cl-fp32-correctly-rounded-divide-sqrt",) if can else ()


@contextmanager
def quiet_builds():
    """Hide drivers' remarks on builds that succeed during the block, unless PYOPENCL_COMPILER_OUTPUT=1 asks for
    them."""
    with warnings.catch_warnings():
        if not os.environ.get("PYOPENCL_COMPILER_OUTPUT"):
            warnings.simplefilter("ignore", cl.CompilerWarning)
        yield


def try_int64_atomics(context: cl.Context, queue: cl.CommandQueue) -> bool:
    """Return whether a 64-bit atomic minimum builds and gives the right result on the device."""
    return _succeeds(context, queue, *TRIALS["int64_atomics"])


def try_exact_division(context: cl.Context, queue: cl.CommandQueue) -> bool:
    """Return whether plain division, of scalars and of vectors, and square roots are correctly rounded on the device,
    whatever the driver promises: all of half a million are."""
    return _succeeds(context, queue, *TRIALS["exact_division"])


def _succeeds(context: cl.Context, queue: cl.CommandQueue, name: str, source: str, items: int, expected: tuple) -> bool:
    import numpy as np

    found = np.full(2, ALL_ONES, np.uint64)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    items = min(items, 64) if "oclgrind" in os.environ.get("LD_PRELOAD", "") else items
    try:
        with quiet_builds():
            kernel = cl.Kernel(_built(queue, source), name)
        buffer = cl.Buffer(context, flags, hostbuf=found)
        kernel(queue, (items,), None, buffer)
        cl.enqueue_copy(queue, found, buffer)
    except (cl.Error, RuntimeError):
        return False
    return tuple(found.tolist()) == expected


# Sums of products of bytes as in convolutions.cl: of integers, and of floats, which hold them exactly.
SUMS_SOURCE = """
#pragma OPENCL FP_CONTRACT OFF
#define OUTPUTS 8
__kernel void of_integers(__global const uint *v, __global const uint *w, __global int *out) {
    const int i = get_global_id(0);
    int sums[OUTPUTS] = {0};
    for (int k = 0; k < 256; ++k) {
        const uchar4 a = as_uchar4(v[i + k]);
#pragma unroll
        for (int j = 0; j < OUTPUTS; ++j) {
            const char4 b = as_char4(w[k * OUTPUTS + j]);
            sums[j] += a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w;
        }
    }
    out[i] = sums[0] + sums[1] + sums[2] + sums[3] + sums[4] + sums[5] + sums[6] + sums[7];
}
__kernel void of_floats(__global const uint *v, __global const float4 *w, __global int *out) {
    const int i = get_global_id(0);
    float4 sums[OUTPUTS / 4] = {0.0f};
    for (int k = 0; k < 256; ++k) {
        const float4 a = convert_float4(as_uchar4(v[i + k]));
#pragma unroll
        for (int j = 0; j < OUTPUTS / 4; ++j) {
            __global const float4 *b = w + (k * OUTPUTS / 4 + j) * 4;
            sums[j] = fma((float4)(a.w), b[3], fma((float4)(a.z), b[2], fma((float4)(a.y), b[1],
                      fma((float4)(a.x), b[0], sums[j]))));
        }
    }
    const float4 sum = sums[0] + sums[1];
    out[i] = convert_int(sum.x + sum.y + sum.z + sum.w);
}
"""
_SUMS_RUNS = 6
_CLEARLY_FASTER = 1.25


def floats_are_faster(context: cl.Context, queue: cl.CommandQueue) -> bool:
    """Return whether the device sums products of bytes faster in floats, clearly so."""
    import numpy as np

    items, inputs, outputs = 1 << 16 if queue.device.type & cl.device_type.GPU else 1 << 12, 256, 8
    if "oclgrind" in os.environ.get("LD_PRELOAD", ""):
        return False
    queue = cl.CommandQueue(context, queue.device, cl.command_queue_properties.PROFILING_ENABLE)
    flags, rng = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, np.random.default_rng(0)
    v = rng.integers(0, 256, (items + inputs, 4), np.uint8)
    w = rng.integers(-63, 64, (inputs, outputs, 4), np.int8)
    as_floats = w.reshape(inputs, outputs // 4, 4, 4).transpose(0, 1, 3, 2).astype(np.float32, order="C")
    out, given = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, 4 * items), cl.Buffer(context, flags, hostbuf=v)
    try:
        with quiet_builds():
            program, times = _built(queue, SUMS_SOURCE), []
        for name, weights in (("of_integers", w), ("of_floats", as_floats)):
            kernel, buffer = cl.Kernel(program, name), cl.Buffer(context, flags, hostbuf=weights)
            events = [kernel(queue, (items,), (64,), given, buffer, out) for _ in range(_SUMS_RUNS)]
            queue.finish()
            times.append(min(event.profile.end - event.profile.start for event in events[1:]))
    except (cl.Error, RuntimeError):
        return False
    return times[0] > _CLEARLY_FASTER * times[1]


# ---- stored results --------------------------------------------------------------------------------


def fingerprint() -> str:
    """Return a hash of everything that probing depends on: drivers and their libraries, their environment variables,
    the machine."""
    facts = [
        hashlib.sha256(Path(__file__).read_bytes()).hexdigest(),
        cl.VERSION_TEXT,
        [(icd.name, _text(icd), _stamps(_text(icd))) for icd in vendors()],
        driver_variables(),
        (platform.node(), platform.release(), platform.machine(), os.cpu_count(), _processor()),
        [(str(node), os.access(node, os.R_OK | os.W_OK)) for node in _matching(_NODES)],
        [_text(Path(path)) for path in _KERNEL_DRIVERS],
        _stamp(Path("/etc/ld.so.cache")),
    ]
    return hashlib.sha256(repr(facts).encode("utf-8", "surrogateescape")).hexdigest()[:24]


def recall(key: str) -> Probed | None:
    """Return the entry stored as `key`, or None. Failures are stored for an hour, once two processes have met them: a
    driver may crash once, under load. Everything expires after a day if the drivers' files do not identify them."""
    found, met = _failed.get(key) or _stored(key)
    if found is None:
        return None
    broken = not all(device.works for device in found.devices)
    longest = _HOUR if broken else float("inf") if vendors() else 24 * _HOUR
    age = time.time() - found.time
    return replace(found, age=age) if 0 <= age <= longest and (met or not broken) else None


def keep(key: str, found: Probed) -> None:
    """Store `found` as `key` for later processes; where no device works, for this process alone."""
    before, _ = _stored(key)
    _failed.pop(key, None)
    folder, found = kept_folder(), replace(found, time=time.time())
    if not any(device.works for device in found.devices):
        _failed[key] = found, True
    if folder is None or key in _failed:
        return
    met = before is not None and _failures(before) == _failures(found)
    if _failures(found) and not met:
        _failed[key] = found, True  # here, too
    document = {"time": found.time, "devices": [asdict(device) for device in found.devices], "met": met}
    with suppress(OSError):
        path = folder / _FILE.format(key)
        keep_file(path, json.dumps(document, indent=1).encode("utf-8"), _FILE.format("*"), _MOST_FILES)


def _failures(probed: Probed) -> list[tuple[str, str]]:
    return [(info.index, info.problem) for info in probed.devices if not info.works]


def _stored(key: str) -> tuple[Probed | None, bool]:
    """Return the entry in the file of `key` (None: there is none), and whether an earlier process met its failures."""
    folder = kept_folder()
    if folder is None:
        return None, False
    try:
        document = json.loads(read_bounded(folder / _FILE.format(key), _MOST_BYTES))
        found = [_device(device) for device in document["devices"]]
        return Probed(found, time=float(document["time"])), bool(found) and document.get("met") is True
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None, False


def _device(document: dict) -> DeviceInfo:
    """Return the entry of a JSON document. Raises TypeError unless the fields have the declared types."""
    info = DeviceInfo(**document)
    kinds = {"works": bool, "exact_division": bool, "lacks": list, "megapixels_per_second": (int, float)}
    for one in fields(DeviceInfo):
        if not isinstance(getattr(info, one.name), kinds.get(one.name, str)):
            raise TypeError(one.name)
    return info


def _stamps(library: str) -> list:
    """Return the stamps of the files that the library of an `.icd` file may be."""
    if not library:
        return []
    if "/" in library:
        return [_stamp(Path(library))]
    folders = os.environ.get("LD_LIBRARY_PATH", "").split(":")
    return [_stamp(folder / library) for folder in (*map(Path, filter(None, folders)), *_matching(_LIBRARIES))]


def _stamp(path: Path) -> tuple | None:
    with suppress(OSError):
        facts = path.stat()
        return str(path), facts.st_mtime_ns, facts.st_size
    return None


def _matching(patterns: tuple[str, ...]) -> list[Path]:
    with suppress(OSError):
        return [path for pattern in patterns for path in sorted(Path("/").glob(pattern.removeprefix("/")))]
    return []


def _text(path: Path) -> str:
    with suppress(OSError), open(path, encoding="utf-8", errors="replace") as file:
        return file.read(4096).strip()
    return ""


def _processor() -> str:
    lines = _text(Path("/proc/cpuinfo")).splitlines()
    return next((line for line in lines if line.startswith("model name")), platform.processor())


# ---- child processes -------------------------------------------------------------------------------


def run_child(
    module: str, arguments: list[str], seconds: float, variables: dict[str, str] | None = None
) -> tuple[str, str]:
    """Run a module as a program, for at most `seconds` of an idle machine, with these additional environment variables.
    Returns its output and its failure ("" if none)."""
    # Without the working folder on the path, where a file may have the name of a module of Python's.
    run = f"runpy.run_module({module!r}, None, '__main__', True)"
    start = f"import runpy, sys; sys.path.append({str(Path(__file__).parents[2])!r}); {run}"
    command = [sys.executable, "-P", "-c", start, *arguments]
    environment = os.environ | (variables or {})
    try:
        child = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=seconds * slowdown(),
            env=environment,
        )
    except subprocess.TimeoutExpired as error:
        output = error.stdout.decode(errors="replace") if isinstance(error.stdout, bytes) else (error.stdout or "")
        return output, f"{HANGS} ({seconds:g} s)"
    return child.stdout, f"driver crashed (exit code {child.returncode})" if child.returncode else ""


def slowdown() -> float:
    """Return how many times longer work takes because of other processes, estimated from the load average."""
    try:
        load = os.getloadavg()[0] / (os.cpu_count() or 1)
    except (AttributeError, OSError):  # the system does not have it
        return 1.0
    return 1.0 if load <= 1 else min(load * _NICENESS ** max(os.nice(0), 0), _MOST_SLOWDOWN)


def _main(wanted: list[str]) -> None:
    """Print the results of probing the devices with indices `wanted`, or of all devices. After `--list` only list
    them."""
    for index, owner, device in _cl_devices():
        if not wanted or wanted == ["--list"] or index in wanted:
            info = describe(index, owner, device)
            print(json.dumps(asdict(info)), flush=True)
            if wanted != ["--list"]:
                _probe(info, device)
    print(_PROBED, flush=True)


if __name__ == "__main__":
    _main(sys.argv[1:])
