"""The viewer's engine: what it shows is what a pipeline gives, however one gets there; nothing stops it."""

import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from scn_models import constant_model, movers_model
from viewer_clips import (
    ALL,
    FPS,
    MOVER,
    SCENE,
    Clip,
    FadingClip,
    H,
    SceneClip,
    W,
    ask,
    assert_same,
    frames,
    inspect,
    plain_run,
    pose,
    running,
    slots,
    want,
)
from viewer_session import wait_for

from gffe_cl import (
    FrameEntry,
    FrameFormat,
    Options,
    SequenceWriter,
    fixed_window,
    named_channels,
    open_sequence,
)
from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.captures.offline.source import Live, Recorded
from gffe_cl.captures.scenes import SceneFrames, SceneRenderer, load_scene
from gffe_cl.engine.frame.window import WindowChooser
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import kernel_folder
from gffe_cl.lab.metrics import focus_mask
from gffe_cl.viewer.engine.engine import open_viewer_device
from gffe_cl.viewer.engine.messages import Failure, Frame, Interrupted, Setup
from gffe_cl.viewer.engine.sources.live import SceneSource
from gffe_cl.viewer.engine.sources.recorded import RecordedSource
from gffe_cl.viewer.engine.sources.stored import StoredSlots


@pytest.fixture
def engine(device):
    """An engine on the clip."""
    with running(device, Clip()) as made:
        yield made


@pytest.mark.parametrize("with_cameras", [True, False])
def test_every_slot_jumped_to_equals_the_run(device, tmp_path, with_cameras):
    """All layers of 12 frames, in random order, are those that `gffe run` writes; cameras are given or predicted."""
    sequence = write(tmp_path / "s", count=12, truth=with_cameras)
    given = Recorded(sequence, device)
    run_sequence(given, tmp_path / "out", device, Options(), [0.5], dump_stages=True, compression="none")
    stored = StoredSlots(str(tmp_path / "out"), "")
    with running(device, lambda d: RecordedSource(sequence, d)) as engine:
        layers = ask(engine, 1, Setup()).specs.keys()
        for slot in np.random.default_rng(0).permutation(24).tolist():
            shown = ask(engine, slot, Setup(), layers)
            written = stored.make(shown.key, frozenset(layers), engine.source, shown.specs).images
            assert len(written) > (20 if slot % 2 else 0)
            for name in written.keys() & shown.images.keys() - {"truth"}:
                assert np.array_equal(shown.images[name], written[name], equal_nan=name != "final"), (slot, name)


def test_a_distant_jump_shows_a_provisional_slot_first(device):
    """It is made of the last few frames, and given in place of no other want than the one for the eye."""
    engine_frames = [replace(frames()[k % 2], time=k / FPS, reset=k == 0) for k in range(60)]
    source = Clip()
    source.count, source.rendered = len(engine_frames), lambda k: source.asked.append(k) or engine_frames[k]
    with running(device, source) as engine:
        exact = want(engine, 101, Setup(), ("final",), preview=True)
        engine.store.want([exact])
        preview = wait_for(lambda: engine.store.get(exact.provisional))
        assert preview.key.provisional and preview.moment.k == 50
        result = wait_for(lambda: engine.store.get(exact))
        assert not result.key.provisional and source.asked == [*range(42, 51), *range(51)]
        source.asked.clear()
        ask(engine, 110, Setup(), ("final",))
        assert source.asked == list(range(51, 56))  # goes on


def test_a_distant_jump_shows_its_progress_and_can_be_stopped(device):
    """Between two rendered frames; later it goes on from there."""
    source, progress = Clip(), []
    source.count = 60

    def rendered(k):
        source.asked.append(k)
        if not progress and k == 30:
            progress.append(engine.progress)
            engine.store.want([])
        return replace(frames()[k % 2], time=k / FPS, reset=k == 0)

    source.rendered = rendered
    with running(device, source) as engine:
        engine.store.want([want(engine, 101, Setup(), ("final",))])
        wait_for(lambda: progress)
        ask(engine, 101, Setup(), ("final",))
        assert progress == [(30, 51)] and source.asked == list(range(51))


def test_nothing_before_a_reset_is_used(device):
    setup = Setup(n=1)
    with running(device, source := Clip(reset=4)) as engine:
        for k in range(6):
            result = ask(engine, 2 * k, setup)
            assert (result.moment.previous_camera is None) == (k in (0, 4))
        played = ask(engine, 11, setup, ("final",)).images["final"]
        ask(engine, 0, setup)
        source.asked.clear()
        assert (ask(engine, 11, setup, ("final",)).images["final"] == played).all()
        assert source.asked == [4, 5]


def test_rendered_slots_and_the_frames_own_layers(engine):
    setup = Setup(n=1)
    names = ("final", "truth", "rendered.color", "rendered.depth", "rendered.motion", "no.such")
    result = ask(engine, 8, setup, names)
    frame = frames()[4]
    assert set(result.images) == set(names[:5]) and result.moment.alpha == 0
    assert result.images["final"].shape == (H, W, 4) and result.images["final"].dtype == np.float16
    for name in ("final", "truth", "rendered.color"):
        assert (result.images[name][..., :3] == frame.color).all()
    assert (result.images["rendered.depth"] == frame.depth).all()
    assert (result.images["rendered.motion"] == frame.motion).all()
    generated = {spec.name for spec in result.specs.values() if spec.of_generated}
    stepped_here = [ask(engine, slot, setup, "all").images.keys() for slot in (7, 8)]
    assert generated - {"focus_truth"} <= stepped_here[0], "all of them at a generated slot"
    assert not generated & stepped_here[1], "and at a rendered one not those that are left of the one before"
    assert not generated & inspect(engine, 3, 4, 8, setup).values.keys()
    result = ask(engine, 9, setup, ("truth",))
    np.testing.assert_array_equal(result.images["truth"][..., :3], Clip().truth(4, 0.5).astype(np.float16))
    again = ask(engine, 9, setup, ("truth", "final"))
    assert not np.shares_memory(again.images["truth"], result.images["truth"])


class SpoiltClip(Clip):
    """The same with NaN in one color, and without a depth, from frame 4 on."""

    def rendered(self, k):
        frame = super().rendered(k)
        if k >= 4:
            color, depth = frame.color.copy(), frame.depth.copy()
            color[10, 20], depth[12, 30] = np.nan, -1.0
            frame = replace(frame, color=color, depth=depth)
        return frame


def test_invalid_pixels_of_the_input_are_a_layer_and_named_in_stories(device):
    setup = Setup(n=1)
    with running(device, SpoiltClip()) as engine:
        assert not ask(engine, 7, setup, ("rendered.invalid",)).images["rendered.invalid"].any(), "valid up to frame 4"
        result = ask(engine, 9, setup, ("rendered.invalid", "frame.motion"))
        assert np.argwhere(result.images["rendered.invalid"]).tolist() == [[10, 20], [12, 30]]
        assert result.images["rendered.invalid"][[10, 12], [20, 30]].tolist() == [1, 2]
        seen = inspect(engine, 20, 10, 8, setup)
        assert "color is NaN" in seen.fault and seen.fault in seen.story.sentences[0]
        y, x = np.mgrid[:H, :W]
        lead = np.floor(result.images["frame.motion"] + np.stack([x + 0.5, y + 0.5], -1))
        y, x = np.argwhere((lead == (20, 10)).all(-1))[0]
        assert "color is NaN" in inspect(engine, x, y, 9, setup).story.sentences[0]
        assert inspect(engine, 2, 2, 9, setup).fault == ""


def test_buffers_as_an_engine_has_them(device, tmp_path):
    """They are named, depth and motion are shown at their own size, and so is the jitter that was taken out of motion;
    all else is as of the frames in our conventions."""
    format, half = FrameFormat(motion_jittered=True), (W // 2, H // 2)
    with SequenceWriter(tmp_path / "given", W, H, FPS, format=format) as writer:
        for k, frame in enumerate(frames()[:4]):
            entry = FrameEntry(
                f"{k}.exr",
                frame.time,
                reset=k == 0,
                render_camera=frame.camera,
                geometry_size=half,
                geometry_jitter=(0.25 if k % 2 else -0.25, 0.0),
            )
            motion = None if k == 0 else frame.motion[::2, ::2] / 2
            writer.add(entry, named_channels(frame.color, frame.depth[::2, ::2], motion))
    sequence = open_sequence(tmp_path / "given")
    with running(device, RecordedSource(sequence, device)) as engine:
        result = ask(engine, 6, Setup(n=1), "all")
        generated = ask(engine, 7, Setup(n=1), ("final", "upload.small_motion"))
    assert result.buffers == (
        f"depth and motion {half[0]}×{half[1]}, color {W}×{H}",
        "geometry_jitter (+0.25, +0.00) px",
        "motion_jittered",
    )
    converted = sequence.read(sequence.rendered[3])
    assert result.images["rendered.depth"].tobytes() == converted.depth.tobytes()
    assert result.images["rendered.motion"].tobytes() == converted.motion.tobytes()
    assert result.images["upload.small_depth"].tobytes() == frames()[3].depth[::2, ::2].tobytes()
    np.testing.assert_allclose(
        result.images["rendered.undone"][8:-8, 8:-8], np.full((H - 16, W - 16, 2), (1.0, 0)), atol=1e-3
    )
    assert generated.images["upload.small_motion"].shape == (H // 2, W // 2, 2)
    with running(device, Clip()) as engine:
        assert not {"upload.small_depth", "rendered.undone"} & ask(engine, 6, Setup(n=1)).specs.keys()


@pytest.mark.parametrize("exposure", [1.0, 0.2])
def test_shading_correction_as_in_a_plain_run(device, tmp_path, exposure):
    setup, wanted = Setup(replace(ALL, scn_model=movers_model(tmp_path / "m.onnx"))), [(2, 1), (3, 1)]
    expected = plain_run(device, frames(), setup, wanted, exposure=exposure)
    source = Clip()
    source.exposure = exposure
    with running(device, source) as engine:
        for at in wanted:
            assert_same(ask(engine, *slots(setup, at), setup, expected[at]).images, expected[at])


def test_the_true_focus_mask(device, monkeypatch):
    source = Clip()
    source.exposure, shade = 0.5, np.where(np.arange(W) < W // 2, 0.2, 1.0)[:, None]
    monkeypatch.setattr(source, "truth", lambda k, alpha: Clip.truth(source, k, alpha) * np.float32(shade))
    with running(device, source) as engine:
        for slot in (13, 9):
            images = ask(engine, slot, Setup(), "all").images
            color, truth = (images[name][..., :3] for name in ("final", "truth"))
            expected = focus_mask(color, truth, images["frame.dynamic"] > 0, 0.5)
            assert images["focus_truth"].dtype == np.uint8 and (images["focus_truth"] == expected).all()
        assert 0.1 < expected.mean() < 0.6
        y, x = np.argwhere(expected)[0]
        assert inspect(engine, x, y, 9, Setup()).values["focus_truth"].tolist() == [1]
        assert "focus_truth" not in ask(engine, 12, Setup(), "all").images


def test_a_network_that_fails_is_an_error_and_the_engine_goes_on(engine, tmp_path):
    (tmp_path / "junk.onnx").write_bytes(b"junk")
    error = ask(engine, 13, Setup(Options(scn_model=str(tmp_path / "junk.onnx"))))
    assert isinstance(error, Failure) and error.during == "network" and "junk.onnx" in error.error
    assert "\n" not in error.error
    assert isinstance(ask(engine, 13, Setup()), Frame)
    error = ask(engine, 13, Setup(Options(shading_correction=True)))
    assert error.during == "network" and "no trained weights" in error.error


# ---- requests and answers ----------------------------------------------------------------------------------


@pytest.mark.parametrize("slot", [5, 3])  # of a frame to come, and of the one that was submitted last
def test_the_most_urgent_want_is_made_first_whatever_was_asked_before(device, slot):
    with running(device, source := Clip()) as engine:
        store, later = engine.store, [want(engine, slot, Setup()) for slot in (8, 12)]
        ask(engine, 0, Setup())
        source.gate.clear()
        store.want(later)
        wait_for(lambda: 1 in source.asked)
        urgent = want(engine, slot, Setup())
        store.want([urgent, *later])
        source.gate.set()
        made = wait_for(lambda: store.get(urgent))
        assert made.slot == slot and source.asked[:2] == [0, 1], "slot 8 was given up at once"
        wait_for(lambda: all(store.get(one) for one in later))
        assert store.next() is None and store.get(urgent) is made, "nothing is made twice"
        ask(engine, 0, Setup())
        assert ask(engine, slot, Setup()).moment == made.moment
        source.asked.clear()
        source.gate.clear()
        gone = want(engine, 16, Setup())
        store.want([gone])
        wait_for(lambda: source.asked)
        store.want([])
        source.gate.set()
        assert isinstance(ask(engine, 2, Setup()), Frame) and store.get(gone) is None, "it is given up"


def test_a_maker_that_was_interrupted_holds_nothing(engine):
    def interrupt():
        raise Interrupted

    ask(engine, 2, Setup())
    maker, key = engine._makers[0], want(engine, 8, Setup()).key
    maker.check = interrupt
    with pytest.raises(Interrupted):
        maker.make(key, frozenset())
    assert maker.key == key and not maker.holds(key)


def test_a_slot_on_screen_is_left_alone_by_what_is_wanted_later(device):
    """Others are made with another pipeline, so that its pixels can be asked for."""
    with running(device, source := Clip()) as engine:
        shown, pixel = want(engine, 3, Setup(), ("final",)), want(engine, 3, Setup(), pixel=(3, 4))
        ahead = [want(engine, slot, Setup(), ("final",)) for slot in range(4, 9)]
        engine.store.want([shown, *ahead])
        wait_for(lambda: all(engine.store.get(one) for one in ahead))
        asked = list(source.asked)
        engine.store.want([shown, pixel])
        assert wait_for(lambda: engine.store.get(pixel)).slot == 3 and source.asked == asked


SOURCE_GRIDS = ("source", "source_blocks", "cells", "level0", "level1", "level2")


def texels_under(x, y, sx, sy):
    """The texel of each grid under display pixel (x, y), and under pixel (sx, sy) of the rendered image."""
    places = {"target": (x, y), "source": (sx, sy), "downsampled": (x // 32, y // 32)}
    places |= {f"network{level or ''}": (x // (2 << level), y // (2 << level)) for level in range(5)}
    places |= {f"level{level}": (sx >> level, sy >> level) for level in range(3)}
    return places | {
        "target_blocks": (x // 8, y // 4),
        "source_blocks": (sx // 8, sy // 4),
        "cells": (sx // 8, sy // 8),
    }


def test_inspection_equals_the_whole_buffers(engine, tmp_path):
    setup = Setup(replace(ALL, history=3, scn_model=constant_model(tmp_path / "m.onnx")), n=1)
    specs = ask(engine, 13, setup).specs
    images = ask(engine, 13, setup, specs).images
    rng = np.random.default_rng(0)
    holes, moving = (np.argwhere(images[name] > 0) for name in ("frame.filled_by", "frame.dynamic"))
    for y, x in [(0, 0), (H - 1, W - 1), *holes[:3], *moving[::40], *rng.integers((H, W), size=(6, 2))]:
        x, y = int(x), int(y)
        seen = inspect(engine, x, y, 13, setup)
        source = images["frame.motion"][y, x] + (x + 0.5, y + 0.5)
        assert seen.pixel == (x, y) and seen.slot == 13 and seen.source == pytest.approx(source, abs=1e-4)
        sx, sy = np.floor(seen.source).astype(int)
        here, origin = texels_under(x, y, x, y), texels_under(x, y, sx, sy)
        inside = 0 <= sx < W and 0 <= sy < H
        for name, image in images.items():
            on_source = specs[name].grid in SOURCE_GRIDS
            assert (name in seen.origin) == (on_source and inside), name
            for values, places in ((seen.values, here), (seen.origin, origin)):
                if name in values:
                    px, py = places[specs[name].grid]
                    expected = image[:, py, px] if specs[name].planes > 1 else image[py, px]
                    np.testing.assert_array_equal(values[name], np.reshape(expected, values[name].shape), name)
            assert name in seen.values
    ask(engine, 13, setup, ("truth",))
    seen = inspect(engine, 3, 4, 13, setup)
    np.testing.assert_array_equal(seen.values["truth"], images["truth"][4, 3])
    seen = inspect(engine, 5, 6, 12, setup)
    assert seen.source == (5.5, 6.5) and seen.slot == 12 and not seen.origin
    np.testing.assert_array_equal(seen.values["rendered.color"][:3], frames()[6].color[6, 5])


def test_what_cannot_be_opened_is_an_error(device):
    def fails(_):
        raise ValueError("out of luck")

    with running(lambda: fails(None)) as engine:
        assert wait_for(engine.poll) == Failure("ValueError: out of luck", "device")
        engine.open_source(lambda _: Clip())
        assert wait_for(engine.poll) == Failure("ValueError: out of luck", "source")
    with running(device) as engine:
        engine.open_source(lambda _: Clip())
        first = wait_for(lambda: engine.source)
        engine.open_source(fails)
        assert wait_for(engine.poll) == Failure("ValueError: out of luck", "source")
        assert engine.source is first and isinstance(ask(engine, 3, Setup()), Frame)
        assert engine.device_name == device.info.name


def test_close_while_work_runs(device):
    source = Clip(delay=0.2)
    with running(device, source) as engine:
        engine.store.want([want(engine, 27, Setup())])
        wait_for(lambda: len(source.asked) > 1)
        start = time.monotonic()
        engine.close()
        assert time.monotonic() - start < 2 and not engine._thread.is_alive()
        assert len(source.asked) < 8


# ---- kernels ----------------------------------------------------------------------------------------------


def test_kernels_are_reloaded_and_broken_ones_survived(device, tmp_path, monkeypatch):
    """A broken kernel: the last good ones go on, whatever is switched; repaired, the new text is in use."""
    folder = tmp_path / "kernels"
    shutil.copytree(kernel_folder(), folder)
    monkeypatch.setenv("GFFE_KERNELS", str(folder))
    setup, text = Setup(), (folder / "holes.cl").read_text()
    other = Setup(Options(hole_filling="downsample"))
    line = text.count("\n") + 1
    with running(lambda: Device(device.cl_device, device.info, profiling=True), Clip()) as engine:
        good, builds = ask(engine, 13, setup, ("final",)).images["final"], engine.builds
        (folder / "holes.cl").write_text(text + "__kernel void broken() { nonsense; }\n")
        wait_for(lambda: engine.build_error)
        assert f"holes.cl:{line}" in engine.build_error and "nonsense" in engine.build_error
        assert isinstance(ask(engine, 14, setup), Frame) and isinstance(ask(engine, 13, other), Frame)
        assert (ask(engine, 13, setup, ("final",)).images["final"] == good).all()
        assert engine.builds == builds
        (folder / "holes.cl").write_text(text.replace("store_color(mean.xyz,", "store_color(9.0f + mean.xyz,"))
        wait_for(lambda: engine.builds == builds + 1)
        result = ask(engine, 13, setup, ("final",))
        assert engine.build_error is None
        changed = result.images["final"] != good
        assert changed.any() and not changed.all()
        (folder / "holes.cl").write_text(text)
        engine.reload_kernels()
        wait_for(lambda: not engine.busy)
        assert (ask(engine, 13, setup, ("final",)).images["final"] == good).all()
    warp = (folder / "warp.cl").read_text()
    (folder / "warp.cl").write_text("nonsense\n")  # from the start
    with running(lambda: Device(device.cl_device, device.info, profiling=True), Clip()) as engine:
        assert "warp.cl" in ask(engine, 13, setup, ("final",)).error and "warp.cl" in engine.build_error
        (folder / "warp.cl").write_text(warp)
        wait_for(lambda: engine.builds)
        assert (ask(engine, 13, setup, ("final",)).images["final"] == good).all() and engine.build_error is None


# ---- sources ----------------------------------------------------------------------------------------------


def write(folder, window=None, render_size=None, count=6, truth=True):
    """The clip as a sequence on disk with truth at α = 0.5; `window(k)` is what frame k is rendered through."""
    with SequenceWriter(folder, W, H, FPS) as writer:
        before = None
        for k in range(count):
            shown = pose(k)
            through = window(k).camera(shown, (W, H), render_size) if window else shown
            frame = SCENE.frame(through, k / FPS, *(render_size or (W, H)), before, reset=k == 0)
            before = (through, k / FPS)
            entry = FrameEntry(
                f"frame_{k}.exr", k / FPS, "rendered", k == 0, render_size, through, display_camera=shown
            )
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion))
            if not truth:
                continue
            between = (k + 0.5) / FPS
            color = SCENE.color(pose(k + 0.5), between, W, H).astype(np.float16)
            writer.add(
                FrameEntry(f"truth_{k}.exr", between, "ground_truth", display_camera=pose(k + 0.5)),
                named_channels(color),
            )
    return open_sequence(folder)


def breathing(k):
    return fixed_window(1.15 + 0.05 * (k % 3))


@pytest.mark.parametrize("render_size", [None, (112, 72)])
@pytest.mark.parametrize("window", [None, "off"])
def test_a_recorded_sequence_is_shown_as_a_run_extrapolates_it(device, tmp_path, window, render_size):
    sequence = write(tmp_path / "s", render_size and breathing, render_size)
    setup, wanted = Setup(window=window), [(k, j) for k in range(6) for j in range(2)]
    plain = Recorded(sequence, device, window)
    given = [frame for _, frame in plain.frames([0.5], False)]

    def camera_at(at):
        return plain.cameras_at([at / FPS])[0]

    expected = plain_run(device, given, setup, wanted, camera_at, render_size=plain.render_size)
    with running(device, lambda d: RecordedSource(sequence, d, cache_bytes=1)) as engine:
        assert engine.source.windowed == bool(render_size)
        for at in (*wanted, (2, 1), (5, 1)):
            result = ask(engine, *slots(setup, at), setup, expected[at] if at[1] else ("final",))
            assert_same(result.images, expected[at], None if at[1] else ["final"])
        error = ask(engine, 3, replace(setup, window="adaptive"))
        assert "adaptive" in error.error and isinstance(ask(engine, 3, setup), Frame)


def test_a_damaged_file_is_reported_when_its_turn_comes_and_the_engine_goes_on(device, tmp_path):
    sequence = write(tmp_path / "s")
    with running(device, lambda d: RecordedSource(sequence, d)) as engine:
        path = tmp_path / "s" / "frame_2.exr"
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2])
        assert isinstance(ask(engine, 3, Setup()), Frame)
        error = ask(engine, 5, Setup())
        assert isinstance(error, Failure) and "frame_2.exr" in error.error
        assert inspect(engine, 1, 1, 5, Setup()) == Failure(error.error, "inspection")
        result = ask(engine, 7, Setup(), ("final",))
        assert result.moment.k == 3 and "frame 2 is left out: " in result.warnings[-1]
        assert result.moment.previous_camera is None  # as after a reset
        (tmp_path / "s" / "truth_4.exr").write_bytes(b"nothing")
        result = ask(engine, 9, Setup(), ("final", "truth"))
        assert "final" in result.images and "truth" not in result.images and "truth_4.exr" in result.warnings[-1]
        path.write_bytes(whole)
        assert isinstance(ask(engine, 5, Setup()), Frame) and not ask(engine, 7, Setup()).warnings
        for slot, setup, message in ((999, Setup(), "to 11"), (-1, Setup(), "slot -1"), (0, Setup(n=9), "-n")):
            error = ask(engine, slot, setup)
            assert isinstance(error, Failure) and message in error.error
        assert isinstance(ask(engine, 11, Setup()), Frame)


SMALL = (64, 40)


def scene_source(device, **given):
    return SceneSource(load_scene("plaza"), device, *SMALL, samples=1, **given)


@pytest.mark.parametrize("kept", [0, 1 << 30])
def test_a_scene_is_rendered_as_a_run_renders_it(device, kept):
    """Through an adaptive window: the same frames and the same extrapolation, at first and when frames are kept."""
    setup, wanted = Setup(window="adaptive"), [(4, 0), (4, 1)]
    scene = load_scene("plaza")

    class FromSomeRows(WindowChooser):  # all that the viewer reads back
        def observe(self, depth):
            super().observe(depth[::16])

    windows = FromSomeRows("adaptive", SMALL, [0.5])
    given = list(SceneFrames(SceneRenderer(device, scene, *SMALL, samples=1), windows).sequence(5, 30.0))
    assert given[4].camera != given[4].display_camera
    expected = plain_run(device, given, setup, wanted, lambda at: scene.camera(at / 30, *SMALL), size=SMALL)
    with running(device, lambda d: scene_source(d, cache_bytes=kept)) as engine:
        ask(engine, 22, setup)  # frame 3 begins a warm-up
        for _ in range(2):
            ask(engine, 0, setup)
            for at, slot in zip(wanted, (8, 9), strict=True):
                result = ask(engine, slot, setup, ("final", "rendered.color", "rendered.depth", "rendered.motion"))
                assert_same(result.images, expected[at], ["final"])
                shown = result.moment
                assert (shown.render_camera, shown.display_camera) == (given[4].camera, given[4].display_camera)
                assert shown.previous_camera == given[3].camera and shown.time == shown.alpha / 30 + given[4].time
                assert (result.images["rendered.color"][..., :3] == given[4].color).all()
                assert (result.images["rendered.depth"] == given[4].depth).all()
                assert result.images["rendered.motion"].tobytes() == given[4].motion.tobytes()


def test_a_scene_is_rendered_for_upscaling_as_a_run_renders_it(device):
    """Smaller and jittered; without upscaling as before."""
    given = [frame for _, frame in Live(load_scene("plaza"), device, *SMALL, 3, 30.0, scale=2.0).frames([0.5], False)]
    layers = ("rendered.color", "rendered.motion", "truth")
    with running(device, scene_source) as engine:
        whole = ask(engine, 5, Setup(), layers)
        for _ in range(2):
            small = ask(engine, 5, Setup(Options(upscale=2.0)), layers)
            assert (small.images["rendered.color"][..., :3] == given[2].color).all()
            assert small.images["rendered.motion"].tobytes() == given[2].motion.tobytes()
            assert small.render_size == (32, 20) and small.moment.render_camera == given[2].camera
            assert (small.images["truth"] == whole.images["truth"]).all()
            again = ask(engine, 5, Setup(), layers)
            assert (
                again.render_size == SMALL and (again.images["rendered.color"] == whole.images["rendered.color"]).all()
            )


def test_the_interface_keeps_a_core(device):
    """The viewer's device gives the same bits."""
    mine = open_viewer_device(device.info.index)
    units = device.cl_device.max_compute_units
    if device.info.kind == "cpu" and units > 1:
        assert mine.cl_device.max_compute_units == units - 1
    expected = plain_run(device, frames(), Setup(), [(2, 1)])
    with running(mine, Clip()) as engine:
        assert_same(ask(engine, 5, Setup(), ("final",)).images, expected[2, 1], ["final"])


# ---- stories ----------------------------------------------------------------------------------------------


def stories(engine, setup, slot, mask_of, most=12):
    """The stories of about `most` pixels of the slot where `mask_of(images)` holds, or that were filled by that."""
    images = ask(engine, slot, setup, "all").images
    found = np.argwhere(mask_of(images) if callable(mask_of) else images["frame.filled_by"] == mask_of)
    assert len(found), "no such pixel"
    return [inspect(engine, x, y, slot, setup).story for y, x in found[:: max(1, len(found) // most)]]


UPSCALED, UNFILLED = Setup(Options(upscale=1)), Setup(Options(hole_filling="none", levels=0))
SAID = {  # of what kind of pixels which sentence says it
    "gathered over time": (UPSCALED, 8, lambda i: i["upscaling.rejected"] == 0, 0),
    "0% of the history": (UPSCALED, 8, lambda i: i["upscaling.rejected"] == 0, 0),
    "seen through the history": (UPSCALED, 9, lambda i: i["frame.disoccluded"] == 0, -1),
    "no history here": (UPSCALED, 9, lambda i: i["frame.disoccluded"] == 1, -1),
    "Crack closing": (Setup(), 13, 254, 0),
    "Soft silhouettes": (Setup(), 13, lambda i: i["silhouettes.coverage"] > 0, -1),
    "No frame before": (Setup(), 0, lambda i: i["rendered.depth"] < 9, 1),
    "far side": (Setup(), 13, 255, 1),
    "Hole filling is off": (UNFILLED, 13, 253, 1),
    "no background": (UNFILLED, 13, 253, 0),
}


def test_stories_say_what_was_done(engine):
    for said, (setup, slot, pixels, place) in SAID.items():
        assert all(said in story.sentences[place] for story in stories(engine, setup, slot, pixels, 6)), said


def surface_at(at, pixel):
    """Which rectangle display pixel `pixel` shows `at` rendered frames from the start, and its place on it."""
    which, _, local = SCENE._hit(pose(at), at / FPS, np.array(pixel) + 0.5)
    return int(which), local


def place_of(which, local, k):
    """Where a place on a rectangle lies on the display at rendered frame k; None if something else is seen there."""
    px = pose(k).project(local + SCENE.rects[which].at(k / FPS))[0]
    return px if surface_at(k, px - 0.5)[0] == which else None


def test_stories_of_the_dilated_warp(engine):
    """Pixels between those of the rendered frame tell its sharpness, if it is measured."""
    for sharpness in (True, False):
        setup = Setup(Options.preset("performance", sharpness=sharpness))
        for hole, said in ((0, "nearest of 3×3 pixels"), (1, "nearest surface beside it")):
            for story in stories(engine, setup, 9, lambda i, hole=hole: i["frame.disoccluded"] == hole, most=2):
                assert story.sentences[0].startswith("It comes from (") and said in story.sentences[hole]
                between = any(c % 1 != 0.5 for c in story.source)  # else it is copied, as at the border
                assert ("a sharpness of" in story.sentences[-1]) == (sharpness and between)


@pytest.mark.parametrize("windowed", [False, True])
def test_stories_of_fragments(device, tmp_path, windowed):
    """Trajectories lead over the display positions of the surface that is seen."""
    setup, k, slot = Setup(Options(history=3, order=2)), 4, 9
    sequence = windowed and write(tmp_path / "s", breathing, (112, 72))
    with running(device, (lambda d: RecordedSource(sequence, d)) if windowed else Clip()) as engine:

        def told(dynamic):
            for story in stories(
                engine, setup, slot, lambda i: (i["frame.filled_by"] == 0) & (i["frame.dynamic"] == dynamic)
            ):
                assert story.filled_by == "its own fragment" and story.dynamic == dynamic
                np.testing.assert_allclose(story.trajectory[-1], np.add(story.pixel, 0.5), atol=0.5001)
                which, local = surface_at(k + 0.5, story.pixel)
                if which >= 0 and (which == MOVER) == dynamic:
                    yield story, which, local

        checked = 0
        for story, which, local in told(False):
            assert story.residual <= story.threshold and "Static" in story.sentences[1] and len(story.trajectory) == 2
            place = place_of(which, local, k)
            if place is not None:
                np.testing.assert_allclose(story.trajectory[0], place, atol=1.0)
                checked += 1
        assert checked > 5
        checked = 0
        for story, which, local in told(True):
            assert story.residual > story.threshold and "Dynamic" in story.sentences[1] and len(story.trajectory) == 4
            assert "by a polynomial of order 2 from its last 3 positions" in story.sentences[2]
            if all(place_of(which, local, m) is not None for m in (k - 2, k - 1, k)):
                were = [local + SCENE.rects[MOVER].at(m / FPS) for m in (k - 2, k - 1, k)]
                np.testing.assert_allclose(story.trajectory[:3], pose(k).project(were)[0], atol=1.0)
                checked += 1
        assert checked > 5
        sky = stories(engine, setup, slot, lambda i: (i["frame.filled_by"] == 0) & np.isinf(i["frame.depth"]))
        assert all("Sky" in story.sentences[1] and len(story.trajectory) == 2 for story in sky)


def test_stories_tell_of_the_fragment_that_landed(device):
    """Seen from farther back several source pixels meet in one: it is of the surface that is shown."""

    def at_silhouettes(images):
        dynamic = images["frame.dynamic"].astype(int)
        edge = sum(np.abs(dynamic - np.roll(dynamic, 1, axis)) for axis in (0, 1)) > 0
        return edge & (images["frame.filled_by"] == 0)

    with running(device, Clip(back=4.0)) as engine:
        dynamic = ask(engine, 9, Setup(), ("frame.dynamic",)).images["frame.dynamic"]
        told = stories(engine, Setup(), 9, at_silhouettes, most=150)
        assert len(told) > 10
        for story in told:
            assert story.dynamic == bool(dynamic[story.pixel[1], story.pixel[0]])
            np.testing.assert_allclose(story.trajectory[-1], np.add(story.pixel, 0.5), atol=0.5001)


def test_stories_of_acceleration(engine):
    """The mover falls: nearly all of its acceleration lasts."""
    told = stories(engine, Setup(), 13, lambda i: (i["frame.filled_by"] == 0) & (i["frame.dynamic"] == 1))
    bent = [said for story in told for said in story.sentences if "of its acceleration counts" in said]
    assert len(bent) > len(told) / 2 and sum(int(said.split("%")[0]) > 80 for said in bent) > len(bent) / 2


def test_stories_of_cracks_rendered_frames_and_no_motion(engine):
    for story in stories(engine, Setup(), 13, 254):
        assert len(story.trajectory) >= 2
        assert np.linalg.norm(np.subtract(story.trajectory[-1], story.pixel) - 0.5) < 2
    still = stories(engine, Setup(Options(motion=False)), 13, 0)
    assert all(s.residual is None and ("off" in s.sentences[1] or "Sky" in s.sentences[1]) for s in still)
    for story in stories(engine, Setup(), 12, lambda i: i["history.dynamic_mask"] == 1):
        assert story.filled_by == "rendered frame" and story.dynamic
        np.testing.assert_allclose(story.trajectory[-1], np.add(story.pixel, 0.5))


def test_stories_of_holes_and_of_the_background(engine):
    setup, k = Setup(), 6
    behind = stories(engine, setup, 13, lambda i: (i["frame.filled_by"] == 1) & (i["frame.disoccluded"] == 1))
    right = 0
    for story in behind:
        assert story.level == 0 and story.filled_by == "background level 0" and story.dynamic is None
        assert "hidden now, last at (" in story.sentences[0] and len(story.trajectory) == 2
        which, local = surface_at(6.5, story.pixel)
        if which == 0:
            expected = pose(k).project(local + SCENE.rects[0].at(0))[0]
            right += np.abs(expected - story.level_px).max() < 2.5
        np.testing.assert_allclose(story.trajectory[0], story.level_px, atol=1e-4)
    assert right > len(behind) / 2
    holes = stories(engine, setup, 13, 255)
    assert all(s.filled_by == "hole filling" for s in holes)
    assert any("outside the rendered image" in s.sentences[-1] for s in holes)


@pytest.mark.parametrize("scene", ["", "barred"])
def test_stories_of_holes_tell_what_was_taken_and_what_was_refused(device, scene):
    """The pixels that are named, past bars too, give the depth that is shown, and hidden parts of movers tell what they
    looked at."""
    setup, checked, past = Setup(Options(levels=0)), 0, 0
    with running(device, SceneClip(scene)) as engine:
        images = ask(engine, 13, setup, ("frame.depth", "frame.dynamic", "final")).images
        for story in stories(engine, setup, 13, 255, 30):
            (taken,) = (step for step in story.sentences if "The result is (" in step)
            color = images["final"][story.pixel[1], story.pixel[0], :3]
            assert f"The result is ({', '.join(f'{float(c):.3g}' for c in color)})." in taken
            (movers,) = (step for step in story.sentences if "Hidden parts of movers left it" in step)
            if movers.links[0].pixel is not None:
                x, y = movers.links[0].pixel
                assert images["frame.dynamic"][y, x] and f"({x}, {y})" in movers
                if " But it is " in movers:
                    away, most = (float(part.split()[-1]) for part in movers.split(" But it is ")[1].split("px")[:2])
                    assert away > most
            if "took the mean of those" not in taken:
                continue
            (x, y), weights, inverse = story.pixel, [], []
            for px, py in (link.pixel for link in taken.links):
                said = taken.split(f"({px}, {py}) at")[1].split(", (")[0].split(". The")[0]
                *_, depth = said.split("before depth ")
                ends = depth != said
                weights.append((0.25 if ends else 1) / np.hypot(px - x, py - y))
                inverse.append(1 / (float(depth) if ends else images["frame.depth"][py, px]))
            assert images["frame.depth"][y, x] == pytest.approx(1 / np.average(inverse, weights=weights), rel=1e-3)
            checked += 1
            past += " in front at depth " in taken
        assert checked > 5 and (past > 1 or not scene)


def test_stories_of_hidden_parts(device):
    """They tell of the bar that hid the mover."""
    with running(device, SceneClip("barred")) as engine:
        told = stories(engine, Setup(), 13, 250)
        assert all(s.filled_by == "hidden part of a mover" and "with its motion" in s.sentences[0] for s in told)
        bars = [float(s.sentences[1].split("shows depth ")[1].split(" ")[0]) for s in told]
        assert max(bars) < 6 and all("depth here is" in s.sentences[1] for s in told)
        left = stories(engine, Setup(Options(levels=0)), 9, 255, 60)
        assert any("But the frame before shows depth 1" in said for s in left for said in s.sentences)


def test_stories_of_movers_that_enter(device):
    """They name the pixel at the border of the rendered frame that is repeated."""
    with running(device, SceneClip("entering")) as engine:
        color = ask(engine, 5, Setup(), ("frame.color",)).images["frame.color"]
        rendered = ask(engine, 5, Setup(), ("rendered.color",)).images["rendered.color"]
        for story in stories(engine, Setup(), 5, 250):
            (x, y), (px, py) = story.pixel, story.sentences[0].links[1].pixel
            assert px == 0 and "outside of rendered frame" in story.sentences[1]
            assert (color[y, x] == rendered[py, px]).all()


def test_stories_of_parts_that_reappear(device):
    """Soft silhouettes are not named as the only cause."""
    with running(device, SceneClip("barred")) as engine:
        for story in stories(engine, Setup(n=3), 31, 252):
            assert "A part of a mover that comes out" in story.sentences[0]
            for sentence in (sentence for sentence in story.sentences if "Soft silhouettes" in sentence):
                assert "The rest is what was filled in before: " in sentence


def test_stories_of_corrected_pixels(device, tmp_path):
    options = Options(scn_model=movers_model(tmp_path / "m.onnx"), image_flow=False)
    with running(device, FadingClip()) as engine:
        for story in stories(engine, Setup(options), 13, lambda i: i["correction.focus_mask"] > 0):
            assert story.corrected and "Shading correction changed it (focus mask " in story.sentences[-1]
        images = ask(engine, 13, Setup(options), "all").images
        y, x = map(int, np.argwhere(images["correction.focus_mask"] == 1)[0])
        colors = (f"({', '.join(f'{c:.4g}' for c in images[n][y, x, :3].astype(float))})" for n in ("gae", "final"))
        expected = f"Shading correction changed it (focus mask 1.00): from {' to '.join(colors)}."
        assert inspect(engine, x, y, 13, Setup(options)).story.sentences[-1] == expected
        others = stories(engine, Setup(options), 13, lambda i: i["correction.focus_mask"] == 0)
        assert all(s.corrected is False and "Shading" not in s.sentences[-1] for s in others)
        whole = stories(engine, Setup(replace(options, focus_mask=False)), 13, lambda i: i["rendered.depth"] > 0)
        assert all("which is off" in s.sentences[-1] for s in whole if s.corrected) and any(s.corrected for s in whole)
        off = stories(engine, Setup(), 13, lambda i: i["rendered.depth"] > 0)
        assert all(s.corrected is None for s in off)
