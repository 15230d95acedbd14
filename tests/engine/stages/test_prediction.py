"""Prediction of positions: the kernel against its twin."""

import numpy as np
import twins
from twin_cases import assert_close, read_history, read_movers

from gffe_cl.engine.stages.frame_block import polynomial_weights


def test_kernel_equals_its_twin(case):
    now, past = case.now, case.past
    dynamic, met_depth = case.read("history", "dynamic_mask"), case.read("history", "met_depth")
    with np.errstate(invalid="ignore"):
        px_prev = twins.centers(*now.depth.shape) + now.motion
        in_previous = twins.unproject(px_prev, met_depth, case.from_previous[4])
    history = read_history(case.pipeline)
    if history is None:  # the one position that history tracking does not store: it follows from the depth met
        known = (dynamic > 0) & (met_depth > 0)
        with np.errstate(invalid="ignore"):
            history = np.concatenate([twins.move(in_previous, case.from_previous), known[..., None]], -1)[None]
    weights = polynomial_weights([now.time, past.time, *(past.time - k / 30 for k in (1, 2))], now.time + 0.02, 5)
    found = read_movers(case.pipeline)
    with np.errstate(invalid="ignore"):
        predicted = twins.predict_positions(
            now.depth, dynamic, history, case.options.order, weights, case.to_target, case.made.alpha, found,
            in_previous,
        )  # fmt: skip
    got = case.read("prediction", "target_position")
    assert np.array_equal(got[..., 2] > 0, predicted[..., 2] > 0)
    assert_close(got, predicted)
    assert 0.02 < (dynamic > 0).mean() < 0.6
