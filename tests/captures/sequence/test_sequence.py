"""Sequences on disk: round trips, other people's files, warnings, prefetching."""

import os
import subprocess
import sys
import threading

import numpy as np
import OpenEXR
import pytest
from tiny_sequence import H, W, camera, contiguous, edit, pixels, write

from gffe_cl.captures.sequence import (
    FrameEntry,
    SequenceWriter,
    named_channels,
    open_sequence,
)
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame, host_arrays


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "sequence")


# Round trips


def test_round_trip(folder):
    sequence = open_sequence(folder)
    assert (sequence.width, sequence.height, sequence.fps, sequence.exposure) == (W, H, 30.0, 1.0)
    assert [len(x) for x in (sequence.frames, sequence.rendered, sequence.ground_truth)] == [6, 3, 3]
    assert open_sequence(folder / "sequence.json").frames == sequence.frames
    for i, entry in enumerate(sequence.rendered):
        frame, (color, depth, motion) = sequence.read(entry), pixels(i)
        assert frame.color.dtype == np.float16 and np.array_equal(frame.color, color)
        assert frame.depth.dtype == np.float32 and np.array_equal(frame.depth, depth)
        assert frame.camera == camera(i) and frame.display_camera is None and frame.time == i / 30
        assert frame.reset == (i == 0)
        if i:
            assert frame.motion.dtype == np.float32 and np.array_equal(frame.motion, motion)
        else:
            assert frame.motion is None
    truth = sequence.ground_truth[1]
    assert np.array_equal(sequence.read_color(truth), pixels(101)[0])
    assert truth.display_camera == camera(1.5) and truth.render_camera is None
    assert sorted(p.name for p in folder.iterdir()) == sorted(
        ["sequence.json"] + [entry.file for entry in sequence.frames]
    )


def test_stored_types(tmp_path):
    color = np.linspace(0, 1e5, H * W * 3, dtype=np.float32).reshape(H, W, 3)
    filled_by = np.arange(H * W, dtype=np.uint8).reshape(H, W)
    identifiers = np.full((H, W), 2**31, np.uint32)
    entry = FrameEntry("e.exr", 0.0, "extrapolated", source="frame_0.exr", alpha=0.5)
    with SequenceWriter(tmp_path, W, H, 30, exposure=2.5) as writer:
        channels = named_channels(color, np.ones((H, W)), np.zeros((H, W, 2), np.float16))
        writer.add(entry, {**channels, "mask.filled_by": filled_by, "id": identifiers})
        color[:] = -1  # the writer has copied
    sequence = open_sequence(tmp_path)
    (back,) = sequence.extrapolated
    assert (back.source, back.alpha, sequence.exposure) == ("frame_0.exr", 0.5, 2.5)
    read = sequence.read_channels(back, ["R", "Z", "motion.x", "mask.filled_by", "id"])
    assert [a.dtype.name for a in read.values()] == ["float32"] * 3 + ["float16", "uint32"]
    assert np.array_equal(read["mask.filled_by"], filled_by) and read["R"].max() > 65504
    assert np.array_equal(read["id"], identifiers)


def test_window(tmp_path):
    """An overscanned frame: other sizes and cameras for rendering and display, also by the windows in the file."""
    render = camera(cx=6.2 + 2, cy=4.1 + 3)
    entry = FrameEntry("f.exr", 0.0, "rendered", True, (W + 5, H + 4), render, camera())
    with SequenceWriter(tmp_path, W, H, 30) as writer:
        writer.add(entry, named_channels(*pixels(0, H + 4, W + 5)))
    sequence = open_sequence(tmp_path)
    frame = sequence.read(sequence.frames[0])
    assert frame.color.shape == (H + 4, W + 5, 3)
    assert frame.camera == render and frame.display_camera == camera()

    edit(tmp_path, lambda d: [d["frames"][0].pop(k) for k in ("render_size", "display_camera")])
    (entry,) = open_sequence(tmp_path).frames
    assert entry.render_size == (W + 5, H + 4)
    np.testing.assert_allclose(entry.display_camera.intrinsics, camera().intrinsics, rtol=1e-5)


def test_first_rendered_frame_is_a_reset(folder):
    edit(folder, lambda d: [f.pop("reset", None) for f in d["frames"]])
    assert [entry.reset for entry in open_sequence(folder).rendered] == [True, False, False]


def test_dynamic_resolution_without_display_camera(tmp_path):
    """No display camera and another size: the frustum of the render camera."""
    with SequenceWriter(tmp_path, 2 * W, 2 * H, 30) as writer:
        writer.add(FrameEntry("f.exr", 0.0, "rendered", True, (W, H), camera()), named_channels(*pixels()))
    frame = open_sequence(tmp_path).read(open_sequence(tmp_path).frames[0])
    assert frame.display_camera == camera().scaled(2, 2)


# Other people's EXRs


def foreign(folder, parts, i=1):
    OpenEXR.File(parts).write(str(folder / f"frame_{i}.exr"))


def test_multi_part_types_and_shifted_window(folder):
    color, depth, motion = pixels(1)
    window = (np.array([7, -4], np.int32), np.array([7 + W - 1, -4 + H - 1], np.int32))
    header = {"type": OpenEXR.scanlineimage, "dataWindow": window, "displayWindow": window}
    red = color[..., 0].astype(np.float32)
    rgb = {"R": red, "G": np.full((H, W), 7, np.uint32), "B": np.ascontiguousarray(color[..., 2])}
    rest = contiguous({"Z": depth.astype(np.float16), "motion.x": motion[..., 0], "motion.y": motion[..., 1]})
    foreign(folder, [OpenEXR.Part(dict(header), rgb, "beauty"), OpenEXR.Part(dict(header), rest, "data")])
    sequence = open_sequence(folder)
    frame = sequence.read(sequence.rendered[1])
    assert frame.color.dtype == np.float32 and (frame.color[..., 1] == 7).all()
    assert np.array_equal(frame.color[..., 0], red) and np.array_equal(frame.motion, motion)
    assert frame.depth.dtype == np.float32 and np.array_equal(frame.depth, depth.astype(np.float16))
    assert np.array_equal(sequence.read_channels(sequence.rendered[1], ["data.Z"])["data.Z"], depth.astype(np.float16))


# Warnings and strict


def test_time_warnings(folder):
    assert open_sequence(folder).warnings() == []
    edit(folder, lambda d: [f.update(time=f["time"] * 1000) for f in d["frames"]])
    assert "33.3 s: milliseconds?" in open_sequence(folder).warnings()[0]
    edit(folder, lambda d: [f.update(time=f["time"] / 2500) for f in d["frames"]])
    assert "fps is 30" in open_sequence(folder).warnings()[0]


# Prefetch


def test_prefetch_order_and_packing(folder):
    sequence = open_sequence(folder)

    def read(entry):
        return host_arrays(sequence.read(entry), H, W), threading.current_thread()

    seen = list(sequence.prefetch(sequence.rendered * 4, read, ahead=3))
    assert [entry.file for entry, _ in seen] == [entry.file for entry in sequence.rendered * 4]
    assert np.array_equal(seen[5][1][0].color[..., :3], pixels(2)[0])
    assert all(thread is not threading.main_thread() for _, (_, thread) in seen)


def test_prefetch_error_at_its_frame(folder):
    sequence = open_sequence(folder)
    (folder / "frame_1.exr").unlink()
    seen = []
    with pytest.raises(GffeError, match=r"frame_1.exr"):
        for entry, _ in sequence.prefetch(sequence.rendered):
            seen.append(entry.file)
    assert seen == ["frame_0.exr"]


def test_prefetch_stops_with_its_consumer(folder):
    sequence = open_sequence(folder)
    started = []
    reading = sequence.prefetch(sequence.rendered * 20, lambda entry: started.append(entry), ahead=2)
    for _ in reading:
        break
    reading.close()
    assert len(started) <= 4
    assert not [t for t in threading.enumerate() if t.name.startswith("gffe-read")]


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_bad_pixels_of_every_type(dtype):
    """Colors beyond half or not finite, in any channel, whether few or none."""
    rng = np.random.default_rng(1)
    most = np.finfo(np.float16).max
    beyond = [value for value in (1e5, -1e5) if dtype != np.float16]
    for bad in ((), (np.nan,), (np.inf,), (-np.inf,), *((value,) for value in beyond), (np.nan, np.inf, *beyond)):
        for channels in (3, 4):
            color = rng.uniform(-1, 1, (5, 7, channels)).astype(dtype)
            color[0, 0, 0], color[0, 1, 1] = most, -most
            expected = color[..., :3].astype(np.float64)
            for k, value in enumerate(bad):
                color[1 + k, 2, k % 3] = value
                expected[1 + k, 2, k % 3] = np.clip(np.nan_to_num(value), -most, most)
            frame = RenderedFrame(color, np.ones((5, 7), np.float32), np.zeros((5, 7, 2), np.float32), camera(), 0.0)
            host = host_arrays(frame, 5, 7)
            laid = host.in_device_layout().color
            clamped = sum(map(np.isfinite, bad))
            assert host.bad == BadPixels(color=len(bad) - clamped, clamped=clamped)
            assert np.array_equal(laid[..., :3], expected.astype(np.float16)) and not laid[..., 3].any()


def test_freed_memory_is_kept():
    """Pages that were fetched once serve again, instead of new ones for each array."""
    code = (
        "import resource, numpy as np\nfrom gffe_cl.engine.opencl.runtimes import keep_freed_memory\n{}\n"
        "def faults():\n    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "np.ones(1 << 22)\nbefore = faults()\nfor k in range(20): np.ones(1 << 22)\nprint(faults() - before)"
    )
    environment = os.environ | {"NUMPY_MADVISE_HUGEPAGE": "0"}
    fetched = [
        int(subprocess.run([sys.executable, "-c", code.format(call)], env=environment, capture_output=True).stdout)
        for call in ("", "keep_freed_memory()")
    ]
    assert fetched[0] < 50_000 or fetched[1] < fetched[0] / 10  # glibc's own way is to give them back


def test_truth_lies_where_its_data_window_says(tmp_path):
    """Black outside; a rendered frame is the data window, and its camera says where that is."""
    write(tmp_path)
    shown = np.random.default_rng(1).random((H, W)).astype(np.float32)
    windows = {"dataWindow": (np.array([3, -2], np.int32), np.array([W + 2, H - 3], np.int32))}
    windows["displayWindow"] = (np.zeros(2, np.int32), np.array([W - 1, H - 1], np.int32))
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION} | windows
    OpenEXR.File(header, dict.fromkeys("RGB", shown)).write(str(tmp_path / "truth_0.exr"))
    sequence = open_sequence(tmp_path)
    expected = np.zeros((H, W), np.float32)
    expected[: H - 2, 3:] = shown[2:, : W - 3]
    np.testing.assert_array_equal(sequence.read_color(sequence.ground_truth[0])[..., 1], expected)
