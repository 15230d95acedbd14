"""Colors times a number, at an exposure that is as much smaller, give the same picture times that number."""

from dataclasses import replace

import numpy as np
import pytest
from moving_scene import MOVING, H, W, dolly
from synthetic import camera

from gffe_cl import Options, Pipeline
from gffe_cl.engine.options import HOLE_FILLINGS

SCALE = 16  # a power of 4: also its root changes exponents only
GAE = Options(shading_correction=False)
OPTIONS = {
    **{filling: replace(GAE, hole_filling=filling) for filling in HOLE_FILLINGS},
    "upscaling": replace(GAE, upscale=2.0),
    "performance": Options.preset("performance"),
}


def made(device, options, scale):
    pipeline = Pipeline(device, W, H, options, render_size=(W // 2, H // 2) if options.upscale > 1 else None)
    pipeline.exposure = 0.7 / scale
    for k in range(3):
        before = (dolly(k - 1), (k - 1) / 30) if k else None
        frame = MOVING.frame(dolly(k), k / 30, *pipeline.sizes.source, before, reset=k == 0)
        pipeline.submit(replace(frame, color=np.float16(scale * np.float16(frame.color))))
    new = pipeline.extrapolate(camera(W, H, (1.5, 0, 0.3), 0.2), 2.5 / 30)
    assert (new.numpy("filled_by") > 0).mean() > 0.01
    return new.numpy("color").astype(np.float32)


@pytest.mark.device
@pytest.mark.parametrize("options", OPTIONS)
def test_the_scale_of_colors_does_not_matter(device, options):
    """Up to the rounding of dark colors, which halves hold less exactly."""
    one, scaled = (made(device, OPTIONS[options], scale) for scale in (1, SCALE))
    np.testing.assert_allclose(scaled / SCALE, one, rtol=1e-3, atol=1e-6)
