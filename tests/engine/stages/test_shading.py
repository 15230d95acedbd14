"""Inputs of the shading correction."""

import numpy as np
import pytest
import twins
from twin_cases import CASES

from gffe_cl.engine.stages.frame_block import reprojection


@pytest.mark.parametrize("case", [name for name in CASES if name.startswith("default")], indirect=True)
def test_inputs_equal_their_twin(case):
    """The mask exactly; the warped frame t−1 as far as halves are rounded from positions good to 1/1000 px."""
    past = case.past
    to_previous = reprojection(case.to, past.camera)
    previous, mask = twins.prepare_inputs(case.after(None), case.now.motion, past.color, past.depth, to_previous)
    assert np.array_equal(case.read("shading", "input_mask"), mask)
    np.testing.assert_allclose(case.read("shading", "warped_previous"), previous, rtol=2e-3, atol=1e-3)
    assert 0.5 < previous[..., 3].mean() < 1
