"""Rendered frames on the device without the stage `upload`."""

import numpy as np
import pyopencl as cl

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.buffers import DeviceFrame


def of_arrays(color, depth, motion) -> RenderedFrame:
    """Return a frame of these arrays; its camera and time are of no use."""
    return RenderedFrame(color, depth, motion, Camera(np.eye(4), 1.0, 1.0, 0.0, 0.0), 0.0)


def copy_to(device: Device, frame: DeviceFrame, arrays: RenderedFrame) -> None:
    """Copy arrays in device layout into the buffers of `frame`, as they are."""
    for buffer, array in zip(frame.buffers, (arrays.color, arrays.depth, arrays.motion), strict=True):
        cl.enqueue_copy(device.queue, buffer, array)


def read_back(device: Device, frame: DeviceFrame, width: int, height: int) -> RenderedFrame:
    """Return copies of the buffers of `frame`, of images of this size."""
    shapes = ((height, width, 4), np.float16), ((height, width), np.float32), ((height, width, 2), np.float32)
    arrays = of_arrays(*(np.empty(shape, dtype) for shape, dtype in shapes))
    for buffer, array in zip(frame.buffers, (arrays.color, arrays.depth, arrays.motion), strict=True):
        cl.enqueue_copy(device.queue, array, buffer)
    return arrays
