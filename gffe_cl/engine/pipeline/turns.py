"""Calls of a pipeline: one thread at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import device_fault


def pipeline_call(method: Callable) -> Callable:
    """Return `method`, of an object with `device`, `turn` (a lock) and `_footprint()`, for one thread at a time: it
    raises GffeError while another thread is in such a method, in a forked child, and where the device fails."""
    name = method.__name__.strip("_")

    @wraps(method)
    def wrapped(self, *arguments, **more):
        if not self.turn.acquire(blocking=False):
            raise GffeError(
                f"{name}: another thread is using this pipeline (expected one thread at a time, which may hand it over"
                " between calls, or a pipeline for each)"
            )
        try:
            self.device.require_process()
            return method(self, *arguments, **more)
        except cl.Error as error:
            raise device_fault(self.device, name, self._footprint, error) from error
        finally:
            self.turn.release()

    return wrapped
