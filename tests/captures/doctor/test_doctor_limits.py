"""Depths and vectors that stop at the end of their range are noted, surfaces that end there are not."""

from dataclasses import replace

import numpy as np
import pytest
from doctor_clips import clip

from gffe_cl.captures.doctor import examine, quick_warning
from gffe_cl.lab.fault_injection import Kept


def changed(**buffers):
    """The exact clip with functions of its buffers in their place."""
    frames = []
    for frame in clip().images:
        made = {
            name: change(getattr(frame, name)) for name, change in buffers.items() if getattr(frame, name) is not None
        }
        frames.append(replace(frame, **{name: np.asarray(value, np.float32) for name, value in made.items()}))
    return Kept(frames)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda z: np.minimum(z, 11.0), "are 11, the largest number, and vectors say that most of these are farther"),
        pytest.param(
            lambda z: np.minimum(np.round(z / 9 * 255), 255) * (9 / 255),
            "are 9, the largest number",
            marks=pytest.mark.long,
        ),
        (lambda z: np.maximum(z, 9.5), "are 9.5, the smallest number, and vectors say that most of these are nearer"),
    ],
    ids=["clamped", "8 bits", "near"],
)
def test_depths_that_stop_at_the_end_of_their_range(change, said):
    bad = changed(depth=change)
    (note,) = [finding for finding in examine(bad).findings if finding.id == "depth-cut-off"]
    depth = np.concatenate([frame.depth.ravel() for frame in bad.images])
    assert said in note.sentence and (note.kind, note.fix) == ("note", "")
    assert note.figures["share"] == pytest.approx(np.mean(depth == depth.dtype.type(note.figures["limit"])), abs=0.03)
    assert ('"sky_from"' in note.sentence) == ("largest" in said)
    assert said in quick_warning(bad)


@pytest.mark.parametrize(("most", "axis"), [(1.5, "x"), (1.0, "y")])
def test_vectors_that_stop_at_the_end_of_their_range(most, axis):
    bad = changed(motion=lambda v: np.where([axis == name for name in "xy"], np.clip(v, -most, most), v))
    notes = [finding for finding in examine(bad).findings if finding.id == "motion-cut-off"]
    assert notes and f"±{most:g} px in {axis}, the largest" in notes[0].sentence
    assert f"±{most:g} px in {axis}, the largest" in quick_warning(bad)


def test_a_wall_at_the_end_of_the_depths_is_no_limit():
    """All that is farther is cut away, with what vectors and depth say of it: a wall, seen straight on."""
    assert not [f for f in examine(clip(True, False)).findings if f.name == "cut off"]
    assert not [
        f for f in examine(changed(depth=lambda z: np.where(z > 15, np.inf, z))).findings if f.name == "cut off"
    ]
