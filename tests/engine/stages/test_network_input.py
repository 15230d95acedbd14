"""Input of the shading correction network: the kernels against their twins."""

import numpy as np
import pytest
import twins
from device_arrays import read_back
from network_stages import SIZES, made_stages, put

from gffe_cl.engine.stages.frame_block import reprojection


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("exposure", [1.0, 0.05])
def test_network_input_equals_its_twin(device, size, exposure):
    """GAE frame and mask to the bit, the rest but for the device's division; from the same colors of t−1 as are shown
    to those who look, where 2×2 pixels are not of one surface."""
    board, _, step = made_stages(device, size, exposure)
    shading, seen = board.stages["shading"], board.stages["network_input"]
    frame = {name: board.frame.read(name) for name in ("color", "depth", "motion", "dynamic")}
    for _ in range(2):  # nothing is left over
        seen.extrapolated(step)
    shading.extrapolated(step)
    previous, mask = shading.read("warped_previous"), shading.read("input_mask")
    if min(size) > 30:
        assert 0.3 < previous[..., 3].mean() < 0.9 and set(np.unique(mask)) == {0, 0.5, 1}
    assert seen.read("median_depth") == twins.depth_median(frame["depth"])
    got = seen.read("frames")
    assert got.shape[2] % 16 == got.shape[1] % 16 == 0 and got.shape[2] >= size[0] / 2
    expected = twins.network_input(
        frame,
        previous,
        mask,
        exposure,
        seen.sizes.of("network"),
        read_back(device, board.bindings.previous, *size),
        reprojection(step.camera, board.bindings.previous.camera),
    )
    np.testing.assert_allclose(got[6], expected[6], rtol=1e-6)
    assert np.array_equal(got[[0, 1, 2, 7]], expected[[0, 1, 2, 7]])
    difference = np.abs(got - expected)[3:6]  # halves are rounded, and few quads are at the limit of a surface
    assert (difference > 1e-3).mean() < 0.006 and (difference > 1e-4).mean() < 0.02


@pytest.mark.parametrize(
    ("depth", "expected"),
    [
        (np.full(2304, np.inf), 1.0),
        (np.full(2304, 2.0), 2.0),
        (np.r_[np.full(1152, 3.0), np.full(1151, 90.0), np.inf], 3.0),
        (np.r_[np.full(1151, 3.0), np.full(1152, 90.0), np.inf], 90.0),
        (np.r_[np.full(2303, np.nan), 1e30], 1e30),
        (np.r_[np.full(2302, -1.0), 1e-30, 1e-39], 1e-39),
    ],
)
def test_median_depth(device, depth, expected):
    board, _, step = made_stages(device, (128, 108))
    stage = board.stages["network_input"]
    counted, depth = depth, np.full((108, 128), 7.0, np.float32)
    depth[1::3, 1::2] = counted.reshape(36, 64)  # only these count
    put(board.frame, depth=depth)
    stage.extrapolated(step)
    assert stage.read("median_depth") == pytest.approx(expected, rel=1 / 200, abs=1e-40)
    assert stage.read("median_depth") == twins.depth_median(depth)
