"""The example of two threads, under its simulated clock: what a viewer of the display notices."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "examples"))
import two_threads

pytestmark = pytest.mark.device


@pytest.fixture(autouse=True)
def on_pocl(device):
    if "pocl" not in device.info.version.lower():
        pytest.skip("runs on PoCL")


def steps(shown, start, end):
    """Seconds between displayed moments, and between refreshes."""
    times = np.array([(now, moment) for now, moment, *_ in shown if start <= now < end])
    return np.diff(times[:, 1]), np.diff(times[:, 0])


def test_uneven_times_are_not_seen(device):
    events = two_threads.Events(3, uneven=0.008)
    found, shown = two_threads.simulate(events, device=device)
    moments, refreshes = steps(shown, 1, 3)
    assert np.allclose(refreshes, 1 / 60) and np.allclose(moments, 1 / 60, atol=1e-6)
    assert found["held"] <= 2 and found["late"] <= 1 and found["dropped"] == found["lost"] == 0
    assert 25 < found["age"] < 25 + 8 + 2 * 1e3 / 60
    again, _ = two_threads.simulate(events, device=device)
    assert again == found


def test_what_happens_to_programs_is_survived(device):
    """A stall, a window of another size, a cut and a lost display: even again soon after each."""
    events = two_threads.Events(8, stalls=((1.5, 0.4),), resizes=(3,), cuts=(4.5,), losses=((6, 1.0),))
    found, shown = two_threads.simulate(events, device=device)
    for start, end in ((1, 1.5), (2.1, 3), (3.2, 4.5), (4.7, 6), (7.1, 8)):
        moments, refreshes = steps(shown, start, end)
        assert np.allclose(refreshes, 1 / 60) and np.allclose(moments, 1 / 60, atol=1e-6), start
    sizes = [(now, size) for now, _, size, _ in shown]
    assert {size for now, size in sizes if now < 3} == {(64, 36)} and sizes[-1][1] == (80, 45)
    assert min(now for now, size in sizes if size == (80, 45)) < 3.1
    assert found["longest interval"] == pytest.approx(1000, abs=40) and found["lost"] == 0
    held = [now for now, *_, plan in shown if plan.held and now > 0.2]
    assert held and all(1.5 < now < 2.0 for now in held)


def test_a_display_thread_that_is_too_slow_still_shows(device):
    """Frames come quicker than they can be taken: the renderer goes on, and its vectors lead to the last one taken."""
    found, _ = two_threads.simulate(two_threads.Events(2, taking=0.04), device=device)
    assert found["shown"] > 15 and found["lost"] > 10 and found["age"] < 250


def test_a_thread_that_fails_ends_the_other(device, monkeypatch):
    def fails(*_):
        raise RuntimeError("device lost")

    monkeypatch.setattr(two_threads.SimulatedRenderer, "frame", fails)
    with pytest.raises(RuntimeError, match="device lost"):
        two_threads.simulate(two_threads.Events(1), device=device)
