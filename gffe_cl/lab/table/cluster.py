"""Computation of cells on a Dask cluster. Their results are stored on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.remote_workers import Cluster
from gffe_cl.lab.table.cache import key_of
from gffe_cl.lab.table.datasets import Subject
from gffe_cl.lab.table.jobs import Cell, compute_cell
from gffe_cl.lab.table.methods import chosen_methods
from gffe_cl.lab.table.runner import Executor, Work


def executor_of(workers: Cluster) -> Executor:
    """Return an executor for `fill`. Workers see folders of sequences and ONNX files under the same paths as here."""

    def compute(items: list[Work], arguments: dict) -> Iterator[tuple[Work, Cell | GffeError]]:
        return _compute(workers, items, arguments)

    return compute


def _compute(workers: Cluster, items: list[Work], arguments: dict) -> Iterator[tuple[Work, Cell | GffeError]]:
    on_moment = arguments.pop("on_moment")
    named = {f"{work.method or 'description'} on {work.subject.name}": work for work in items}
    for name, cell in workers.compute(_cell, {name: (work, arguments) for name, work in named.items()}):
        yield named[name], cell
        for _ in range(named[name].subject.moments if named[name].method else 0):
            on_moment()


def _cell(work: Work, arguments: dict) -> Cell | GffeError:
    """Return, on a worker, the cell, or why the sequence cannot be measured. Raises GffeError if the same name would
    mean something else there."""
    chosen = chosen_methods([work.method], arguments["onnx"], network=arguments["network"]) if work.method else {}
    method = chosen.get(work.method or "")
    if key_of(_identity(work.subject), method and method.identity()) != work.key:
        raise GffeError(
            "--scheduler: a worker has another version of gffe-cl, other weights or other files of"
            f" {work.subject.name} (expected the same as here)"
        )
    try:
        return compute_cell(work.subject, work.method, **arguments)
    except GffeError as error:
        return error


@lru_cache(maxsize=4)
def _identity(subject: Subject) -> dict:
    return subject.identity()
