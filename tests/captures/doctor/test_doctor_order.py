"""Frames that were recorded twice are left out."""

from dataclasses import replace

import pytest
from doctor_clips import COUNT, assert_restored, clip, names, written

from gffe_cl import open_sequence
from gffe_cl.captures.doctor import examine, selected, write_repaired
from gffe_cl.lab.fault_injection import Kept


def twice(which):
    """The exact clip with some frames recorded twice."""
    frames = [frame for k, frame in enumerate(clip().images) for _ in range(1 + (k in which))]
    return Kept([replace(frame, time=k / 30, reset=k == 0) for k, frame in enumerate(frames)])


@pytest.mark.parametrize(("which", "said"), [((4,), "frame 5 is the same"), ((2, 6), "frames 3, 8 are the same")])
def test_frames_recorded_twice_are_left_out(tmp_path, which, said):
    bad = open_sequence(written(tmp_path / "bad", twice(which)))
    diagnosis = examine(bad)
    assert names(diagnosis) == ["frames: recorded twice"] and said in diagnosis.faults[0].sentence
    assert write_repaired(bad, selected(diagnosis), tmp_path / "fixed") == COUNT
    fixed = open_sequence(tmp_path / "fixed")
    assert examine(fixed).findings == []
    assert_restored([fixed.read(entry) for entry in fixed.rendered])
    assert [entry.time for entry in fixed.rendered] == sorted({e.time for e in bad.rendered} - {
        e.time for k, e in enumerate(bad.rendered) if k in diagnosis.faults[0].figures["frames"]
    })  # fmt: skip


def test_a_color_that_was_recorded_twice_is_named():
    frames = clip().images
    late = [replace(frame, color=frames[k - (k in (3, 7))].color) for k, frame in enumerate(frames)]
    (fault,) = examine(Kept(late)).findings
    assert fault.id == "color-repeated" and fault.sentence.startswith("frames 3, 7 have the color of the frame before")


def test_frames_at_rest_are_not_recorded_twice():
    assert names(examine(clip(False, False))) == []
