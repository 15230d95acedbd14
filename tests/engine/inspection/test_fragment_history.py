"""Sentences of a fragment's story."""

from types import SimpleNamespace

import numpy as np

from gffe_cl.engine.inspection.explain.fragment_history import _fragment_sentences
from gffe_cl.engine.stages.history import DYNAMIC, STATIC


def test_a_mask_that_contradicts_the_numbers_is_named():
    pipeline = SimpleNamespace(options=SimpleNamespace(motion=True))
    shot = SimpleNamespace(moment=SimpleNamespace(previous_camera=object()))

    def said(label, residual, depth=2.0):
        motion, static = np.array([4.0, 3.0]), np.zeros(2)
        mover = (-1, 0.0, False, False)
        return _fragment_sentences(pipeline, shot, depth, motion, static, label, residual, 0.25, mover)[0]

    assert said(STATIC, 0.1).startswith("Static: its motion (+4.00, +3.00) px is 0.10 px from")
    assert said(DYNAMIC, 4.99).startswith("Dynamic: its motion") and "), more than the thres" in said(DYNAMIC, 4.99)
    assert said(STATIC, 4.99).startswith("The mask says static, but its motion (+4.00, +3.00) px is 4.99 px from")
    assert said(STATIC, 4.99).endswith("still (+0.00, +0.00), more than the threshold of 0.25 px.")
    assert said(DYNAMIC, 0.1).startswith("The mask says dynamic, but its") and "not more than" in said(DYNAMIC, 0.1)
    assert said(DYNAMIC, 0.2501).startswith("Dynamic") and said(STATIC, 0.2501).startswith("Static")  # rounding
    assert said(DYNAMIC, None, np.inf) == "The mask says dynamic, but sky turns with the camera."
