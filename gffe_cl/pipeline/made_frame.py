"""Frames that the pipeline made, on the device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import pyopencl as cl

from gffe_cl.core.validation import require_choice
from gffe_cl.frame.camera import Camera
from gffe_cl.opencl.device import Device
from gffe_cl.opencl.device_errors import device_faults
from gffe_cl.stages.buffers import EXTRAPOLATED, RGBA, Sizes

_SPECS = {spec.name: spec for spec in EXTRAPOLATED}
_LIKE = {"gae": "color"}  # what is described like another buffer


@dataclass(frozen=True)
class MadeFrame:
    """What the pipeline made, on the device: buffers that hold it until the next one is made.

    `camera` in display pixels, `time` in seconds; `color` (half ×4, linear RGB), `depth` (float, world units, +inf sky)
    and `motion` (float ×2, pixels).
    """

    camera: Camera
    time: float
    _color: cl.Buffer
    depth: cl.Buffer
    motion: cl.Buffer
    _device: Device
    _size: tuple[int, int]

    @property
    def color(self) -> cl.Buffer:
        return self._color

    def numpy(self, name: str) -> np.ndarray:
        """Copy to the host by the attribute's name: colours (H, W, 3) float16, "depth" (H, W) float32, "motion"
        (H, W, 2) float32, all others (H, W) uint8. Raises GffeError for other names, and where the device fails."""
        names = [n for n in (*_SPECS, *_LIKE) if n == "color" or n in {field.name for field in fields(self)}]
        spec = _SPECS[_LIKE.get(require_choice(name, names, "frame: name"), name)]
        out = np.empty(spec.shape(Sizes(self._size, self._size)), spec.dtype)
        with device_faults(self._device, f'reading "{name}"', lambda: f"{self._size[0]}×{self._size[1]}"):
            cl.enqueue_copy(self._device.queue, out, getattr(self, name))
        return out[..., :3] if spec.components == RGBA else out


class PresentedFrame(MadeFrame):
    """What is shown of the rendered frame at t: its display part, in display pixels; `motion` t → t−1 between the
    displayed images. The buffers are the rendered frame's own where all of it is shown."""


@dataclass(frozen=True)
class ExtrapolatedFrame(MadeFrame):
    """An extrapolated frame at t + α.

    `motion` is t + α → t, into the rendered image of t; `dynamic`, `disoccluded`, `filled_by` (uchar). `gae` is the
    colour before shading correction and overlays, the same buffer as `color` where these are off. Where the network
    works beside the device, asking for `color` waits for it.
    """

    alpha: float
    source_time: float
    dynamic: cl.Buffer
    disoccluded: cl.Buffer
    filled_by: cl.Buffer
    gae: cl.Buffer
    _finish: Callable[[], None] | None  # None: nothing waits

    @property
    def color(self) -> cl.Buffer:
        if self._finish:
            self._finish()
        return self._color
