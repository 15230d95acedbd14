"""Filling of holes: what fills which hole."""

import numpy as np
from moving_scene import MOVING, WALL, H, W, dolly, submit
from synthetic import Rect, Rects, camera

from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline


def test_holes_are_filled_with_surroundings(device):
    """Everything is finite, filled pixels are tagged, and carry the motion of a static point at their depth."""
    pipeline = Pipeline(device, W, H)
    submit(pipeline, MOVING, [dolly(k) for k in range(3)], [0, 1 / 30, 2 / 30])
    end = camera(W, H, (1.5, 0, 0.3), 0.2)
    out = pipeline.extrapolate(end, 2.5 / 30)
    holes = out.numpy("disoccluded") == 1
    filled_by = out.numpy("filled_by")[holes]
    assert np.isin(filled_by, (1, 255)).all() and (filled_by == 255).mean() > 0.9
    assert np.isfinite(out.numpy("color")).all() and (out.numpy("depth") > 0).all()
    assert (out.numpy("color")[holes] > 0.05).all() and (out.numpy("depth")[holes] < 20).all()
    y, x = np.mgrid[:H, :W] + 0.5
    px = np.stack([x, y], -1)
    source = dolly(2).project(end.unproject(px, out.numpy("depth")))[0]
    assert np.abs(out.numpy("motion") - (source - px))[holes].max() < 1e-2


def test_holes_below_the_horizon_are_not_sky(device):
    """A mover leaves a place that is half ground, half sky: each pixel shows the one that it is closer to."""
    ground = Rect((0, 10, 8), (99, 10), frequency=0.2, tint=(0.9, 0.2, 0.1))  # y down: below the middle row
    mover = Rect((0.6, 0, 3), (0.4, 0.6), velocity=(-24, 0, 0), tint=(0.1, 0.1, 0.9))
    still, pipeline = camera(W, H), Pipeline(device, W, H, Options(levels=0))
    submit(pipeline, Rects([ground, mover]), [still] * 2, [0, 1 / 30])
    out = pipeline.extrapolate(still, 1.5 / 30)
    hole, depth = out.numpy("filled_by") == 255, out.numpy("depth")
    truth = Rects([ground]).frame(still, 0, W, H).depth
    near = hole & np.isfinite(truth)
    assert near.sum() > 10 and (hole & ~near).sum() > 10
    assert (np.isfinite(depth) == np.isfinite(truth))[hole].mean() > 0.9
    np.testing.assert_allclose(depth[near & np.isfinite(depth)], 8, rtol=1e-3)


def test_slit_between_a_bar_and_a_mover_shows_what_is_behind_them(device):
    """The hole between them meets nothing else: it is the wall's, which is seen beyond them."""
    bar, mover = Rect((-0.1, 0, 4), (0.1, 3)), Rect((-0.4, 0, 5), (0.2, 3), velocity=(9, 0, 0))
    options = Options(levels=0, hidden_parts=False, reappearing=False)
    still, pipeline = camera(W, H), Pipeline(device, W, H, options)
    submit(pipeline, Rects([Rect((0, 0, 10)), bar, mover]), [still] * 3, [0, 1 / 30, 2 / 30])
    out = pipeline.extrapolate(still, 2.5 / 30)
    hole, columns = out.numpy("filled_by") == 255, np.nonzero(out.numpy("depth")[0] < 6)[0]
    assert hole.sum() >= H and not hole[:, : columns[0]].any() and not hole[:, columns[-1] :].any()
    np.testing.assert_allclose(out.numpy("depth")[hole], 10, rtol=1e-3)


def test_mover_at_the_border_does_not_go_on_beyond_it(device):
    """What the camera carries along stands at the border, as the pillar of a cab: out of screen is the wall behind."""
    speed = 60
    cameras = [camera(W, H, (speed * k / 30, 0, 0)) for k in range(4)]
    wall = Rect((0, 0, 10), (99, 99), tint=(0.2, 0.6, 0.2))
    pillar = Rect((2.25, 0, 2), (1, 3), velocity=(speed, 0, 0), tint=(0.9, 0.1, 0.1))
    pipeline = Pipeline(device, W, H)
    submit(pipeline, Rects([wall, pillar]), cameras[:3], [0, 1 / 30, 2 / 30])
    out = pipeline.extrapolate(cameras[3], 3 / 30)
    hole, color, depth = out.numpy("filled_by") == 255, out.numpy("color"), out.numpy("depth")
    assert hole.sum() > 10 * H and (color[hole][:, 1] > color[hole][:, 0]).all()
    assert (np.abs(depth - 10) < 0.1)[hole].mean() > 0.99


def test_surface_that_ends_does_not_go_on_into_a_hole(device):
    """A board ended in view before a wall, which then hides behind it: beyond the board is the wall all the same."""
    cameras = [camera(W, H, (2 - k, 0, 0), 0.15 * (k - 2)) for k in range(4)]
    board = Rect((-96.15, 0, 5), (99, 99))
    pipeline = Pipeline(device, W, H)
    submit(pipeline, Rects([Rect((0, 0, 20), (99, 99)), board]), cameras[:3], [0, 1 / 30, 2 / 30])
    out = pipeline.extrapolate(cameras[3], 3 / 30)
    hole, depth = out.numpy("filled_by") == 255, out.numpy("depth")
    assert hole.sum() > 10 * H and (depth[hole] > 18).mean() > 0.7


def test_turning_away_fills_everything(device):
    """Nothing of the rendered frame is in view: the frame is filled all the same, without NaN."""
    pipeline = Pipeline(device, W, H)
    submit(pipeline, MOVING, [dolly(0), dolly(1)], [0, 1 / 30])
    out = pipeline.extrapolate(camera(W, H, yaw=np.pi), 1.5 / 30)
    assert (out.numpy("disoccluded") == 1).all()
    color = out.numpy("color")
    assert np.isfinite(color).all() and (color > 0.01).all()
    assert np.isfinite(out.numpy("motion")).all()


def test_labels_tell_holes_that_are_filled_from_those_that_are_not(device):
    """255 is hole filling; 253 is nothing, where holes stay."""
    turned = camera(W, H, yaw=0.5)
    for filling, label in (("far-side", 255), ("downsample", 255), ("none", 253)):
        pipeline = Pipeline(device, W, H, Options(hole_filling=filling))
        submit(pipeline, Rects([WALL]), [camera(W, H)] * 2, [0, 1 / 30])
        out = pipeline.extrapolate(turned, 1.5 / 30)
        holes = out.numpy("disoccluded") == 1
        assert holes.sum() > 500 and set(np.unique(out.numpy("filled_by")[holes])) == {label}
        assert (out.numpy("color")[holes].max() == 0) == (filling == "none")
