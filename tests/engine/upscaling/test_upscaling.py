"""Temporal anti-aliasing and upsampling, what it promises: jitter that nothing takes for motion, pictures better than
resampled ones, no shimmer, no ghosts, thin bars that stay."""

import json
from dataclasses import replace

import numpy as np
import pytest
from synthetic import Rect, Rects, camera

from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.captures.sequence import open_sequence
from gffe_cl.engine.frame.rendered_frame import RenderedFrame
from gffe_cl.engine.frame.window import Jitter, without_jitter
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline

W, H = 96, 64
JITTER, SHOWN = Jitter(16), camera(W, H)
WALL = Rect((0, 0, 12), (9, 6), frequency=0.7)
STILL = Rects([WALL, Rect((0.9, 0.2, 6), (0.7, 1.5), frequency=1, tint=(0.7, 0.2, 0.1))])


def pipeline_for(device, size=(W, H), render_size=(W // 2, H // 2)):
    return Pipeline(device, *size, Options(upscale=2.0), render_size=render_size)


def frames(scene, count):
    """Jittered frames of a sample per pixel."""
    before = None
    for k in range(count):
        render = JITTER.camera(SHOWN.scaled(0.5, 0.5), k)
        frame = scene.frame(render, k / 30, W // 2, H // 2, before, reset=before is None)
        before = (render, k / 30)
        yield replace(frame, display_camera=SHOWN)


def color_of(pipeline):
    return pipeline.present().numpy("color").astype(np.float32)


def psnr(a, b):
    return -10 * np.log10(np.mean((np.clip(a[..., :3].astype(np.float64), 0, 1) - np.clip(b, 0, 1)) ** 2))


def test_jitter_is_no_motion(device):
    """A still scene under a jittered camera: motion is the jitter's difference, and nothing is dynamic."""
    pipeline = pipeline_for(device)
    for frame in frames(STILL, 4):
        pipeline.submit(frame)
        assert not pipeline.stages["history"].read("dynamic_mask").any()
        assert not pipeline.is_cut
    assert np.abs(frame.motion).max() > 0.05
    made = pipeline.extrapolate()
    assert made.camera.intrinsics == camera(W, H).intrinsics  # generated frames have no jitter
    assert not made.numpy("dynamic").any()
    assert made.numpy("disoccluded").mean() < 0.01


def test_the_whole_still_scene_of_a_renderer_is_static(device):
    """The same of a built-in scene at rest, whose motion vectors are a ray tracer's."""
    scene = load_scene("room", 0)
    still = replace(scene, eye=lambda t: scene.eye(0.0), target=lambda t: scene.target(0.0))
    renderer = SceneRenderer(device, still, 60, 40, 1, 0.5)
    made = SceneFrames(renderer, size=(120, 80), jitter=JITTER)
    pipeline = pipeline_for(device, (120, 80), (60, 40))
    before = None
    for k in range(3):
        frame = made.rendered(0.0, None, k)  # the same moment again and again
        image = renderer.render(0.0, frame.camera, 0.0, before.camera if before else None)
        frame = replace(frame, motion=image.read("motion"), time=k / 30, reset=before is None)
        pipeline.submit(frame)
        assert not pipeline.stages["history"].read("dynamic_mask").any()
        before = frame


def test_samples_gathered_over_time_beat_resampling(device):
    """A still camera, after all of the jitter: far above the bicubic picture of the last frame, and generated frames
    are as good."""
    pipeline, plain = pipeline_for(device), Pipeline(device, W, H, render_size=(W // 2, H // 2))
    truth = STILL.color(SHOWN, 0, W, H, 6)
    for frame in frames(STILL, 20):
        pipeline.submit(frame)
        plain.submit(frame)
    rendered, resampled = psnr(color_of(pipeline), truth), psnr(color_of(plain), truth)
    assert rendered > resampled + 6
    made = pipeline.extrapolate(SHOWN, 19.5 / 30)
    assert psnr(made.numpy("color"), truth) > rendered - 0.1


def test_a_still_picture_does_not_shimmer(device):
    """Variance over time falls by more than 4 times; and generated frames stand between rendered ones unnoticed."""
    pipeline, plain = pipeline_for(device), Pipeline(device, W, H, render_size=(W // 2, H // 2))
    with_it, without = [], []
    for k, frame in enumerate(frames(STILL, 28)):
        for one, seen in ((pipeline, with_it), (plain, without)):
            one.submit(frame)
            if k >= 12:
                seen.append(color_of(one))
                seen.append(one.extrapolate(SHOWN, (k + 0.5) / 30).numpy("color").astype(np.float32))
    assert np.var(without, 0).mean() > 4 * np.var(with_it, 0).mean()


@pytest.mark.parametrize("speed, most", [(9, 0.02), (1.5, 0.025)])
def test_no_ghost_stays_behind_a_mover(device, speed, most):
    """A bright board crosses a flat gray wall; three frames after it has left a pixel, nothing of it is there."""
    gray = Rect((0, 0, 12), (20, 20), frequency=0, tint=(0.2, 0.2, 0.2))
    board = Rect((-speed / 3, 0, 6), (0.6, 1.5), velocity=(speed, 0, 0), frequency=0, tint=(0.9, 0.8, 0.7))
    scene, pipeline = Rects([gray, board]), pipeline_for(device)
    wall = gray.texture(np.zeros(2))
    for k, frame in enumerate(frames(scene, 18)):
        pipeline.submit(frame)
        if k < 6:
            continue
        left = np.ones((H, W), bool)
        for back in range(4):  # where it is now, and was in the three frames before
            left &= (np.abs(scene.color(SHOWN, (k - back) / 30, W, H, 2) - wall) < 1e-3).all(-1)
        grown = ~left
        grown = np.any([np.roll(grown, s, a) for a in (0, 1) for s in (-2, -1, 1, 2)], 0) | grown
        assert np.abs(color_of(pipeline) - wall)[~grown].max() < most


@pytest.mark.parametrize("width, least", [(1, 0.75), (0.75, 0.4)])
def test_thin_bars_stay(device, width, least):
    """Bars of one rendered pixel keep three quarters of their contrast all the time; thinner ones, which have no
    sample in some frames, 40 %."""
    focal = camera(W, H).fx
    half = width * 6 * 2 / focal / 2
    bars = [Rect((0.35 * k - 1.75, 0, 6), (half, 2), frequency=0, tint=(0.9,) * 3) for k in range(11)]
    scene = Rects([Rect((0, 0, 12), (20, 20), frequency=0, tint=(0.1,) * 3), *bars])
    pipeline, truth = pipeline_for(device), scene.color(SHOWN, 0, W, H, 8)[..., 1]
    row = truth[H // 2] - truth[H // 2].mean()
    worst = 1.0
    for k, frame in enumerate(frames(scene, 40)):
        pipeline.submit(frame)
        if k >= 24:
            shown = color_of(pipeline)[H // 4 : 3 * H // 4, :, 1].mean(0)
            worst = min(worst, float(shown @ row / (row @ row)))
    assert worst > least


def test_a_change_of_exposure_does_not_show(device):
    """The history is kept in scene colors: halving the exposure leaves them as they are."""
    pipeline = pipeline_for(device)
    for k, frame in enumerate(frames(STILL, 18)):
        pipeline.exposure = 1.0 if k < 17 else 0.5
        before = color_of(pipeline) if k == 17 else None
        pipeline.submit(frame)
    assert np.abs(color_of(pipeline) - before).mean() < 0.01


def test_a_reset_forgets(device):
    other = Rects([Rect((0, 0, 12), (20, 20), frequency=0, tint=(0.1, 0.8, 0.1))])
    pipeline = pipeline_for(device)
    for frame in frames(STILL, 6):
        pipeline.submit(frame)
    frame = next(iter(frames(other, 1)))
    pipeline.submit(replace(frame, time=1.0, reset=True))
    assert np.abs(color_of(pipeline) - other.rects[0].texture(np.zeros(2))).max() < 0.01
    assert (pipeline.stages["upscaling"].read("rejected") == 255).all()


def test_jitter_without_a_display_camera(device):
    """Principal points within a pixel of the middle are jitter: what is shown stands still."""
    told, untold = pipeline_for(device), pipeline_for(device)
    for frame in frames(STILL, 6):
        told.submit(frame)
        untold.submit(replace(frame, display_camera=None))
        assert np.allclose(untold.shown_camera.intrinsics, told.shown_camera.intrinsics)
    np.testing.assert_allclose(color_of(told), color_of(untold), atol=1e-3)
    window = replace(camera(W, H), cx=10.0)
    assert without_jitter(window, (W, H)) is window


def test_points_of_the_jitter():
    """Halton's sequence, by its definition; all different, within the pixel, around its middle."""
    assert Jitter(16).offset(0) == (0.0, pytest.approx(1 / 3 - 0.5)) and Jitter(16).offset(2)[0] == 0.25
    points = np.array([JITTER.offset(k) for k in range(16)])
    assert len(np.unique(points, axis=0)) == 16 and np.abs(points).max() < 0.5 and np.abs(points.mean(0)).max() < 0.05
    assert JITTER.offset(17) == JITTER.offset(1) and Jitter().offset(5) == (0.0, 0.0)
    shown = camera(8, 6)
    assert JITTER.camera(shown, 2).cx == shown.cx - 0.25


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A small jittered sequence with truth of the display's size."""
    from typer.testing import CliRunner

    from gffe_cl.cli.commands import app

    folder = tmp_path_factory.mktemp("upscaling") / "small"
    arguments = ["render", "corridor", folder, "--size", "91x61", "--frames", "4"]
    arguments += ["--jitter", "halton:16", "--scale", "1.5", "--ground-truth"]
    made = CliRunner().invoke(app, [str(a) for a in arguments])
    assert made.exit_code == 0, made.output
    return folder


def test_rendered_sequences_tell_sizes_and_jitter(recorded):
    sequence = open_sequence(recorded)
    assert (sequence.width, sequence.height) == (91, 61)
    for k, entry in enumerate(sequence.rendered):
        assert sequence.size_of(entry) == (61, 41)
        small = entry.display_camera.scaled(61 / 91, 41 / 61)
        x, y = JITTER.offset(k)
        assert (entry.render_camera.cx - small.cx, entry.render_camera.cy - small.cy) == pytest.approx(
            (-x, -y), abs=0.01
        )
    assert sequence.read_color(sequence.ground_truth[0]).shape == (61, 91, 3)
    assert not sequence.warnings()


def test_run_writes_a_sequence_of_the_display(gffe, recorded, tmp_path):
    """Rendered frames too are as shown; the result can be compared, and is better than without."""
    out = {}
    for name, options in (("with", ("--upscale", "1.5")), ("without", ())):
        code, _, err = gffe("run", recorded, tmp_path / name, "--no-scn", *options)
        assert code == 0, err
        code, _, err = gffe("compare", tmp_path / name, recorded, "--json", tmp_path / f"{name}.json")
        assert code == 0, err
        out[name] = json.loads((tmp_path / f"{name}.json").read_text())["mean"]["psnr"]
    sequence = open_sequence(tmp_path / "with")
    frame = sequence.read(sequence.rendered[2])
    assert frame.color.shape == (61, 91, 3) and frame.motion.shape == (61, 91, 2) and not sequence.warnings()
    assert all(entry.display_camera == entry.render_camera for entry in sequence.rendered)
    assert out["with"] > out["without"] + 0.3


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("--upscale", "2"), "frames of 61×41 for a display of 91×61 (expected --upscale 1.49, got 2)"),
        (("--upscale", "1.5", "--window", "off"), "--upscale 1.5 and --window off exclude each other"),
        (("--upscale", "0.5"), "--upscale must be a number, 0 or 1 to 3, got '0.5'"),
        (("--upscale", "9"), "--upscale must be"),
    ],
)
def test_what_does_not_fit_is_told(gffe, recorded, tmp_path, arguments, said):
    code, _, err = gffe("run", recorded, tmp_path / "out", *arguments)
    assert code == 2 and said in err and "Traceback" not in err and not (tmp_path / "out").exists()


def test_a_scene_rendered_meanwhile(gffe, tmp_path):
    code, _, err = gffe(
        "run", "plaza", tmp_path / "out", "--upscale", "2", "--size", "65x41", "--frames", "2", "--no-scn"
    )
    assert code == 0, err
    made = open_sequence(tmp_path / "out")
    assert made.read_color(made.extrapolated[0]).shape == (41, 65, 3)


def test_pipelines_refuse_nothing_of_odd_sizes(device):
    """One pixel, and a display that is no multiple."""
    for size, small in (((1, 1), (1, 1)), ((7, 5), (5, 3)), ((3, 2), (1, 1))):
        pipeline = pipeline_for(device, size, render_size=small)
        shown = camera(*size)
        render = shown.scaled(small[0] / size[0], small[1] / size[1])
        arrays = (np.full((*small[::-1], 3), 0.25, np.float16), np.full(small[::-1], 5, np.float32))
        motion = np.zeros((*small[::-1], 2), np.float32)
        for k in range(2):
            pipeline.submit(RenderedFrame(*arrays, motion, render, k / 30, shown, reset=k == 0))
        np.testing.assert_allclose(pipeline.extrapolate().numpy("color"), 0.25, rtol=2e-3)
        np.testing.assert_allclose(pipeline.present().numpy("color"), 0.25, rtol=2e-3)
