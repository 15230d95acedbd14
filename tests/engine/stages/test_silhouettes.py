"""Soft silhouettes: what they change, and that it is right."""

from dataclasses import replace

import numpy as np
from synthetic import Rect, Rects, camera

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline

W, H, FINER = 64, 48, 8
SCENE = Rects(
    [
        Rect((0, 0, 12), (12, 9), frequency=0.4, tint=(0.3, 0.5, 0.9)),
        Rect((-0.6, 0.3, 6), (0.7, 1.1), velocity=(7, 2, 0), frequency=0.5, tint=(1, 0.4, 0.1)),
    ]
)


def antialiased(k, previous):
    """Frame k: color is the mean over each pixel, depth and motion are those at its center."""
    before = None if previous is None else (camera(W, H), previous)
    return SCENE.frame(camera(W, H), k / 30, W, H, before, reset=previous is None, samples=FINER)


def extrapolated(device, options):
    pipeline = Pipeline(device, W, H, replace(options, shading_correction=False))
    for k in range(4):
        pipeline.submit(antialiased(k, (k - 1) / 30 if k else None))
    pipeline.extrapolate(camera(W, H), 3.5 / 30)
    return pipeline


def test_edges_are_the_truths(device):
    """Edges of a mover are at most half as wrong, and nothing else changes."""
    hard, soft = (extrapolated(device, Options(soft_silhouettes=on)) for on in (False, True))
    truth = antialiased(3.5, None).color.astype(np.float32)[..., :3]
    coverage = soft.stages["silhouettes"].read("coverage")
    for name in ("depth", "motion", "dynamic", "disoccluded", "filled_by"):
        assert soft.board.frame.read(name).tobytes() == hard.board.frame.read(name).tobytes()
    colors = [p.board.frame.read("color")[..., :3].astype(np.float32) for p in (hard, soft)]
    assert np.array_equal(colors[0][coverage == 0], colors[1][coverage == 0])
    assert 0.02 < (coverage > 0).mean() < 0.2 and ((coverage > 60) & (coverage < 200)).sum() > 20
    errors = [np.square(color - truth)[coverage > 0].mean() for color in colors]
    assert errors[1] < 0.5 * errors[0]


def test_what_moves_along_stays_as_it_is(device):
    """Nothing parts where nothing moves: the frame is the rendered one, bit for bit."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    frame = antialiased(0, None)
    pipeline.submit(frame)
    pipeline.extrapolate(camera(W, H), 0.5 / 30)
    assert not pipeline.stages["silhouettes"].read("layer").any()
    assert pipeline.board.frame.read("color")[..., :3].tobytes() == np.ascontiguousarray(frame.color[..., :3]).tobytes()
