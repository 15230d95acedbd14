"""The same cells on many machines: a Dask cluster computes them, each worker on its own OpenCL device, and what comes
back is kept here, in the same cache. A worker that dies loses nothing but the cell it was at, which another one takes.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import lru_cache

from gffe_cl.errors import GffeError
from gffe_cl.evaluation.table.cache import key_of
from gffe_cl.evaluation.table.cells import Cell, compute_cell
from gffe_cl.evaluation.table.engine import Executor, Work
from gffe_cl.evaluation.table.methods import chosen_methods
from gffe_cl.evaluation.table.subjects import Subject

_PATIENCE = "20s"  # for a scheduler's answer
_one_at_a_time = threading.Lock()  # of a worker's threads: they share a device


def cluster(address: str) -> Executor:
    """An executor for `fill` on the Dask scheduler at `address` ("tcp://host:8786"). Workers need gffe-cl, of the same
    version, and see folders of sequences and ONNX files under the same paths. Raises GffeError if none answers."""
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise GffeError("--scheduler needs dask and distributed: pip install 'gffe-cl[dask]'") from None
    try:
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError, TypeError) as error:
        raise GffeError(f"--scheduler {address}: no Dask scheduler answers ({type(error).__name__})") from None

    def compute(items: list[Work], arguments: dict) -> Iterator[tuple[Work, Cell]]:
        return _compute(client, items, arguments)

    return compute


def _compute(client, items: list[Work], arguments: dict) -> Iterator[tuple[Work, Cell]]:
    from distributed import KilledWorker, as_completed

    on_moment = arguments.pop("on_moment")
    futures = {client.submit(_cell, work, key=f"gffe-{work.key}", **arguments): work for work in items}
    try:
        for future in as_completed(list(futures)):
            work = futures.pop(future)
            try:
                cell = future.result()
            except KilledWorker:
                name = f"{work.method or 'description'} on {work.subject.name}"
                raise GffeError(f"--scheduler: workers died again and again at the cell {name}") from None
            yield work, cell
            for _ in range(work.subject.moments if work.method else 0):
                on_moment()
            future.release()
    finally:
        client.cancel(list(futures))


def _cell(work: Work, **arguments) -> Cell:
    """On a worker. GffeError if the same name would mean something else there."""
    with _one_at_a_time:
        chosen = chosen_methods([work.method], arguments["onnx"]) if work.method else {}
        method = chosen.get(work.method)
        if key_of(_identity(work.subject), method and method.identity()) != work.key:
            raise GffeError(
                "--scheduler: a worker has another version of gffe-cl, other weights or other files of"
                f" {work.subject.name} (expected the same as here)"
            )
        return compute_cell(work.subject, work.method, **arguments)


@lru_cache(maxsize=4)
def _identity(subject: Subject) -> dict:
    return subject.identity()
