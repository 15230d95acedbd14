"""Explanation of a device's failure to the user: no memory left, or lost (reset, unplugged, driver gone)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import Device, forget_opened

_CODES = cl.status_code
_MEMORY = {
    _CODES.MEM_OBJECT_ALLOCATION_FAILURE, _CODES.OUT_OF_RESOURCES, _CODES.OUT_OF_HOST_MEMORY,
    _CODES.INVALID_BUFFER_SIZE,
}  # fmt: skip


def device_fault(device: Device, work: str, footprint: Callable[[], str], error: cl.Error) -> GffeError:
    """Return a driver's `error` in one line with a remedy, and forget the device. `footprint` is the text about sizes
    and memory."""
    forget_opened(device)
    advice = (
        "is out of memory, or lost (expected smaller images, fewer background levels, or less else on it)"
        if error.code in _MEMORY
        else "is lost, or its driver has failed (expected it to answer)"
    )
    reason = " ".join(str(error).split())[:120]
    return GffeError(
        f"{device.info.name}: {work} failed: {reason}; {footprint()}: the device {advice};"
        " open the device and a new pipeline to go on"
    )


@contextmanager
def device_faults(device: Device, work: str, footprint: Callable[[], str]) -> Iterator[None]:
    """Turn driver errors within its block `work` into `device_fault`."""
    try:
        yield
    except cl.Error as error:
        raise device_fault(device, work, footprint, error) from error
