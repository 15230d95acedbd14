"""Cache of cells on disk, found by a hash of everything that they depend on. Cells on disk are always complete."""

from __future__ import annotations

import ast
import hashlib
import json
import os
from functools import cache
from importlib.resources import files
from pathlib import Path

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import read_bounded, replacing
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.lab.table.jobs import Cell

_VERSION = 1
_MOST_BYTES = 64 << 20  # of a file
# Modules that figures do not depend on, or that only transport them.
_ELSEWHERE = ("cli", "viewer", "training", "run.py", "render.py", "__main__.py")
_MEASURING = ("images", "datasets", "regions", "labels", "methods", "baselines", "image_space", "network", "flicker",
              "videos", "jobs",              "pipelines", "windows")  # fmt: skip


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
        """Return the cell, with the times of any machine; None if it is not there, or damaged."""
        try:
            document = json.loads(read_bounded(self.path / f"{key}.json", _MOST_BYTES))
            names = document.pop("pictures")
            pictures = {name: read_bounded(self.path / f"{key}.{name}.webp", _MOST_BYTES) for name in names}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return Cell(document, pictures)

    def write(self, key: str, cell: Cell) -> None:
        """Write a cell. The JSON is written last, so that an incomplete cell does not count."""
        try:
            for name, data in cell.pictures.items():
                with replacing(self.path / f"{key}.{name}.webp") as part:
                    part.write_bytes(data)
            if cell.timing:
                self._dump(f"{key}.{_slug(cell.timing['machine'])}.time.json", cell.timing)
            self._dump(f"{key}.json", cell.document | {"pictures": sorted(cell.pictures)})
        except OSError as error:
            raise GffeError(f"{self.path}: cannot be written to ({error.strerror or error})") from None

    def timing(self, key: str, machine: str) -> dict | None:
        """Return the times of that machine, else of another one; None if there are none."""
        own = self.path / f"{key}.{_slug(machine)}.time.json"
        for path in (own, *sorted(self.path.glob(f"{key}.*.time.json"))):
            try:
                return json.loads(read_bounded(path, _MOST_BYTES))
            except (OSError, ValueError):
                continue
        return None

    def _dump(self, name: str, document: dict) -> None:
        with replacing(self.path / name) as part:
            part.write_text(json.dumps(document, allow_nan=False), "utf-8")


def key_of(subject: dict, method: dict | None) -> str:
    """Return the key of the cell of a method on a subject, by their identities and the sources of the program."""
    known = {"version": _VERSION, "subject": subject, "method": method, "sources": sources(), "kernels": kernels()}
    return hashlib.sha256(json.dumps(known, sort_keys=True, default=str).encode()).hexdigest()[:32]


@cache
def sources() -> str:
    """Return a hash of the modules that figures depend on. Comments and docstrings do not change it."""
    root, total = Path(str(files("gffe_cl"))), hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        place = path.relative_to(root)
        measuring = path.stem in _MEASURING if "lab" in place.parts else True
        if measuring and not set(place.parts) & set(_ELSEWHERE):
            total.update(f"{place.as_posix()}\0{_code(path.read_text('utf-8'))}\0".encode())
    return total.hexdigest()


def kernels() -> str:
    """Return a hash of all kernel files."""
    total = hashlib.sha256()
    for path in sorted(p for p in kernel_folder().rglob("*") if p.suffix in (".cl", ".h")):
        total.update(os.fsencode(path.name) + b"\0" + path.read_bytes())
    return total.hexdigest()


def _code(text: str) -> str:
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        first = body[0] if isinstance(body, list) and body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            first.value.value = None
    return ast.unparse(tree)


def _slug(machine: str) -> str:
    return hashlib.sha256(machine.encode()).hexdigest()[:12]
