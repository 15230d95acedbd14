"""The definition of `compare` and of the repeated-frame baseline."""

import json

import numpy as np
import pytest

from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels, open_sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.lab.compare import baseline_repeat, compare
from gffe_cl.lab.metrics import METRICS, psnr, ssim, to_display

W, H = 11, 8
CAMERA = Camera(np.eye(4), 9, 9, 5.5, 4)


def color(level, width=W):
    return np.full((H, width, 3), level, np.float32)


def truth_level(i):
    return 0.1 + 0.05 * i


def write(path, kind, times, levels, resets=(0,), exposure=1.0, width=W, sources=None, masks=None):
    """Rendered frames at 0, 0.1, …, each of color i/10, and frames of `kind` at `times`."""
    with SequenceWriter(path, width, H, 10, exposure) as writer:
        for i in range(6):
            entry = FrameEntry(f"frame_{i}.exr", i / 10, "rendered", i in resets, None, CAMERA)
            plane = np.ones((H, width), np.float32)
            writer.add(entry, named_channels(color(i / 10, width), plane, np.stack([plane, plane], -1)))
        for i, (time, level) in enumerate(zip(times, levels, strict=True)):
            entry = FrameEntry(f"{kind}_{i}.exr", time, kind, source=sources[i] if sources else None)
            channels = named_channels(color(level, width))
            if masks is not None:
                channels["mask.dynamic"] = masks
            writer.add(entry, channels)
    return open_sequence(path)


HALVES = [i / 10 + 0.05 for i in range(6)]
TRUTH = [truth_level(i) for i in range(6)]


@pytest.fixture
def truth(tmp_path):
    return write(tmp_path / "truth", "ground_truth", HALVES, TRUTH, exposure=0.8)


def level_psnr(a, b, exposure=0.8):
    a, b = to_display(color(a), exposure), to_display(color(b), exposure)
    return psnr(a, b)


def test_definition(tmp_path, truth):
    levels = [level + 0.1 for level in TRUTH]
    a = write(tmp_path / "a", "extrapolated", HALVES, levels, exposure=0.8)
    calls = []
    result = compare(a, truth, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(i + 1, 6) for i in range(6)]
    assert [frame.counted for frame in result.frames] == [False, False, True, True, True, True]
    expected = [level_psnr(x, y) for x, y in zip(levels, TRUTH, strict=True)]
    np.testing.assert_allclose([frame.values["psnr"] for frame in result.frames], expected, atol=1e-3)
    assert result.mean["psnr"] == pytest.approx(np.mean(expected[2:]), abs=1e-3)
    similarity = [
        ssim(to_display(color(x), 0.8), to_display(color(y), 0.8)) for x, y in zip(levels, TRUTH, strict=True)
    ]
    assert result.mean["ssim"] == pytest.approx(np.mean(similarity[2:]), abs=1e-6)
    document = json.loads(json.dumps(result.to_json()))
    assert set(document) == {"mean", "frames"} and set(document["mean"]) == set(METRICS) >= {"psnr", "ssim", "flip"}
    assert set(document["frames"][0]) == {"time", "file", "truth", "counted", *METRICS}
    assert document["frames"][3]["file"] == "extrapolated_3.exr"
    assert document["frames"][3]["truth"] == "ground_truth_3.exr"


def test_matching_within_a_fiftieth_of_an_interval(tmp_path, truth):
    """Rendered frames are 0.1 s apart, so the tolerance is 0.002 s."""
    times = [0.25 + 0.0019, 0.35 - 0.0019, 0.45 + 0.0021, 0.55 - 0.0021]
    with SequenceWriter(tmp_path / "a", W, H, 10) as writer:
        for i, time in enumerate([0.0, 0.05, *times]):
            writer.add(FrameEntry(f"e_{i}.exr", time, "extrapolated"), named_channels(color(0.5)))
    result = compare(open_sequence(tmp_path / "a"), truth)
    matched = [(frame.file, frame.truth) for frame in result.frames]
    assert matched[-2:] == [("e_2.exr", "ground_truth_2.exr"), ("e_3.exr", "ground_truth_3.exr")]
    assert len(matched) == 3  # e_1 too
    assert "e_4.exr is left out" in result.notes[0] and "ground_truth_4.exr at 0.45 s is 2.1 ms" in result.notes[0]
    assert "; 1 more" in result.notes[0]


def test_resets_in_between(tmp_path, truth):
    a = write(tmp_path / "a", "extrapolated", HALVES, TRUTH, resets=(0, 3))
    counted = [frame.counted for frame in compare(a, truth).frames]
    assert counted == [False, False, True, False, False, True]


def test_source_decides_about_history(tmp_path, truth):
    """A frame far ahead of its source counts by its source, not by what was rendered meanwhile."""
    a = write(tmp_path / "a", "extrapolated", [0.25], [0.5], sources=["frame_1.exr"])
    result = compare(a, truth)
    assert result.notes and "all frames" in result.notes[-1] and result.frames[0].counted


def test_all_excluded(tmp_path, truth):
    a = write(tmp_path / "a", "extrapolated", HALVES[:2], [0.5, 0.6], exposure=0.8)
    result = compare(a, truth)
    assert result.mean["psnr"] == pytest.approx(
        np.mean([level_psnr(0.5, TRUTH[0]), level_psnr(0.6, TRUTH[1])]), abs=1e-3
    )
    assert result.to_json()["notes"] == result.notes


def test_mask(tmp_path, truth):
    masks = np.zeros((H, W), np.float32)
    a = write(tmp_path / "a", "extrapolated", HALVES, [0.5] * 6, masks=masks)
    result = compare(a, truth, mask="mask.dynamic")
    assert set(result.to_json()["mean"].values()) == {None}
    masks[2, 3] = 1  # where no window of SSIM fits
    a = write(tmp_path / "b", "extrapolated", HALVES, [0.5] * 6, masks=masks)
    masked, whole = (compare(a, truth, mask=mask).mean for mask in ("mask.dynamic", None))
    assert masked["psnr"] == pytest.approx(whole["psnr"], abs=1e-3) and np.isnan(masked["ssim"])
    with pytest.raises(GffeError, match=r"extrapolated_0.exr: no channel 'mask.none'"):
        compare(a, truth, mask="mask.none")


def test_nothing_to_compare(tmp_path, truth):
    far = write(tmp_path / "far", "extrapolated", [7.03, 7.08], [0.5, 0.5])
    nearest = r"no extrapolated frame has ground truth .* at 7\.03 s, the nearest is at 0\.55 s"
    with pytest.raises(GffeError, match=nearest):
        compare(far, truth)
    with pytest.raises(GffeError, match="no extrapolated frames"):
        compare(truth, truth)
    with pytest.raises(GffeError, match="no ground truth"):
        compare(far, far)
    wide = write(tmp_path / "wide", "extrapolated", HALVES, TRUTH, width=W + 1)
    with pytest.raises(GffeError, match=rf"{W + 1}×{H} pixels, expected {W}×{H}"):
        compare(wide, truth)


def test_baseline(truth):
    result = baseline_repeat(truth)
    expected = [level_psnr(i / 10, TRUTH[i]) for i in range(6)]
    np.testing.assert_allclose([frame.values["psnr"] for frame in result.frames], expected, atol=1e-2)
    assert result.mean["psnr"] == pytest.approx(np.mean(expected[2:]), abs=1e-2)
    assert result.frames[4].file == "frame_4.exr" and result.frames[4].truth == "ground_truth_4.exr"
    assert result.frames[4].time == pytest.approx(0.45)
