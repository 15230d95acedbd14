"""Handlers of SIGINT, SIGTERM and SIGHUP: one way out for all of them. The module imports nothing heavy, because it
must be there first."""

from __future__ import annotations

import atexit
import os
import select
import signal
import sys
import threading

INTERRUPTED = 130
_KINDS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_GRACE = 3.0  # seconds: one signal ends every command within five


class Interrupts:
    """Context in which the first of these signals raises KeyboardInterrupt in the main thread, so that the command can
    keep what is finished. The second, or the end of `_GRACE`, ends the process at once. Before `begin` nothing can be
    lost, so the first signal does, because libraries convert exceptions while they are loaded.

    Python handles signals between its own instructions only, and a call into a library may never return. So on POSIX a
    thread waits for the signals, too. Signals that the process was started to ignore stay ignored.

    `received`: whether one came; `told`: whether the user knows of it.
    """

    def __init__(self):
        self.received = self.told = self._working = False
        self._before: dict = {}
        self._ending = threading.RLock()

    def begin(self) -> None:
        self._working = True

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for kind in _KINDS:
                if signal.getsignal(kind) is not signal.SIG_IGN:
                    self._before[kind] = signal.signal(kind, self._receive)
            if os.name == "posix":
                end, self._pipe = os.pipe()
                os.set_blocking(self._pipe, False)
                signal.set_wakeup_fd(self._pipe, warn_on_full_buffer=False)
                threading.Thread(target=self._wait, args=(end,), name="gffe-signals", daemon=True).start()
        return self

    def __exit__(self, *_) -> None:
        if self.received:  # the process ends
            atexit.register(lambda: [signal.signal(kind, signal.SIG_DFL) for kind in self._before])
        elif self._before:
            if os.name == "posix":
                signal.set_wakeup_fd(-1)
                os.close(self._pipe)
            for kind, handler in self._before.items():
                signal.signal(kind, handler)

    def _receive(self, kind, frame) -> None:
        if self.received or not self._working:
            self._end()
        self.received = True
        sys.unraisablehook = lambda _: None  # of half-built objects, and of this interrupt in a destructor
        raise KeyboardInterrupt

    def _wait(self, pipe: int) -> None:
        """End the process by the second signal of which Python writes the number into `pipe`, or after the grace."""
        kinds = b""
        while len(kinds) < 1 + self._working:
            if kinds and not select.select([pipe], [], [], _GRACE)[0]:
                break
            arrived = os.read(pipe, 1)
            if not arrived:
                os.close(pipe)
                return
            kinds += arrived if arrived[0] in self._before else b""
        self._end()

    def _end(self) -> None:
        with self._ending:  # by one thread
            if not self.told:
                os.write(2, b"interrupted\n")
            os._exit(INTERRUPTED)
