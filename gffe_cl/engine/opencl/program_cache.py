"""Cache of built programs on disk. Some drivers take seconds to build a program that loads in milliseconds.

pyopencl keeps them too, but behind a lock that a killed process leaves behind: every later process waits for a minute.
Here a file is whole or not there at all, so that no process waits for another. A folder that cannot be read or written
is no error. Drivers crash on damaged binaries: each is stored behind a digest, which is checked first.
"""

from __future__ import annotations

import hashlib
import os
import platform
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyopencl as cl
from pyopencl.characterize import has_src_build_cache

from gffe_cl.engine.core.files import read_bounded
from gffe_cl.engine.opencl.runtimes import NO_CACHE, driver_variables, keep_file, kept_folder, private_folder

_FOLDER = "kernels"
_MOST_FILES = 256
_MOST_BYTES = 64 << 20


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
    facts = (
        source, options, device.name, device.version, device.driver_version, driver.name, driver.version,
        cl.VERSION_TEXT, driver_variables(), _processor(),
    )  # fmt: skip
    return folder / _FOLDER / f"{hashlib.sha256(repr(facts).encode('utf-8', 'surrogateescape')).hexdigest()[:32]}.bin"


def _processor() -> list[str]:
    """Return the CPU features that compiled code depends on: home folders are shared between machines."""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        first, *_ = file.read(1 << 14).split("\n\n")
        return [line for line in first.splitlines() if line.startswith(("model name", "flags", "Features"))]
    return [platform.processor()]
