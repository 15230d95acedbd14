"""SIGINT, SIGTERM and SIGHUP: one way out for all of them. Imports nothing heavy: it must be there first."""

from __future__ import annotations

import _thread
import atexit
import os
import signal
import sys
import threading

INTERRUPTED = 130
_KINDS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_PATIENCE = 3
_SOON = 0.02  # seconds


class Interrupts:
    """Context in which the first of these signals raises KeyboardInterrupt in the main thread, the second is ignored so
    that the current work can finish, and the third ends the process. Before `begin` nothing can be lost, so the first
    signal ends the process, because libraries convert exceptions while they are loaded.

    `received` counts them. Signals that the process was started to ignore stay ignored.
    """

    def __init__(self):
        self.received = 0
        self._working = False
        self._before: dict = {}

    def begin(self) -> None:
        self._working = True

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for kind in _KINDS:
                if signal.getsignal(kind) is not signal.SIG_IGN:
                    self._before[kind] = signal.signal(kind, self._receive)
            self._hook, sys.unraisablehook = sys.unraisablehook, self._unraisable
        return self

    def __exit__(self, *_) -> None:
        if not self._before:
            return
        sys.unraisablehook = self._hook
        for kind, handler in self._before.items():
            signal.signal(kind, handler)
        atexit.register(_end_quietly, tuple(self._before))

    def _receive(self, kind, frame) -> None:
        self.received += 1
        if not self._working or self.received >= _PATIENCE:
            os.write(2, b"interrupted\n")
            os._exit(INTERRUPTED)
        if self.received == 1:
            raise KeyboardInterrupt

    def _unraisable(self, unraisable) -> None:
        """Raise an interrupt again soon if it came in a destructor or a library's callback, where it cannot
        propagate. Other complaints after an interrupt come from half-built objects."""
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            if not self.received:
                self._hook(unraisable)
            return
        self.received = 0
        again = threading.Timer(_SOON, _interrupt, (next(iter(self._before)),))
        again.daemon = True
        again.start()


def _interrupt(kind) -> None:
    """As if the signal had come from outside: a call that waits ends, too."""
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
