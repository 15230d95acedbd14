"""Building kernels from `kernels/*.cl`, and launching them by the names of their arguments.

Includes are expanded here, with `#line`, so that every build error names the real file and line and the
driver's build cache sees the whole text.

Built programs are stored on disk: some drivers take seconds to build one that loads in milliseconds. pyopencl stores
them too, but behind a lock that a killed process leaves behind: every later process waits for a minute. Here a file is
whole or not there at all. A folder that cannot be read or written is no error. Drivers crash on damaged binaries: each
is stored behind a digest, which is checked first.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path, PurePosixPath
from posixpath import normpath
from threading import Lock
from typing import Any

import numpy as np
import pyopencl as cl
from pyopencl.characterize import has_src_build_cache

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import read_bounded
from gffe_cl.engine.core.validation import shown
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.probing import build_log, quiet_builds, rounding_options
from gffe_cl.engine.opencl.runtimes import NO_CACHE, driver_variables, keep_file, kept_folder, private_folder

_FOLDER = "kernels"
_RESULTS = ("engine", "captures", "lab")  # wings that results depend on
_MOST_FILES = 256
_MOST_BYTES = 64 << 20
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"')
_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_DEFINE = re.compile(r"^\s*#define\s+([A-Z]\w*)\s+([^\s(].*?)\s*$", re.MULTILINE)
_ENUM = re.compile(r"\benum\s*\{([\w\s,]*)\}")
_MACRO = re.compile(r"^\s*#define\s+([A-Z]\w*)\s+((?:.*\\\n)*.*)$", re.MULTILINE)
_ATTRIBUTE = r"(?:\s*__attribute__\s*\(\(.*?\)\)\))?"
_KERNEL = re.compile(rf"\b__kernel\b{_ATTRIBUTE}\s+void\s+(\w+)\s*\(([^{{;]*?)\)\s*\{{", re.DOTALL)
_STRUCT = re.compile(r"\btypedef\s+struct\s*\{([^}]*)\}\s*(\w+)\s*;")
_QUALIFIERS = {"const", "__global", "__constant", "__local", "restrict"}
_SCALARS = {"int": np.int32, "uint": np.uint32, "float": np.float32}


@dataclass(frozen=True)
class Argument:
    """Argument of a kernel: `type` as in OpenCL C without qualifiers; a `buffer` is a pointer, `read_only` if const."""

    name: str
    type: str
    buffer: bool
    read_only: bool

    @property
    def is_number(self) -> bool:
        """Whether it is a number, passed by value."""
        return not self.buffer and self.type in _SCALARS

    @property
    def is_frame_block(self) -> bool:
        """Whether it is the pointer to the frame block, which a kernel reads, or writes if it brings the frame."""
        return self.buffer and self.type == "Frame"

    @property
    def brings_frame(self) -> bool:
        """Whether it is a frame block by value: the kernel writes it to the device, for those after it."""
        return not self.buffer and self.type == "Frame"

    @property
    def numpy_type(self) -> Any:
        """NumPy type for pyopencl: of a number, or of a struct's bytes; None for buffers."""
        return None if self.buffer else _SCALARS.get(self.type, np.void)

    def packed(self, value: Any) -> Any:
        """Return `value` as the kernel takes it: numbers in the argument's type, everything else unchanged."""
        return value if self.buffer or self.type not in _SCALARS else _SCALARS[self.type](value)


class Program:
    """The kernels of one file. `kernels` are the objects that `launch` uses, `arguments` describe the parameters of
    each, and `constants` are the numbers defined by the file and its headers."""

    def __init__(self, device: Device, name: str, source: str, variant: dict[str, int]):
        self.name = name
        defined = (f"-D{key}={value}" for key, value in sorted(variant.items()))
        options = ("-cl-kernel-arg-info", *rounding_options(device.cl_device), *defined)
        try:
            with quiet_builds():
                built = built_program(device.context, device.cl_device, source, options)
        except cl.RuntimeError as error:
            what = f"kernels/{name}.cl does not build on {device.info.name}"
            log = with_files_named(build_log(error), source)
            raise BuildError(f"{what}: {first_error(log)}", f"{what}:\n{log}") from None
        # Not `all_kernels`: pyopencl (2026.1) retains those once too often, and the context is never released.
        names = str(built.get_info(cl.program_info.KERNEL_NAMES)).split(";")
        self._built = built
        self.arguments = parse_kernels(source)
        self.constants = parse_constants(source) | variant
        self._launching = Lock()  # arguments are set one by one: several threads share the kernels of `launch`
        self.kernels = {kernel: self.kernel(kernel) for kernel in names}
        for kernel in self.kernels.values():
            told = _told_names(kernel)
            parsed = [argument.name for argument in self.arguments.get(kernel.function_name, ())]
            assert told in (None, parsed), f"kernels/{name}.cl, {kernel.function_name}: takes {told}, read as {parsed}"

    def kernel(self, name: str) -> cl.Kernel:
        """Return a new kernel object, whose arguments nobody else sets."""
        kernel = cl.Kernel(self._built, name)
        # pyopencl takes some 20 µs to determine the type of a number.
        kernel.set_arg_types([argument.numpy_type for argument in self.arguments.get(name, ())])
        return kernel

    def launch(
        self,
        queue: cl.CommandQueue,
        kernel: str,
        size: tuple[int, ...],
        group: tuple[int, ...] | None,
        values: Mapping[str, Any],
    ) -> cl.Event:
        """Enqueue `kernel` over `size` work-items in groups of `group`, and return its event. `values` are set by the
        names of arguments, others are left alone."""
        try:
            packed = [argument.packed(values[argument.name]) for argument in self.arguments[kernel]]
        except KeyError as missing:
            raise TypeError(f"kernels/{self.name}.cl, {kernel}: no value for argument {missing}") from None
        with self._launching:
            return self.kernels[kernel](queue, size, group, *packed)


def build(device: Device, name: str, **variant: int) -> Program:
    """Build `kernels/<name>.cl` for `device` and return the program; `variant` becomes -D options (true variants only).

    A program is built only once from the same text: pipelines of one device share kernels, on several threads too.
    Raises GffeError with the compiler's log (file and line) when it does not build.
    """
    source = expand(f"{name}.cl")
    choices = {"LANES": device.lanes}
    if device.exact_division:
        choices["EXACT_DIVISION"] = 1
    if device.info.platform == "Oclgrind" and device.lanes > 1:
        choices["OCLGRIND"] = 1
    variant = {choice: value for choice, value in choices.items() if choice in source} | variant
    key = (name, source, *sorted(variant.items()))
    if key not in device.programs:
        device.programs[key] = Program(device, name, source, variant)
    return device.programs[key]


def kernel_folder() -> Path:
    """Return the folder of the kernel sources: `GFFE_KERNELS`, else the one in the installed package. Raises GffeError
    unless it is one."""
    if not (chosen := os.environ.get("GFFE_KERNELS")):
        return Path(str(files("gffe_cl.kernels")))
    if not os.path.isfile(os.path.join(chosen, "common.h")):
        raise GffeError(f"GFFE_KERNELS must be a folder of kernels with common.h, got {shown(chosen)}")
    return Path(chosen)


def kernel_digest() -> str:
    """Return a hash of all kernel files."""
    total = hashlib.sha256()
    for path in sorted(path for path in kernel_folder().rglob("*") if path.suffix in (".cl", ".h")):
        total.update(os.fsencode(path.name) + b"\0" + path.read_bytes())
    return total.hexdigest()


@cache
def package_digest() -> str:
    """Return a hash of everything in the package that results depend on: sources, kernels, weights."""
    total = hashlib.sha256(kernel_digest().encode())
    for path in sorted(path for wing in _RESULTS for path in Path(str(files("gffe_cl")), wing).rglob("*")):
        if path.suffix in (".py", ".onnx", ".npz"):
            total.update(os.fsencode(path.name) + b"\0" + path.read_bytes())
    return total.hexdigest()


def constants(name: str) -> dict[str, Any]:
    """Return the numbers that `kernels/<name>` and its headers define: {"BINS": 32768, …}."""
    return parse_constants(expand(name))


def parse_constants(source: str) -> dict[str, Any]:
    """Return the numbers that are defined in the text of a kernel file, and the members of its enums: integers, and
    floats as float32 has them."""
    found: dict[str, Any] = {}
    for name, text in _DEFINE.findall(_COMMENT.sub(" ", source)):
        text = text.strip()
        if re.fullmatch(r"(0[xX][0-9a-fA-F]+|\d+)[uU]?", text):
            found[name] = int(text.rstrip("uU"), 0)
        elif re.fullmatch(r"-?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?f?", text):
            found[name] = float(np.float32(text.rstrip("f")))
    for members in _ENUM.findall(_COMMENT.sub(" ", source)):
        found |= {name: value for value, name in enumerate(re.findall(r"\w+", members))}
    return found


def parse_kernels(source: str) -> dict[str, tuple[Argument, ...]]:
    """Return the arguments of every kernel in the text of a kernel file."""
    source = _COMMENT.sub(" ", source)
    macros = {name: body.replace("\\\n", " ") for name, body in _MACRO.findall(source)}

    def spelt_out(arguments: str) -> str:
        return re.sub(r"\w+", lambda word: macros.get(word[0], word[0]), arguments)

    return {
        kernel: tuple(_argument(text) for text in spelt_out(arguments).split(",") if text.strip())
        for kernel, arguments in _KERNEL.findall(source)
    }


def parse_struct(source: str, name: str) -> np.dtype:
    """Return the struct `name` in the text of a kernel file as a NumPy type, laid out as OpenCL C does: vectors are
    subarrays."""
    return _layout(_COMMENT.sub(" ", source), name)[0]


def _layout(source: str, name: str) -> tuple[np.dtype, int]:
    """Return the NumPy type of an OpenCL type, and its alignment in bytes."""
    if vector := re.fullmatch(r"(int|uint|float)(2|4|8|16)?", name):
        count = int(vector[2] or 1)
        dtype = np.dtype((_SCALARS[vector[1]], count)) if vector[2] else np.dtype(_SCALARS[name])
        return dtype, dtype.itemsize
    body = next(body for body, struct in _STRUCT.findall(source) if struct == name)
    fields, end, widest = {}, 0, 1
    for kind, names in re.findall(r"(\w+)\s+([^;]+);", body):
        dtype, alignment = _layout(source, kind)
        widest = max(widest, alignment)
        for member, count in re.findall(r"(\w+)(?:\[(\w+)\])?\s*(?:,|$)", names):
            size = int(parse_constants(source).get(count, count)) if count else 0
            start = -(-end // alignment) * alignment
            fields[member] = (np.dtype((dtype.base, (size, *dtype.shape))) if count else dtype, start)
            end = start + fields[member][0].itemsize
    formats, offsets = zip(*fields.values(), strict=True)
    layout: Any = {
        "names": list(fields),
        "formats": formats,
        "offsets": offsets,
        "itemsize": -(-end // widest) * widest,
    }
    return np.dtype(layout), widest


def _argument(text: str) -> Argument:
    words = text.replace("*", " * ").split()
    kind = " ".join(word for word in words[:-1] if word not in _QUALIFIERS and word != "*")
    return Argument(words[-1], kind, "*" in words, not {"const", "__constant"}.isdisjoint(words))


def _told_names(kernel: cl.Kernel) -> list[str] | None:
    """Return the names of a kernel's arguments if the runtime reports them."""
    try:
        return [str(kernel.get_arg_info(k, cl.kernel_arg_info.NAME)) for k in range(kernel.num_args)]
    except cl.Error:
        return None


def expand(name: str, folder: Path | None = None) -> str:
    """Return the text of the kernel file `name` with its includes in place and `#line` directives. `folder`: where it
    is; None: `kernel_folder`."""
    return "\n".join(_expanded_lines(folder or kernel_folder(), PurePosixPath(name), set())) + "\n"


def _expanded_lines(folder: Path, name: PurePosixPath, seen: set[PurePosixPath]) -> list[str]:
    seen.add(name)
    path = folder / name
    try:
        text = path.read_text()
    except OSError as error:
        raise GffeError(f"{path}: cannot read kernel source: {error.strerror}") from None
    lines = [f'#line 1 "{name}"']
    for number, line in enumerate(text.splitlines(), 1):
        include = _INCLUDE.match(line)
        if include is None:
            lines.append(line)
            continue
        included = PurePosixPath(normpath(name.parent / include[1]))  # relative to the including file, as in C
        if included not in seen:
            lines += _expanded_lines(folder, included, seen)
        lines.append(f'#line {number + 1} "{name}"')
    return lines


class BuildError(GffeError):
    """Error of kernels that do not build. The message is the compiler's first error, `log` its whole output."""

    def __init__(self, message: str, log: str = ""):
        super().__init__(message)
        self.log = log


def with_files_named(log: str, source: str) -> str:
    """Return a compiler's log with file and line in place of lines of the expanded `source`, "<kernel>:N", which
    NVIDIA's compiler counts although there are `#line` directives."""

    def named(place: re.Match[str]) -> str:
        above = source.splitlines()[: int(place[1])]
        after = next((k for k, line in enumerate(reversed(above)) if line.startswith("#line ")), 0)
        if not after:
            return place[0]
        _, first, name = above[-1 - after].replace('"', "").split(maxsplit=2)
        return f"{name}:{int(first) + after - 1}"

    return re.sub(r"<kernel>:(\d+)", named, log)


def first_error(log: str) -> str:
    """Return the first error in a compiler's log, with file and line if it names them."""
    lines = log.strip().splitlines()
    errors = [line for line in lines if re.search(r"\berror\b", line)]
    return ([line for line in errors if re.search(r"\w:\d+", line)] or errors or lines or [""])[0].strip()


# ---- stored programs -------------------------------------------------------------------------------


def built_program(context: cl.Context, device: cl.Device, source: str, options: tuple[str, ...] = ()) -> cl.Program:
    """Return the program of `source`, built for a device of `context`. Raises cl.RuntimeError with the compiler's
    log."""
    if not os.environ.get("PYOPENCL_COMPILER_OUTPUT"):
        options = (*options, "-w")  # else clang counts its warnings on standard error
    path = None if has_src_build_cache(device) else _path(device, source, options)
    if path is not None:
        with suppress(OSError, cl.Error):
            return _built(cl.Program(context, [device], [_read(path)]), device, options)
    program = _built(cl.Program(context, source), device, options)
    if path is not None:
        with suppress(OSError, cl.Error):
            binaries: Any = program.get_info(cl.program_info.BINARIES)
            binary = binaries[context.devices.index(device)]
            keep_file(path, _digest(path, binary) + binary, "*.bin", _MOST_FILES)
    return program


def _built(program: cl.Program, device: cl.Device, options: tuple[str, ...]) -> cl.Program:
    return program.build(options=list(options), devices=[device], cache_dir=NO_CACHE)


def _read(path: Path) -> bytes:
    """Return a stored binary. Raises OSError if it is missing or damaged."""
    content = read_bounded(path, _MOST_BYTES)
    size = hashlib.sha256().digest_size
    if content[:size] != _digest(path, content[size:]):
        raise OSError(f"{path}: damaged")
    return content[size:]


def _digest(path: Path, binary: bytes) -> bytes:
    return hashlib.sha256(path.stem.encode() + binary).digest()


def _path(device: cl.Device, source: str, options: tuple[str, ...]) -> Path | None:
    """Return the path of a stored program, None if there is no folder that only this user can write to. The name hashes
    everything the program depends on."""
    folder = kept_folder()
    if folder is None or not private_folder(folder / _FOLDER):
        return None
    driver = device.platform
    of_driver = device.name, device.version, device.driver_version, driver.name, driver.version
    facts = source, options, *of_driver, cl.VERSION_TEXT, driver_variables(), _processor()
    return folder / _FOLDER / f"{hashlib.sha256(repr(facts).encode('utf-8', 'surrogateescape')).hexdigest()[:32]}.bin"


def _processor() -> list[str]:
    """Return the CPU features that compiled code depends on: home folders are shared between machines."""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        first, *_ = file.read(1 << 14).split("\n\n")
        return [line for line in first.splitlines() if line.startswith(("model name", "flags", "Features"))]
    return [platform.processor()]
