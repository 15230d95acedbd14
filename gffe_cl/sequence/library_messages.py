"""What the OpenEXR library says on the console, for our own messages.

It has no way to be told where to: it prints to Python's standard output and, from C, to file descriptor 2. Both are
diverted while a file is being read or written on any thread; whatever others print meanwhile is passed on.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

_STDERR = 2
_MOST_BYTES = 1 << 20


@contextmanager
def library_messages(path: Path) -> Iterator[list[str]]:
    """The lines that the library prints about the file `path` in this block, complete when it is left; the first one
    says most."""
    messages: list[str] = []
    _listener.enter(str(path), messages)
    try:
        yield messages
    finally:
        _listener.leave()


@dataclass
class _Caller:
    """A thread that is in the library."""

    path: str
    messages: list[str]
    printed: str = ""  # to Python's standard output, in pieces of lines


class _Listener:
    def __init__(self):
        self._lock = threading.Lock()
        self._threads: dict[int, _Caller] = {}
        self._stdout: _Stdout | None = None
        self._file: int | None = None  # takes the place of descriptor 2
        self._stderr: int | None = None  # a copy of descriptor 2 as it was, while it is diverted
        self._passed = 0  # bytes of the file that have been looked at

    def enter(self, path: str, messages: list[str]) -> None:
        with self._lock:
            if not self._threads:
                self._divert()
            self._threads[threading.get_ident()] = _Caller(path, messages)

    def leave(self) -> None:
        with self._lock:
            last = len(self._threads) == 1
            if last:
                self._restore()
            self._sort(last)
            caller = self._threads.pop(threading.get_ident())
            caller.messages += caller.printed.splitlines()

    def take(self, text: str) -> bool:
        """Whether this was printed by the library on the present thread."""
        caller = self._threads.get(threading.get_ident())
        if caller is None:
            return False
        caller.printed += text
        return True

    def _divert(self) -> None:
        self._stdout = sys.stdout = _Stdout(sys.stdout)
        with suppress(OSError):  # no standard error at all
            if self._file is None:
                self._file = _nameless_file()
            if self._passed > _MOST_BYTES:
                os.ftruncate(self._file, 0)
                self._passed = 0
            self._stderr = os.dup(_STDERR)
            os.dup2(self._file, _STDERR)

    def _restore(self) -> None:
        if sys.stdout is self._stdout:
            sys.stdout = self._stdout.real
        if self._stderr is not None:
            os.dup2(self._stderr, _STDERR)

    def _sort(self, last: bool) -> None:
        """Give each thread what is about its file, and pass on the rest."""
        if self._stderr is None:
            return
        size = os.fstat(self._file).st_size
        if size > self._passed:
            text = os.pread(self._file, size - self._passed, self._passed)
            text = text if last else text[: text.rfind(b"\n") + 1]  # the rest may not be a whole line yet
            self._passed += len(text)
            for path in {caller.path for caller in self._threads.values()}:
                pattern = re.escape(os.fsencode(path)) + rb": (?:\(EXR_ERR_\w+\) )?([^\n]*)\n"
                found = [line.decode("utf-8", "replace") for line in re.findall(pattern, text)]
                text = re.sub(pattern, b"", text)
                for caller in self._threads.values():
                    caller.messages += found if caller.path == path else ()
            with suppress(OSError):
                os.write(self._stderr, text)
        if last:
            os.close(self._stderr)
            self._stderr = None


class _Stdout:
    """Standard output without what the library prints."""

    def __init__(self, real):
        self.real = real

    def write(self, text: str) -> int:
        return len(text) if _listener.take(text) else self.real.write(text)

    def __getattr__(self, name: str):
        return getattr(self.real, name)


def _nameless_file() -> int:
    """Several threads write to it at once: each at its end."""
    descriptor, path = tempfile.mkstemp(prefix="gffe-messages-")
    os.close(descriptor)
    try:
        return os.open(path, os.O_RDWR | os.O_APPEND)
    finally:
        with suppress(OSError):
            os.unlink(path)


_listener = _Listener()
