"""Cameras are recovered from depth and motion vectors alone."""

import json

import numpy as np
import pytest
from synthetic import Rect, Rects, camera

from gffe_cl.captures.calibration.calibrate import Calibration, calibrate_sequence
from gffe_cl.captures.calibration.correspondences import Correspondences, correspondences
from gffe_cl.captures.calibration.focal import find_focal, lens_of_view, view_of_lens
from gffe_cl.captures.calibration.pose import Lens, fit, residuals, rotation_of
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.captures.sequence.description import Description, FrameEntry, describe
from gffe_cl.captures.sequence.exr import write_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.camera import Camera

WIDTH, HEIGHT, FPS = 64, 48, 30.0
MIDDLE = np.array([WIDTH / 2, HEIGHT / 2])
SCENE = Rects([
    Rect((0, 0, 12)),
    Rect((-1.5, 0.5, 6), (0.9, 1.5)),
    Rect((1.8, -0.6, 4), (0.7, 0.8)),
    Rect((0.2, 1.2, 7), (1.2, 0.6), velocity=(4, 0, -3)),
])  # fmt: skip


def seen_by(now: Camera, before: Camera, rng, moving=0.0, sky=0.0, quantum=0.0, count=600):
    """Points at random, projected in float64 by `Camera`; the moving ones drift and grow as one."""
    px = rng.uniform((0, 0), (WIDTH, HEIGHT), (count, 2))
    depth = np.exp(rng.uniform(np.log(2), np.log(30), count))
    at_infinity = rng.random(count) < sky
    px_prev = before.project(now.unproject(px, np.where(at_infinity, 1e12, depth)))[0]
    moves = rng.random(count) < moving
    px_prev[moves] += (2.5, -1.2) + 0.05 * (px[moves] - MIDDLE)
    if quantum:
        px_prev = px + np.round((px_prev - px) / quantum) * quantum
    return Correspondences(px, px_prev, np.where(at_infinity, 1.0, depth), at_infinity), moves


def pair(turn=(0.01, -0.03, 0.005), step=(0.1, -0.02, 0.3), focal=60.0):
    """The cameras of a frame and of the one before, standing somewhere."""
    first = camera(WIDTH, HEIGHT, (3, -2, 7), 0.4, 0.1, 0.05)
    before = Camera(first.world_to_view, focal, focal, *MIDDLE)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation_of(np.array(turn)), step
    return Camera(matrix @ before.world_to_view, focal, focal, *MIDDLE), before


def test_a_movement_is_found_among_movers_and_quantized_vectors():
    """Two fifths of the samples move as one; what is off by the recovered movement is less than the quantum."""
    rng = np.random.default_rng(0)
    for turn, step in (
        ((0.01, -0.03, 0.005), (0.1, -0.02, 0.3)),
        ((0, 0, 0), (0.4, 0, 0)),
        ((0.1, 0.3, -0.2), (0, 0, 0)),
    ):
        now, before = pair(turn, step)
        seen, moves = seen_by(now, before, rng, moving=0.4, sky=0.1, quantum=1 / 16)
        movement = fit(seen, Lens(60.0, MIDDLE))
        truth = now.to_view_of(before)
        assert np.abs(movement.rotation - truth[:3, :3]).max() < 1e-3
        assert np.abs(movement.translation - truth[:3, 3]).max() < 0.02
        off = np.linalg.norm(residuals(seen, Lens(60.0, MIDDLE), movement), axis=-1)
        assert np.percentile(off[~moves], 90) < 0.06 < 1 < np.median(off[moves])
        assert movement.degrees == pytest.approx(np.degrees(np.linalg.norm(turn)), abs=0.05)


def test_sky_tells_how_the_camera_turns():
    now, before = pair()
    seen, _ = seen_by(now, before, np.random.default_rng(1), sky=1.1)
    movement = fit(seen, Lens(60.0, MIDDLE))
    assert np.abs(movement.rotation - now.to_view_of(before)[:3, :3]).max() < 1e-6
    assert np.abs(movement.translation).max() < 1e-6


@pytest.mark.parametrize("focal", [35.0, 90.0])
def test_the_focal_length_is_told_by_turning(focal):
    rng = np.random.default_rng(2)
    pairs = [
        seen_by(*pair((0.004, sign * 0.03, 0), (0.1, 0, 0.1), focal), rng, moving=0.3, quantum=1 / 16)[0]
        for sign in (1, -1, 1, 1)
    ]
    lens, deviation = find_focal(pairs, (WIDTH, HEIGHT), MIDDLE, 1.0)
    assert abs(lens.focal / focal - 1) < min(0.01, 5 * deviation) and deviation < 0.003
    assert lens_of_view(view_of_lens(lens, (WIDTH, HEIGHT)), (WIDTH, HEIGHT), MIDDLE, 1.0).focal == pytest.approx(
        lens.focal
    )


def test_bad_pixels_are_left_out():
    depth, motion = np.full((40, 60), 3.0, np.float32), np.ones((40, 60, 2), np.float32)
    assert len(correspondences(depth, motion)) == 40 * 60
    for row, value in enumerate((np.nan, 0, -1)):
        depth[row] = value
    motion[5], motion[6], motion[7], depth[9] = np.nan, np.inf, 1e9, np.inf
    seen = correspondences(depth, motion)
    assert len(seen) == (40 - 6) * 60 and seen.sky.sum() == 60
    assert np.isfinite(seen.depth).all() and (seen.px_prev - seen.px == 1).all()


# ---- sequences -------------------------------------------------------------------------------------------


def bare(folder, turn=0.03, frames=6, resets=(), truth=False):
    """A sequence without any camera, and the true ones. Objects move in it."""
    folder.mkdir()
    entries, cameras, before = [], [], None
    for k in range(frames):
        eye = camera(WIDTH, HEIGHT, (0.06 * k, 0.02 * k, 0.1 * k), turn * k, 0.004 * k)
        for at, kind in ((0.0, "rendered"), (0.5, "ground_truth"))[: 1 + truth]:
            time = (k + at) / FPS
            frame = SCENE.frame(eye, time, WIDTH, HEIGHT, before, reset=before is None)
            motion = np.zeros((HEIGHT, WIDTH, 2), np.float32) if before is None else frame.motion
            channels = dict(zip("RGB", np.moveaxis(frame.color.astype(np.float16), -1, 0), strict=True))
            channels |= {"Z": frame.depth, "motion.x": motion[..., 0], "motion.y": motion[..., 1]}
            if kind == "rendered":
                before = (eye, time)
                cameras.append(eye)
            write_channels(folder / f"{kind}_{k}.exr", {n: np.ascontiguousarray(c) for n, c in channels.items()}, {})
            entries.append(FrameEntry(f"{kind}_{k}.exr", time, kind, reset=k in resets and kind == "rendered"))
    (folder / "sequence.json").write_text(describe(Description(WIDTH, HEIGHT, FPS, 1.0, entries), "test"))
    return folder, cameras


def test_a_sequence_without_cameras_gets_them(gffe, tmp_path):
    """Up to the world, which is the first frame's; ground truth too, here from the place of the frame before."""
    folder, cameras = bare(tmp_path / "in", truth=True)
    with pytest.raises(GffeError, match="no render_camera"):
        open_sequence(folder)
    code, text, _ = gffe("calibrate", folder, tmp_path / "out", "--json", tmp_path / "report.json")
    assert code == 0 and "good: " in text and "6 rendered frames and 6 ground-truth ones" in text
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["percentile_90"] < 0.05 and report["cuts"] == [] and 0.8 < report["static"] < 1
    assert report["turned"] == pytest.approx(np.degrees(0.03) * 5, rel=0.05)
    made = open_sequence(tmp_path / "out")
    assert [entry.file for entry in made.frames] == [
        entry.file for entry in open_sequence(folder, cameras="optional").frames
    ]
    for entry, truth, eye in zip(made.rendered, made.ground_truth, cameras, strict=True):
        assert entry.render_camera.fx == entry.render_camera.fy == pytest.approx(eye.fx, rel=0.01)
        expected = eye.world_to_view @ cameras[0].view_to_world
        assert np.abs(entry.render_camera.world_to_view - expected).max() < 0.01
        assert np.abs(truth.display_camera.world_to_view - expected).max() < 0.01
    assert [entry.reset for entry in made.rendered] == [True] + 5 * [False]


def test_a_camera_that_does_not_turn_needs_a_field_of_view(gffe, tmp_path):
    folder, cameras = bare(tmp_path / "in", turn=0.0, frames=3)
    code, _, error = gffe("calibrate", folder, tmp_path / "out")
    assert code == 2 and "not determined by this motion" in error and "--fov" in error and "Traceback" not in error
    assert not (tmp_path / "out").exists()
    view = np.degrees(2 * np.arctan(WIDTH / 2 / cameras[0].fx))
    assert gffe("calibrate", folder, tmp_path / "out", "--fov", view)[0] == 0
    last = open_sequence(tmp_path / "out").rendered[-1].render_camera
    assert np.abs(last.world_to_view - cameras[-1].world_to_view @ cameras[0].view_to_world).max() < 0.01


def test_resets_start_a_new_world_and_cuts_become_resets(tmp_path):
    folder, _ = bare(tmp_path / "in", frames=6, resets=(2,))
    rng = np.random.default_rng(0)
    channels = {name: rng.normal(size=(HEIGHT, WIDTH)).astype(np.float32) for name in ("R", "G", "B")}
    channels |= {name: rng.uniform(-30, 30, (HEIGHT, WIDTH)).astype(np.float32) for name in ("motion.x", "motion.y")}
    write_channels(folder / "rendered_4.exr", channels | {"Z": np.abs(channels["motion.x"]) + 1}, {})
    found = calibrate_sequence(open_sequence(folder, cameras="optional"), tmp_path / "out", view=55.0)
    assert found.cuts == ["rendered_4.exr"] and found.deviation is None
    made = open_sequence(tmp_path / "out").rendered
    assert [entry.reset for entry in made] == [True, False, True, False, True, False]
    for entry in made:
        assert np.array_equal(entry.render_camera.world_to_view, np.eye(4)) == entry.reset


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--fov", "0"), "--fov must be 1 to 170 degrees"),
        (("--aspect", "99"), "--aspect must be 0.1 to 10"),
        (("--cx", "1e6"), "--cx must be pixels"),
    ],
)
def test_what_makes_no_sense_is_said(gffe, tmp_path, options, message):
    folder, _ = bare(tmp_path / "in", frames=1)
    code, _, error = gffe("calibrate", folder, tmp_path / "out", *options)
    assert code == 2 and message in error and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("percentile_90", "static", "verdict"),
    [(0.2, 0.7, "good"), (0.6, 0.7, "usable"), (1.4, 0.7, "poor"), (0.1, 0.3, "poor")],
)
def test_the_verdict_follows_from_the_residuals(percentile_90, static, verdict):
    found = Calibration(5, 0, (60, 60), 56.0, None, 9.0, percentile_90 / 2, percentile_90, static)
    assert found.verdict.startswith(f"{verdict}: ")


def test_vectors_rounded_to_pixels_are_usable(tmp_path):
    """Not good, and said so; after two movements the camera is still right to a pixel."""
    folder, cameras = bare(tmp_path / "in", frames=3)
    for k in range(1, 3):
        frame = SCENE.frame(cameras[k], k / FPS, WIDTH, HEIGHT, (cameras[k - 1], (k - 1) / FPS))
        channels = dict(zip("RGB", np.moveaxis(frame.color.astype(np.float16), -1, 0), strict=True)) | {
            "Z": frame.depth
        }
        channels |= {f"motion.{name}": np.round(frame.motion[..., axis]) for axis, name in enumerate("xy")}
        write_channels(folder / f"rendered_{k}.exr", {n: np.ascontiguousarray(c) for n, c in channels.items()}, {})
    view = np.degrees(2 * np.arctan(WIDTH / 2 / cameras[0].fx))
    found = calibrate_sequence(open_sequence(folder, cameras="optional"), tmp_path / "out", view=view)
    assert found.verdict.startswith("usable") and 0.3 < found.percentile_90 < 0.7 and found.static > 0.8
    last = open_sequence(tmp_path / "out").rendered[-1].render_camera
    y, x = np.mgrid[4:HEIGHT:8, 4:WIDTH:8] + 0.5
    world = cameras[-1].unproject(np.stack([x, y], -1), np.full(x.shape, 8.0))
    relative = np.moveaxis(world, -1, 0).reshape(3, -1).T @ cameras[0].world_to_view[:3, :3].T
    at = last.project(relative + cameras[0].world_to_view[:3, 3])[0]
    assert np.abs(at - cameras[-1].project(world)[0].reshape(-1, 2)).max() < 1.0


def test_one_frame_is_not_enough(gffe, tmp_path):
    folder, _ = bare(tmp_path / "in", frames=1)
    code, _, error = gffe("calibrate", folder, tmp_path / "out", "--fov", "60")
    assert code == 2 and "no pair of rendered frames" in error
