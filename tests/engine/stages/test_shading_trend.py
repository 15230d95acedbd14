"""The trend of shading: what it says of lights that go on, and of those that do not."""

from dataclasses import replace

import numpy as np
import pytest
from scn_models import FOR_GOOD, IN_PLACE, constant_model
from synthetic import Rect, Rects, camera
from twins import doubled

from gffe_cl import Options, Pipeline
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.stages.base import Step

LOOKED_AT = Options(shading_inputs=True, shading_correction=False)
WALL = Rects([Rect((0, 0, 8), (40, 40), frequency=0.5)])
SIZE = (136, 104)
LASTING = [*IN_PLACE, FOR_GOOD]


def lit_frames(levels, size=SIZE):
    """A wall under a camera that turns a little; its light has these strengths, one after another."""
    previous = None
    for k, level in enumerate(levels):
        seen = camera(*size, (0.05 * k, 0, 0), yaw=0.01 * k)
        frame = WALL.frame(seen, k / 30, *size, previous, reset=k == 0)
        previous = (seen, k / 30)
        color = (np.asarray(frame.color, np.float32)[..., :3] * level).astype(np.float16)
        yield RenderedFrame(color, frame.depth, frame.motion, seen, frame.time, reset=k == 0)


def trends_of(device, levels, alpha=0.5, exposure=1.0):
    """(8, h, w) after the last of these frames."""
    pipeline = Pipeline(device, *SIZE, LOOKED_AT)
    pipeline.exposure = exposure
    for frame in lit_frames(levels):
        pipeline.submit(frame)
    pipeline.extrapolate(time=frame.time + alpha / 30)
    width, height = SIZE[0] // 4, SIZE[1] // 4
    return pipeline.stages["shading_trend"].read("trends")[:, :height, :width]


@pytest.mark.parametrize("size", [(136, 104), (61, 37), (9, 70), (1, 1)])
def test_a_few_samples_that_change_are_noise(device, size):
    """More than eight in one tile of 4×4 cells are not; tiles at the border have fewer cells."""
    pipeline = Pipeline(device, *size, LOOKED_AT)
    pipeline.submit(next(lit_frames([1.0], size)))
    stage, step = pipeline.stages["shading_trend"], Step(pipeline.frames.current, None, [0.0])
    height, width = shape = stage.read("changed_samples").shape
    for corner in {(0, 0), (height - 1, width - 1), (min(3, height - 1), min(4, width - 1))}:
        samples, (top, left) = np.zeros(shape, np.uint8), (4 * (side // 4) for side in corner)
        samples[::4, ::4] = 8  # in each other tile
        samples[top : top + 4, left : left + 4] = 0
        for many in (8, 9):
            samples[corner] = many
            stage.upload("changed_samples", samples)
            stage.upload("changed", np.zeros(1, np.int32))  # as measure_changes leaves it
            stage.launch("find_trend", step)
            assert stage.read("changed") == (many == 9)


def test_a_light_that_fades_goes_on(device):
    """By the same factor per interval: encoded color, a logarithm, changes by α of what it did before."""
    levels = [1.0, 0.9, 0.81, 0.729]
    for exposure in (1.0, 0.1):
        for alpha in (0.25, 1.0):
            said = trends_of(device, levels, alpha, exposure)[:, 6:-6, 6:-6]
            assert said[6].min() > 0.9
            slope = np.log(0.9) / np.log1p(5000)
            most = 0.15 if exposure == 1 else 0.45  # dark color is encoded less than logarithmically
            for part in (said[:3], said[3:6]):
                np.testing.assert_allclose(part.mean(), alpha * slope, rtol=most)


def test_trends_tell_a_flicker_from_a_fade(device):
    """What comes and goes has the opposite sign in the interval before; what stays as it is has none."""
    flicker = trends_of(device, [1.0, 0.7, 1.0, 0.7])[:, 4:-4, 4:-4]
    assert flicker[:3].max() < -0.005 and flicker[3:6].min() > 0.005
    assert np.abs(trends_of(device, [1.0, 1.0, 1.0, 1.0])[:6]).max() < 2e-3


def test_without_an_interval_before_there_is_no_trend_of_it(device):
    said = trends_of(device, [1.0, 0.8])[:, 4:-4, 4:-4]
    assert said[:3].max() < -0.001 and not said[3:6].any()
    assert not trends_of(device, [1.0])[:3].any()


def test_a_reset_leaves_no_trend(device):
    """Of neither interval; then each is known when it has passed."""
    pipeline = Pipeline(device, *SIZE, LOOKED_AT)
    known = []
    for k, frame in enumerate(lit_frames([1.0, 0.5, 0.25, 0.2, 0.1, 0.05])):
        pipeline.submit(replace(frame, reset=k in (0, 3), motion=None if k == 3 else frame.motion))
        pipeline.extrapolate()
        said = pipeline.stages["shading_trend"].read("trends")
        known.append((bool(said[:3].any()), bool(said[3:6].any())))
    assert known[:3] == [(False, False), (True, False), (True, True)]
    assert not known[3][0] and known[4:] == [(True, False), (True, True)]


def test_colors_that_make_no_sense_change_nothing_else(device):
    """NaN, infinities and black: finite everywhere."""
    pipeline = Pipeline(device, *SIZE, LOOKED_AT)
    for frame in lit_frames([1.0, 0.9, 0.8]):
        frame.color[::3, ::5] = np.nan
        frame.color[1::7, ::3] = np.inf
        frame.color[2::7] = 0
        pipeline.submit(frame)
    pipeline.extrapolate()
    assert np.isfinite(pipeline.stages["shading_trend"].read("trends")).all()


# ---- networks --------------------------------------------------------------------------------------------


def test_a_network_gets_trends_and_they_last_as_it_says(device, tmp_path):
    """They are among its candidates; with a judgement that they go on for good the frame takes all of them."""
    pipeline = Pipeline(
        device, *SIZE, Options(scn_model=constant_model(tmp_path / "m.onnx", judgement=LASTING, trend=1))
    )
    for frame in lit_frames([1.0, 0.9, 0.81]):
        pipeline.submit(frame)
    made = pipeline.extrapolate()
    gae, final = made.numpy("gae").astype(np.float32), made.numpy("color").astype(np.float32)  # the network is done
    trends, candidates = (
        pipeline.stages[stage].read(name)
        for stage, name in (("shading_trend", "trends"), ("shading_flow", "candidates"))
    )
    assert np.array_equal(candidates[8:11], 4 * trends[:3])
    shown = np.stack([doubled(plane) for plane in trends[:3]])
    correction = pipeline.stages["correction"].read("correction")
    trusted = correction[4] > 0
    assert trusted.mean() > 0.5
    np.testing.assert_allclose(correction[:3, trusted], shown[:, trusted], atol=1e-6)
    assert (final[20:-20, 20:-20, 0] < gae[20:-20, 20:-20, 0]).mean() > 0.99
