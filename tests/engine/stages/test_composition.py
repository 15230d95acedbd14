"""What lies over the picture stays where it is, or goes its own way; it leaves no trace in what is warped."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from synthetic import Rect, Rects, camera, psnr

from gffe_cl import GffeError, Options, Overlays, Pipeline
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels, open_sequence
from gffe_cl.engine.stages.buffers import BY_FIXED

W, H = 96, 64
GAE = Options(shading_correction=False)
SCENE = Rects([Rect((0, 0, 14), frequency=0.12), Rect((-1.5, 0.3, 6), (1, 1), frequency=0.5, tint=(0.6, 0.3, 0.1))])
HELD = np.zeros((H, W), bool)
HELD[34:, 50:80] = True


def panning(k):
    return camera(W, H, (0.12 * k, 0, 0.02 * k), yaw=0.01 * k)


def armed(frame):
    """With something held before the camera, textured so that its place shows; its motion vectors are those of a static
    surface, as from engines that know only the camera's motion."""
    color, depth, motion = (np.array(array) for array in (frame.color, frame.depth, frame.motion))
    y, x = np.nonzero(HELD)
    color[HELD] = np.stack([0.1 + 0.008 * (x - 50), 0.9 - 0.01 * (y - 34), 0 * x + 0.2], -1)
    k = round(frame.time * 30)
    px = np.stack([x, y], -1) + 0.5
    depth[HELD] = 0.5
    motion[HELD] = panning(k - 1).project(frame.camera.unproject(px, np.full(len(px), 0.5)))[0] - px
    return replace(frame, color=color, depth=depth, motion=motion)


def played(device, options=GAE, change=lambda frame: frame, frames=4, overlays=lambda k: None):
    """The pipeline after some frames."""
    pipeline = Pipeline(device, W, H, options, fps=30)
    for k in range(frames):
        before = (panning(k - 1), (k - 1) / 30) if k else (panning(0), 0.0)
        frame = SCENE.frame(panning(k), k / 30, W, H, before, reset=k == 0)
        pipeline.submit(replace(change(frame), overlays=overlays(k)))
    return pipeline


@pytest.mark.parametrize("windowed", [False, True])
def test_what_is_held_stays_and_leaves_no_trace(device, windowed):
    """Its pixels keep their bits; beside it is the world that a frame without it would show."""

    def shown(frame):
        wide = replace(frame.camera, fx=frame.camera.fx * 0.95) if windowed else frame.camera
        return replace(armed(frame), camera=wide, display_camera=wide)

    time = 3.5 / 30
    truth = SCENE.color(panning(3.5), time, W, H)
    errors = {}
    for mask in (HELD, None):
        pipeline = played(device, change=armed, overlays=lambda k, mask=mask: Overlays(fixed_mask=mask))
        out = pipeline.extrapolate(panning(3.5), time)
        errors[mask is not None] = psnr(out.numpy("color"), truth, ~HELD)
        if mask is not None:
            source = pipeline.present().numpy("color")
            assert np.array_equal(out.numpy("color")[HELD], source[HELD])
            assert (out.numpy("filled_by")[HELD] == BY_FIXED).all() and (out.numpy("depth")[HELD] == 0.5).all()
            assert not out.numpy("motion")[HELD].any() and not out.numpy("disoccluded")[HELD].any()
            assert (out.numpy("filled_by")[~HELD] != BY_FIXED).all()
            assert pipeline.present().numpy("depth")[HELD].max() == 0.5  # the frame's own depth is not touched
            assert not pipeline.bad_pixels
            assert pipeline.frames.current.depth is not pipeline.frames.previous.depth
    assert errors[True] > errors[False] + 3, errors


def test_effects_go_on_along_their_motion_and_stay_without(device):
    y, x = np.mgrid[:H, :W]

    def smoke(k, moving):
        layer = np.zeros((H, W, 4), np.float16)
        layer[np.hypot(x - 20 - 6 * k, y - 30) < 5] = (2, 2, 2, 1)
        motion = np.broadcast_to(np.float32((-6, 0)), (H, W, 2))
        return Overlays(effects=layer, effects_motion=motion if moving else None)

    for moving, expected in ((True, 20 + 18 + 3), (False, 20 + 18)):
        pipeline = played(device, overlays=lambda k, moving=moving: smoke(k, moving))
        made = pipeline.extrapolate(panning(3.5), 3.5 / 30).numpy("color")[..., 0] > 1.9
        assert abs(x[made].mean() - expected) < 0.3 and abs(y[made].mean() - 30) < 0.3
        assert abs(made.sum() - 69) < 8
        shown = pipeline.present().numpy("color")[..., 0] > 1.9
        assert abs(x[shown].mean() - 38) < 0.1


def test_user_interface_is_composed_over_rendered_and_new_frames(device):
    ui = np.zeros((H, W, 4), np.float16)
    ui[5:15, 10:60] = (0.25, 0.5, 0, 0.5)
    bare, dressed = played(device), played(device, overlays=lambda k: Overlays(ui=ui))
    for make in (lambda p: p.extrapolate(panning(3.5), 3.5 / 30), lambda p: p.present()):
        under, over = make(bare).numpy("color").astype(float), make(dressed).numpy("color")
        expected = ui[..., :3].astype(float) + (1 - ui[..., 3:].astype(float)) * under
        np.testing.assert_allclose(over, expected, rtol=1e-3)
    assert np.array_equal(dressed.extrapolate().numpy("gae"), bare.extrapolate().numpy("gae"))
    assert "composition.ui" in {f"{owner.name}.{spec.name}" for owner, spec in dressed.named_buffers()}
    ignored = played(device, replace(GAE, overlays=False), overlays=lambda k: Overlays(ui=ui))
    assert np.array_equal(ignored.extrapolate().numpy("color"), bare.extrapolate().numpy("color"))


def test_overlays_end_with_the_frame_that_brings_none(device):
    bare = played(device, frames=5)
    once = played(device, frames=5, overlays=lambda k: Overlays(ui=np.ones((H, W, 4))) if k == 3 else None)
    assert np.array_equal(once.extrapolate().numpy("color"), bare.extrapolate().numpy("color"))


def test_device_buffers_are_used_in_place(device):
    ui = np.full((H, W, 4), 0.5, np.float16)
    buffer = device.buffer(ui.nbytes)
    cl.enqueue_copy(device.queue, buffer, ui)
    made = [played(device, overlays=lambda k, u=u: Overlays(ui=u)).extrapolate().numpy("color") for u in (ui, buffer)]
    assert np.array_equal(*made)


def test_wrong_overlays_are_refused_in_one_line(device):
    pipeline = played(device)
    before = pipeline.extrapolate().numpy("color")
    frame = SCENE.frame(panning(4), 4 / 30, W, H, (panning(3), 3 / 30))
    for overlays, message in (
        (Overlays(fixed_mask=np.ones((H, W + 1))), r"fixed_mask must have shape \(64, 96\), got \(64, 97\)"),
        (Overlays(ui=np.ones((H, W, 3))), r"ui must have shape \(64, 96, 4\), got \(64, 96, 3\)"),
        (Overlays(effects_motion=np.ones((H, W, 2))), "effects_motion without effects"),
        (Overlays(ui=device.buffer(100)), r"ui buffer must hold 49152 bytes \(96×64\), got 100"),
    ):
        with pytest.raises(GffeError, match=message):
            pipeline.submit(replace(frame, overlays=overlays))
        assert np.array_equal(pipeline.extrapolate().numpy("color"), before)
    pipeline.submit(replace(frame, overlays=Overlays(ui=np.zeros((H, W, 4)))))


def test_channels_of_a_sequence_are_overlays(device, gffe, tmp_path):
    """Written, read back, and composed by a run; half of a layer is a fault."""
    rng = np.random.default_rng(0)
    layer = rng.uniform(0, 1, (H, W, 4)).astype(np.float16)
    overlays = Overlays(HELD, layer, rng.normal(0, 3, (H, W, 2)).astype(np.float32), layer[::-1])
    frame = SCENE.frame(panning(0), 0.0, W, H, reset=True)
    entry = FrameEntry("frame_0.exr", 0.0, reset=True, render_camera=panning(0))
    with SequenceWriter(tmp_path / "in", W, H, 30.0) as writer:
        writer.add(entry, named_channels(frame.color, frame.depth, frame.motion, overlays))
    sequence = open_sequence(tmp_path / "in")
    read = sequence.read(sequence.rendered[0])
    for name in ("fixed_mask", "effects", "effects_motion", "ui"):
        assert np.array_equal(getattr(read.overlays, name), getattr(overlays, name)), name

    assert gffe("run", tmp_path / "in", tmp_path / "out", "--no-scn", "--device", device.info.index)[0] == 0
    made = open_sequence(tmp_path / "out")
    labels = made.read_channels(made.extrapolated[0], ["mask.filled_by"])["mask.filled_by"]
    assert (labels[HELD] == BY_FIXED).all() and not (labels[~HELD] == BY_FIXED).any()

    channels = named_channels(frame.color, frame.depth, frame.motion, overlays)
    del channels["ui.A"]
    with SequenceWriter(tmp_path / "half", W, H, 30.0) as writer:
        writer.add(entry, channels)
    with pytest.raises(GffeError, match=r"no channel 'ui.A' \(expected all of ui.R, ui.G, ui.B, ui.A, or none\)"):
        open_sequence(tmp_path / "half")
