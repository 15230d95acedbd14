"""Work on a Dask cluster: one function of many cells. Arguments and results travel as JSON and as bytes of files, so no
disk is shared. Workers import the function from their own gffe-cl, which must be the same program. If a worker dies,
another one computes its cell again."""

from __future__ import annotations

import json
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any

from gffe_cl.engine.core.errors import GffeError, require_packages
from gffe_cl.engine.core.files import Files, packed_files, unpack
from gffe_cl.engine.core.public_names import __version__
from gffe_cl.engine.opencl.program import package_digest

_PATH = "gffe path"  # key of a path in arguments
_one_at_a_time = threading.Lock()  # of a worker's threads: they share its device
_copies: dict[str, TemporaryDirectory] = {}  # a worker's, by run and path


class Cluster(ExitStack):
    """Connection to a Dask scheduler, as a context. `scheduler`: its address ("tls://host:8786"), the file that it
    writes for clients, or "local:N", which starts one with N workers on this machine, encrypted. `tls`: files of the
    authority, the certificate and its key, or nothing. Raises GffeError if no scheduler answers."""

    def __init__(self, scheduler: str, tls: tuple[Path, ...] = ()):
        super().__init__()
        require_packages("--scheduler", "cluster", "distributed", "cryptography")
        import distributed
        from distributed.comm.addressing import get_address_host_port

        self._dask: Any = distributed
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a lost worker is no message of this program
        begun, (kind, _, number) = monotonic(), scheduler.partition(":")
        where: dict[str, Any] = {"scheduler_file" if Path(scheduler).is_file() else "address": scheduler}
        try:
            if tls:
                names = dict(zip(("tls_ca_file", "tls_client_cert", "tls_client_key"), map(str, tls), strict=True))
                where["security"] = distributed.Security(require_encryption=True, **names)
            if kind == "local" and number.isdecimal():
                count: Any = {"n_workers": max(int(number), 1), "threads_per_worker": 1, "dashboard_address": None}
                local = distributed.LocalCluster(
                    host="127.0.0.1", security=True, silence_logs=logging.CRITICAL, **count
                )
                where = {"address": self.enter_context(local)}
            address = where.get("address")  # a client that cannot be made prints a traceback when it is dropped
            if isinstance(address, str):
                get_address_host_port(address)
                if address.startswith("tls:") and not tls:
                    raise ValueError("TLS without its files")
            self._client: Any = self.enter_context(distributed.Client(**where, timeout="10s", set_as_default=False))
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            self.close()
            why = f"{type(error).__name__} (expected tls://HOST:8786, the file of a scheduler, or local:N)"
            raise GffeError(f"--scheduler {scheduler}: no Dask scheduler answers, {why}") from None
        self._sent, self._workers = {}, set()
        self._connecting, self._since = monotonic() - begun, monotonic()
        self._cells = self._there = self._back = 0

    def __exit__(self, kind, *rest):
        if kind is KeyboardInterrupt:  # nobody waits for workers: those of this process end with it
            self.pop_all()
        return super().__exit__(kind, *rest)

    def summary(self) -> str:
        """Return a line on the cells so far: how many, how many a minute, and their bytes both ways."""
        rate, count = 60 * self._cells / max(monotonic() - self._since, 1e-3), max(self._cells, 1) * 1e6
        workers = f"{len(self._workers)} worker{'s' * (len(self._workers) != 1)}"
        return (
            f"{self._cells} cells on {workers}: {rate:.3g} a minute, {self._there / count:.3g} MB a cell there and"
            f" {self._back / count:.3g} MB back, {self._connecting:.1f} s to connect"
        )

    def map(self, function: Callable[..., Any], cells: Iterable[dict[str, Any]]) -> Iterator[tuple[Any, Files]]:
        """Yield what `function(output, **arguments)` returns for each of `cells`, in order, and the files that it
        leaves in the empty folder `output`, by relative path, without those that are as they came. Arguments are JSON,
        and paths at any depth of files and folders, which travel. Cells that nobody takes any more are dropped. Raises
        GffeError if a worker's program differs, and if workers or the scheduler are lost."""
        name, running = f"{function.__module__}:{function.__qualname__}", deque()
        for arguments in cells:
            most = 2 * max(sum(self._client.nthreads().values()), 1)
            while len(left := [one for one in running if not one.done()]) >= most:
                with self._client.as_current():
                    self._dask.wait(left, return_when="FIRST_COMPLETED")
            running.append(self._submit(name, arguments))
            while running and running[0].done():
                yield self._taken(running.popleft())
        while running:
            yield self._taken(running.popleft())

    def _submit(self, name: str, arguments: dict[str, Any]) -> Any:
        used: dict[str, Any] = {}

        def as_sent(path: Path) -> dict[str, str]:
            place = os.path.abspath(path) + os.sep * path.is_dir()
            if place not in self._sent:  # a task of its own: another worker does it again if the one that has it dies
                packed = packed_files(Path(place))
                self._there += sum(map(len, packed.values()))
                self._sent[place] = self._client.submit(dict, packed, pure=False)
            used[place] = self._sent[place]
            return {_PATH: place}

        text = json.dumps(arguments, default=as_sent)
        self._sent, self._there = used, self._there + len(text)
        return self._client.submit(_on_worker, program(), self._client.id, name, text, used, pure=False)

    def _taken(self, future: Any) -> tuple[Any, Files]:
        try:
            text, made, worker = future.result()
        except (self._dask.KilledWorker, self._dask.CancelledError) as error:
            raise GffeError(f"--scheduler: its workers are lost, {type(error).__name__} (their logs say why)") from None
        except (ImportError, AttributeError) as error:
            raise GffeError(f"--scheduler: {error} on a worker (expected gffe-cl {program()} there)") from None
        self._cells, self._back = self._cells + 1, self._back + len(text) + sum(map(len, made.values()))
        self._workers.add(worker)
        return json.loads(text), made


def _on_worker(expected: str, run: str, name: str, text: str, sent: dict[str, Files]) -> tuple:
    """Compute a cell. Return the document in JSON, the files, and the address of this worker."""
    from distributed import get_worker

    if program() != expected:
        raise GffeError(f"--scheduler: a worker has gffe-cl {program()} (expected {expected}, as here)")
    with _one_at_a_time, TemporaryDirectory(prefix="gffe-") as output:
        for key in set(_copies) - {run + path for path in sent}:
            _copies.pop(key).cleanup()
        places = {path: _copy(run, path, packed) for path, packed in sent.items()}
        arguments = json.loads(text, object_hook=lambda found: places[found[_PATH]] if _PATH in found else found)
        document = resolve_name(name)(Path(output), **arguments)
        came = [item for packed in sent.values() for item in packed.items()]
        made = dict(item for item in packed_files(Path(output)).items() if item not in came)
    return json.dumps(document), made, get_worker().address


def _copy(run: str, path: str, packed: Files) -> Path:
    """Return this process's copy of a file, or of a folder, whose path ends in "/"."""
    name = Path(path).name
    if run + path not in _copies:
        _copies[run + path] = TemporaryDirectory(prefix="gffe-")
        unpack(packed, Path(_copies[run + path].name, name if path.endswith(os.sep) else ""))
    return Path(_copies[run + path].name, name)


def program() -> str:
    """Return the version of this program, with a hash of everything in it that results depend on."""
    return f"{__version__} ({package_digest()[:12]})"
