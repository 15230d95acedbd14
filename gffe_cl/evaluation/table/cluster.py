"""The same cells on many machines: a Dask cluster computes them, each worker on its own OpenCL device, and what comes
back is kept here, in the same cache. A worker that dies loses nothing but the cell it was at, which another one takes.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator

from gffe_cl.errors import GffeError
from gffe_cl.evaluation.table.cells import Cell, compute_cell
from gffe_cl.evaluation.table.engine import Executor, Work

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
    futures = {
        client.submit(_cell, work.subject, work.method, key=f"gffe-{work.key}", **arguments): work for work in items
    }
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


def _cell(subject, method, **arguments) -> Cell:
    """On a worker."""
    with _one_at_a_time:
        return compute_cell(subject, method, **arguments)
