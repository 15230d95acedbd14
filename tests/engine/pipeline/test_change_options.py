"""Options that change while a pipeline runs."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from tiny_frames import frames

from gffe_cl import GffeError, Options, Pipeline
from gffe_cl.engine.selftest import scene

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
    assert not changed.keeps_frames(options)
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


@pytest.mark.parametrize(
    ("provider", "rests"),
    [
        ("cpu", {"shading_correction": False}),
        ("opencl", {"shading_correction": False, "hidden_parts": False}),
        ("opencl", {"reappearing": False}),
    ],
)
def test_modules_rest_and_work_again(device, default_model, provider, rests):
    """Frames are kept: the same bits as of pipelines that had either options from the beginning."""
    model = default_model().with_stem("scn-int8") if provider == "opencl" else default_model()
    options = Options(scn_model=model, scn_provider=provider)
    shown, several = scene.frames(96, 54, count=6, samples=1), (options, options, replace(options, **rests))
    changed, full, less = (Pipeline(device, 96, 54, one) for one in several)
    for frame, now in zip(shown, (full, full, less, less, full, full), strict=True):
        if changed.options != now.options:
            changed.keep(["warp.color"])  # forgotten by the change
            before = device.allocated
            assert changed.keeps_frames(now.options)
            changed.change_options(now.options)
            assert device.allocated <= before and list(changed.stages) == list(now.stages)
        for pipeline in (changed, full, less):
            pipeline.submit(frame)
        assert made(changed) == made(now)
        assert [spec.name for _, spec in changed.named_buffers()] == [spec.name for _, spec in now.named_buffers()]
    for other in (replace(options, levels=1), replace(options, motion=False), replace(options, focus_mask=False)):
        assert not full.keeps_frames(other)
    assert not less.keeps_frames(options)


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
