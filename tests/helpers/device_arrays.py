"""Rendered frames on the device without the stage `upload`."""

import pyopencl as cl

from gffe_cl.engine.frame.rendered_frame import HostArrays
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.buffers import DeviceFrame


def copy_to(device: Device, frame: DeviceFrame, arrays: HostArrays) -> None:
    """Copy arrays in device layout into the buffers of `frame`, as they are."""
    for buffer, array in zip(frame.buffers, (arrays.color, arrays.depth, arrays.motion), strict=True):
        cl.enqueue_copy(device.queue, buffer, array)
