"""Prediction of positions: movers that enter, and that come from behind others."""

import numpy as np
from synthetic import Rect, Rects, camera
from twins import centers

from gffe_cl import Options, Pipeline


def predicted_half_a_frame_after(device, scene, view, size, count):
    """Predicted positions with and without `entering`, by that option; the last of `count` frames, and its history."""
    predicted = {}
    for entering in (True, False):
        pipeline, before = Pipeline(device, *size, Options(acceleration=False, entering=entering)), None
        for k in range(count):
            frame = scene.frame(view, k / 30, *size, before, reset=k == 0)
            pipeline.submit(frame)
            before = (view, k / 30)
        pipeline.extrapolate(view, (count - 0.5) / 30)
        predicted[entering] = pipeline.stages["prediction"].read("target_position")
    history = {name: pipeline.stages["history"].read(name) for name in ("dynamic_mask", "met_depth")}
    return predicted, frame, history


def entered_from_the_left(device, velocity, away, count):
    """The predicted positions of a mover, which began `away` to the left of the image, and came to a depth of 6; those
    half a frame later; the last frame, and its history."""
    width, height = 160, 80
    still, velocity = camera(width, height), np.array(velocity)
    edge = still.unproject(np.array([[0.0, height / 2]]), np.array([6.0]))[0, 0]
    depth = 6 - velocity[2] * (count - 1) / 30
    mover = Rect((edge - away, 0, depth), (1.0, 0.6), velocity=tuple(velocity), frequency=0.1)
    scene = Rects([Rect((0, 0, 12), (20, 9), frequency=0.3), mover])
    predicted, frame, history = predicted_half_a_frame_after(device, scene, still, (width, height), count)
    place = still.unproject(centers(height, width), np.where(frame.depth < 7, frame.depth, 1))
    return predicted, still.project(place + velocity / 60), frame, history


def test_movers_that_enter_go_on(device):
    """Fragments that came through the border, and closer, are predicted where they are then, as those beside whose
    place in the frame before is known."""
    predicted, (there, depth), frame, history = entered_from_the_left(device, (18.0, 0.0, -6.0), 1.8, 4)
    shown, met = frame.depth < 7, history["met_depth"]
    entered = shown & ~(met > 0)
    entered[:, 1:] &= ~(shown & ~entered)[:, :-1]  # but for what is at the outline: nothing tells of its depth before
    assert entered.sum() > 20
    np.testing.assert_allclose(predicted[True][entered][:, :2], there[entered], atol=0.02)
    np.testing.assert_allclose(predicted[True][entered][:, 2], depth[entered], rtol=1e-4)
    assert np.abs(predicted[False][entered][:, 0] - there[entered][:, 0]).min() > 4
    assert np.array_equal(predicted[True][~entered], predicted[False][~entered])


def test_movers_that_enter_as_a_whole_go_on(device):
    """A mover that the frame before did not show at all, and that comes closer, is predicted where it is then: the
    motion of its fragments shows how fast it comes."""
    predicted, (there, depth), frame, history = entered_from_the_left(device, (75.0, 0.0, -24.0), 9.2, 5)
    entered = frame.depth < 7
    assert entered.sum() > 200 and not (history["met_depth"][entered] > 0).any()
    assert np.median(np.abs(predicted[True][..., 2] - depth)[entered]) < 0.1 * 24 / 60
    assert np.median(np.abs(predicted[True][..., :2] - there)[entered]) < 0.3


def test_movers_that_come_from_behind_others_go_on(device):
    """Fragments that a bar hid in the frame before are predicted where they are then, not where they are now."""
    width, height, velocity = 160, 80, np.array([9.0, 0.0, 0.0])
    still = camera(width, height)
    mover = Rect((-1.0, 0, 6), (0.8, 0.6), velocity=tuple(velocity), frequency=0.1)
    scene = Rects([Rect((0, 0, 12), (20, 9), frequency=0.3), mover, Rect((0.5, 0, 4), (0.4, 3), frequency=0.2)])
    predicted, frame, history = predicted_half_a_frame_after(device, scene, still, (width, height), 7)
    unseen = (np.abs(frame.depth - 6) < 0.1) & ~(history["met_depth"] > 0)
    assert unseen.sum() > 20
    place = still.unproject(centers(height, width)[unseen], frame.depth[unseen])
    there = still.project(place + velocity / 60)[0]
    np.testing.assert_allclose(predicted[True][unseen][:, :2], there, atol=0.02)
    assert np.abs(predicted[False][unseen][:, 0] - there[:, 0]).min() > 0.5
