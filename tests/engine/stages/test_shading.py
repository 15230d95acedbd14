"""Inputs of the shading correction, and the focus mask."""

import numpy as np
import pyopencl as cl
import pytest
import twins
from twin_cases import CASES

from gffe_cl.engine.stages.base import Board
from gffe_cl.engine.stages.buffers import Sizes
from gffe_cl.engine.stages.frame_block import reprojection
from gffe_cl.engine.stages.shading import FocusMask
from gffe_cl.lab.metrics import focus_mask, smape

SIZES = [(61, 37), (64, 48), (1, 5), (7, 1), (1, 1)]


def on_device(device, array):
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    return cl.Buffer(device.context, flags, hostbuf=np.ascontiguousarray(array))


def half4(rgb):
    return np.concatenate([rgb, np.zeros((*rgb.shape[:2], 1))], -1).astype(np.float16)


def focus(device, color, truth, dynamic, exposure):
    height, width = dynamic.shape
    board = Board(device, Sizes((width, height), (width, height)))
    board.frame.upload("color", half4(color))
    board.frame.upload("dynamic", np.ascontiguousarray(dynamic))
    stage = FocusMask(board)
    stage.make(on_device(device, half4(truth)), exposure)
    return stage.read("focus_truth")


@pytest.mark.parametrize("case", [name for name in CASES if name.startswith("default")], indirect=True)
def test_inputs_equal_their_twin(case):
    """The mask exactly; the warped frame t−1 as far as halves are rounded from positions good to 1/1000 px."""
    past = case.past
    to_previous = reprojection(case.to, past.camera)
    previous, mask = twins.prepare_inputs(case.after(None), case.now.motion, past.color, past.depth, to_previous)
    assert np.array_equal(case.read("shading", "input_mask"), mask)
    np.testing.assert_allclose(case.read("shading", "warped_previous"), previous, rtol=2e-3, atol=1e-3)
    assert 0.5 < previous[..., 3].mean() < 1


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("exposure", [1.0, 0.07])
def test_focus_mask_equals_its_twin(device, size, exposure):
    rng = np.random.default_rng(3)
    shape = (size[1], size[0], 3)
    color = rng.lognormal(-1, 2, shape)
    truth = color * rng.lognormal(0, 1.5, (*shape[:2], 1))
    for array in (color, truth):
        for value in (np.nan, np.inf, -np.inf, 0, -3, 60000):
            array[rng.integers(shape[0]), rng.integers(shape[1]), rng.integers(3)] = value
    dynamic = (rng.random(shape[:2]) < 0.2).astype(np.uint8)
    expected = focus_mask(half4(color), half4(truth), dynamic, exposure)
    assert np.array_equal(focus(device, color, truth, dynamic, exposure), expected)
    if min(size) > 1:
        assert 0.02 < expected.mean() < 0.6


def test_focus_mask_is_where_a_shadow_has_moved(device):
    """A shadow a pixel off is forgiven, one further off is not; movers are never in focus."""
    color, truth, dynamic = np.ones((16, 32, 3)), np.ones((16, 32, 3)), np.zeros((16, 32), np.uint8)
    color[:, 8:14], truth[:, 9:15] = 0.2, 0.2
    assert smape(color, truth).max() > 0.5 and not focus(device, color, truth, dynamic, 1).any()
    truth[:, 9:15], truth[:, 12:18] = 1, 0.2
    expected = np.zeros_like(dynamic)
    expected[:, 8:11], expected[:, 14:17] = 1, 1
    assert np.array_equal(focus(device, color, truth, dynamic, 1), expected)
    dynamic[:8] = 1
    expected[:8] = 0
    assert np.array_equal(focus(device, color, truth, dynamic, 1), expected)
    assert not focus(device, color, truth, dynamic, 1e-4).any()  # too dark to see
