"""Stepping between options by the times of frames."""

import numpy as np

from gffe_cl import Options, Stepper
from gffe_cl.engine.options import is_part_of

BEST = Options(shading_correction=True, scn_model="network.onnx")


def steps(stepper, costs, loads):
    """Return (frame, level) of the steps; `costs` of the levels, ms; `loads`: factors, frame by frame."""
    found = []
    for number, load in enumerate(loads):
        if stepper.took(load * costs[stepper.level]):
            found.append((number, stepper.level))
    return found


def test_levels():
    stepper = Stepper(1, BEST, [Options.preset("performance")])
    levels = [stepper.options]
    for _ in range(50):
        if stepper.took(2):
            levels.append(stepper.options)
    assert levels[0] == BEST and [one.shading_correction for one in levels[1:]] == [False, False, False]
    assert [one.hidden_parts for one in levels] == [True, True, False, True] and levels[3].warp == "dilated"
    assert [is_part_of(one, BEST) for one in levels] == [True, True, True, False]


def test_the_best_that_fits_is_used():
    costs = 8.0, 3.0, 2.0
    assert steps(Stepper(10, BEST), costs, np.ones(500)) == []
    assert steps(Stepper(4, BEST), costs, np.ones(500)) == [(4, 1)]
    assert steps(Stepper(2.5, BEST), costs, np.ones(500)) == [(4, 1), (9, 2)]
    assert steps(Stepper(1, BEST), costs, np.ones(500)) == [(4, 1), (9, 2)]  # the last one, whatever it takes


def test_a_few_late_frames_change_nothing():
    loads = np.ones(600)
    loads[::7] = loads[1::7] = 20
    assert steps(Stepper(10, BEST), (8.0, 3.0, 2.0), loads) == []


def test_it_goes_up_again_when_the_scene_is_lighter():
    loads = np.concatenate([np.ones(200), np.full(400, 0.4), np.ones(200)])
    found = steps(Stepper(4, BEST), (8.0, 3.0, 2.0), loads)
    assert [level for _, level in found] == [1, 0, 1]
    assert 200 < found[1][0] < 210 and 600 < found[2][0] < 610


def test_steps_up_that_fail_are_tried_ever_less():
    """Nothing changes, so that the better level never fits."""
    found = steps(Stepper(4, BEST), (4.5, 3.0, 2.0), np.ones(30000))
    assert [level for _, level in found] == [1, 0] * (len(found) // 2) + [1] * (len(found) % 2)
    waits = np.diff([number for number, level in found if level == 0])
    assert len(waits) > 2 and (waits[1:] > 1.9 * waits[:-1]).all()
