"""Work on many machines: functions computed by the workers of a Dask cluster, each on its own OpenCL device.

If a worker dies, another one repeats the item in progress; every result comes once.
"""

from __future__ import annotations

import hashlib
import re
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from functools import cache, lru_cache
from importlib.resources import files
from itertools import islice
from pathlib import Path
from typing import Any

from gffe_cl.engine.core.errors import GffeError, require_packages
from gffe_cl.engine.core.files import follow_links, following_links
from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.opencl.program import kernel_folder

PATIENCE = "8s"  # for a scheduler's answer
_ADDRESS = re.compile(r"inproc://\S+|([a-z]+://)?[^\s/]+:\d{1,5}")
_AHEAD = 64  # results that wait on workers, at most
_one_at_a_time = threading.Lock()  # of a worker's threads: they share a device


class Cluster:
    """Connection to the Dask scheduler at `address` ("tcp://host:8786"). Workers need the same sources of gffe-cl as
    here, and see files under the same paths. Raises GffeError if no scheduler answers."""

    def __init__(self, address: str):
        require_packages("--scheduler", "cluster", "dask", "distributed")
        from distributed import Client

        if not _ADDRESS.fullmatch(address):
            raise GffeError(f"--scheduler {address}: is no address (expected tcp://HOST:8786)")
        try:
            self._client = Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise GffeError(f"--scheduler {address}: no Dask scheduler answers ({type(error).__name__})") from None

    def close(self) -> None:
        """Leave the scheduler. Its work for other clients continues."""
        self._client.close()

    def compute(
        self, function: Callable[..., Any], items: Mapping[str, tuple], in_order: bool = False
    ) -> Iterator[tuple[str, Any]]:
        """Yield (name, result of `function` with the arguments of that name) of each item, in order or as they
        finish. Items that nobody takes any more are cancelled. Raises GffeError, also for `function`'s exceptions
        and if workers died repeatedly."""
        from distributed import KilledWorker, as_completed

        run, waiting, names = uuid.uuid4().hex, iter(items.items()), {}
        known, links = fingerprint(), following_links()

        def submit(count: int) -> list:
            begun = []
            for name, arguments in islice(waiting, count):
                future = self._client.submit(_on_worker, known, links, function, arguments, key=f"gffe-{run}-{name}")
                names[future] = name
                begun.append(future)
            return begun

        submit(_AHEAD)
        finished = None if in_order else as_completed(list(names), loop=self._client.loop)
        try:
            while names:
                future = next(iter(names)) if finished is None else next(finished)
                try:
                    result = future.result()
                except KilledWorker:
                    raise GffeError(f"--scheduler: workers died again and again at {names[future]}") from None
                name = names.pop(future)
                begun = submit(1)
                if finished is not None:
                    finished.update(begun)
                yield name, result
                future.release()
        finally:
            self._client.cancel(list(names))


def _on_worker(known: str, links: bool, function: Callable[..., Any], arguments: tuple) -> Any:
    with _one_at_a_time, follow_links(links):
        if fingerprint() != known:
            raise GffeError("--scheduler: a worker has another version of gffe-cl (expected the same as here)")
        return function(*arguments)


@lru_cache(maxsize=1)
def device_of_worker(name: str | None) -> Device:
    """Return the device that a worker's process opens for all of its work."""
    return open_device(name, profiling=True)


@cache
def fingerprint() -> str:
    """Return a hash of the sources and the kernels of this program."""
    total, root = hashlib.sha256(), Path(str(files("gffe_cl")))
    for folder, endings in ((root, (".py",)), (kernel_folder(), (".cl", ".h"))):
        for path in sorted(p for p in folder.rglob("*") if p.suffix in endings):
            total.update(f"{path.relative_to(folder).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return total.hexdigest()
