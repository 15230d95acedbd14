"""Building kernels from `kernels/*.cl`.

Includes are expanded here, with `#line`, so that every build error names the real file and line and the
driver's build cache sees the whole text.
"""

from __future__ import annotations

import os
import re
from importlib.resources import files
from pathlib import Path, PurePosixPath
from posixpath import normpath

import pyopencl as cl

from gffe_cl.errors import GffeError
from gffe_cl.opencl.device import Device, quiet_builds

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"')


class Program:
    """The kernels of one file; each kernel object is made once and is an attribute: `program.splat(…)`."""

    def __init__(self, device: Device, name: str, source: str, variant: dict[str, int]):
        self.name = name
        options = [f"-D{key}={value}" for key, value in sorted(variant.items())]
        try:
            with quiet_builds():
                built = cl.Program(device.context, source).build(options=options)
        except cl.RuntimeError as error:
            raise GffeError(f"kernels/{name}.cl does not build on {device.info.name}:\n{_log(error)}") from None
        self.kernels = {kernel.function_name: kernel for kernel in built.all_kernels()}

    def __getattr__(self, name):
        try:
            return self.__dict__["kernels"][name]
        except KeyError:
            raise AttributeError(f"kernels/{self.__dict__.get('name')}.cl has no kernel '{name}'") from None


def build(device: Device, name: str, **variant: int) -> Program:
    """Build `kernels/<name>.cl` for `device`; `variant` becomes -D options (true variants only).

    What has been built before, from the same text, is not built again: pipelines of one device share kernels, so use
    them from one thread. Raises GffeError with the compiler's log (file and line) when it does not build.
    """
    source = expand(f"{name}.cl")
    key = (name, source, *sorted(variant.items()))
    if key not in device.programs:
        device.programs[key] = Program(device, name, source, variant)
    return device.programs[key]


def kernel_folder() -> Path:
    """Where kernel sources are read from: `GFFE_KERNELS`, else the installed package."""
    return Path(os.environ.get("GFFE_KERNELS") or str(files("gffe_cl.kernels")))


def expand(name: str) -> str:
    """Text of `kernels/<name>` with its includes in place and `#line` directives."""
    return "\n".join(_expanded_lines(PurePosixPath(name), set())) + "\n"


def _expanded_lines(name: PurePosixPath, seen: set[PurePosixPath]) -> list[str]:
    seen.add(name)
    path = kernel_folder() / name
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
            lines += _expanded_lines(included, seen)
        lines.append(f'#line {number + 1} "{name}"')
    return lines


def _log(error: Exception) -> str:
    noise = ("clBuildProgram failed", "Build on", "(options:", "(source saved", "Compilation ")
    lines = [line for line in str(error).splitlines() if line.strip() and not line.startswith(noise)]
    return "\n".join(lines) or str(error)
