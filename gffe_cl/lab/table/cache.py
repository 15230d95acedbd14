"""Cache of cells on disk, found by a hash of everything that they depend on. Cells on disk are always complete."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from pathlib import Path

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import read_bounded, replacing
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.lab.table.jobs import Cell

_VERSION = 2
_MOST_BYTES = 64 << 20  # of a file
_USED = ("engine", "captures", "lab")  # the wings that figures depend on


class Cache:
    """Cache of cells in the folder `path`, as files named by their keys. Raises GffeError where it cannot be written
    to."""

    def __init__(self, path: Path):
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GffeError(f"{path}: cannot be made ({error.strerror or error})") from None

    def read(self, key: str) -> Cell | None:
        """Return the cell; None if it is not there, or damaged."""
        try:
            document = json.loads(read_bounded(self.path / f"{key}.json", _MOST_BYTES))
            names, timing = document.pop("pictures"), document.pop("timing")
            pictures = {name: read_bounded(self.path / f"{key}.{name}.webp", _MOST_BYTES) for name in names}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return Cell(document, pictures, timing)

    def write(self, key: str, cell: Cell) -> None:
        """Write a cell. The JSON is written last, so that an incomplete cell does not count."""
        try:
            for name, data in cell.pictures.items():
                with replacing(self.path / f"{key}.{name}.webp") as part:
                    part.write_bytes(data)
            document = cell.document | {"pictures": sorted(cell.pictures), "timing": cell.timing}
            with replacing(self.path / f"{key}.json") as part:
                part.write_text(json.dumps(document, allow_nan=False), "utf-8")
        except OSError as error:
            raise GffeError(f"{self.path}: cannot be written to ({error.strerror or error})") from None


def key_of(subject: dict, method: dict | None) -> str:
    """Return the key of the cell of a method on a subject, by their identities and the sources of the program."""
    known = {"version": _VERSION, "subject": subject, "method": method, "sources": sources(), "kernels": kernels()}
    return hashlib.sha256(json.dumps(known, sort_keys=True, default=str).encode()).hexdigest()[:32]


@cache
def sources() -> str:
    """Return a hash of the modules that figures depend on."""
    root = Path(str(files("gffe_cl")))
    return _digest(path for wing in _USED for path in (root / wing).rglob("*.py"))


def kernels() -> str:
    """Return a hash of all kernel files."""
    return _digest(path for path in kernel_folder().rglob("*") if path.suffix in (".cl", ".h"))


def _digest(paths: Iterable[Path]) -> str:
    total = hashlib.sha256()
    for path in sorted(paths):
        total.update(os.fsencode(path.name) + b"\0" + path.read_bytes())
    return total.hexdigest()
