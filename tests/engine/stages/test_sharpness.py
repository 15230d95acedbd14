"""Sharpness of the rendered frames' edges: measured as its twin does, and worth what it should be."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import camera
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
    least = SHARPNESS.LEAST_EVIDENCE
    share = np.clip((found[0] + SHARPNESS.EXPECTED * least) / (found[1] + least), 0, SHARPNESS.SHARPEST)
    assert found[1] > 0 and stage.read("sharpness").item() == pytest.approx(share, rel=1e-5)
    pipeline.submit(next(frames(*size)))
    assert not stage.read("evidence").any() and stage.read("sharpness").item() == 0


def test_without_it_interpolation_is_as_of_sharpness_0(device):
    """The same bits, without the stage. With more only colors differ, for the dilated warp, too."""
    options = Options.preset("performance", shading_correction=False)
    made = []
    for sharpness in (None, 0.0, 1.5):
        pipeline = Pipeline(device, 96, 54, replace(options, sharpness=sharpness is not None))
        for frame in frames(96, 54):
            pipeline.submit(frame)
        assert ("sharpness" in pipeline.stages) == (sharpness is not None)
        if sharpness is not None:
            pipeline.stages["sharpness"].upload("sharpness", np.array([sharpness], np.float32))
        new = pipeline.extrapolate(camera(96, 54, (0.35, 0.07, 0.6), 0.075, 0.045, 0.035), frame.time + 0.02)
        made.append([new.numpy(name).tobytes() for name in ("color", "depth", "motion", "filled_by")])
    without, of_none, of_more = made
    assert without == of_none
    assert of_more[0] != of_none[0] and of_more[1:] == of_none[1:]
