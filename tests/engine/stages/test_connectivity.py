"""Surfaces, as links between pixels: the kernel against its twin, for all numbers of lanes and images smaller than a
lane's reach."""

import numpy as np
import pyopencl as cl
import pytest
import twins

from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.connectivity import Connectivity
from gffe_cl.engine.stages.frame_block import FRAME

SIZES = [(1, 1), (2, 5), (8, 1), (13, 9), (16, 12), (61, 37)]


def uneven_depth(rng, width, height):
    """Planes, steps of depth of all sizes, sky, bad values."""
    y, x = np.mgrid[:height, :width]
    depth = (8 + 0.3 * x + 0.05 * y * rng.uniform(0, 1)) * (
        1 + rng.choice([0, 0.0195, 0.02, 0.021, 0.12], (height, width))
    )
    smooth = rng.random((height, width)) < np.where(x % 32 < 20, 0.999, 0.5)
    depth = np.where(smooth, 9 + 0.01 * y + 0.02 * x, depth).astype(np.float32)
    for value in (np.inf, np.nan, 0, -2, 1e30, 1e-30):
        depth[rng.random((height, width)) < 0.01] = value
    depth[: height // 4] = np.inf
    return depth


def uploaded(device, array):
    buffer = device.buffer(array.nbytes)
    cl.enqueue_copy(device.queue, buffer, array)
    return buffer


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_kernel_equals_its_twin(device, lanes, size):
    """Where depth jumps, and where it does not."""
    width, height = size
    rng = np.random.default_rng(width)
    board = Board(device, Sizes(size, size))
    stage = Connectivity(board)
    block = np.zeros(1, FRAME)
    block["source_width"], block["source_height"], block["has_previous"], block["collects"] = width, height, 1, 1
    for k in range(4):
        block["levels"] = 1 + k % 2
        depth = uneven_depth(rng, width, height)
        dynamic = (rng.random((height, width)) < 0.02 * (k > 1)).astype(np.uint8)
        given = {"depth": uploaded(device, depth), "dynamic_mask": uploaded(device, dynamic)}
        level1 = -(-width // 2) * -(-height // 2)
        state, keys = np.full(depth.size + level1, 7, np.uint8), np.zeros(depth.size + level1, np.uint64)
        block["level_starts"] = depth.size, state.size, state.size, state.size
        written = {"levels_state": uploaded(device, state), "keys": uploaded(device, keys)}
        given |= written | {"winners": uploaded(device, keys), "last_stir": uploaded(device, keys)}
        stage.launch("find_links", frame=uploaded(device, block), **given)
        cl.enqueue_copy(device.queue, state, written["levels_state"])
        cl.enqueue_copy(device.queue, keys, written["keys"])
        assert np.array_equal(stage.read("links"), twins.link_surfaces(depth, dynamic)), k
        assert np.array_equal(state[: depth.size], twins.shown_state(depth, dynamic).ravel()), k
        assert (state[depth.size :] == (0 if k % 2 else 7)).all()  # a single level has none below
        emptied = keys.view(np.uint32 if len(stage.passes) > 1 else np.uint64)[: state.size]
        assert (~emptied[state == 0] == 0).all() and not emptied[state == 7].any()


def test_links_of_a_pipeline_are_those_of_its_frame(case):
    links = twins.link_surfaces(case.now.depth, case.read("history", "dynamic_mask"))
    assert np.array_equal(case.read("connectivity", "links"), links)
