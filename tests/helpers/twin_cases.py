"""Small frames that hold everything (moving parts, sky, bad pixels), and pipelines that have seen them, for the tests
of the stages."""

from typing import NamedTuple

import numpy as np
from synthetic import Rect, Rects, camera

from gffe_cl.engine.pipeline.pipeline import Pipeline

SHARPNESS = 1.3  # of new frames, whatever was measured
SCENE = Rects(
    [
        Rect((0, 0, 12), (9, 4), frequency=0.3),
        Rect((-1, 0.5, 6), (0.8, 1.5), velocity=(9, 0, 0), frequency=1, tint=(0.7, 0.2, 0.1)),
        Rect((1.5, -0.3, 5), (0.5, 0.5), velocity=(-3, 2, -12), frequency=2, tint=(4, 5, 90)),
        Rect((-1.2, -1.2, 8), (0.6, 0.6), velocity=(-26, 0, 0), frequency=1, tint=(0.2, 0.6, 0.1)),
        Rect((0.2, 0, 4), (0.05, 3), frequency=2, tint=(0.1, 0.1, 0.1)),
        Rect((7.5, 3, 9), (2.5, 1.8), velocity=(-30, -8, 0), frequency=1, tint=(0.3, 0.3, 0.9)),  # enters
    ]
)


def time_of(k):
    """Return the time of rendered frame `k`, seconds: the first two intervals are uneven."""
    return (k - 0.3 * (k == 1)) / 30


def frames(width, height, count=4, spoil=True, scene=SCENE):
    """Yield rendered frames of a camera that moves and turns; with `spoil` some pixels are bad, and vectors noisy."""
    rng = np.random.default_rng(5)
    cameras = [
        camera(width, height, (0.1 * k, 0.02 * k, 0.15 * k), 0.02 * k, 0.004 * k * k, 0.01 * k) for k in range(count)
    ]
    previous = None
    for k in range(count):
        frame = scene.frame(cameras[k], time_of(k), width, height, previous, reset=k == 0)
        previous = (cameras[k], time_of(k))
        if spoil and k:
            for array, values in (
                (frame.depth, (np.nan, 0, -3, np.inf, 1e30)),
                (frame.motion, (np.nan, np.inf, 1e9, -1e6, 300)),
                (frame.color, (np.nan, np.inf, -np.inf, 60000, -5)),
            ):
                for value in values:
                    y, x = rng.integers(height), rng.integers(width)
                    array[y, x] = value
            frame.motion += rng.uniform(-0.01, 0.01, frame.motion.shape).astype(np.float32)
        yield frame


class Case(NamedTuple):
    """A pipeline that has made a frame, and what it was given."""

    pipeline: Pipeline
    now: object  # the rendered frames, as they were submitted
    past: object
    to: object  # camera of the new frame
    made: object


def run(device, width, height, options, int64=None, target=None, spoil=True):
    """Submit four frames and make one, with the output of every stage kept. Return a `Case`."""
    pipeline = Pipeline(device, *(target or (width, height)), options, render_size=(width, height), int64_atomics=int64)
    pipeline.keep()
    *first, past, now = frames(width, height, spoil=spoil)
    for frame in (*first, past):
        pipeline.submit(frame)
    pipeline.submit(now)
    if options.sharpness:
        pipeline.stages["history"].upload("sharpness", np.array([SHARPNESS], np.float32))
    to = camera(*(target or (width, height)), (0.35, 0.07, 0.6), 0.075, 0.045, 0.035)
    return Case(pipeline, now, past, to, pipeline.extrapolate(to, now.time + 0.02))
