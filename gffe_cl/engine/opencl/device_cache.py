"""Device cache: results of probing, stored between processes. Probing takes half a second, and its figures depend on
the load.

There is one file for each state of drivers and machine (`fingerprint`). A folder that cannot be read or written is no
error.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from contextlib import suppress
from dataclasses import asdict, fields
from pathlib import Path

import pyopencl as cl

from gffe_cl.engine.core.files import read_bounded
from gffe_cl.engine.opencl import probing
from gffe_cl.engine.opencl.probing import DeviceInfo, Probed
from gffe_cl.engine.opencl.runtimes import driver_variables, keep_file, kept_folder, vendors

_NAME = "devices-{}.json"
_MOST_FILES = 16
_MOST_BYTES = 1 << 20
_HOUR = 3600.0
_NODES = ("/dev/dri/*", "/dev/nvidia*", "/dev/kfd", "/dev/dxg", "/dev/mali*")
_KERNEL_DRIVERS = ("/proc/driver/nvidia/version", "/sys/module/amdgpu/version", "/sys/module/i915/srcversion")
_LIBRARIES = ("/usr/lib/*-linux-gnu*", "/usr/lib64", "/usr/lib", "/usr/local/lib*")


def fingerprint() -> str:
    """Return a hash of everything that probing depends on: drivers and their libraries, their environment variables,
    the machine."""
    facts = [
        hashlib.sha256(Path(probing.__file__).read_bytes()).hexdigest(),
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
    """Return the entry stored as `key`, or None. Failures expire after an hour. Everything expires after a day if
    the drivers' files do not identify them."""
    folder = kept_folder()
    if folder is None:
        return None
    try:
        document = json.loads(read_bounded(folder / _NAME.format(key), _MOST_BYTES))
        age = time.time() - float(document["time"])
        found = Probed(
            [_device(device) for device in document["devices"]],
            {str(icd): _device(device) for icd, device in document["crashing"].items()},
            age,
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    broken = found.crashing or not found.devices or not all(device.works for device in found.devices)
    longest = _HOUR if broken else float("inf") if vendors() else 24 * _HOUR
    return found if 0 <= age <= longest else None


def keep(key: str, found: Probed) -> None:
    """Store `found` as `key` for later processes."""
    folder = kept_folder()
    if folder is None:
        return
    document = {
        "time": time.time(),
        "devices": [asdict(device) for device in found.devices],
        "crashing": {icd: asdict(device) for icd, device in found.crashing.items()},
    }
    with suppress(OSError):
        path = folder / _NAME.format(key)
        keep_file(path, json.dumps(document, indent=1).encode("utf-8"), _NAME.format("*"), _MOST_FILES)


def _device(document: dict) -> DeviceInfo:
    """Return the entry of a JSON document. Raises TypeError unless the fields have the declared types."""
    info = DeviceInfo(**document)
    for name, value in ((field.name, getattr(info, field.name)) for field in fields(DeviceInfo)):
        kind = {"works": bool, "exact_division": bool, "lacks": list, "megapixels_per_second": (int, float)}.get(
            name, str
        )
        if not isinstance(value, kind):
            raise TypeError(name)
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
