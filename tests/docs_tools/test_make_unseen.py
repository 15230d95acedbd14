"""Generators of unseen sequences: what they write is sound."""

import sys
from pathlib import Path

import numpy as np
import pytest

import gffe_cl as gffe
from gffe_cl.cli.commands import invoke

TOOLS = Path(__file__).parents[2] / "docs" / "tools"


@pytest.mark.long
@pytest.mark.parametrize(("module", "name", "size"), [("raymarched", "Raymarched", (160, 90))])
def test_a_small_sequence_is_sound(module, name, size, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    __import__(f"unseen.{module}")
    from unseen.recording import record

    generator = getattr(sys.modules[f"unseen.{module}"], name)(*size, frames=4)
    record(generator, tmp_path / module)
    generator.close()
    sequence = gffe.open_sequence(tmp_path / module)
    assert (len(sequence.rendered), len(sequence.ground_truth)) == (4, 4)
    frame = sequence.read(sequence.rendered[2])
    assert np.isfinite(frame.color).all() and np.isfinite(frame.motion).all()
    assert invoke(["check", str(tmp_path / module)]) in (None, 0)
