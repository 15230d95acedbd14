"""Compilers of the vendors of GPUs: they build every program of `kernels/` as a GPU gets it, on a machine without one.

`gpu_compilers.py --setup FOLDER` fetches them. Tests and tools look for them in `GFFE_GPU_COMPILERS`. Nothing is
installed: programs are started with the dynamic loader of the release that they are from.
"""

from __future__ import annotations

import os
import re
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import ClassVar

from gffe_cl.engine.opencl.program import expand, kernel_folder, parse_kernels, parse_struct

VARIABLE = "GFFE_GPU_COMPILERS"
BUILTINS = Path(__file__).with_name("nvidia_builtins.cl")
ITEMS_OF_GROUP = 64  # that kernels are launched with on GPUs (base.py)

FILES = sorted(path.relative_to(kernel_folder()).with_suffix("").as_posix() for path in kernel_folder().rglob("*.cl"))


class BuildFailed(Exception):
    """A program does not build; the message is the compiler's."""


class NotFound(Exception):
    """A compiler is not in the folder; the message says so in a line."""


@dataclass(frozen=True)
class Cost:
    """The cost of a kernel on a GPU, by its compiler.

    Attributes
    ----------
    registers : int
        Of 4 bytes per work-item. On Intel's GPUs: of 32 bytes per hardware thread.
    spilled, private : int
        Bytes of registers that did not fit, and of variables in memory, per work-item (`spilled` of Intel: per thread).
    local : int
        Bytes of local memory per work-group.
    instructions : int
        In the program, executed or not.
    simd : int
        Work-items that run in step.
    occupancy : float
        Share of the hardware's threads that registers allow at once.
    """

    registers: int
    spilled: int
    private: int
    local: int
    instructions: int
    simd: int
    occupancy: float


# ---- programs and their forms ------------------------------------------------------------------------------------


def forms(source: str) -> dict[str, dict[str, int]]:
    """Return the options of every form that a GPU gets of a program, by a name; first the one that most get."""
    base = {"LANES": 1} if "LANES" in source else {}
    atomics = {"64-bit atomics": {"INT64_ATOMICS": 1}, "32-bit atomics": {}} if "INT64_ATOMICS" in source else {"": {}}
    division = {"": {}, "exact division": {"EXACT_DIVISION": 1}} if "EXACT_DIVISION" in source else {"": {}}
    sums = {"": {}, "float sums": {"FLOAT_SUMS": 1}} if "FLOAT_SUMS" in source else {"": {}}
    return {
        ", ".join(filter(None, names)): base | atomics[names[0]] | division[names[1]] | sums[names[2]]
        for names in product(atomics, division, sums)
    }


def argument_bytes(source: str) -> dict[str, int]:
    """Return the bytes of arguments of every kernel, each aligned as OpenCL C does; pointers have 64 bits."""
    return {kernel: _bytes_of_arguments(source, arguments) for kernel, arguments in parse_kernels(source).items()}


def _bytes_of_arguments(source: str, arguments) -> int:
    end = 0
    for argument in arguments:
        kind = None if argument.buffer else parse_struct(source, argument.type)
        size = 8 if kind is None else kind.itemsize
        alignment = 16 if kind is not None and kind.names else size
        end = -(-end // alignment) * alignment + size
    return end


# ---- compilers ---------------------------------------------------------------------------------------------------


class System:
    """A release of Debian that is unpacked in a folder; its dynamic loader starts its programs."""

    def __init__(self, folder: Path):
        self.folder = folder

    def find(self, *patterns: str) -> Path:
        """Return the file or folder of the highest version. Raises NotFound if there is none."""
        found = [path for pattern in patterns for path in self.folder.glob(pattern)]
        if not found:
            raise NotFound(f"there is no {patterns[0]} in {self.folder}")
        return max(found, key=lambda path: [int(number) for number in re.findall(r"\d+", path.as_posix())])

    def run(self, program: Path, *arguments: str | Path, text: str | None = None) -> str:
        """Run a program. Returns what it printed. Raises BuildFailed if it fails."""
        of_system = [self.folder / name for name in ("lib/x86_64-linux-gnu", "usr/lib/x86_64-linux-gnu")]
        libraries = ":".join(map(str, (*of_system, program.parent.parent / "lib")))
        loader = next(path for place in of_system if (path := place / "ld-linux-x86-64.so.2").exists())
        return _printed([loader, "--library-path", libraries, program, *arguments], text)

    def version(self, package: str) -> str:
        """Return a package's name and version without Debian's part, from the list that `--setup` has written."""
        for line in (self.folder / "packages.txt").read_text().splitlines():
            name, _, version = line.partition(" ")
            if re.fullmatch(package, name):
                return f"{name} {re.sub(r'^[0-9]+:|[+-].*$', '', version)}"
        raise NotFound(f"{self.folder} has no list of packages with {package}")


class Compiler:
    """Builds programs for the GPUs of one vendor. Raises NotFound where it is not in `folder`."""

    vendor: ClassVar[str]
    gpus: tuple[str, ...]
    version: str

    def __init__(self, folder: Path):
        raise NotImplementedError

    def build(self, source: str, options: dict[str, int], gpu: str, folder: Path) -> dict[str, Cost]:
        """Build and link a program with files in an empty `folder`. Returns the cost of each kernel. Raises
        BuildFailed."""
        raise NotImplementedError


class Amd(Compiler):
    """LLVM with the device libraries of ROCm."""

    vendor = "AMD"

    def __init__(self, folder: Path):
        self.system = _newest(folder, "usr/lib/llvm-*/bin/clang")
        self.clang, self.linker = (self.system.find(f"usr/lib/llvm-*/bin/{name}") for name in ("clang", "ld.lld"))
        self.libraries = self.system.find("usr/lib/*/amdgcn/bitcode", "usr/lib/llvm-*/lib/clang/*/amdgcn/bitcode")
        there = [gpu for gpu in ("gfx1030", "gfx1100") if (self.libraries / f"oclc_isa_version_{gpu[3:]}.bc").exists()]
        self.gpus = tuple(there)
        self.version = f"{self.system.version('clang-[0-9]+')}, {self.system.version('rocm-device-libs.*')}"

    def build(self, source: str, options: dict[str, int], gpu: str, folder: Path) -> dict[str, Cost]:
        code, made, program = (folder / name for name in ("kernels.s", "kernels.o", "kernels.so"))
        abi = max(path.stem[-3] for path in self.libraries.glob("oclc_abi_version_*.bc"))
        target = ("-target", "amdgcn-amd-amdhsa", f"-mcpu={gpu}", f"-mcode-object-version={abi}")
        rounded = ["-cl-fp32-correctly-rounded-divide-sqrt"] if "EXACT_DIVISION" in options else []
        self.system.run(
            self.clang,
            *_resources(self.clang),
            *_OPENCL,
            *target,
            *rounded,
            *_defined(options),
            "-O3",
            f"--rocm-device-lib-path={self.libraries}",
            "-S",
            "-",
            "-o",
            code,
            text=source,
        )
        self.system.run(self.clang, "-x", "assembler", *target, "-c", code, "-o", made)
        self.system.run(self.linker, "--no-undefined", "-shared", made, "-o", program)
        return dict(self._costs(code.read_text()))

    @staticmethod
    def _costs(code: str) -> Iterator[tuple[str, Cost]]:
        for block in re.split(r"\n  - \.a", code.split("amdhsa.kernels:")[1])[1:]:
            name = _first(r"\.name:\s+(\w+)", block)
            body = _first(rf"^{name}:.*?\n(.*?)^\.Lfunc_end", code)
            facts = {key: int(value) for key, value in re.findall(r"\.(\w+):\s+(\d+)$", block, re.M)}
            waves = int(_first(r"; Occupancy: (\d+)", code[code.index(f"\n{name}:") :]))
            yield (
                name,
                Cost(
                    facts["vgpr_count"],
                    4 * (facts["vgpr_spill_count"] + facts["sgpr_spill_count"]),
                    facts["private_segment_fixed_size"],
                    facts["group_segment_fixed_size"],
                    len(re.findall(r"^\t[a-z]\w+", body, re.M)),
                    facts["wavefront_size"],
                    waves / 16,
                ),
            )


class Nvidia(Compiler):
    """LLVM with libclc, and NVIDIA's assembler."""

    vendor, gpus = "NVIDIA", ("sm_86",)
    threads, registers, groups = 48, 65536, 16  # of a multiprocessor: warps, registers, work-groups

    def __init__(self, folder: Path):
        self.system = System(folder / "release")
        self.clang = self.system.find("usr/lib/llvm-*/bin/clang")
        self.library = self.system.find("usr/lib/clc/nvptx64--nvidiacl.bc")
        tools = System(folder / "python")
        self.assembler, self.disassembler = (tools.find(f"nvidia/*/bin/{name}") for name in ("ptxas", "nvdisasm"))
        own = _first(r"release ([\d.]+), V([\d.]+)", _printed([self.assembler, "--version"]), group=2)
        self.version = f"{self.system.version('clang-[0-9]+')}, {self.system.version('libclc.*')}, ptxas {own}"

    @cached_property
    def builtins(self) -> Path:
        """Built-in functions that libclc lacks."""
        self._temporary = tempfile.TemporaryDirectory()
        path = Path(self._temporary.name, "builtins.bc")
        self._compile("sm_86", "-cl-ext=+all", "-O3", "-emit-llvm", "-c", BUILTINS, "-o", path)
        return path

    def build(self, source: str, options: dict[str, int], gpu: str, folder: Path) -> dict[str, Cost]:
        code, program = folder / "kernels.ptx", folder / "kernels.cubin"
        libraries = (part for path in (self.builtins, self.library) for part in _cc1("-mlink-builtin-bitcode", path))
        division = f"-nvptx-prec-divf32={2 if 'EXACT_DIVISION' in options else 1}"
        self._compile(
            gpu,
            _EXTENSIONS,
            *libraries,
            "-mllvm",
            division,
            *_defined(options),
            "-O3",
            "-S",
            "-",
            "-o",
            code,
            text=source,
        )
        report = _printed([self.assembler, "-v", f"-arch={gpu}", code, "-o", program])
        counted = _instructions(_printed([self.disassembler, "-c", program]))
        return dict(self._costs(report, counted))

    def _compile(self, gpu: str, extensions: str, *arguments: str | Path, text: str | None = None) -> None:
        target = ("-target", "nvptx64--nvidiacl", *_cc1("-target-cpu", gpu), *_cc1(extensions))
        self.system.run(self.clang, *_resources(self.clang), *_OPENCL, *target, *arguments, text=text)

    def _costs(self, report: str, counted: dict[str, int]) -> Iterator[tuple[str, Cost]]:
        about = re.compile(
            r"Function properties for (\w+)\n\s*(\d+) bytes stack frame, (\d+) bytes spill stores, "
            r"(\d+) bytes spill loads\n.*?Used (\d+) registers(.*)"
        )
        for name, stack, stores, loads, registers, rest in about.findall(report):
            of_warp = 32 * -(-int(registers) // 8) * 8
            of_group = ITEMS_OF_GROUP // 32
            warps = min(self.threads, self.groups * of_group, self.registers // of_warp // of_group * of_group)
            local = int(_first(r"(\d+) bytes smem", rest, "0"))
            spilled = int(stores) + int(loads)
            yield name, Cost(int(registers), spilled, int(stack), local, counted[name], 32, warps / self.threads)


class Intel(Compiler):
    """Intel's offline compiler, ocloc."""

    vendor, gpus = "Intel", ("dg2-g10",)

    def __init__(self, folder: Path):
        self.system = _newest(folder, "usr/bin/ocloc*")
        self.ocloc = self.system.find("usr/bin/ocloc*")
        self.version = f"{self.system.version('intel-ocloc|intel-opencl-icd')}, {self.system.version('libigc[0-9]')}"

    def build(self, source: str, options: dict[str, int], gpu: str, folder: Path) -> dict[str, Cost]:
        (folder / "kernels.cl").write_text(source)
        rounded = ["-cl-fp32-correctly-rounded-divide-sqrt"] if "EXACT_DIVISION" in options else []
        asked = " ".join(("-cl-std=CL1.2", "-cl-kernel-arg-info", *rounded, *_defined(options)))
        self.system.run(
            self.ocloc,
            "compile",
            "-file",
            folder / "kernels.cl",
            "-device",
            gpu,
            "-options",
            asked,
            "-internal_options",
            "-cl-intel-allow-zebin",
            "-out_dir",
            folder,
            "-output",
            "kernels",
        )
        sections = elf_sections(next(folder.glob("*.bin")).read_bytes())
        if missing := [name for name in undefined_symbols(sections) if not name.startswith("__INTEL_")]:
            raise BuildFailed(f"undefined: {', '.join(missing)}")  # ocloc leaves them to the driver
        return dict(self._costs(sections))

    @staticmethod
    def _costs(sections: dict[str, bytes]) -> Iterator[tuple[str, Cost]]:
        kernels = sections[".ze_info"].decode().split("\nkernels:")[1].split("\nkernels_misc_info:")[0]
        for block in re.split(r"\n\s+- name:\s+", kernels)[1:]:
            name = block.split("\n")[0].strip().strip("'\"")
            if f".text.{name}" not in sections or name.startswith("Intel_"):
                continue
            facts = {key: int(value) for key, value in re.findall(r"^\s+(\w+):\s+(\d+)$", block, re.M)}
            memory = re.findall(r"- type:\s+(\w+)\s+usage:\s+(\w+)\s+size:\s+(\d+)", block)
            private = sum(int(size) for kind, usage, size in memory if usage == "private_space")
            simd = facts["simd_size"]
            yield (
                name,
                Cost(
                    facts["grf_count"],
                    facts.get("spill_size", 0),
                    private,
                    facts.get("slm_size", 0),
                    intel_instructions(sections[f".text.{name}"]),
                    simd,
                    128 / facts["grf_count"],
                ),
            )


COMPILERS: tuple[type[Compiler], ...] = (Amd, Nvidia, Intel)


def compilers_folder() -> Path:
    """Return the folder of the compilers. Raises NotFound if the environment names none."""
    if not os.environ.get(VARIABLE):
        raise NotFound(f"{VARIABLE} is not set (docs/tools/gpu_compilers.py --setup FOLDER)")
    return Path(os.environ[VARIABLE])


@dataclass(frozen=True)
class Built:
    """A program in one form, for one GPU: the cost of its kernels, or why it does not build."""

    program: str
    form: str
    gpu: str
    costs: dict[str, Cost]
    failure: str = ""


def build_all(compiler: Compiler, few: bool = False) -> list[Built]:
    """Build every program: for the first GPU in every form, for others in the form that most GPUs get. `few`: in that
    form for all, and for the first in the last form where it is a path of its own, without 64-bit atomics. Return all
    builds."""

    def chosen(source: str, gpu: str) -> list[tuple[str, dict[str, int]]]:
        first, *others = forms(source).items()
        if gpu != compiler.gpus[0] or (few and "INT64_ATOMICS" not in source):
            return [first]
        return [first, *(others[-1:] if few else others)]

    def built(name: str, source: str, form: str, options: dict[str, int], gpu: str) -> Built:
        with tempfile.TemporaryDirectory() as folder:
            try:
                return Built(name, form, gpu, compiler.build(source, options, gpu, Path(folder)))
            except BuildFailed as failure:
                return Built(name, form, gpu, {}, " ".join(str(failure).split())[:400])

    work = [
        (name, source, form, options, gpu)
        for name in FILES
        for source in [expand(f"{name}.cl")]
        for gpu in compiler.gpus
        for form, options in chosen(source, gpu)
    ]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        return list(pool.map(lambda one: built(*one), work))


# ---- reading what compilers write --------------------------------------------------------------------------------

_OPENCL = ("-x", "cl", "-cl-std=CL1.2", "-ffp-contract=off", "-w")
_EXTENSIONS = "-cl-ext=-all," + ",".join(
    f"+cl_khr_{name}"
    for name in (
        "fp16",
        "byte_addressable_store",
        "int64_base_atomics",
        "int64_extended_atomics",
        "global_int32_base_atomics",
        "global_int32_extended_atomics",
        "local_int32_base_atomics",
        "local_int32_extended_atomics",
    )
)


def elf_sections(file: bytes) -> dict[str, bytes]:
    """Return the sections of an ELF file of 64 bits, by name."""
    (table,) = struct.unpack_from("<Q", file, 0x28)
    size, count, names = struct.unpack_from("<HHH", file, 0x3A)
    heads = [struct.unpack_from("<IIQQQQ", file, table + k * size) for k in range(count)]
    text = file[heads[names][4] :]
    return {text[h[0] : text.index(b"\0", h[0])].decode(): file[h[4] : h[4] + h[5]] for h in heads}


def undefined_symbols(sections: dict[str, bytes]) -> list[str]:
    """Return the names in the table of symbols of an ELF file that it does not define."""
    names, symbols = sections[".strtab"], struct.iter_unpack("<IBBHQQ", sections.get(".symtab", b""))
    found = (names[at : names.index(b"\0", at)].decode() for at, _, _, section, _, _ in symbols if section == 0)
    return [name for name in found if name]


def intel_instructions(code: bytes) -> int:
    """Return the instructions of a kernel for Xe: of 8 bytes each where bit 29 is set, else of 16; 0 is padding."""
    count = start = 0
    while start < len(code):
        (word,) = struct.unpack_from("<I", code, start)
        count += bool(word & 0x7F)
        start += 8 if word >> 29 & 1 else 16
    return count


def _instructions(disassembled: str) -> dict[str, int]:
    """Return the instructions of each kernel in the output of nvdisasm, without the jump to itself and the padding that
    end it."""
    counts: dict[str, int] = {}
    for kernel, body in re.findall(r"^\s*\.text\.(\w+):(.*?)(?=^\s*\.text\.|\Z)", disassembled, re.M | re.S):
        counts[kernel] = sum("NOP" not in line for line in re.findall(r"^\s+/\*[0-9a-f]+\*/\s+(.*?);", body, re.M)) - 1
    return counts


def _newest(folder: Path, pattern: str) -> System:
    """Return Debian's development release if it is in the folder and has such a file, else this release."""
    systems = [System(folder / name) for name in ("sid", "release")]
    return next((system for system in systems if any(system.folder.glob(pattern))), systems[-1])


def _resources(clang: Path) -> tuple[str, Path]:
    """Return the headers beside clang, which does not find them itself when the dynamic loader starts it."""
    return "-resource-dir", System(clang.parent.parent).find("lib/clang/*")


def _defined(options: dict[str, int]) -> list[str]:
    return [f"-D{name}={value}" for name, value in options.items()]


def _cc1(*arguments: str | Path) -> list[str | Path]:
    return [part for argument in arguments for part in ("-Xclang", argument)]


def _first(pattern: str, text: str, default: str | None = None, group: int = 1) -> str:
    found = re.search(pattern, text, re.M | re.S)
    if found is None and default is not None:
        return default
    assert found, f"the compiler's output has no {pattern}"
    return found[group]


def _printed(command: list, text: str | None = None) -> str:
    done = subprocess.run(list(map(str, command)), input=text, capture_output=True, text=True)
    if done.returncode:
        raise BuildFailed(f"{Path(command[0]).name}: {done.stderr or done.stdout}")
    return done.stdout + done.stderr
