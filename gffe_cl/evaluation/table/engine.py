"""Filling the table: cells that are there are taken, others are computed, here or on a cluster, and kept one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gffe_cl.errors import GffeError
from gffe_cl.evaluation.table.cache import Cache, key_of
from gffe_cl.evaluation.table.cells import Cell, compute_cell, machine_of
from gffe_cl.evaluation.table.methods import Method, chosen_methods
from gffe_cl.evaluation.table.subjects import Subject

# (work items, arguments of `compute_cell` beside) → the items with their cells, as they come.
Executor = Callable[[list["Work"], dict], Iterator[tuple["Work", Cell]]]


@dataclass(frozen=True)
class Work:
    """A cell to compute: `method` None is what describes the sequence."""

    subject: Subject
    method: str | None
    key: str


@dataclass
class Filled:
    """The table: cells by (name of the sequence, name of the method), what describes each sequence, and why the others
    are missing; `computed`: how many cells were not there before."""

    methods: dict[str, Method]
    subjects: list[Subject]
    machine: str
    cells: dict[tuple[str, str], Cell] = field(default_factory=dict)
    described: dict[str, Cell] = field(default_factory=dict)
    skipped: dict[tuple[str, str], str] = field(default_factory=dict)
    computed: int = 0


@dataclass(frozen=True)
class Order:
    """What is asked for. `methods`, `onnx` as of `chosen_methods`; `videos`: names of `VIDEO_METRICS`; `recompute`:
    take no cell that is there; `scn_model`: as of `chosen_methods`."""

    subjects: tuple[Subject, ...]
    methods: tuple[str, ...] | None = None
    onnx: tuple[str, ...] = ()
    videos: tuple[str, ...] = ()
    recompute: bool = False
    scn_model: Path | None = None


def fill(
    order: Order,
    folder: Path,
    device: str | None = None,
    executor: Executor | None = None,
    on_plan: Callable[[int], Callable[[], None]] = lambda total: lambda: None,
) -> Filled:
    """Fill the table; cells are kept in `folder`. `on_plan` takes the number of moments to come and returns what is
    called after each of them. Cells that were finished stay whatever ends it. Raises GffeError."""
    names = [subject.name for subject in order.subjects]
    if len(set(names)) < len(names):
        raise GffeError(f"eval: two sequences have one name, {next(n for n in names if names.count(n) > 1)}")
    methods = chosen_methods(order.methods, order.onnx, any(s.upscale for s in order.subjects), order.scn_model)
    filled = Filled(methods, list(order.subjects), _machine(device, executor))
    cache, missing = Cache(folder), []
    for subject in order.subjects:
        identity = subject.identity()
        for name in (None, *methods):
            method = methods[name] if name else None
            if method and (reason := method.missing(subject)):
                filled.skipped[subject.name, name] = reason
                continue
            work = Work(subject, name, key_of(identity, method and method.identity()))
            cell = None if order.recompute else cache.read(work.key)
            if cell and set(order.videos if method else ()) <= _tried(cell):
                _take(filled, work, cell, cache)
            else:
                missing.append(work)
    advance = on_plan(sum(work.subject.moments for work in missing if work.method))
    arguments = {"onnx": order.onnx, "videos": order.videos, "device": device, "scn_model": order.scn_model}
    compute = executor or _in_this_process
    for work, cell in compute(missing, arguments | {"on_moment": advance}):
        cache.write(work.key, cell)
        filled.computed += 1
        _take(filled, work, cell, cache)
    return filled


def _machine(device: str | None, executor: Executor | None) -> str:
    """This one; a machine without a device may have others compute."""
    try:
        return machine_of(device)
    except GffeError:
        if executor is None:
            raise
        return "a cluster"


def _in_this_process(items: list[Work], arguments: dict) -> Iterator[tuple[Work, Cell]]:
    for work in items:
        yield work, compute_cell(work.subject, work.method, **arguments)


def _tried(cell: Cell) -> set[str]:
    """Names of the video metrics that were measured, or could not be."""
    return {*cell.document.get("videos", {}), *cell.document.get("skipped", {})}


def _take(filled: Filled, work: Work, cell: Cell, cache: Cache) -> None:
    if work.method is None:
        filled.described[work.subject.name] = cell
    else:
        cell.timing = cache.timing(work.key, filled.machine)
        filled.cells[work.subject.name, work.method] = cell
