"""A background thread for jobs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class Worker:
    """Runs the jobs from `take`, one after the other, on a thread that starts with the first job.

    Parameters
    ----------
    name : str
        Of the thread.
    take : callable
        The next job, or None if there is none now; called with `lock` held.
    do : callable
        Does a job; called without the lock. It must not raise.

    Attributes
    ----------
    lock : threading.Condition
        Guards what the thread and others share.
    """

    def __init__(self, name: str, take: Callable[[], Any], do: Callable[[Any], None]):
        self.lock = threading.Condition()
        self._name, self._take, self._do = name, take, do
        self._thread: threading.Thread | None = None
        self._closing = False

    def wake(self) -> None:
        """Signal a new job; call it with the lock held."""
        if self._thread is None and not self._closing:
            self._thread = threading.Thread(target=self._run, name=f"gffe-viewer-{self._name}", daemon=True)
            self._thread.start()
        self.lock.notify()

    def close(self) -> None:
        """End the thread after the job that is under way; does not wait for it."""
        with self.lock:
            self._closing = True
            self.lock.notify()

    def _run(self) -> None:
        while True:
            with self.lock:
                job = None
                while not self._closing and (job := self._take()) is None:
                    self.lock.wait()
                if self._closing:
                    return
            self._do(job)
