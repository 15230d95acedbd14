"""Generators of unseen sequences: what they write is sound."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gffe_cl as gffe
from gffe_cl.cli.commands import invoke

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.long
@pytest.mark.parametrize(
    ("module", "name"), [("raymarched", "Raymarched"), ("aquarium", "Aquarium"), ("fairground", "Fairground")]
)
def test_a_small_sequence_is_sound(module, name, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    __import__(f"unseen.{module}")
    from unseen.recording import record

    generator = getattr(sys.modules[f"unseen.{module}"], name)(160, 90, frames=4)
    record(generator, tmp_path / module)
    generator.close()
    sequence = gffe.open_sequence(tmp_path / module)
    assert (len(sequence.rendered), len(sequence.ground_truth)) == (4, 4)
    frame = sequence.read(sequence.rendered[2])
    assert np.isfinite(frame.color).all() and np.isfinite(frame.motion).all()
    assert invoke(["check", str(tmp_path / module)]) in (None, 0)


_PANDA = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from unseen.panda_live import PandaLiveAntialiased
from unseen.recording import record

record(PandaLiveAntialiased(160, 90, frames=4), Path(sys.argv[2]))
"""


@pytest.mark.long
def test_the_live_game_is_sound_with_antialiasing(tmp_path):
    pytest.importorskip("panda3d")
    command = [sys.executable, "-c", _PANDA, str(DOCS), str(tmp_path / "live")]
    found = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert found.returncode == 0, found.stderr
    sequence = gffe.open_sequence(tmp_path / "live")
    frame = sequence.read(sequence.rendered[2])
    assert frame.color.shape == (90, 160, 3) and frame.camera.cx == 80
    assert invoke(["check", str(tmp_path / "live")]) in (None, 0)
