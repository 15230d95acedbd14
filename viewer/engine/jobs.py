"""Background work: jobs on a thread of their own, and values that are made there; and leaving it at the end."""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
import threading
import weakref
from collections import deque
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, Protocol

_PATIENCE = 5.0  # seconds that the end of the program waits for jobs under way, and then for those that it gives up
_all: weakref.WeakSet[Jobs] = weakref.WeakSet()


class Jobs:
    """Runs jobs one after the other on a thread, which starts with the first of them and keeps no program alive."""

    def __init__(self, name: str):
        self._name = name
        self._news = threading.Condition()
        self._jobs: deque[tuple[Future, Callable, tuple]] = deque()
        self._thread: threading.Thread | None = None
        self._closing = self._at_work = False
        _all.add(self)

    @property
    def busy(self) -> bool:
        """Whether a job is under way or waits."""
        return self._at_work or bool(self._jobs)

    def run(self, job: Callable[..., Any], *arguments: Any, soon: bool = False) -> Future:
        """Run a job, `soon`: before those that wait. What it returns or raises is in the Future."""
        future: Future = Future()
        with self._news:
            if self._closing:
                future.cancel()
                return future
            (self._jobs.appendleft if soon else self._jobs.append)((future, job, arguments))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=f"gffe-viewer-{self._name}", daemon=True)
                self._thread.start()
            self._news.notify()
        return future

    def close(self) -> None:
        """End the thread after the job that is under way, which is not waited for. Jobs that wait are canceled."""
        with self._news:
            self._closing = True
            for future, *_ in self._jobs:
                future.cancel()
            self._news.notify()

    def give_up(self) -> None:
        """End the job that is under way with SystemExit, as soon as it is in Python again."""
        if self._thread is not None and self._thread.ident is not None:
            thread, error = ctypes.c_ulong(self._thread.ident), ctypes.py_object(SystemExit)
            ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, error)

    def join(self) -> None:
        """Wait for a thread that is ending, but not for ever."""
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    def _run(self) -> None:
        while True:
            with self._news:
                self._at_work = False
                while not self._jobs and not self._closing:
                    self._news.wait()
                if self._closing:
                    return
                self._at_work = True
                future, job, arguments = self._jobs.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                made = job(*arguments)
            except BaseException as error:  # whatever a binary package throws
                future.set_exception(error)
            else:
                future.set_result(made)


class Derived:
    """A value that follows from what is shown; it is made in the background, for what was asked for last, before jobs
    that wait."""

    def __init__(self, background: Jobs):
        self._background = background
        self._future: Future | None = None
        self._wanted = self._coming = self._made = None  # their keys
        self._value: Any = None
        self.error: BaseException | None = None

    @property
    def ready(self) -> bool:
        """Whether the last value is the one that was asked for last."""
        return self._made is not None and self._made == self._wanted

    def get(self, key: Hashable, make: Callable[..., Any], *arguments: Any) -> Any:
        """Return the last value; None without one, and where `make` failed: `error` is why. If it is not that of `key`,
        `make` is called for it as soon as nothing else is being made."""
        self._wanted = key
        future = self._future
        if future is not None and future.done():
            self._future, self._made = None, self._coming
            self.error = future.exception()
            self._value = future.result() if self.error is None else None
        if self._future is None and key != self._made:
            self._coming = key
            self._future = self._background.run(make, *arguments, soon=True)
        return self._value

    def forget(self) -> None:
        """Drop the value, and the one that is being made."""
        self._future = self._wanted = self._made = self._value = self.error = None


@atexit.register
def _end() -> None:
    """End all threads before the interpreter stops them: within a binary package that is a crash."""
    for end in (Jobs.close, Jobs.join, Jobs.give_up, Jobs.join):
        for background in list(_all):
            end(background)


class Leavable(Protocol):
    """Work that `close` stops; `left_working`: the device is at work although it was called."""

    @property
    def left_working(self) -> bool: ...

    def close(self) -> None: ...


@contextmanager
def leaving(work: Leavable) -> Iterator[None]:
    """Close `work` at the end. If the device is still busy, end the program without shutting down the OpenCL
    runtime, which would abort or hang: with exit code 0, or as `gffe` does after the exception."""
    code = 2
    try:
        yield
        code = 0
    except KeyboardInterrupt:
        code = 130
        raise
    finally:
        work.close()
        threading.excepthook = lambda _: None  # of threads that the interpreter takes down in the midst of their work
        if work.left_working:
            atexit.register(_exit, code)


def _exit(code: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
