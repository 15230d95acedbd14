"""Input of the shading correction network: encoded color, and the median of depth."""

import numpy as np
import pytest
from network_stages import made_stages, put


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


@pytest.mark.parametrize("exposure", [1.0, 0.01, 30.0])
def test_colors_are_encoded_by_the_mu_law(device, exposure):
    board, _, step = made_stages(device, (128, 64), exposure)
    color = np.r_[0, np.logspace(-6, np.log10(65504), 2047)].astype(np.float16).reshape(32, 64)
    put(board.frame, color=np.stack([color.repeat(2, 0).repeat(2, 1)] * 4, -1))
    stage = board.stages["network_input"]
    stage.extrapolated(step)
    exact = np.log1p(5000 * exposure / 8 * color.astype(np.float64)) / np.log1p(5000)
    for plane in stage.read("frames")[:3, :32, :64]:
        np.testing.assert_allclose(plane, exact, rtol=3e-7, atol=2e-8)
