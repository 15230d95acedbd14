"""Rendered frames on the device without the stage `upload`."""

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.rendered_frame import HostArrays
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.buffers import DeviceFrame


def copy_to(device: Device, frame: DeviceFrame, arrays: HostArrays) -> None:
    """Copy arrays in device layout into the buffers of `frame`, as they are."""
    for buffer, array in zip(frame.buffers, (arrays.color, arrays.depth, arrays.motion), strict=True):
        cl.enqueue_copy(device.queue, buffer, array)


def read_back(device: Device, frame: DeviceFrame, width: int, height: int) -> HostArrays:
    """Return copies of the buffers of `frame`, of images of this size."""
    shapes = ((height, width, 4), np.float16), ((height, width), np.float32), ((height, width, 2), np.float32)
    arrays = HostArrays(*(np.empty(shape, dtype) for shape, dtype in shapes))
    for buffer, array in zip(frame.buffers, (arrays.color, arrays.depth, arrays.motion), strict=True):
        cl.enqueue_copy(device.queue, array, buffer)
    return arrays
