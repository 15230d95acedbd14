"""`gffe eval --upscale`: small frames go through upscaling, beside the same done otherwise."""

import json
from dataclasses import replace

import numpy as np
import pytest
from upscaling_frames import MOVING, H, W, frames, path, pipeline_for

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.stages.frame_block import mapping
from gffe_cl.lab.table.datasets import open_subject, parse_subject
from gffe_cl.lab.table.image_space import pixel_centers
from gffe_cl.lab.table.methods import METHODS, chosen_methods


def footage_of(device, upscale):
    return open_subject(parse_subject("corridor", (32, 20), 4, 30.0, (0.5,), upscale=upscale), device)


@pytest.mark.long
def test_upscaling_is_measured_beside_what_is_done_otherwise(gffe, tmp_path):
    """A scene, and the same frames from disk, where new frames have no known G-buffers, and rendered ones no truth."""
    folder = tmp_path / "small"
    size = ("--size", "64x40", "--frames", 5)
    assert gffe("render", "corridor", folder, *size, "--jitter", "halton:16", "--scale", 2, "--ground-truth")[0] == 0
    report = tmp_path / "report"
    chosen = ("--methods", "gffe,upscaling,repeat", "--upscale", 2)
    code, _, err = gffe("eval", "corridor", folder, "--out", report, *size, *chosen)
    assert code == 0, err
    document = json.loads((report / "results.json").read_text())
    cells = {(c["sequence"], c["method"]): c for c in document["cells"]}
    upscaling = [name for name, method in METHODS.items() if method.group == "upscaling"]
    assert [m for s, m in cells if s == "corridor:0"] == ["gffe", *upscaling]
    assert [m for s, m in cells if s == "small"] == ["gffe", *upscaling[:-1]]
    ours, plain, alone, first, true = (cells["corridor:0", name] for name in ("gffe", *upscaling))
    assert ours["rendered_psnr"] > plain["rendered_psnr"] + 0.5 and ours["psnr"] > plain["psnr"] + 0.5
    assert alone["rendered_psnr"] == first["rendered_psnr"] == true["rendered_psnr"] == ours["rendered_psnr"]
    assert alone["psnr"] == pytest.approx(plain["psnr"], abs=0.1) and alone["flicker"] > ours["flicker"]
    assert first["psnr"] > plain["psnr"] + 0.3 and abs(true["psnr"] - ours["psnr"]) < 0.5
    at_times = {round(frame["time"], 6): frame["psnr"] for frame in ours["frames"]}
    for frame in cells["small", "gffe"]["frames"]:
        assert frame["psnr"] == pytest.approx(at_times[round(frame["time"], 6)], abs=0.02)
    assert cells["small", "gffe"]["flicker"] is None and "rendered_psnr" not in cells["small", "gffe"]
    reasons = {skip["what"]: skip["reason"] for skip in document["skipped"]}
    assert "needs G-buffers" in reasons["true-geometry"] and "display's size" in reasons["repeat"]


def test_frames_of_upscaling_are_small_and_jittered_and_regions_as_without(device):
    """Rendered frames differ, moments and regions do not."""
    small, large = (footage_of(device, upscale) for upscale in (1.6, 0.0))
    shots = list(small.shots("given"))
    assert small.render_size("given") == (20, 12) and [s.frame.depth.shape for s in shots] == [(12, 20)] * 4
    assert len({shot.frame.camera.cx - shot.frame.shown_camera.cx / 1.6 for shot in shots}) == 4
    assert small.render_size("off") == large.render_size("given") == (32, 20)
    for a, b, shot in zip(small.shots(), large.shots("given"), shots, strict=True):
        np.testing.assert_array_equal(a.frame.depth, b.frame.depth)
        np.testing.assert_array_equal(shot.shown, b.shown)
        assert all((x.truth == y.truth).all() for x, y in zip(shot.moments, b.moments, strict=True))


def test_what_is_done_otherwise(device):
    """Without a network: which picture each of them shows of a rendered frame and of a new one."""
    footage = footage_of(device, 2.0)
    shown = {}
    for name in ("gffe", "bicubic", "rendered-upscaled", "upscaled-first", "true-geometry"):
        method = METHODS[name]
        runner = replace(method, options=replace(method.options, shading_correction=False)).runner(footage, device)
        for shot in footage.shots(method.window):
            runner.submit(shot)
            for moment in shot.moments:
                runner.finish()
                shown[name] = runner.present(), runner.make(moment)
        assert len(runner.milliseconds) == 2 and min(runner.milliseconds) > 0
    ours, plain = shown["gffe"], shown["bicubic"]
    for name, (rendered, new) in shown.items():
        assert (rendered == (plain if name == "bicubic" else ours)[0]).all()
        assert name in ("gffe", "bicubic") or (new != ours[1]).any()
        assert (new == plain[1]).all() == (name in ("bicubic", "rendered-upscaled"))
    errors = {name: np.mean((new - moment.truth.astype(np.float32)) ** 2) for name, (_, new) in shown.items()}
    assert max(errors[name] for name in ("gffe", "upscaled-first", "true-geometry")) < 0.9 * errors["bicubic"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("room", "--upscale", 0.5), "upscaling must be 0 (off) or 1 to 3"),
        (("room", "--upscale", 2, "--late-warp"), "exclude each other"),
        (("{}", "--upscale", 2), "its frames are as large as its ground truth, 32×20"),
    ],
)
def test_what_cannot_be_upscaled_is_told(gffe, tmp_path, arguments, words):
    folder = tmp_path / "full"
    if "{}" in arguments:
        assert gffe("render", "room", folder, "--size", "32x20", "--frames", 4, "--ground-truth")[0] == 0
    arguments = [str(a).format(folder) for a in arguments]
    code, _, err = gffe("eval", *arguments, "--out", tmp_path / "report")
    assert code == 2 and words in " ".join(err.split()) and not (tmp_path / "report" / "index.html").exists()


def test_methods_of_upscaling_are_there_when_asked_for():
    assert "bicubic" not in chosen_methods(None) and "bicubic" in chosen_methods(None, upscale=True)
    subject = parse_subject("room", (32, 20), 4, 30.0, (0.5,))
    assert "--upscale" in METHODS["bicubic"].missing(subject) and METHODS["gffe"].missing(subject) is None


def test_new_frames_are_seen_through_what_is_given(device):
    """The extrapolated frame's own depth and motion change nothing; motion a pixel off shows the pixel beside."""
    pipeline = pipeline_for(device, shading_correction=False)
    for frame in frames(MOVING, 4, still=False):
        pipeline.submit(frame)
    at = path(4, still=False), 3.5 / 30
    made = pipeline.extrapolate(*at)
    color, depth, motion = (made.numpy(name) for name in ("color", "depth", "motion"))
    np.testing.assert_array_equal(pipeline.extrapolate(*at, seen_through=(depth, motion)).numpy("color"), color)
    flat, here = np.full((H, W), 5, np.float32), pixel_centers(H, W)
    to_render = mapping(frame.display_camera, frame.camera)
    still = here * to_render[:2] + to_render[2:] - here
    shown = [pipeline.extrapolate(*at, seen_through=(flat, still + (d, 0))).numpy("color") for d in (0, 0.5)]
    inner = (slice(4, -4), slice(4, -4))
    off = np.abs(np.roll(shown[0], -1, 1) - shown[1])[inner]  # half a rendered pixel is one that is shown
    assert off[pipeline.board.frame.read("disoccluded")[inner] == 0].max() < 2e-3 < np.abs(shown[0] - shown[1]).max()
    with pytest.raises(GffeError, match="seen_through, motion must have shape"):
        pipeline.extrapolate(*at, seen_through=(flat, flat))
