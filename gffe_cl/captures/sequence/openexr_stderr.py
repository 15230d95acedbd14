"""Calls of the OpenEXR library without its messages on standard error.

It prints to Python's standard output and, from C, to descriptors 1 and 2, and has no option against it. On Linux a
thread can have descriptors of its own. The library works on such a thread, while those of the process stay unchanged
for drivers and all other threads. Elsewhere its output from C reaches the console.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

_CLOSE_RANGE, _UNSHARE = 436, 2  # Linux: the system call, the same on every processor, and its flag
_FIRST, _LAST = 3, 2**32 - 1
_MOST_BYTES = 1 << 16
_OF_LIBRARY = re.compile(rb"^ojph [^\n]*\n?", re.MULTILINE)  # its output through C's standard output
_PREFIX = re.compile(r"^.*?: \(EXR_ERR_\w+\) |^ojph \w+ \w+ at [^:]*:\d+: |^Warning: .* - ")


def quietly(work: Callable[[], Any]) -> Any:
    """Return the result of `work`. Its exceptions pass; the first line that the library printed meanwhile is their
    note.

    `work` must leave no file open, and return nothing that has one: its number would mean another file elsewhere.
    """
    call = _Call(work)
    thread = threading.Thread(target=call.run, name="gffe-exr")
    thread.start()
    thread.join()
    if call.of_others:
        with suppress(OSError):
            os.write(1, call.of_others)
    if call.error is not None:
        raise call.error
    return call.result


class _Call:
    def __init__(self, work: Callable[[], Any]):
        self._work, self._printed = work, []
        self.result, self.error = None, None
        self.of_others = b""  # from the buffer of C's standard output, which all threads share

    def run(self) -> None:
        _flush()
        files = _own_descriptors()
        _stdout.enter(self._printed)
        try:
            self.result = self._work()
        except BaseException as error:
            error.__traceback__ = error.__context__ = None  # its frames keep objects of `work` alive
            self.error = error
        finally:
            _stdout.leave()
            _flush()
            out, err = map(_read, files)
            self.of_others = _OF_LIBRARY.sub(b"", out)
            lines = (err.decode("utf-8", "replace") + "".join(self._printed)).splitlines()
            if self.error is not None and lines:
                self.error.add_note(_PREFIX.sub("", lines[0]))


def _own_descriptors() -> tuple[int | None, int | None]:
    """Give this thread file descriptors of its own. Return the files behind 1 and 2, None if the system cannot do
    it."""
    if not sys.platform.startswith("linux") or not hasattr(os, "memfd_create"):
        return None, None
    # All others are closed, so that files closed by the process are really closed, locks and pipes above all.
    if ctypes.CDLL(None).syscall(_CLOSE_RANGE, _FIRST, ctypes.c_uint(_LAST), _UNSHARE):
        return None, None
    try:
        out, err = os.memfd_create("gffe-exr"), os.memfd_create("gffe-exr")
    except OSError:  # in sandboxes, and on old kernels
        return None, None
    os.dup2(out, 1)
    os.dup2(err, 2)
    return out, err


def _read(file: int | None) -> bytes:
    """Return the beginning of the messages in `file`."""
    return b"" if file is None else os.pread(file, _MOST_BYTES, 0)


def _flush() -> None:
    with suppress(OSError, ValueError, TypeError):  # where C's library calls it otherwise
        library = ctypes.CDLL(None)
        library.fflush(ctypes.c_void_p.in_dll(library, "stdout"))


class _Stdout:
    """Python's standard output without the output of threads that are within the context."""

    def __init__(self):
        self._lock, self._threads = threading.Lock(), {}
        self._real: Any = None  # while it stands in

    def enter(self, printed: list[str]) -> None:
        with self._lock:
            if not self._threads:
                self._real, sys.stdout = sys.stdout, self
            self._threads[threading.get_ident()] = printed

    def leave(self) -> None:
        with self._lock:
            del self._threads[threading.get_ident()]
            if not self._threads and sys.stdout is self:
                sys.stdout = self._real

    def write(self, text: str) -> int:
        printed = self._threads.get(threading.get_ident())
        if printed is None:
            return self._real.write(text)
        printed.append(text)
        return len(text)

    def __getattr__(self, name: str):
        return getattr(self._real, name)


_stdout = _Stdout()
