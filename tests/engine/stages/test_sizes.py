"""Images of all small sizes, which are no multiples of what work-items and work-groups take."""

import numpy as np
import twins
from hypothesis import given, settings
from hypothesis import strategies as st

from gffe_cl import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.sampled_from([1, 7, 8, 16, 64, 127, 128, 129, 256]), st.integers(1, 70))
def test_colors_of_all_pixels_are_encoded_while_the_camera_rests(device, width, height):
    """Also in the last columns and rows, in images as wide as a work-group."""
    from synthetic import Rect, Rects, camera

    scene, still = Rects([Rect((0, 0, 12), (9, 4)), Rect((0, 0, 6), (5, 5), velocity=(9, 0, 0))]), camera(width, height)
    pipeline, previous = Pipeline(device, width, height, Options(blocks=False, cut_detection=False)), None
    for k in range(3):
        frame = scene.frame(still, k / 30, width, height, previous, reset=k == 0)
        previous = still, k / 30
        pipeline.submit(frame)
        pipeline.extrapolate(still, (k + 0.5) / 30)
    codes = pipeline.stages["color_code"].read("codes")[..., :3].astype(np.float32)
    np.testing.assert_allclose(codes, twins.codes_of(frame.color).astype(np.float32), rtol=1e-3, atol=1e-7)
