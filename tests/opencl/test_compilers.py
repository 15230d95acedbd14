"""Kernels are accepted by compilers that are stricter than the runtimes here, and ask little of a device.

That is clang's OpenCL front end, for a 64-bit device without extensions, warnings being errors; what it makes is valid
SPIR-V.
"""

import os
import re
import shutil
import subprocess

import pytest

from gffe_cl.opencl.program import expand, kernel_folder, parse_kernels

STANDARDS = ("CL1.2", "CL2.0", "CL3.0")
# A device without double precision, images and the rest. clang 14 knows vload_half4 only with cl_khr_fp16, though it is
# no part of that.
EXTENSIONS = "-cl-ext=-all,+cl_khr_fp16,+cl_khr_int64_base_atomics,+cl_khr_int64_extended_atomics"
WARNINGS = (
    "-Wall", "-Wextra", "-Wshadow", "-Wdouble-promotion", "-Wfloat-conversion", "-Wundef", "-Wvla", "-Werror",
)  # fmt: skip
MOST_LOCAL = 16 << 10  # bytes per work-group
MOST_PRIVATE = {1: 64, 8: 3 << 10}  # bytes per work-item, by LANES: that of CPUs holds eight pixels on the stack
PRIVATE = {"scenes/scene.shade": 1 << 10}  # kernels that may have more: those of test scenes

FILES = sorted(path.relative_to(kernel_folder()).with_suffix("").as_posix() for path in kernel_folder().rglob("*.cl"))


def tool(*names):
    """The first of these programs that is here; else skips the test, but not in CI."""
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        assert not os.environ.get("CI"), f"CI must have {names[0]}"
        pytest.skip(f"{names[0]} is not installed")
    return found


def variants(source):
    """The options with which a file is built (program.build, NearestStage): together they reach every #if."""
    for lanes, int64, exact in ((1, True, False), (8, True, True), (1, False, True), (8, False, False)):
        if (lanes, int64) == (8, False) and "INT64_ATOMICS" not in source:
            continue
        options = {"LANES": lanes, "RUN": 16 if lanes > 1 else 1}
        options |= ({"INT64_ATOMICS": 1} if int64 else {}) | ({"EXACT_DIVISION": 1} if exact else {})
        yield [f"-D{name}={value}" for name, value in options.items() if name in source]


def clang(source, standard, *options):
    """What clang writes to its standard output."""
    command = [tool("clang-14", "clang"), "-target", "spir64", "-x", "cl", f"-cl-std={standard}", *options]
    child = subprocess.run([*command, "-", "-o", "-"], input=source.encode(), capture_output=True)
    assert child.returncode == 0, f"{options}: {child.stderr.decode()[:2000]}"
    return child.stdout


@pytest.mark.parametrize("name", FILES)
def test_clang_accepts_it_without_a_warning(name):
    source = expand(f"{name}.cl")
    for standard in STANDARDS:
        for options in variants(source):
            clang(source, standard, *WARNINGS, "-Xclang", EXTENSIONS, *options, "-fsyntax-only")


def test_a_warning_is_an_error():
    """... and double precision is none of the language."""
    for fault in ("float f(int unused) { return 1.0f; }", "float f(float x) { return 2.0 * x; }", "double f(void);"):
        with pytest.raises(AssertionError, match="error"):
            clang(fault, "CL1.2", *WARNINGS, "-Xclang", EXTENSIONS, "-fsyntax-only")


@pytest.mark.long
@pytest.mark.parametrize("name", FILES)
def test_its_spirv_is_valid(name, tmp_path):
    translate, check = tool("llvm-spirv-14", "llvm-spirv"), tool("spirv-val")
    source = expand(f"{name}.cl")
    for options in variants(source):
        # Unoptimized: LLVM's optimizations write what SPIR-V cannot say.
        code = clang(source, "CL1.2", "-O0", "-Xclang", "-disable-O0-optnone", "-emit-llvm", "-c", *options)
        path = tmp_path / "kernels.spv"
        subprocess.run([translate, "--spirv-max-version=1.0", "-", "-o", path], input=code, check=True)
        subprocess.run([check, "--target-env", "opencl1.2", path], check=True)


def memory_of_kernels(name, *options):
    """(bytes of local memory, bytes of private arrays and structures) by kernel: what stays in memory when clang has
    inlined and optimized, registers apart."""
    code = clang(expand(f"{name}.cl"), "CL1.2", "-O2", "-S", "-emit-llvm", *options).decode()
    structs = dict(re.findall(r"^(%\S+) = type (\{.*\})$", code, re.M))
    local = [(owner, nbytes(kind, structs)) for owner, kind in
             re.findall(r"^@(\w+)\.\S+ = .*addrspace\(3\) global (.*?) undef", code, re.M)]  # fmt: skip
    found = {}
    for head, kernel, body in re.findall(r"^define ([^\n]*?)@(\w+)\([^\n]*\{\n(.*?)^\}", code, re.M | re.S):
        allocated = re.findall(r"= alloca (.*), align \d+$", body, re.M)
        assert "spir_kernel" in head or not allocated, f"{name}, {kernel}: not inlined"
        found[kernel] = (
            sum(size for owner, size in local if owner == kernel),
            sum(nbytes(kind, structs) for kind in allocated),
        )
    return found


def nbytes(kind, structs):
    """Of a type of LLVM: every member at a multiple of its own size at the most, so this errs to the larger side."""
    kind = kind.strip()
    if kind in structs:
        return nbytes(structs[kind], structs)
    if kind.startswith("{"):
        members = re.split(r",\s*(?![^\[<]*[\]>])", kind.strip("{} "))
        sizes = [nbytes(member, structs) for member in members]
        return sum(-(-size // 16) * 16 if size > 8 else size for size in sizes)
    if many := re.fullmatch(r"[\[<](\d+) x (.*)[\]>]", kind):
        count = int(many[1])
        return (4 if kind[0] == "<" and count == 3 else count) * nbytes(many[2], structs)
    return 8 if kind.endswith("*") else {"float": 4, "half": 2, "i1": 1}.get(kind) or int(kind.removeprefix("i")) // 8


@pytest.mark.parametrize("lanes", MOST_PRIVATE)
def test_kernels_are_modest(lanes):
    found = {}
    for name in FILES:
        told = memory_of_kernels(name, f"-DLANES={lanes}", f"-DRUN={16 if lanes > 1 else 1}")
        assert set(told) == set(parse_kernels(expand(f"{name}.cl")))
        found |= {f"{name}.{kernel}": sizes for kernel, sizes in told.items()}
    assert found["holes.fill_from_downsampled"][0] == 3428  # as Intel's runtime and PoCL say
    assert {kernel: sizes for kernel, sizes in found.items() if sizes[0] > MOST_LOCAL} == {}
    too_large = {k: sizes for k, sizes in found.items() if sizes[1] > max(MOST_PRIVATE[lanes], PRIVATE.get(k, 0))}
    assert too_large == {}
