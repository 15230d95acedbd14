"""Sharpness of the rendered frames' edges: what interpolation makes of it."""

from dataclasses import replace

import numpy as np
from synthetic import camera
from twin_cases import frames

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline


def test_without_it_interpolation_is_as_of_sharpness_0(device):
    """The same bits, without the stage. With more only colors differ, for the dilated warp, too."""
    options = Options.preset("performance", shading_correction=False)
    made = []
    for sharpness in (None, 0.0, 1.5):
        pipeline = Pipeline(device, 96, 54, replace(options, sharpness=sharpness is not None))
        for frame in frames(96, 54):
            pipeline.submit(frame)
        if sharpness is not None:
            pipeline.stages["history"].upload("sharpness", np.array([sharpness], np.float32))
        new = pipeline.extrapolate(camera(96, 54, (0.35, 0.07, 0.6), 0.075, 0.045, 0.035), frame.time + 0.02)
        made.append([new.numpy(name).tobytes() for name in ("color", "depth", "motion", "filled_by")])
    without, of_none, of_more = made
    assert without == of_none
    assert of_more[0] != of_none[0] and of_more[1:] == of_none[1:]
