"""Cuts and teleports are found without being told, and nothing else is taken for one."""

from dataclasses import replace

import numpy as np
import pyopencl as cl
from synthetic import Rect, Rects, camera

from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels, open_sequence
from gffe_cl.engine.frame.rendered_frame import host_arrays
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.measures import COUNTED, counts_say_cut
from gffe_cl.lab.compare import compare
from gffe_cl.viewer.engine.messages import Recipe, Setup
from gffe_cl.viewer.engine.slot_maker import Seeker
from gffe_cl.viewer.engine.sources.recorded import RecordedSource
from gffe_cl.viewer.picture.current_frame import Contents

WIDTH, HEIGHT, FPS = 96, 64, 30.0
FIRST = Rects([Rect((0, 0, 9)), Rect((0, 0.6, 5), (0.6, 1.2), velocity=(2, 0, 0), frequency=2, tint=(0.7, 0.2, 0.1))])
SECOND = Rects([Rect((0, 0, 14), frequency=0.4), Rect((0.4, 0, 6), (2.5, 1), frequency=1.5, tint=(0.2, 0.5, 0.3))])


def shot(scene, count, start=0, step=(0.05, 0.01, 0.02), turn=0.0):
    """Frames of a scene, the camera moving by `step` and turning by `turn` radians."""
    before = None
    for k in range(start, start + count):
        time = k / FPS
        eye = camera(WIDTH, HEIGHT, tuple(k * s for s in step), turn * k)
        yield scene.frame(eye, time, WIDTH, HEIGHT, before, reset=before is None)
        before = (eye, time)


def found(device, given, options=None):
    """Which of the frames are found to be cuts; only the first one is told as a reset."""
    pipeline = Pipeline(device, WIDTH, HEIGHT, options or Options(), fps=FPS)
    cuts = []
    for k, frame in enumerate(given):
        motion = frame.motion if k == 0 or frame.motion is not None else np.zeros((HEIGHT, WIDTH, 2), np.float32)
        pipeline.submit(replace(frame, time=k / FPS, reset=k == 0, motion=motion))
        if pipeline.is_cut:
            cuts.append(k)
    return cuts


def test_a_cut_to_another_scene_is_a_reset(device):
    """With the new shot's own vectors, and with none; what follows is as if it had been told."""
    for motion in ("own", "zero"):
        second = list(shot(SECOND, 3, start=7))
        if motion == "own":  # as after the frame that nobody shows
            second = list(shot(SECOND, 4, start=6))[1:]
        given = [*shot(FIRST, 4), *second]
        assert found(device, given) == [4]
        assert found(device, given, Options(cut_detection=False)) == []


def test_cuts_are_found_in_device_buffers(device):
    given = [*shot(FIRST, 3), *list(shot(SECOND, 4, start=6))[1:3]]
    pipeline, cuts = Pipeline(device, WIDTH, HEIGHT, fps=FPS), []
    for k, frame in enumerate(given):
        host = host_arrays(frame).in_device_layout()
        buffers = [device.buffer(array.nbytes) for array in (host.color, host.depth, host.motion)]
        for buffer, array in zip(buffers, (host.color, host.depth, host.motion), strict=True):
            cl.enqueue_copy(device.queue, buffer, array)
        color, depth, motion = buffers
        pipeline.submit(
            replace(frame, time=k / FPS, reset=k == 0, color=color, depth=depth, motion=motion, display_camera=None)
        )
        cuts.append(pipeline.is_cut)
    assert cuts == [False, False, False, True, False]


def test_after_a_cut_all_is_as_if_it_had_been_told(device):
    given = [*shot(FIRST, 4), *list(shot(SECOND, 4, start=6))[1:3]]
    made = []
    for told in (False, True):
        pipeline = Pipeline(device, WIDTH, HEIGHT, Options(cut_detection=not told), fps=FPS)
        for k, frame in enumerate(given):
            pipeline.submit(replace(frame, time=k / FPS, reset=k == 0 or (told and k == 4)))
            frame = pipeline.extrapolate()
            made.append((frame.numpy("color"), frame.numpy("depth"), frame.numpy("dynamic"), frame.camera))
    for a, b in zip(made[: len(given)], made[len(given) :], strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a[:3], b[:3], strict=True)) and a[3] == b[3]


def test_fast_cameras_are_no_cuts(device):
    assert found(device, shot(FIRST, 5, step=(0.6, 0.1, 0.3))) == []
    assert found(device, shot(SECOND, 5, turn=0.35)) == []


def test_light_that_changes_is_no_cut(device):
    """Strobes, flashes over a part of the image, darkness, colors."""
    rng = np.random.default_rng(3)
    given = []
    for k, frame in enumerate(shot(FIRST, 8, step=(0.2, 0, 0.1))):
        light = np.ones((HEIGHT, WIDTH, 3)) * (30.0 if k % 2 else 0.05) * rng.uniform(0.3, 3, 3)
        light[: HEIGHT // 2, rng.integers(WIDTH) :] *= 500
        given.append(replace(frame, color=np.minimum(frame.color * light, 6e4).astype(np.float16)))
    assert found(device, given) == []


def test_a_view_without_overlap_is_a_teleport(device):
    """True vectors that leave the image or come from behind the camera."""
    before = camera(WIDTH, HEIGHT, (0, 0, 0))
    for eye in (camera(WIDTH, HEIGHT, (30, 0, 0)), camera(WIDTH, HEIGHT, (0, 0, 0), 1.3)):
        given = [FIRST.frame(before, 0.0, WIDTH, HEIGHT, None, reset=True)]
        given.append(FIRST.frame(eye, 1 / FPS, WIDTH, HEIGHT, (before, 0.0)))
        assert found(device, given) == [1]


def test_a_sudden_long_step_is_a_teleport_though_vectors_are_true(device):
    """A camera that always moves so far is none."""
    steps = {(0.02, 0, 0): [3], (0.9, 0, 0): []}
    for step, expected in steps.items():
        places = [tuple(k * s for s in step) for k in range(3)]
        far = (places[2][0] + 4.0, 0, 6.0) if expected else tuple(3 * s for s in step)
        given, before = [], None
        for k, place in enumerate([*places, far]):
            eye = camera(WIDTH, HEIGHT, place)
            given.append(FIRST.frame(eye, k / FPS, WIDTH, HEIGHT, before, reset=k == 0))
            before = (eye, k / FPS)
        assert found(device, given) == expected


def written(path, given):
    """The frames as a sequence whose first frame alone is told as a reset, with made-up truth in between."""
    with SequenceWriter(path, WIDTH, HEIGHT, FPS) as writer:
        for k, frame in enumerate(given):
            motion = frame.motion if k else None
            entry = FrameEntry(f"frame_{k:06d}.exr", k / FPS, reset=k == 0, render_camera=frame.camera)
            writer.add(entry, named_channels(frame.color, frame.depth, motion))
            truth = FrameEntry(f"truth_{k:06d}.exr", (k + 0.5) / FPS, "ground_truth", display_camera=frame.camera)
            writer.add(truth, named_channels(frame.color))
    return open_sequence(path)


def test_a_run_tells_of_cuts_and_writes_resets(device, tmp_path):
    """So compare leaves out what has no history, and says so; without detection it does not."""
    sequence = written(tmp_path / "in", [*shot(FIRST, 4), *list(shot(SECOND, 4, start=6))[1:]])
    resets, counted, notes = {}, {}, {}
    for detect in (True, False):
        out, options = tmp_path / f"out-{detect}", Options(cut_detection=detect, shading_correction=False)
        report = run_sequence(Recorded(sequence, device), out, device, options, [0.5])
        assert (report.rendered, report.cuts) == (7, ["frame_000004.exr"] if detect else [])
        made = open_sequence(out)
        resets[detect] = [entry.file for entry in made.rendered if entry.reset]
        result = compare(made, sequence)
        counted[detect], notes[detect] = [frame.counted for frame in result.frames], result.notes
    assert resets == {True: ["frame_000000.exr", "frame_000004.exr"], False: ["frame_000000.exr"]}
    assert counted[True] == [False, False, True, True, False, False, True] and sum(counted[False]) == 5
    assert "frame_000004.exr: reset in" in notes[True][0] and not notes[False]


def test_the_viewer_shows_cuts(device, tmp_path):
    """Those found up to the slot that is shown, beside the resets that are told."""
    sequence = written(tmp_path, [*shot(FIRST, 4), *list(shot(SECOND, 4, start=6))[1:]])
    sequence.rendered[2].reset = True
    source = RecordedSource(sequence, device)
    contents, seeker = Contents(), Seeker(device, source, lambda: False)
    contents.open(source)
    seeker.prepare(Recipe(1, Setup(), ""))
    for k, cuts in ((3, set()), (5, {4}), (1, {4})):
        seeker.go_to(k, 0.0, provisional=False)
        assert seeker.cuts == cuts
    contents.cuts = frozenset(seeker.cuts)
    assert contents.resets == {4: "a cut was found here", 2: "reset"}
    seeker.prepare(Recipe(1, Setup(Options(cut_detection=False)), ""))
    seeker.go_to(5, 0.0, provisional=False)
    assert seeker.cuts == set()
    source.close()


def counts(**changed):
    return dict.fromkeys(COUNTED, 1000) | {"passed": 0} | changed


def test_what_counts_mean():
    """Each rule alone, on either side of it."""
    assert not counts_say_cut(counts())
    assert counts_say_cut(counts(inside=40)) and not counts_say_cut(counts(inside=60))
    assert counts_say_cut(counts(depth_right=390)) and not counts_say_cut(counts(depth_right=410))
    assert counts_say_cut(counts(depth_right=790, contrast_right=240))
    assert not counts_say_cut(counts(depth_right=790, contrast_right=260))
    assert not counts_say_cut(counts(depth_right=810, contrast_right=0))
    assert not counts_say_cut(counts(compared=3, depth_right=0)), "all sky"
    assert counts_say_cut(counts(depth_right=590, with_contrast=0, contrast_right=0))
    assert not counts_say_cut(counts(depth_right=610, with_contrast=0, contrast_right=0))
    assert counts_say_cut(counts(passed=600), jumped=True)
    assert not counts_say_cut(counts(passed=600)) and not counts_say_cut(counts(), jumped=True)
    assert not counts_say_cut({name: 50 * (name == "valid") for name in COUNTED}), "too few to say"
