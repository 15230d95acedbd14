"""Probing of OpenCL devices, in a child process: a driver may crash there.

A device counts only after a kernel has been built and run on it. A driver that crashes while its devices are listed is
found by listing each vendor's in a child of its own, and left out.
"""

from __future__ import annotations

import json
import os
import sys
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pyopencl as cl

from gffe_cl.engine.opencl.runtimes import NO_CACHE, VENDORS, hide_vendors, only_vendors, vendors
from gffe_cl.engine.opencl.subprocess_runner import run_child, slowdown

# Time limits; beyond them a driver hangs.
_FIRST_SECONDS = 6.0  # for all devices in one child process
_LIST_SECONDS = 6.0  # for listing the devices of one vendor
_DEVICE_SECONDS = 8.0  # for one device alone
_RANKING_SECONDS = (
    0.2  # of repeating the kernel, and the copy: other processes disturb single runs, and GPUs begin with low clocks
)
_BYTES_PER_PIXEL = 96  # that the probe copies: GAE reads and writes about as many
_PROBED = "probed"  # last line of a child process: later failures are no device's fault


@dataclass
class DeviceInfo:
    """Result of probing one OpenCL device."""

    # "platform:device"; "–" for a driver that crashes before it lists its devices, and for `Device.from_context`.
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
    """Result of probing: `devices` that can be listed once the vendors `crashing`, by the names of their `.icd`
    files, are hidden. `age`: seconds since then; None if it was just now."""

    devices: list[DeviceInfo] = field(default_factory=list)
    crashing: dict[str, DeviceInfo] = field(default_factory=dict)
    age: float | None = None


def probe() -> Probed:
    """Probe every OpenCL device and return the results. A driver that crashes or hangs while its devices are listed is
    also hidden from this process.

    One child tries all devices, one after the other, so that their figures do not disturb each other. Only if that one
    fails, vendors and then devices are tried side by side, each in a child of its own.
    """
    output, _ = _run_child([], _FIRST_SECONDS)
    if _is_whole(output):
        return Probed(_told(output))
    crashing = _crashing_vendors()
    if crashing:
        hide_vendors(set(crashing))
    output, failure = _run_child(["--list"], _LIST_SECONDS)
    if not _is_whole(output):  # none fails alone
        unknown = DeviceInfo("–", "unknown", "all drivers together", "", "", "other", problem=failure)
        return Probed([unknown], crashing)
    return Probed(_side_by_side(_probe_alone, _told(output)), crashing)


def _side_by_side(work: Callable, items: list) -> list:
    with ThreadPoolExecutor(max(len(items), 1)) as pool:
        return list(pool.map(work, items))


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


def _crashing_vendors() -> dict[str, DeviceInfo]:
    """Return the vendors whose devices cannot be listed, by the name of their `.icd` file; each is tried alone."""
    icds = vendors()
    crashing = {}
    for icd, (output, failure) in zip(icds, _side_by_side(_list_vendor, icds), strict=True):
        if not _is_whole(output):
            library = icd.read_text().strip()
            problem = f"{failure} while it is listed: {library} is left out"
            crashing[icd.name] = DeviceInfo("–", Path(library).name, icd.name, "", "", "other", problem=problem)
    return crashing


def _list_vendor(icd: Path) -> tuple[str, str]:
    return _run_child(["--list"], _LIST_SECONDS, {VENDORS: str(only_vendors([icd]))})


def _run_child(arguments: list[str], seconds: float, variables: dict[str, str] | None = None) -> tuple[str, str]:
    """Return the output of this module run as a program, and how it failed ("" if it did not)."""
    return run_child("gffe_cl.engine.opencl.probing", arguments, seconds, variables)


def describe(index: str, platform: cl.Platform, device: cl.Device) -> DeviceInfo:
    """Return the properties of a device that its driver reports; nothing is tried."""
    kind = "gpu" if device.type & cl.device_type.GPU else "cpu" if device.type & cl.device_type.CPU else "other"
    return DeviceInfo(
        index,
        device.name.strip(),
        platform.name.strip(),
        platform.version.strip(),
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
    except Exception as error:  # whatever a driver throws
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
    import numpy as np

    try:
        with quiet_builds():
            kernel = cl.Kernel(_built(queue, INT64_SOURCE), "least")
        out = np.full(2, np.iinfo(np.uint64).max, np.uint64)
        buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=out)
        kernel(queue, (64,), None, buffer)
        cl.enqueue_copy(queue, out, buffer)
    except (cl.Error, RuntimeError):
        return False
    return out.tolist() == [(1 << 33) | 62, 63]


DIVISION_SOURCE = """
__kernel void divide(__global const float *a, __global const float *b, __global float *one, __global float *eight,
                     __global float *roots) {
    const int i = get_global_id(0);
    one[i] = a[i] / b[i];
    vstore8(vload8(i, a) / vload8(i, b), i, eight);
    vstore8(sqrt(fabs(vload8(i, a))), i, roots);
}
"""


def try_exact_division(context: cl.Context, queue: cl.CommandQueue) -> bool:
    """Return whether plain division, of scalars and of vectors, and square roots are correctly rounded on the device,
    whatever the driver promises: all of half a million are."""
    import numpy as np

    n = 1 << 16 if "oclgrind" not in os.environ.get("LD_PRELOAD", "") else 64
    rng = np.random.default_rng(0)
    a, b = ((rng.normal(size=8 * n) * 10 ** rng.uniform(-6, 6, 8 * n)).astype(np.float32) for _ in range(2))
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    try:
        with quiet_builds():
            kernel = cl.Kernel(_built(queue, DIVISION_SOURCE), "divide")
        made = [cl.Buffer(context, cl.mem_flags.WRITE_ONLY, 4 * 8 * n) for _ in range(3)]
        kernel(queue, (n,), None, *(cl.Buffer(context, flags, hostbuf=x) for x in (a, b)), *made)
        one, eight, roots = (np.empty_like(a) for _ in made)
        for array, buffer in zip((one, eight, roots), made, strict=True):
            cl.enqueue_copy(queue, array, buffer)
    except (cl.Error, RuntimeError):
        return False
    expected = a / b
    right = np.array_equal(one[:n], expected[:n]) and np.array_equal(eight, expected)
    return right and np.array_equal(roots, np.sqrt(np.abs(a)))


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


def _main(wanted: list[str]) -> None:
    """Print the results of probing the devices with indices `wanted`, or of all devices. After `--list` only list
    them."""
    for index, platform, device in _cl_devices():
        if not wanted or wanted == ["--list"] or index in wanted:
            info = describe(index, platform, device)
            print(json.dumps(asdict(info)), flush=True)
            if wanted != ["--list"]:
                _probe(info, device)
    print(_PROBED, flush=True)


if __name__ == "__main__":
    _main(sys.argv[1:])
