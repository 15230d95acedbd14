"""Color code: the kernel against its twin."""

import numpy as np
import twins
from twins.warp import codes_of


def test_kernel_equals_its_twin(case):
    """NaN, infinities and negative colors included; in linear light the code is the color."""
    codes, color = case.read("color_code", "codes")[..., :3], case.now.color
    # A root that the device rounds otherwise may end in the next half.
    np.testing.assert_allclose(codes.astype(np.float32), codes_of(color).astype(np.float32), rtol=1e-3, atol=1e-7)
    assert (codes.view(np.uint16) == codes_of(color).view(np.uint16)).mean() > 0.999
    assert np.isfinite(codes).all() and (codes < 0).any() and not np.isfinite(color).all()
    if case.options.resampling == "linear":
        assert np.array_equal(codes, twins.load_color(color).astype(np.float16))
