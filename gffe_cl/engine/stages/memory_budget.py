"""Memory budget: whether a pipeline fits on a device, checked before allocation because some drivers promise more
memory than they have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import KEPT_BYTES_PER_PIXEL
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.buffers import Sizes

_SURELY = 1024  # bytes per pixel that suffice for any options: only larger sizes are checked in detail
_TRIAL = 256  # pixels along the longer side of the images by which memory is estimated
_MARGIN = 0.97  # of the size that would fit: sides are rounded


class NoRoomError(GffeError):
    """Error for images that do not fit on the device, as estimated before anything is allocated."""


def require_room(device: Device, sizes: Sizes, allocated_for: Callable[[Sizes], int]) -> None:
    """Raise a NoRoomError that names a size that fits, unless images of `sizes` fit on the device. `allocated_for`
    returns the bytes of all buffers for other sizes."""
    pixels = _pixels(sizes)
    if pixels * _SURELY <= device.memory:
        return
    shrink = _TRIAL / max(*sizes.source, *sizes.target)
    trial = replace(sizes, source=_scaled(sizes.source, shrink), target=_scaled(sizes.target, shrink))
    frames = KEPT_BYTES_PER_PIXEL * math.prod(sizes.source)
    before = device.allocated
    needed = allocated_for(trial) * pixels / _pixels(trial) + frames
    device.allocated = before  # the trial's memory is free again
    if needed <= device.memory:
        return
    width, height = _scaled(sizes.target, _MARGIN * math.sqrt(device.memory / needed))
    fits = f"expected at most about {width}×{height} of this shape with these options"
    raise NoRoomError(f"pipeline: {footprint(device, sizes, needed)} ({fits})")


def footprint(device: Device, sizes: Sizes, nbytes: float | None) -> str:
    """Return the sizes of the images in words, and the share of the device's memory that they take, as far as that is
    known."""
    through = f" (rendered {sizes.source[0]}×{sizes.source[1]})" if sizes.source != sizes.target else ""
    takes = "" if nbytes is None else f" takes {_size(nbytes)}"
    return f"{sizes.target[0]}×{sizes.target[1]}{through}{takes} of the {_size(device.memory)} of {device.info.name}"


def _pixels(sizes: Sizes) -> int:
    return max(math.prod(sizes.source), math.prod(sizes.target))


def _scaled(size: tuple[int, int], factor: float) -> tuple[int, int]:
    width, height = (max(int(side * factor), 1) for side in size)
    return width, height


def _size(nbytes: float) -> str:
    return f"{nbytes / 2**30:.1f} GiB" if nbytes >= 2**30 else f"{nbytes / 2**20:.0f} MiB"
