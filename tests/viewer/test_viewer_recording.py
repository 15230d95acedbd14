"""Recordings of running programs: what the viewer shows of them, and how they begin and end."""

import errno
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from engine_buffers import stored
from viewer_clips import ALL, FPS, H, W, ask, assert_same, frames, plain_run, running, slots
from viewer_session import wait_for

import gffe_cl as gffe
from gffe_cl.captures.offline import recording as module
from gffe_cl.viewer.engine.messages import Setup
from gffe_cl.viewer.engine.sources.recorded import Growth, RecordedSource

FORMAT = gffe.FrameFormat(
    color_type="unorm8", color_encoding="srgb", depth="device", near_z=0.1, far_z=100.0, depth_range=(1, 0),
    depth_type="unorm24", motion_type="snorm16", motion_unit="uv", motion_direction="from_previous", motion_y="up",
    motion_invalid=-1.0, rows="up", geometry_size=(W // 2, H // 2),
)  # fmt: skip
CUT, COVERED = 4, 2  # an unmarked cut, and a frame with overlays
FORMS = ("arrays", "buffers", "described arrays", "described buffers")


def played(device, form):
    """Frames of a program, in a form; one of them is of another place."""
    rng = np.random.default_rng(1)
    given = [replace(one, overlays=None) for one in frames()[:7]]
    for k in range(CUT, 7):
        given[k] = replace(given[k], color=np.float16(1) - given[k].color[::-1], depth=given[k].depth[::-1] * 3)
    layers = {
        "fixed_mask": np.arange(W) < np.full((H, 1), 9),
        "effects": rng.random((H, W, 4), np.float32) / 2,
        "effects_motion": rng.random((H, W, 2), np.float32),
        "ui": rng.random((H, W, 4)).astype(np.float16),
    }
    if "described" in form:
        plain = replace(FORMAT, rows="down")
        given = [integers(stored(one, given[k - 1] if k else None, plain)) for k, one in enumerate(given)]
    if "buffers" in form:
        given = [on_device(device, one) for one in given]
        layers["effects"] = layers["effects"].astype(np.float16)
        layers = {name: buffer(device, np.uint8(a) if a.dtype == bool else a) for name, a in layers.items()}
    given[COVERED] = replace(given[COVERED], overlays=gffe.Overlays(**layers))
    return given


def integers(frame):
    """A frame of floats in the types of `FORMAT`, from its last row up."""
    color = np.uint8(np.clip(frame.color, 0, 1) * 255)
    depth = np.uint32(frame.depth.astype(np.float64) * 0xFFFFFF) | 0x7000000
    motion = None if frame.motion is None else np.int16(np.clip(frame.motion, -1, 1) * 32767)[::-1]
    return replace(frame, color=color[::-1], depth=depth[::-1], motion=motion)


def buffer(device, array):
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    return cl.Buffer(device.context, flags, hostbuf=np.ascontiguousarray(array))


def on_device(device, frame):
    color = np.dstack([frame.color, np.ones_like(frame.color[..., :1])])
    planes = {"color": color, "depth": frame.depth, "motion": frame.motion}
    return replace(frame, **{name: None if a is None else buffer(device, a) for name, a in planes.items()})


@pytest.mark.parametrize("form", FORMS)
def test_the_layers_are_the_programs_own(device, tmp_path, form):
    """Overlays, a cut that the pipeline finds, and buffers as an engine has them: to the bit."""
    setup, recordings, cuts = Setup(ALL, n=1), [], []
    wanted = [(k, j) for k in range(7) for j in range(2)]

    def source():
        for given in played(device, form):
            yield given
            cuts.append(recordings[0]._pipeline().is_cut)

    expected = plain_run(
        device,
        source(),
        setup,
        wanted,
        camera_at=lambda at: None,
        begin=lambda pipeline: recordings.append(gffe.record(pipeline, tmp_path / "seen")),
        format=FORMAT if "described" in form else None,
    )
    recordings[0].close()
    sequence = gffe.open_sequence(tmp_path / "seen")
    assert (recordings[0].written, recordings[0].dropped, cuts) == (7, 0, [k == CUT for k in range(6)])
    assert [entry.reset for entry in sequence.rendered] == [k in (0, CUT) for k in range(7)]
    assert (sequence.format is not None) == ("described" in form)
    with running(device, RecordedSource(sequence, device)) as engine:
        for at in wanted:
            result = ask(engine, *slots(setup, at), setup, expected[at])
            generated = {name for name, spec in result.specs.items() if spec.of_generated}
            left_out = set() if at[1] else generated  # these are the slot's before
            if at[0] == CUT:  # counted before the program knew of the cut
                left_out |= {"shading_trend.changed_samples"}
            assert_same(result.images, expected[at], expected[at].keys() - left_out)


def program(device, **given):
    return gffe.Pipeline(device, W, H, gffe.Options(shading_correction=False), fps=FPS, **given)


def test_lost_frames_tear_it_and_nothing_is_recorded_while_it_is_off(device, tmp_path, monkeypatch):
    pipeline, given = program(device), frames()
    with gffe.record(pipeline, tmp_path / "seen", most=6) as recording:
        for k in range(3):
            pipeline.submit(given[k])
        with monkeypatch.context() as patch:
            patch.setattr(module, "_WAITING", 0)
            pipeline.submit(given[3])  # lost
        for k in (4, 5):
            pipeline.submit(given[k])
        recording.stop()
        assert not recording.on and pipeline.watcher is None
        pipeline.submit(given[6])
        recording.start()
        recording.start()
        pipeline.submit(replace(given[0], reset=True))  # its clock begins anew
        assert recording.on
        for k in (8, 9):
            pipeline.submit(given[k])
        assert not recording.on and recording.dropped == 1
        recording.start()
        assert not recording.on, "it has `most` frames"
    rendered = gffe.open_sequence(tmp_path / "seen").rendered
    assert recording.written == len(rendered) == 6
    assert [entry.reset for entry in rendered] == [True, False, False, True, False, True]
    assert [round(entry.time * FPS, 6) for entry in rendered] == [0, 1, 2, 4, 5, 6]
    gffe.record(pipeline, tmp_path / "seen").close()  # an earlier recording is replaced
    assert list((tmp_path / "seen").iterdir()) == []


def test_the_viewer_follows(device, tmp_path):
    pipeline, given = program(device), frames()
    with gffe.record(pipeline, tmp_path / "seen") as recording:
        for k in range(3):
            pipeline.submit(given[k])
        wait_for(lambda: recording.written == 2)  # of the last one it is not known yet whether it is a cut
        source = RecordedSource(gffe.open_sequence(tmp_path / "seen"), device)
        source.growth = Growth(tmp_path / "seen")
        for k in range(3, 6):
            pipeline.submit(given[k])
        wait_for(lambda: recording.written == 5)
        wait_for(lambda: [source.grow(), source.count][1] == 5)
        assert source.rendered(4).color.tobytes() == given[4].color.tobytes()


def test_what_cannot_be_written_ends_it_with_one_warning(device, tmp_path, monkeypatch):
    pipeline, given = program(device), frames()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("")
    for folder, reason in ((tmp_path / "other", "holds other files"), (tmp_path / "other/notes.txt", "cannot be wr")):
        with pytest.raises(gffe.GffeError, match=reason):
            gffe.record(pipeline, folder)
    assert pipeline.watcher is None

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    recording = gffe.record(pipeline, tmp_path / "seen")
    with pytest.raises(gffe.GffeError, match="recorded already"):
        gffe.record(pipeline, tmp_path / "again")
    with pytest.warns(UserWarning, match=r"the recording ends after 0 frames \(No space left") as told:
        monkeypatch.setattr(module.exr, "write_channels", full)
        for k in range(3):
            pipeline.submit(given[k])
        recording.close()
    assert len(told) == 1 and not recording.on
    monkeypatch.undo()
    pipeline = program(device)
    recording = gffe.record(pipeline, tmp_path / "seen")
    pipeline.submit(given[0])
    pipeline.format = gffe.FrameFormat(motion_y="up")
    with pytest.warns(UserWarning, match="another format"):
        pipeline.submit(given[1])
        recording.close()
    assert recording.written == 1


PROGRAM = """
import sys
import numpy as np
import gffe_cl as gffe
pipeline = gffe.Pipeline(gffe.open_device(), 32, 24, gffe.Options(shading_correction=False))
recording = gffe.record(pipeline, sys.argv[1])
camera = gffe.Camera(np.eye(4), 32.0, 32.0, 16.0, 12.0)
for k in range(3):
    arrays = np.ones((24, 32, 3), np.float16), np.ones((24, 32), np.float32), np.zeros((24, 32, 2), np.float32)
    pipeline.submit(gffe.RenderedFrame(*arrays, camera, k / 30))
"""


def test_a_program_that_ends_leaves_all_frames(tmp_path):
    done = subprocess.run([sys.executable, "-c", PROGRAM, tmp_path / "seen"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(gffe.open_sequence(tmp_path / "seen").rendered) == 3
