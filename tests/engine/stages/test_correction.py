"""What the network's judgement does to the frame, and its μ-law."""

import numpy as np
import pytest
import twins
from network_stages import SIZES, made_stages, put


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("with_refined", [True, False])
def test_what_is_not_in_focus_stays_whatever_the_network_says(device, size, with_refined):
    """With NaN and infinities in its judgement, too."""
    rng = np.random.default_rng(3)
    board, correction, step = made_stages(device, size, seed=2)
    board.stages["network_input"].extrapolated(step)
    color = board.frame.read("color")
    said = rng.normal(0, 0.3, correction.spec("correction").shape(correction.sizes)).astype(np.float32)
    said[3] = rng.uniform(-0.5, 1.5, said[3].shape)
    said[4] = np.where(rng.random(said[4].shape) < 0.6, 0, rng.uniform(-0.1, 2, said[4].shape))
    for value in (np.nan, np.inf, -np.inf, 1e38):
        said[rng.integers(5), rng.integers(said.shape[1]), rng.integers(said.shape[2])] = value
    put(correction, correction=said)
    correction.with_refined = with_refined
    correction.compose(step, True)
    focus, got = correction.read("focus_mask"), correction.read("color")
    assert got[focus == 0].tobytes() == color[focus == 0].tobytes() and np.isfinite(got).all()
    if min(size) > 30:
        assert 0.1 < (focus == 0).mean() < 0.9 and (focus == 1).any()


def test_encoding_is_the_mu_law_and_decoding_its_inverse():
    """Of the twins, and so of the kernels: against float64."""
    color = np.r_[0, np.logspace(-6, np.log10(65504), 5000)].astype(np.float32)
    for exposure in (1.0, 0.01, 30.0):
        exact = np.log1p(5000 * exposure / 8 * color.astype(np.float64)) / np.log1p(5000)
        np.testing.assert_allclose(twins.encode(color, exposure), exact, rtol=3e-7, atol=2e-8)
        code = exact.astype(np.float32)
        np.testing.assert_allclose(twins.decode(code, exposure), color, rtol=3e-6, atol=1e-12)
    assert twins.decode(np.array([-1, 0, 1, 50], np.float32), 1.0) == pytest.approx([0, 0, 8, 65504])
