"""Filling of the table: cached cells are reused, others are computed and stored one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.lab.table.cache import Cache, key_of
from gffe_cl.lab.table.datasets import Subject
from gffe_cl.lab.table.jobs import Cell, compute_cell, machine_of
from gffe_cl.lab.table.methods import Method, chosen_methods


@dataclass(frozen=True)
class Work:
    """A cell to compute; `method` None stands for the description of the sequence."""

    subject: Subject
    method: str | None
    key: str


@dataclass
class Filled:
    """The table: cells by (name of the sequence, name of the method), the description of each sequence, and reasons
    for missing cells; `broken`: reasons by name for sequences that cannot be measured; `computed`: number of cells
    not taken from the cache."""

    methods: dict[str, Method]
    subjects: list[Subject]
    machine: str
    cells: dict[tuple[str, str], Cell] = field(default_factory=dict)
    described: dict[str, Cell] = field(default_factory=dict)
    skipped: dict[tuple[str, str], str] = field(default_factory=dict)
    broken: dict[str, str] = field(default_factory=dict)
    computed: int = 0

    def drop(self, name: str, reason: str) -> None:
        """Leave out a sequence that cannot be measured."""
        self.broken.setdefault(name, reason)
        self.subjects = [subject for subject in self.subjects if subject.name != name]
        self.described.pop(name, None)
        for table in (self.cells, self.skipped):
            for key in [key for key in table if key[0] == name]:
                del table[key]


@dataclass(frozen=True)
class TableOrder:
    """Requested evaluation. `methods`, `onnx` as of `chosen_methods`; `videos`: names of `VIDEO_METRICS`; `recompute`:
    ignore cached cells; `network`: as of `chosen_methods`."""

    subjects: tuple[Subject, ...]
    methods: tuple[str, ...] | None = None
    onnx: tuple[str, ...] = ()
    videos: tuple[str, ...] = ()
    recompute: bool = False
    network: tuple[str | None, str | None] = (None, None)


def fill(
    order: TableOrder,
    folder: Path,
    device: str | None = None,
    on_plan: Callable[[int], Callable[[], None]] = lambda total: lambda: None,
) -> Filled:
    """Fill the table and return it; cells are cached in `folder`. `on_plan` takes the number of moments to come and
    returns a function that is called after each of them. Finished cells survive an interrupt. Sequences with faults are
    left out. Raises GffeError if all have faults."""
    names = [subject.name for subject in order.subjects]
    if len(set(names)) < len(names):
        raise GffeError(f"eval: two sequences have one name, {next(n for n in names if names.count(n) > 1)}")
    methods = chosen_methods(order.methods, order.onnx, any(s.upscale for s in order.subjects), order.network)
    filled = Filled(methods, list(order.subjects), machine_of(device))
    cache, missing = Cache(folder), []
    for subject in order.subjects:
        try:
            identity = subject.identity()
        except OSError as error:
            filled.drop(subject.name, f"{error.filename}: {error.strerror or error}")
            continue
        for name in (None, *methods):
            method = methods[name] if name else None
            if method and name and (reason := method.missing(subject)):
                filled.skipped[subject.name, name] = reason
                continue
            work = Work(subject, name, key_of(identity, method and method.identity()))
            cell = None if order.recompute else cache.read(work.key)
            if cell and set(order.videos if method else ()) <= _tried(cell):
                _take(filled, work, cell)
            else:
                missing.append(work)
    advance = on_plan(sum(work.subject.moments for work in missing if work.method))
    arguments = {"onnx": order.onnx, "videos": order.videos, "device": device, "network": order.network}
    for work, cell in _computed(missing, arguments | {"on_moment": advance}):
        if isinstance(cell, GffeError):
            filled.drop(work.subject.name, str(cell))
            continue
        cache.write(work.key, cell)
        filled.computed += 1
        if work.subject.name not in filled.broken:
            _take(filled, work, cell)
    if filled.broken and not filled.subjects:
        raise GffeError("; ".join(f"{name}: {reason}" for name, reason in filled.broken.items()))
    return filled


def _computed(items: list[Work], arguments: dict) -> Iterator[tuple[Work, Cell | GffeError]]:
    """Yield the items with their cells; with a GffeError if the sequence cannot be measured."""
    broken = set()
    for work in items:
        if work.subject.name in broken:
            continue
        try:
            yield work, compute_cell(work.subject, work.method, **arguments)
        except GffeError as error:
            broken.add(work.subject.name)
            yield work, error


def _tried(cell: Cell) -> set[str]:
    """Return the names of the video metrics that were measured, or could not be."""
    return {*cell.document.get("videos", {}), *cell.document.get("skipped", {})}


def _take(filled: Filled, work: Work, cell: Cell) -> None:
    if work.method is None:
        filled.described[work.subject.name] = cell
    else:
        filled.cells[work.subject.name, work.method] = cell
