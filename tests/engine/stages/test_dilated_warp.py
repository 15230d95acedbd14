"""Dilated warp: what the preset that uses it promises."""

import numpy as np
from synthetic import Rect, Rects, camera
from twin_cases import run

from gffe_cl.engine.options import PRESETS, Options
from gffe_cl.engine.pipeline.outputs import stages_of
from gffe_cl.engine.pipeline.pipeline import Pipeline

OPTIONS = Options.preset("performance")


def test_a_still_frame_keeps_its_bits(device, lanes):
    case = run(device, 61, 37, OPTIONS, spoil=False)
    pipeline, now = Pipeline(device, 61, 37, OPTIONS), case.now
    pipeline.submit(now)
    made = pipeline.extrapolate(now.camera, now.time)
    assert np.array_equal(made.numpy("color")[..., :3], now.color[..., :3].astype(np.float16))


WALL = Rect((0, 0, 10), frequency=0, tint=(0.1, 0.2, 0.6))


def half_a_frame_later(device, rects, speed=0.0, samples=1):
    """The frame after four rendered ones, and its true color; the camera slides to the right with `speed`."""
    scene, size, previous = Rects(rects), (96, 64), None
    pipeline = Pipeline(device, *size, OPTIONS)
    for time in np.arange(4) / 30:
        seen = camera(*size, (speed * time, 0, 0))
        pipeline.submit(scene.frame(seen, time, *size, previous, reset=previous is None, samples=samples))
        previous = (seen, time)
    seen = camera(*size, (speed * 3.5 / 30, 0, 0))
    return pipeline.extrapolate(seen, 3.5 / 30), scene.color(seen, 3.5 / 30, *size, samples)


def test_a_mover_that_has_gone_is_not_shown_again(device):
    """Behind a mover that leaves a bar, the bar's motion leads to the mover as it was: a second outline."""
    bar = Rect((0, 0, 4), (0.05, 3), frequency=0)
    mover = Rect((-2, 0, 6), (1, 1), velocity=(30, 0, 0), frequency=0, tint=(0.6, 0.3, 0.1))
    made, truth = half_a_frame_later(device, [WALL, mover, bar])
    repeated = (made.numpy("color")[..., 0] > 0.3) & (truth[..., 2] > 0.5)
    assert repeated.sum() <= 2 * 24  # columns and rows: 5 columns without the mover's own motion


def test_an_outline_that_has_gone_is_not_repeated(device):
    """What a near post uncovers comes from beside the post as it was, where antialiased colors hold some of it."""
    post = Rect((0, 0, 2), (0.3, 3), frequency=0, tint=(0.6, 0.3, 0.1))
    made, truth = half_a_frame_later(device, [WALL, post], speed=10, samples=4)
    uncovered = (made.numpy("disoccluded") == 1) & (truth[..., 2] > 0.58)
    assert uncovered.sum() > 300
    assert (made.numpy("color")[uncovered, 0] > 0.13).sum() <= 5  # a column of 64 pixels without the step aside


def test_stages_that_add_to_footprints_are_left_out():
    """... and none of them is missed by a stage that stays."""
    names = [stage.name for stage in stages_of(OPTIONS)]
    assert "dilated_warp" in names and not {"warp", "background", "silhouettes", "holes", "connectivity"} & {*names}
    assert "dilated_warp" not in [stage.name for stage in stages_of(Options())]
    assert PRESETS["performance"].values["warp"] == "dilated"
