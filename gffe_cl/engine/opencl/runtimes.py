"""Discovery of OpenCL runtimes, before the ICD loader lists them; folders of caches; tuning of this process's memory.

The loader reads its list of vendors once in a process, when OpenCL is first asked for platforms: `prepare_runtimes`
must run before. Runtimes that pip installed into the environment (Intel's CPU runtime) are not in the system's vendor
folder; they are added to a folder of our own that repeats the system's entries.
"""

from __future__ import annotations

import ctypes
import hashlib
import mmap
import os
import stat
import sys
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import platformdirs

from gffe_cl.engine.core.errors import printable

_KEPT = "GFFE_DEVICE_CACHE"
_INTEL_ICD = "gffe-intel.icd"  # of Intel's runtime in this environment
VENDORS = "OCL_ICD_VENDORS"  # the ICD loader's variable: a folder of `.icd` files, or one such file
NO_CACHE: Any = False  # for pyopencl's `cache_dir`, whose stub only accepts folders
_POCL_CACHE = "POCL_CACHE_DIR"  # PoCL's variable
_DRIVER_CACHES = ("pocl", "pyopencl", "neo_compiler_cache", "mesa_shader_cache", "mesa_shader_cache_db")
# Environment variables of drivers and their libraries begin with these.
_DRIVERS_READ = ("CL_", "CUDA_", "GPU_", "HIP_", "HSA_", "MESA_", "NEO", "NVIDIA_", "OCL_", "OCLGRIND_", "ONEAPI_")
_DRIVERS_READ += ("OPENCL_", "POCL_", "ROCR_", "RUSTICL_", "SYCL_", "ZE_", "LD_PRELOAD", "LD_LIBRARY_PATH")
_SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
_MOST_NAMED, _LONGEST_NAME = 3, 300  # drivers in a message, and characters of a library's name
# Parameters of mallopt (malloc.h of glibc): memory freed at the end of the heap goes back to the system above so many
# bytes; so many allocations have pages of their own, which go back when they are freed; so many heaps.
_M_TRIM_THRESHOLD, _M_MMAP_MAX, _M_ARENA_MAX = -1, -4, -8
_NEVER = 2**31 - 1
# libintelocl.so finds these only if they are already loaded, in this order.
_INTEL_NEEDS = ("libintlc.so.5", "libimf.so", "libsvml.so", "libirng.so", "libtbb.so.12")


def cache_folder() -> Path:
    """Return the folder for caches of this package, made on first use; a temporary one where home is not writable, or
    belongs to another user: native code is loaded from folders in it."""
    folder = platformdirs.user_cache_path("gffe-cl", appauthor=False)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        probe = folder / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError:
        return _temporary_folder()
    return folder if _is_safe(folder) else _temporary_folder()


def kept_folder() -> Path | None:
    """Return the folder for results that later processes reuse: `cache_folder`, or `GFFE_DEVICE_CACHE`. None if that
    is "off" or if there is no such folder."""
    chosen = os.environ.get(_KEPT)
    if chosen:
        return None if chosen == "off" else Path(chosen)
    with suppress(OSError):
        return cache_folder()
    return None


def keep_file(path: Path, content: bytes, alike: str, most: int) -> None:
    """Write a file atomically, also if other processes write it. Of the files beside it that match `alike` the
    `most` newest are kept."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.stem}.{os.getpid()}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        with suppress(OSError):
            partial.unlink()
    kept = sorted(path.parent.glob(alike), key=lambda file: file.stat().st_mtime, reverse=True)
    for file in kept[most:]:
        file.unlink(missing_ok=True)


def private_folder(folder: Path) -> bool:
    """Make `folder` if it is missing. Return whether only this user can write to it, as native code is loaded from it:
    it is no link, no file in it belongs to another user, and no other user can put another folder in its place."""
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        facts = folder.lstat()
        if not stat.S_ISDIR(facts.st_mode):
            return False
        owners = {facts.st_uid, *(path.lstat().st_uid for path in folder.iterdir())}
        own = not hasattr(os, "getuid") or (owners == {os.getuid()} and not facts.st_mode & 0o022)
        return own and _is_safe(folder)
    return False


def _is_safe(folder: Path) -> bool:
    """Return whether `folder` and those around it belong to this user or to root, and whoever may write to them cannot
    rename what is in them."""
    if not hasattr(os, "getuid"):
        return True
    folder = folder.resolve()
    around = [path.stat() for path in (folder, *folder.parents)]
    return all(
        facts.st_uid in (0, os.getuid()) and (not facts.st_mode & stat.S_IWOTH or facts.st_mode & stat.S_ISVTX)
        for facts in around
    )


def _temporary_folder() -> Path:
    """Return a temporary folder that only this user can write to."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"gffe-cl-{user}"
    return folder if private_folder(folder) else Path(tempfile.mkdtemp(prefix="gffe-cl-"))


def prepare_runtimes() -> None:
    """Make OpenCL runtimes of this Python environment known, such as Intel's for CPUs, and let drivers keep their
    caches where they can write.

    `open_device`, `list_devices` and the command line call it. Call it yourself, first of all, in a program that uses
    pyopencl before them: when OpenCL has been asked for platforms, it is too late. Sets
    the environment variable OCL_ICD_VENDORS, unless the user has, and XDG_CACHE_HOME where caches cannot be written.
    A second call does nothing.
    """
    redirect_unwritable_caches()
    expose_installed_runtimes()


def expose_installed_runtimes() -> None:
    """Add OpenCL runtimes of this Python environment to those the ICD loader will list.

    Does nothing if `OCL_ICD_VENDORS` is set (the user has chosen), or if there is no such runtime. Intel's does not
    find its other files in a folder whose name has a space.
    """
    if os.environ.get(VENDORS) or not sys.platform.startswith("linux"):
        return
    library = Path(sys.prefix) / "lib" / "libintelocl.so"
    if not library.exists():
        return
    if any(letter.isspace() for letter in str(library.resolve())):
        warnings.warn(
            f"{library}: Intel's OpenCL runtime does not work in a folder whose name has a space (expected another"
            " folder for the environment)",
            stacklevel=2,
        )
        return
    try:
        for name in _INTEL_NEEDS:
            ctypes.CDLL(str(library.with_name(name)), mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return
    entries = {icd.name: icd.read_text() for icd in vendors()} | {_INTEL_ICD: f"{library}\n"}
    os.environ[VENDORS] = str(_vendor_folder(entries))


def driver_variables() -> dict[str, str]:
    """Return the environment variables that drivers and their libraries read, sorted by name. What a driver finds and
    builds depends on them: Intel's runtime for CPUs takes the instruction set from CL_CONFIG_CPU_TARGET_ARCH."""
    return {name: value for name, value in sorted(os.environ.items()) if name.startswith(_DRIVERS_READ)}


def vendors() -> list[Path]:
    """Return the `.icd` files that the ICD loader reads, sorted by name."""
    chosen = Path(os.environ.get(VENDORS) or _SYSTEM_VENDORS)
    return sorted(chosen.glob("*.icd")) if chosen.is_dir() else [chosen] if chosen.is_file() else []


def why_no_platform() -> str | None:
    """Return why the ICD loader lists no platform, as far as its variable or its files show it, else None."""
    chosen, found = os.environ.get(VENDORS), vendors()
    expected = f"(expected a folder of them, as {_SYSTEM_VENDORS}, or no such variable)"
    if chosen and not found:
        there = "where there is no .icd file" if Path(chosen).is_dir() else "which is not there"
        return f"{VENDORS} is {chosen}, {there} {expected}"
    gone = [(icd, library) for icd in found if (library := _library_of(icd)).is_absolute() and not library.exists()]
    if gone and len(gone) == len(found):
        return f"{gone[0][0]} names {gone[0][1]}, which is not there (expected the driver's library)"
    if chosen and _INTEL_ICD not in (icd.name for icd in found):  # else it is ours
        named = printable(", ".join(f"{icd.name} names {_library_of(icd)}" for icd in found[:_MOST_NAMED]))
        return f"{VENDORS} is {chosen}, whose .icd files bring no platform: {named} {expected}"
    return None


def _library_of(icd: Path) -> Path:
    with suppress(OSError, UnicodeDecodeError), icd.open() as file:
        return Path(file.read(_LONGEST_NAME).strip())
    return Path(icd.name)


def redirect_unwritable_caches() -> None:
    """Make PoCL and pyopencl keep their caches where they can be written, if the home folder cannot be written or
    belongs to another user, as with sudo, or folders in it do.

    Both fail to build anything otherwise. Both look for the folder when they first need it.
    """
    chosen = os.environ.get(_POCL_CACHE)
    if chosen and not _can_be_written(Path(chosen)):
        os.environ[_POCL_CACHE] = str(cache_folder() / "pocl")
        warnings.warn(
            f"{_POCL_CACHE} is {chosen}, which cannot be written: PoCL keeps its cache in {os.environ[_POCL_CACHE]}",
            stacklevel=2,
        )
    home = platformdirs.user_cache_path()
    if not _can_be_written(home) or not all(map(_can_be_written, _driver_folders(home))):
        os.environ["XDG_CACHE_HOME"] = str(cache_folder())


def _can_be_written(folder: Path) -> bool:
    """Return whether files can be made in `folder`, or if it is missing, whether it can be made, and no other user
    owns it: root can write to every folder, but code comes from these."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    writable = folder.is_dir() and os.access(folder, os.W_OK | os.X_OK) and not str(folder).startswith("/proc")
    return writable and _is_safe(folder)


def _driver_folders(home: Path) -> list[Path]:
    """Return the caches of drivers in `home`, and the folders in them."""
    found = []
    for name in _DRIVER_CACHES:
        folder = home / name
        if os.path.lexists(folder):
            found.append(folder)
            with suppress(OSError):
                found += [path for path in folder.iterdir() if path.is_dir()]
    return found


def _vendor_folder(entries: dict[str, str]) -> Path:
    digest = hashlib.sha256(repr(sorted(entries.items())).encode()).hexdigest()[:16]
    folder = cache_folder() / f"vendors-{digest}"
    if not private_folder(folder) or {icd.name for icd in folder.glob("*.icd")} - entries.keys():
        folder = Path(tempfile.mkdtemp(prefix="gffe-cl-"))  # the loader loads whatever an `.icd` file names
    for name, text in entries.items():
        path = folder / name
        if not path.exists() or path.read_text() != text:
            partial = folder / f"{name}.{os.getpid()}.partial"
            partial.write_text(text)
            partial.replace(path)
    return folder


def keep_freed_memory() -> None:
    """Keep freed pages in this process, to be used again, for a command that allocates images of one size over and
    over. Fetching new ones from the system costs more time than filling them, in virtual machines ten times as much.
    Does nothing but with glibc."""
    with suppress(OSError, AttributeError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in ((_M_TRIM_THRESHOLD, _NEVER), (_M_MMAP_MAX, 0), (_M_ARENA_MAX, 1)):
            mallopt(parameter, value)


def ask_for_huge_pages(address: int, nbytes: int) -> None:
    """Ask Linux to back memory with pages of 2 MiB where it can: with small ones, kernels that jump about in images
    wait for translations of addresses. Does nothing elsewhere."""
    start = -(-address // mmap.PAGESIZE) * mmap.PAGESIZE
    length = (address + nbytes - start) // mmap.PAGESIZE * mmap.PAGESIZE
    with suppress(OSError, AttributeError, TypeError):
        madvise = ctypes.CDLL(None).madvise
        madvise(ctypes.c_void_p(start), ctypes.c_size_t(length), mmap.MADV_HUGEPAGE)
