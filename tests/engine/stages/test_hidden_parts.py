"""What hidden parts of movers promise, where the exact answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import Rect, Rects, camera

from gffe_cl import Options, Pipeline
from gffe_cl.engine.stages.buffers import BY_HIDDEN_PART, BY_REAPPEARING

W, H = 160, 80
WALL = Rect((0, 0, 10), frequency=0.25)
MOVER = Rect((-1.2, 0, 6), (1.0, 0.6), velocity=(4, 0, 0), frequency=0.1, tint=(5, 0.1, 0.1))
BARS = [Rect((x, 0, 4), (0.05, 3), frequency=0.2, tint=(0.1, 0.1, 0.1)) for x in np.arange(-2, 2.1, 0.5)]


def last_frame(device, rects, options=None, target=(W, H), count=8):
    """(new frame at t + ½, truth there, rendered frame) of `rects` before a still camera."""
    scene, still = Rects(rects), camera(W, H)
    pipeline = Pipeline(device, *target, options, render_size=(W, H))
    previous = None
    for k in range(count):
        frame = scene.frame(still, k / 30, W, H, previous, reset=k == 0)
        pipeline.submit(frame)
        previous = (still, k / 30)
    time, to = (count - 0.5) / 30, camera(*target)
    return pipeline.extrapolate(to, time), scene.frame(to, time, *target), frame


@pytest.mark.parametrize("target", [(W, H), (W * 3 // 2, H * 3 // 2)], ids=["same size", "larger"])
def test_mover_behind_bars_is_whole(device, target):
    """What the bars hid of the mover is the mover's, with its depth and motion; what they hid of the wall is not."""
    out, truth, frame = last_frame(device, [WALL, MOVER, *BARS], target=target)
    hidden = out.numpy("filled_by") == BY_HIDDEN_PART
    mover = (truth.depth > 5) & (truth.depth < 7)
    assert hidden.sum() > 20 and (hidden & mover).sum() > 0.9 * hidden.sum()
    assert ((out.numpy("disoccluded") == 1) & mover & ~hidden).sum() < 0.2 * hidden.sum()
    inside = hidden & mover
    assert (out.numpy("color")[inside, 0] > 2).all()
    np.testing.assert_allclose(out.numpy("depth")[inside], 6, rtol=1e-3)
    y, x = np.nonzero(inside)
    at = np.stack([x, y], -1) + 0.5 + out.numpy("motion")[inside]
    shown = frame.depth[tuple(np.floor(at).astype(int).T[::-1])]
    assert np.isclose(shown, 4, rtol=0.01).mean() > 0.9  # a bar


@pytest.mark.parametrize("z, whole", [(3, True), (4.5, False)])
def test_broad_mover_that_leaves_a_post_is_whole(device, z, whole):
    """As far behind the post as it is; nearer to that it owns only what is close by, as a narrow one would."""
    mover = Rect((-2.6, 0, 6), (2.4, 0.6), velocity=(14, 0, 0), frequency=0.1, tint=(5, 0.1, 0.1))
    post = Rect((0, 0, z), (0.06 * z, 3), frequency=0.2, tint=(0.1, 0.1, 0.1))
    out, truth, _ = last_frame(device, [WALL, mover, post], count=5)
    holes = (out.numpy("disoccluded") == 1) & (truth.depth > 5) & (truth.depth < 7)
    missing = holes & (out.numpy("filled_by") != BY_HIDDEN_PART)
    assert holes.sum() > 50 and (missing.sum() < 0.1 * holes.sum()) == whole, (missing.sum(), holes.sum())


def test_mover_has_no_part_where_the_frame_before_showed_the_wall(device):
    """A bar hides the wall beside the mover's edge, which the frame before had shown free of the bars."""
    mover = Rect((-1.2, 0, 6), (1.0, 0.6), velocity=(6, 0, 0), frequency=0.1, tint=(5, 0.1, 0.1))
    out, truth, _ = last_frame(device, [WALL, mover, *BARS], count=5)
    hidden = out.numpy("filled_by") == BY_HIDDEN_PART
    is_mover = (truth.depth > 5) & (truth.depth < 7)
    assert (hidden & is_mover).sum() > 50 and not (hidden & ~is_mover).any()


@pytest.mark.parametrize("zoom", [1, 2])
def test_mover_comes_out_from_behind_bars(device, zoom):
    """Its front is where it is, in all target pixels that a part covers, with its depth, motion and color; without that
    the wall stays in view there."""
    mover = Rect((-1.3, 0, 6), (1.0, 0.6), velocity=(9, 0, 0), frequency=0.1, tint=(5, 0.1, 0.1))
    wrong = {}
    for reappearing in (True, False):
        options, target = Options(reappearing=reappearing), (zoom * W, zoom * H)
        out, truth, frame = last_frame(device, [WALL, mover, *BARS], options, target, count=5)
        is_mover, depth = (truth.depth > 5) & (truth.depth < 7), out.numpy("depth")
        wrong[reappearing] = int((is_mover & (np.abs(depth - 6) > 0.1)).sum())
        shown = out.numpy("filled_by") == BY_REAPPEARING
        assert shown.any() == reappearing
        if not reappearing:
            continue
        assert (shown & is_mover).sum() > 0.9 * shown.sum() and (out.numpy("dynamic")[shown] == 1).all()
        assert (out.numpy("color")[shown, 0] > 2).all()
        y, x = np.nonzero(shown)
        at = np.stack([x, y], -1) + 0.5 + out.numpy("motion")[shown]
        assert np.isclose(frame.depth[tuple(np.floor(at).astype(int).T[::-1])], 4, rtol=0.01).mean() > 0.9  # a bar
    assert wrong[True] < min(0.5 * wrong[False], 30 * zoom), wrong


def test_mover_comes_out_from_behind_a_nearer_mover(device):
    """As from behind bars that move, unless they are so little nearer that they may be limbs of its own."""
    mover = Rect((-1.3, 0, 6), (1.0, 0.6), velocity=(9, 0, 0), frequency=0.1, tint=(5, 0.1, 0.1))
    for nearer, comes_out in ((1, True), (1.3, False)):
        bars = [replace(bar, center=(*bar.center[:2], nearer * bar.center[2]), velocity=(-1, 0, 0)) for bar in BARS]
        out, truth, _ = last_frame(device, [WALL, mover, *bars], count=4)
        shown = out.numpy("filled_by") == BY_REAPPEARING
        assert shown.any() == comes_out
        assert not comes_out or np.isclose(truth.depth[shown], 6, rtol=0.01).mean() > 0.9


@pytest.mark.parametrize("row", [H / 2, H], ids=["side", "corner"])
def test_mover_that_enters_goes_on_to_the_border(device, row):
    """Where it is known to the last pixel, and where no frame has shown it yet; without that it is torn."""
    edge, y, _ = camera(W, H).unproject(np.array([[0.0, row]]), np.array([6.0]))[0]
    mover = Rect((edge - 1.8, y, 6), (1.0, 1.2), velocity=(18, 0, 0), frequency=0.1, tint=(5, 0.1, 0.1))
    wrong = {}
    for entering in (True, False):
        out, truth, frame = last_frame(device, [WALL, mover], Options(entering=entering), count=4)
        shown = truth.depth < 7
        assert shown[:, 0].any() and (frame.depth < 7)[:, 0].any()  # it lies across the border
        wrong[entering] = int((shown & (np.abs(out.numpy("depth") - 6) > 0.1)).sum())
    assert shown.sum() > 300 and wrong[True] < 10 and wrong[False] > 40, wrong


def rect_from(left, right, z, step, **look):
    """A rectangle over all rows between two columns in the last of four rendered frames, `step` px in an interval."""
    ends = camera(W, H).unproject(np.array([[left, H / 2], [right, H / 2], [0, 0], [step, 0]]), np.full(4, float(z)))
    speed, middle = 30 * (ends[3] - ends[2])[0], ends[:2].mean(0)
    return Rect(
        (middle[0] - speed * 3 / 30, middle[1], z), ((ends[1] - ends[0])[0] / 2, 4), velocity=(speed, 0, 0), **look
    )


def test_mover_that_has_entered_ends_where_it_ends(device):
    """The border that it has left, in the rendered frame, shows the wall: it has no parts outside."""
    out, truth, frame = last_frame(device, [WALL, rect_from(3, 63, 6, 40, frequency=0.1)], count=4)
    assert (frame.depth[:, 0] > 7).all() and (frame.depth[:, 5] < 7).all()
    hole = (out.numpy("disoccluded") == 1) & (truth.depth > 7)
    assert hole.sum() > 500 and not (hole & (out.numpy("filled_by") == BY_HIDDEN_PART)).any()


def test_mover_that_enters_behind_another_goes_on_to_the_border(device):
    """All that the rendered frame showed of it is hidden by a nearer mover that passes."""
    far = rect_from(W - 12, W + 60, 6, -20, frequency=0.1, tint=(5, 0.1, 0.1))
    near = rect_from(W - 60, W - 22, 4, 36, frequency=0.1)
    out, truth, _ = last_frame(device, [WALL, far, near], count=4)
    hole = (out.numpy("disoccluded") == 1) & (np.abs(truth.depth - 6) < 0.1)
    assert hole.sum() > 100
    np.testing.assert_allclose(out.numpy("depth")[hole], 6, rtol=1e-2)
    assert (out.numpy("color")[hole, 0] > 2).all()


def test_mover_off_the_bars_leaves_the_background_alone(device):
    """Nothing hid a mover that stands free: its wake is the wall's."""
    free, _, _ = last_frame(device, [WALL, MOVER])
    assert (free.numpy("disoccluded") == 1).any() and not (free.numpy("filled_by") == BY_HIDDEN_PART).any()
    out, _, _ = last_frame(device, [WALL, MOVER, *BARS], Options(hidden_parts=False))
    assert not (out.numpy("filled_by") == BY_HIDDEN_PART).any()
