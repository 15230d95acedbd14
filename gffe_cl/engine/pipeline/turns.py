"""Calls of a pipeline: one thread at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from threading import RLock

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import device_fault


class Turns:
    """Turns of the threads that use a pipeline. A call while another thread calls is refused; nothing ever waits for a
    call. A read that finishes a frame waits for the call of another thread, and calls wait for such a read, because
    frames may be read on any thread."""

    def __init__(self):
        self.calling, self.working = RLock(), RLock()

    def read(self, finish: Callable[[], None]) -> None:
        """Run `finish` when no other thread works."""
        with self.working:
            finish()


def pipeline_call(method: Callable) -> Callable:
    """Return `method`, of an object with `device`, `turns` and `_footprint()`, for one thread at a time: it raises
    GffeError while another thread is in such a method, in a forked child, and where the device fails."""
    name = method.__name__.strip("_")

    @wraps(method)
    def wrapped(self, *arguments, **more):
        if not self.turns.calling.acquire(blocking=False):
            raise GffeError(
                f"{name}: another thread is using this pipeline (expected one thread at a time, which may hand it over"
                " between calls, or a pipeline for each)"
            )
        try:
            self.device.require_process()
            with self.turns.working:
                return method(self, *arguments, **more)
        except cl.Error as error:
            raise device_fault(self.device, name, self._footprint, error) from error
        finally:
            self.turns.calling.release()

    return wrapped
