"""Which frame is at a time, and the cameras of new frames that follow from it: one tolerance for everything."""

from pathlib import Path

import numpy as np
import pytest
from tiny_sequence import H, W, camera, pixels

from gffe_cl.captures.offline.run import alphas_for, run_sequence
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.sequence import FrameEntry, Sequence, SequenceWriter, named_channels, open_sequence
from gffe_cl.captures.sequence.description import Description
from gffe_cl.captures.sequence.exr import OwnPixels
from gffe_cl.engine.options import Options
from gffe_cl.viewer.engine.sources.recorded import RecordedSource

FRAMES = 6


def entries(times, kind="rendered", resets=(0,)):
    return [FrameEntry(f"{kind}_{i}.exr", t, kind, reset=i in resets) for i, t in enumerate(times)]


def timeline(rendered, truth, resets=(0,)):
    frames = entries(rendered, resets=resets) + entries(truth, "ground_truth")
    described = Description(W, H, 10.0, 1.0, sorted(frames, key=lambda entry: entry.time))
    return Sequence(Path("none"), described, OwnPixels(Path("none")))


def file_at(line, time, kind="ground_truth"):
    entry = line.at(kind, time)
    return entry and entry.file


def test_one_fiftieth_of_the_interval_there():
    line = timeline([0.0, 0.1, 0.3], [0.05, 0.2, 0.4])
    for near, slack in ((0.05, 0.002), (0.2, 0.004), (0.4, 0.004)):
        assert file_at(line, near - 0.95 * slack) == file_at(line, near + 0.95 * slack) == file_at(line, near)
        assert (
            file_at(line, near)
            and file_at(line, near - 1.05 * slack) is None
            and file_at(line, near + 1.05 * slack) is None
        )
    assert line.at("extrapolated", 0.05) is None and file_at(line, 0.0999, "rendered") == "rendered_1.exr"
    assert line.nearest("ground_truth", 7.0).file == "ground_truth_2.exr" and line.nearest("extrapolated", 0) is None
    assert "ground_truth_1.exr at 0.2 s is 5 ms" in line.near_miss("ground_truth", 0.205)
    assert line.near_miss("ground_truth", 0.203) is None and line.near_miss("ground_truth", 0.225) is None


def test_gaps_before_a_reset_are_no_intervals():
    line = timeline([0.0, 0.1, 5.0, 5.2], [0.15, 5.1], resets=(0, 2))
    assert file_at(line, 0.1519) == "ground_truth_0.exr" and file_at(line, 0.153) is None
    assert file_at(timeline([0.0, 5.0], [0.05], resets=(0, 1)), 0.0519) == "ground_truth_0.exr"  # 1/fps
    assert (
        file_at(timeline([], [0.05]), 0.0519) == "ground_truth_0.exr" and file_at(timeline([], [0.05]), 0.053) is None
    )


def test_the_nearest_of_several():
    line = timeline([0.0, 0.1], [0.049, 0.05, 0.0505])
    assert [file_at(line, t)[-5] for t in (0.0489, 0.0498, 0.0504)] == ["0", "1", "2"]


def test_rendered_before():
    line = timeline([0.0, 0.1, 0.2], [])
    assert [line.rendered_before(t) for t in (0.0, 0.05, 0.1, 0.1 + 1e-9, 0.15, 0.9)] == [None, 0, 0, 0, 1, 2]


# ---- cameras of new frames --------------------------------------------------------------------------------


def write(path, per_frame, digits=None):
    """Rendered frames at 30 per second, each followed by `per_frame` true ones; times rounded to so many `digits`."""

    def time(at):
        return at / 30 if digits is None else round(at / 30, digits)

    with SequenceWriter(path, W, H, 30.0) as writer:
        for k in range(FRAMES):
            entry = FrameEntry(f"frame_{k:06d}.exr", time(k), "rendered", k == 0, None, camera(0.1 * k))
            writer.add(entry, named_channels(*pixels(k)))
            for alpha in alphas_for(per_frame):
                seen = camera(0.1 * (k + alpha))
                name = f"truth_{k}_{alpha:.4f}.exr"
                entry = FrameEntry(name, time(k + alpha), "ground_truth", display_camera=seen)
                writer.add(entry, named_channels(pixels(k)[0]))
    return open_sequence(path)


def expected_cameras(sequence, n):
    """By frame: the true cameras, by index, if each is within 1/50 of an interval; else none. By brute force."""
    times = [entry.time for entry in sequence.rendered]
    for k, now in enumerate(times):
        interval = now - times[k - 1] if k else 1 / 30
        ahead = times[k + 1] - now if k + 1 < FRAMES else interval
        found = []
        for alpha in alphas_for(n):
            gaps = [abs(entry.time - (now + alpha * interval)) for entry in sequence.ground_truth]
            found.append(int(np.argmin(gaps)) if gaps and min(gaps) <= ahead / 50 else None)
        yield None if None in found else [sequence.ground_truth[i].display_camera for i in found]


@pytest.mark.parametrize(("n", "truth", "digits"), [(1, "dense", 3), (3, "sparse", None), (3, "dense", None)])
def test_cameras_of_every_frame(device, tmp_path, n, truth, digits):
    """With truth at t + ½ only n = 1 has a known camera for each new frame; with n true frames every n has."""
    sequence = write(tmp_path / "in", 1 if truth == "sparse" else n, digits)
    expected = list(expected_cameras(sequence, n))
    if digits is None:
        complete = truth == "dense" or (truth == "sparse" and n == 1)
        assert [known is not None for known in expected] == [complete] * FRAMES
    else:  # roundings add up to more than 1/50 in some intervals
        assert sum(map(bool, expected)) == 4
    options = Options(shading_correction=False, levels=0, cut_detection=False)
    for predicted in (False, True):
        source, out = Recorded(sequence, device), tmp_path / f"out{predicted}"
        run_sequence(source, out, device, options, alphas_for(n), predicted_camera=predicted)
    made, guessed = (open_sequence(tmp_path / f"out{predicted}").extrapolated for predicted in (False, True))
    assert len(made) == n * FRAMES
    for k, known in enumerate(expected):
        cameras = [entry.display_camera for entry in made[k * n : (k + 1) * n]]
        assert cameras == (known or [entry.display_camera for entry in guessed[k * n : (k + 1) * n]]), k


def test_a_near_miss_is_told(tmp_path):
    """0.067 + 0.034 / 2 = 0.084, and the truth is at 0.083."""
    source = Recorded(write(tmp_path / "in", 1, 3), None)
    assert source.cameras_at([0.084]) is None
    assert "truth_2_0.5000.exr at 0.083 s is 1 ms from 0.084 s" in source.warnings()[-1]
    exact = Recorded(write(tmp_path / "exact", 1), None)
    assert exact.cameras_at([2.4 / 30]) is None and exact.cameras_at([2.5 / 30]) and not exact.warnings()


def test_the_viewer_matches_as_a_run_does(tmp_path):
    """α = 0.4 is not measured against the truth at t + ½; α = 0.5 of n = 3 is, but has no known camera."""
    source = RecordedSource(write(tmp_path / "in", 1), None)
    for n, known in ((1, True), (3, False), (4, False), (1, True)):
        source.configure(None, n)
        for alpha in alphas_for(n):
            assert (source.camera(2, alpha) is not None) == known
            assert (source.truth(2, alpha) is not None) == (alpha == 0.5), alpha
    assert source.camera(2, 0.5) == source.sequence.ground_truth[2].display_camera
    source.close()
