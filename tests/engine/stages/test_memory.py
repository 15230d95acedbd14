"""Memory of stages: the order in which parts of lent buffers are released, and that kernels stay within it."""

from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest
from twin_cases import frames

from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.memory import LentMemory

FENCE = np.full(4096, 0xA5, np.uint8)


class Whole:
    """Stands for a buffer; notes the parts that are released."""

    def __init__(self):
        self.released = []

    def get_sub_region(self, start, nbytes):
        return SimpleNamespace(release=lambda: self.released.append((start, nbytes)))


def test_parts_are_released_in_the_reverse_of_the_order_in_which_they_were_made():
    whole, memory = Whole(), LentMemory(Sizes((64, 48), (64, 48)), {})
    wanted = [(0, 100), (40, 50), (0, 20), (10, 200)]
    kept = [memory.part(whole, *place) for place in wanted]
    assert len(kept) == 4 and whole.released == []
    memory.let_go()
    assert whole.released == wanted[::-1]


@pytest.mark.parametrize("own_lanes", [8, 1])
def test_nothing_is_written_behind_a_buffer(device, monkeypatch, own_lanes):
    """Nor by what a compiler makes of a kernel: PoCL ran code behind a barrier for items that had returned. No side
    is a multiple of a group's. Nothing is lent, because it would lie in the fences."""
    buffers, allocate = [], Device.buffer

    def with_fence(self, nbytes, mapped=False):
        buffers.append(allocate(self, nbytes + len(FENCE), mapped))
        return buffers[-1]

    monkeypatch.setitem(device.__dict__, "lanes", own_lanes)
    monkeypatch.setattr(Device, "buffer", with_fence)
    monkeypatch.setattr(LentMemory, "lend", lambda *_, **__: None)
    pipeline = Pipeline(device, 131, 75, Options(shading_correction=False))
    fenced = list(buffers)
    for buffer in fenced:
        cl.enqueue_copy(device.queue, buffer, FENCE, dst_offset=buffer.size - len(FENCE))
    for frame in frames(131, 75):
        pipeline.submit(frame)
        pipeline.extrapolate()
    found = np.empty_like(FENCE)
    for buffer in fenced:
        cl.enqueue_copy(device.queue, found, buffer, src_offset=buffer.size - len(FENCE))
        assert np.array_equal(found, FENCE)
