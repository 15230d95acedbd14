"""Options that change while a pipeline runs."""

from itertools import islice

import numpy as np
import pytest
from tiny_frames import frames

from gffe_cl import GffeError, Options, Pipeline

pytestmark = pytest.mark.device
FIRST, SECOND = Options(shading_correction=False), Options(shading_correction=False, motion=False, levels=1)


def made(pipeline):
    frame = pipeline.extrapolate()
    return [frame.numpy(name).tobytes() for name in ("color", "depth", "motion", "filled_by", "dynamic")]


@pytest.mark.parametrize("options", [SECOND, Options.preset("performance")])
def test_as_a_new_pipeline(device, options):
    """The same bits as of a pipeline that never had other options, and has seen the later frames alone."""
    shown = list(frames())
    size = shown[0].depth.shape[::-1]
    changed, fresh = Pipeline(device, *size, FIRST), Pipeline(device, *size, options)
    for frame in shown[:2]:
        changed.submit(frame)
    before = changed.extrapolate()
    kept = before.numpy("color")
    changed.change_options(options)
    assert changed.options == options
    assert np.array_equal(before.numpy("color"), kept)
    with pytest.raises(GffeError, match="submit a rendered frame first"):
        changed.extrapolate()
    for frame in shown[1:]:
        frame.time += 1.0
        changed.submit(frame)
        fresh.submit(frame)
    assert made(changed) == made(fresh)


def test_bad_pixels_are_counted_on(device):
    frame = next(frames())
    frame.color[3, 4] = np.nan
    pipeline = Pipeline(device, *frame.depth.shape[::-1], FIRST)
    pipeline.submit(frame)
    bad = pipeline.bad_pixels
    pipeline.change_options(SECOND)
    assert bad.color == 1 and pipeline.bad_pixels == bad
    pipeline.submit(frame)
    assert pipeline.bad_pixels == bad + bad


def test_no_options(device):
    frame = next(frames())
    pipeline = Pipeline(device, *frame.depth.shape[::-1], FIRST)
    for shown in islice(frames(), 2):
        pipeline.submit(shown)
    expected = made(pipeline)
    with pytest.raises(GffeError, match="change_options: options must be Options, got"):
        pipeline.change_options({"motion": False})
    assert made(pipeline) == expected
