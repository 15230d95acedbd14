"""Sharpness of the rendered frames' edges: measured as its twin does, and worth what it should be."""

import numpy as np
import pytest
from twin_cases import frames
from twins.sharpness import SHARPNESS, compare

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.frame_block import reprojection


@pytest.mark.parametrize("size", [(61, 37), (130, 83)])
def test_kernel_equals_its_twin(device, size):
    """Sums to the rounding of integers; the frame before counts less; none is kept after a reset."""
    pipeline = Pipeline(device, *size, Options(shading_correction=False))
    stage, past, expected = pipeline.stages["sharpness"], None, np.zeros(2)
    for now in frames(*size):
        pipeline.submit(now)
        if past is not None:
            dynamic = pipeline.stages["history"].read("dynamic_mask")
            to_previous = reprojection(now.camera, past.camera)
            sums = compare(now.color, now.depth, now.motion, dynamic, past.color, past.depth, to_previous)
            expected = SHARPNESS.EVIDENCE_KEPT * expected + sums
        past = now
    found = stage.read("evidence").ravel()
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)
    share = np.clip(found[0] / (found[1] + SHARPNESS.LEAST_EVIDENCE) - SHARPNESS.DOUBT, 0, SHARPNESS.SHARPEST)
    assert found[1] > 0 and stage.read("sharpness").item() == pytest.approx(share, rel=1e-5)
    pipeline.submit(next(frames(*size)))
    assert not stage.read("evidence").any() and stage.read("sharpness").item() == 0
