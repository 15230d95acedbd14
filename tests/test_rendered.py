"""Stages of a rendered frame, bit for bit, for all numbers of lanes and images smaller than a lane's reach."""

import numpy as np
import pyopencl as cl
import pytest
import twins

from gffe_cl.buffers import Sizes
from gffe_cl.stage import Board
from gffe_cl.stages.surfaces import Surfaces

SIZES = [(1, 1), (2, 5), (8, 1), (13, 9), (16, 12), (61, 37)]


@pytest.fixture(params=[8, 1])
def lanes(request, device, monkeypatch):
    monkeypatch.setitem(device.__dict__, "lanes", request.param)


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
def test_surfaces(device, lanes, size):
    """Where depth jumps, and where it does not."""
    width, height = size
    rng = np.random.default_rng(width)
    board = Board(device, Sizes(size, size))
    stage = Surfaces(board)
    for k in range(4):
        depth = uneven_depth(rng, width, height)
        dynamic = (rng.random((height, width)) < 0.02 * (k > 1)).astype(np.uint8)
        given = {"depth": uploaded(device, depth), "dynamic_mask": uploaded(device, dynamic)}
        stage.launch("find_surfaces", **given)
        assert np.array_equal(stage.read("links"), twins.link_surfaces(depth, dynamic)), k
        assert np.array_equal(stage.read("unmixed"), twins.unmixed(depth, dynamic)), k
