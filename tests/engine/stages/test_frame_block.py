"""The frame block on the device: what its kernel writes is what the host says."""

import numpy as np
import pyopencl as cl
from twin_cases import run

from gffe_cl.engine.options import Options
from gffe_cl.engine.stages.base import Step
from gffe_cl.engine.stages.frame_block import FRAME


def test_kernel_writes_the_block(device):
    """Every byte but padding, of the rendered frame and of the new one; members are where frame.h has them."""
    case = run(device, 24, 18, Options(shading_correction=False))
    board = case.pipeline.board
    for slot, camera in (("rendered", None), ("new", case.to)):
        step = Step(board.bindings.rendered, board.bindings.previous, [0.1, 0.06], camera, 0.12, 0.6)
        given = np.frombuffer(bytes(step.block(board)), FRAME)[0]
        written = np.zeros(1, FRAME)
        board.blocks.set(step)
        cl.enqueue_copy(board.device.queue, written, board.blocks.buffer[slot])
        board.blocks.forget()
        for name in FRAME.names:
            assert written[0][name].tobytes() == given[name].tobytes(), (slot, name)
        sizes = {
            f"{grid}_{side}": n
            for grid in ("source", "target")
            for side, n in zip(("width", "height"), board.sizes.of(grid), strict=True)
        }
        assert {name: int(written[0][name]) for name in sizes} == sizes
