"""Handlers of SIGINT, SIGTERM and SIGHUP: one way out for all of them. The module imports nothing heavy, because it
must be there first."""

from __future__ import annotations

import _thread
import atexit
import os
import signal
import sys
import threading
import time

INTERRUPTED = 130
_KINDS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_PATIENCE = 3
_SOON = 0.02  # seconds


class Interrupts:
    """Context in which the first of these signals raises KeyboardInterrupt in the main thread, the second is ignored so
    that the current work can finish, and the third ends the process. Before `begin` nothing can be lost, so the first
    signal ends the process, because libraries convert exceptions while they are loaded.

    Python handles signals between its own instructions only, and a call into a library may never return. So on POSIX a
    thread counts the signals as they arrive, and ends the process itself.

    `received` counts them. Signals that the process was started to ignore stay ignored.
    """

    def __init__(self):
        self.received = 0
        self._working = False
        self._before: dict = {}
        self._arrived = 0  # signals that the thread has counted
        self._pipe: tuple[int, int] | None = None
        self._ending = threading.Lock()

    def begin(self) -> None:
        self._working = True

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for kind in _KINDS:
                if signal.getsignal(kind) is not signal.SIG_IGN:
                    self._before[kind] = signal.signal(kind, self._receive)
            self._hook, sys.unraisablehook = sys.unraisablehook, self._unraisable
            if os.name == "posix":
                self._pipe = os.pipe()
                os.set_blocking(self._pipe[1], False)
                signal.set_wakeup_fd(self._pipe[1], warn_on_full_buffer=False)
                threading.Thread(target=self._count, args=self._pipe[:1], name="gffe-signals", daemon=True).start()
        return self

    def __exit__(self, *_) -> None:
        if not self._before:
            return
        sys.unraisablehook = self._hook
        if self._pipe:
            signal.set_wakeup_fd(-1)
            os.close(self._pipe[1])
        for kind, handler in self._before.items():
            signal.signal(kind, handler)
        atexit.register(_end_quietly, tuple(self._before))

    def _receive(self, kind, frame) -> None:
        self.received += 1
        self._end_if_due(self.received)
        if self.received == 1:
            raise KeyboardInterrupt

    def _count(self, pipe: int) -> None:
        """Count the signals that arrive, whose numbers Python writes into `pipe`, until that is closed."""
        while arrived := os.read(pipe, 1):
            if arrived[0] in self._before:
                self._arrived += 1
                self._end_if_due(self._arrived)
        os.close(pipe)

    def _end_if_due(self, count: int) -> None:
        if not self._working or count >= _PATIENCE:
            if not self._ending.acquire(blocking=False):  # the other thread does it
                time.sleep(1)
                return
            os.write(2, b"interrupted\n")
            os._exit(INTERRUPTED)

    def _unraisable(self, unraisable) -> None:
        """Raise an interrupt again soon if it came in a destructor or a library's callback, where it cannot
        propagate. Other complaints after an interrupt come from half-built objects."""
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            if not self.received:
                self._hook(unraisable)
            return
        self.received = self._arrived = 0
        again = threading.Timer(_SOON, _interrupt, (next(iter(self._before)),))
        again.daemon = True
        again.start()


def _interrupt(kind) -> None:
    """Interrupt the process as if the signal had come from outside: a call that waits ends, too."""
    if hasattr(signal, "pthread_kill"):
        main = threading.main_thread().ident
        assert main is not None  # it runs
        signal.pthread_kill(main, kind)
    else:
        _thread.interrupt_main(kind)


def _end_quietly(kinds) -> None:
    """Suppress messages while Python ends."""
    for kind in kinds:
        signal.signal(kind, signal.SIG_DFL)
