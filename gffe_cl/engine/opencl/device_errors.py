"""Explanation of a device's failure to the user: no memory left, or lost (reset, unplugged, driver gone)."""

from __future__ import annotations

from collections.abc import Callable

import pyopencl as cl

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import Device, forget_opened

_CODES = cl.status_code
_MEMORY = {
    _CODES.MEM_OBJECT_ALLOCATION_FAILURE, _CODES.OUT_OF_RESOURCES, _CODES.OUT_OF_HOST_MEMORY,
    _CODES.INVALID_BUFFER_SIZE,
}  # fmt: skip


class device_faults:
    """Turns driver errors within its block `work` into a GffeError of one line with a remedy. `footprint` is the text
    about sizes and memory."""

    def __init__(self, device: Device, work: str, footprint: Callable[[], str]):
        self.device, self.work, self.footprint = device, work, footprint

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, cl.Error):
            return
        device, work, footprint = self.device, self.work, self.footprint
        forget_opened(device)
        advice = (
            "is out of memory, or lost (expected smaller images, fewer background levels, or less else on it)"
            if error.code in _MEMORY
            else "is lost, or its driver has failed (expected it to answer)"
        )
        reason = " ".join(str(error).split())[:120]
        raise GffeError(
            f"{device.info.name}: {work} failed: {reason}; {footprint()}: the device {advice};"
            " open the device and a new pipeline to go on"
        ) from error
