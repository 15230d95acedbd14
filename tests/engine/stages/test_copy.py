"""Copies for measuring bandwidth: each kernel copies every byte, and no more."""

import numpy as np
import pyopencl as cl
import pytest

from gffe_cl.engine.opencl.program import build


@pytest.mark.parametrize(("kernel", "per_item"), [("copy_scalar", 1), ("copy_vector", 4), ("copy_run", 16 * 4)])
def test_kernels_copy(device, kernel, per_item):
    items, run = 32, 4
    given = np.random.default_rng(0).normal(size=items * per_item).astype(np.float32)
    copied = np.zeros(given.size + 16, np.float32)
    source, target = device.buffer(given.nbytes), device.buffer(copied.nbytes)
    cl.enqueue_copy(device.queue, source, given)
    cl.enqueue_copy(device.queue, target, copied)
    build(device, "copy").launch(device.queue, kernel, (items,), None, {"from": source, "to": target, "run": run})
    cl.enqueue_copy(device.queue, copied, target)
    assert copied.tobytes() == given.tobytes() + bytes(64)
