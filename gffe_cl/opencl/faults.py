"""What a device that fails at work means to the user: no memory left, or lost (reset, unplugged, driver gone)."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import pyopencl as cl

from gffe_cl.errors import GffeError

_MEMORY = {
    cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE, cl.status_code.OUT_OF_RESOURCES, cl.status_code.OUT_OF_HOST_MEMORY,
    cl.status_code.INVALID_BUFFER_SIZE,
}  # fmt: skip


def explains_device_faults(method: Callable) -> Callable:
    """For methods of what has a `device` and a `_footprint` (a text that names sizes and memory): errors of the driver
    become a GffeError that says so, and what to do."""

    @wraps(method)
    def wrapped(self, *arguments, **more):
        try:
            return method(self, *arguments, **more)
        except cl.Error as error:
            what = f"{self.device.info.name}: {method.__name__.strip('_')} failed: {_reason(error)}"
            advice = (
                "is out of memory, or lost (expected smaller images, fewer background levels, or less on the device)"
                if error.code in _MEMORY
                else "is lost, or its driver has failed (expected it to answer)"
            )
            raise GffeError(
                f"{what}; {self._footprint}: the device {advice}; open the device and a new pipeline to go on"
            ) from error

    return wrapped


def _reason(error: cl.Error) -> str:
    return " ".join(str(error).split())[:120]
