"""Surfaces, as links between pixels: the kernel against its twin, for all numbers of lanes and images smaller than a
lane's reach."""

import numpy as np
import pyopencl as cl
import pytest
from twins.common import invalid, kernel_constants

from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.frame_block import FRAME
from gffe_cl.engine.stages.warp import Connectivity

SURFACES, STATES = kernel_constants("connectivity.cl"), kernel_constants("background.cl")
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # right, down, left, up: bits 1, 2, 4, 8
SIZES = [(1, 1), (2, 5), (8, 1), (13, 9), (16, 12), (61, 37)]


def _shifted(image, dx, dy, fill):
    """Return image[y + dy, x + dx], `fill` outside."""
    height, width = image.shape[:2]
    out = np.full_like(image, fill)
    ys, xs = slice(max(-dy, 0), height - max(dy, 0)), slice(max(-dx, 0), width - max(dx, 0))
    yd, xd = slice(max(dy, 0), height + min(dy, 0)), slice(max(dx, 0), width + min(dx, 0))
    if ys.start < ys.stop and xs.start < xs.stop:
        out[ys, xs] = image[yd, xd]
    return out


def link_surfaces(depth, dynamic):
    links = np.zeros(depth.shape, np.uint8)

    def is_plane(a2, a, b, most):
        off = np.abs((a2 - a) * b - (a - b) * a2)
        return (a2 > 0) & (a2 < np.inf) & (off < SURFACES.SURFACE_CURVATURE * most * a2)

    for bit, (dx, dy) in enumerate(_STEPS):
        a2, a = _shifted(depth, -dx, -dy, np.nan), depth
        b, b2 = _shifted(depth, dx, dy, np.nan), _shifted(depth, 2 * dx, 2 * dy, np.nan)
        with np.errstate(all="ignore"):
            most = np.where(a > b, a, b)
            near = np.abs(a - b) <= SURFACES.SURFACE_STEP * most
            near |= is_plane(a2, a, b, most) | is_plane(b2, b, a, most)
            same = (a > 0) & (b > 0) & np.where(most < np.inf, near, a == b)
        links |= (same & (_shifted(dynamic, dx, dy, 2) == dynamic)).astype(np.uint8) << bit
    return links


def unmixed(depth, dynamic):
    """Return (H, W) uint8: 1 where depth is valid and no pixel of 3×3 is dynamic or nearer."""
    keep = ~invalid(depth)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            with np.errstate(invalid="ignore"):
                nearer = _shifted(depth, dx, dy, np.inf) < depth * SURFACES.MIXES_IN
            keep &= ~(_shifted(dynamic, dx, dy, 0) > 0) & ~nearer
    return keep.astype(np.uint8)


def shown_state(depth, dynamic):
    """Return (H, W) uint8: the state of level 0 before anything is remembered; only what is beside movers is open."""
    static = unmixed(np.where(invalid(depth), np.nan, np.float32(1)), dynamic) > 0
    return np.where(unmixed(depth, dynamic) > 0, STATES.SHOWN, np.where(static, STATES.EDGE, STATES.EMPTY)).astype(
        np.uint8
    )


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
        depth = uneven_depth(rng, width, height)
        dynamic = (rng.random((height, width)) < 0.02 * (k > 1)).astype(np.uint8)
        given = {"depth": uploaded(device, depth), "dynamic_mask": uploaded(device, dynamic)}
        state, keys = np.full(depth.size, 7, np.uint8), np.zeros(depth.size, np.uint64)
        written = {"levels_state": uploaded(device, state), "keys": uploaded(device, keys)}
        given |= written | {"winners": uploaded(device, keys), "last_stir": uploaded(device, keys)}
        stage.launch("find_links", frame=uploaded(device, block), **given)
        cl.enqueue_copy(device.queue, state, written["levels_state"])
        cl.enqueue_copy(device.queue, keys, written["keys"])
        assert np.array_equal(stage.read("links"), link_surfaces(depth, dynamic)), k
        assert np.array_equal(state, shown_state(depth, dynamic).ravel()), k
        emptied = keys.view(np.uint32 if len(stage.passes) > 1 else np.uint64)[: state.size]
        assert (~emptied[state == 0] == 0).all()
