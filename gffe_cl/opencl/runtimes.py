"""Making OpenCL runtimes visible before pyopencl loads.

The ICD loader reads its list of vendors once, so this must run before the first `import pyopencl`:
importing `gffe_cl` does it. Where pyopencl came first, only the system's runtimes are seen.
Runtimes that pip installed into the environment (Intel's CPU runtime) are not in the system's vendor
folder; they are added to a folder of our own that repeats the system's entries.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
import tempfile
from pathlib import Path

_SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
# What libintelocl.so finds only when these are already loaded, in this order.
_INTEL_NEEDS = ("libintlc.so.5", "libimf.so", "libsvml.so", "libirng.so", "libtbb.so.12")


def cache_folder() -> Path:
    """Folder for caches of this package, made on first use; a temporary one where home is not writable."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folder = Path(base) / "gffe-cl"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"gffe-cl-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        folder.mkdir(parents=True, exist_ok=True)
    return folder


HIDE_INSTALLED = "GFFE_HIDE_INSTALLED_RUNTIMES"  # set for children of a process that does not see them either
_exposed = False


def installed_runtimes_are_exposed() -> bool:
    """Whether this process, and so a child that imports `gffe_cl`, sees runtimes installed by pip."""
    return _exposed or "OCL_ICD_VENDORS" in os.environ


def expose_installed_runtimes() -> None:
    """Add OpenCL runtimes of this Python environment to those the ICD loader will list.

    Does nothing if `OCL_ICD_VENDORS` is set (the user has chosen), if pyopencl is already loaded, or if
    there is no such runtime.
    """
    global _exposed
    chosen = "OCL_ICD_VENDORS" in os.environ or HIDE_INSTALLED in os.environ
    if chosen or "pyopencl" in sys.modules or not sys.platform.startswith("linux"):
        return
    library = Path(sys.prefix) / "lib" / "libintelocl.so"
    if not library.exists():
        return
    try:
        for name in _INTEL_NEEDS:
            ctypes.CDLL(str(library.with_name(name)), mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return
    entries = {"gffe-intel.icd": f"{library}\n"}
    if _SYSTEM_VENDORS.is_dir():
        for icd in sorted(_SYSTEM_VENDORS.glob("*.icd")):
            entries[icd.name] = icd.read_text()
    os.environ["OCL_ICD_VENDORS"] = str(_vendor_folder(entries))
    _exposed = True


def redirect_unwritable_caches() -> None:
    """Let PoCL and pyopencl keep their caches where they can be written, for homes that cannot.

    Both fail to build anything otherwise. Does nothing for a variable that the user has set.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    while not home.exists() and home != home.parent:
        home = home.parent
    if not os.access(home, os.W_OK) or str(home).startswith("/proc"):
        os.environ.setdefault("POCL_CACHE_DIR", str(cache_folder() / "pocl"))
        os.environ.setdefault("PYOPENCL_NO_CACHE", "1")


def _vendor_folder(entries: dict[str, str]) -> Path:
    digest = hashlib.sha256(repr(sorted(entries.items())).encode()).hexdigest()[:16]
    folder = cache_folder() / f"vendors-{digest}"
    folder.mkdir(exist_ok=True)
    for name, text in entries.items():
        path = folder / name
        if not path.exists() or path.read_text() != text:
            partial = folder / f"{name}.{os.getpid()}.partial"
            partial.write_text(text)
            partial.replace(path)
    return folder
