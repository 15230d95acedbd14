"""Soft silhouettes: what they change, and that it is right."""

from dataclasses import replace

import numpy as np
import twins
from synthetic import Rect, Rects, camera

from gffe_cl.engine.opencl.program import constants
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.background import REMEMBERED

W, H, FINER = 64, 48, 8
SCENE = Rects(
    [
        Rect((0, 0, 12), (12, 9), frequency=0.4, tint=(0.3, 0.5, 0.9)),
        Rect((-0.6, 0.3, 6), (0.7, 1.1), velocity=(7, 2, 0), frequency=0.5, tint=(1, 0.4, 0.1)),
    ]
)


FASTER = Rects(
    [
        Rect((0, 0, 12), (12, 9), frequency=1, tint=(0.3, 0.5, 0.9)),
        Rect((-0.6, 0.3, 6), (0.7, 1.1), velocity=(14, 4, 0), frequency=0.1, tint=(1, 0.4, 0.1)),
    ]
)


def antialiased(k, previous, scene=SCENE):
    """Frame k: color is the mean over each pixel, depth and motion are those at its center."""
    before = None if previous is None else (camera(W, H), previous)
    return scene.frame(camera(W, H), k / 30, W, H, before, reset=previous is None, samples=FINER)


def extrapolated(device, options, scene=SCENE):
    pipeline = Pipeline(device, W, H, replace(options, shading_correction=False))
    for k in range(4):
        pipeline.submit(antialiased(k, (k - 1) / 30 if k else None, scene))
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


def test_texture_behind_stays_in_place(device):
    """Where the rendered frame shows the far layer it is taken from the exact place: at pixels that had mixed with the
    mover, for which the warp shows a neighbor's color, and under the mover's own edge."""
    hard, soft = (extrapolated(device, Options(soft_silhouettes=on), FASTER) for on in (False, True))
    truth = antialiased(3.5, None, FASTER).color.astype(np.float32)[..., :3]
    errors = [np.square(p.board.frame.read("color")[..., :3].astype(np.float32) - truth).mean(-1) for p in (hard, soft)]
    coverage = soft.stages["silhouettes"].read("coverage")
    mixed = coverage == 1
    covered = (soft.board.frame.read("depth") < 9) & (coverage > 1) & (coverage < 230)
    assert mixed.sum() > 20 and covered.sum() > 20
    assert errors[1][mixed].mean() < 0.5 * errors[0][mixed].mean()
    assert errors[1][covered].mean() < 0.21 * errors[0][covered].mean()


def test_what_moves_along_stays_as_it_is(device):
    """Nothing parts where nothing moves: the frame is the rendered one, bit for bit."""
    pipeline = Pipeline(device, W, H, Options(shading_correction=False))
    frame = antialiased(0, None)
    pipeline.submit(frame)
    pipeline.extrapolate(camera(W, H), 0.5 / 30)
    assert not pipeline.stages["silhouettes"].read("layer").any()
    assert pipeline.board.frame.read("color")[..., :3].tobytes() == np.ascontiguousarray(frame.color[..., :3]).tobytes()


def test_remembered_colors_unmix(device):
    """Where the background remembers what a mover is about to cover, the mover's share is taken out better."""
    wall = Rects([Rect((0, 0, 12), (12, 9), frequency=4, tint=(0.3, 0.5, 0.9))])
    both = Rects([*wall.rects, Rect((-0.6, 0.3, 6), (0.7, 1.1), velocity=(7, 2, 0), frequency=3, tint=(1, 0.4, 0.1))])
    fewer, more = (extrapolated(device, Options(levels=levels), both) for levels in (0, 1))
    remembered = more.stages["background"].read("state_0") == REMEMBERED
    far = remembered & (more.stages["silhouettes"].read("layer") == constants("silhouettes.cl")["FAR"])
    truth = np.clip(twins.codes_of(antialiased(3, None, wall).color).astype(np.float32), 0, None)
    errors = [np.square(p.stages["silhouettes"].read("behind")[..., :3] - truth)[far].mean() for p in (fewer, more)]
    assert errors[1] < 0.3 * errors[0]
