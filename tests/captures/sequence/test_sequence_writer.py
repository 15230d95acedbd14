"""Writers that are interrupted, that fail, and that meet files of others."""

import errno
import os
import resource
import shutil
import signal
import threading
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from tiny_sequence import H, W, edit, names, pixels, rendered, write

from gffe_cl.captures.sequence import (
    FrameEntry,
    SequenceWriter,
    named_channels,
    open_sequence,
    refuse_same_folder,
)
from gffe_cl.captures.sequence import exr as exr_module
from gffe_cl.captures.sequence.output_folder import OutputFolder
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.frame.rendered_frame import RenderedFrame


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "sequence")


def contents(path):
    return {name: (path / name).read_bytes() for name in names(path) if (path / name).is_file()}


@pytest.mark.parametrize("earlier", [False, True])
def test_interrupted_writer_keeps_what_was_finished(tmp_path, earlier):
    """Beside the output folder, until the next run; an earlier output stays."""
    out, part = tmp_path / "out", tmp_path / "out.part"
    before = contents(write(out, 4)) if earlier else {}
    with pytest.raises(KeyboardInterrupt) as stop, SequenceWriter(out, W, H, 30) as writer:
        for i in range(5):
            writer.add(rendered(i), named_channels(*pixels(i)))
            if i == 2:
                raise KeyboardInterrupt
    assert stop.value.__notes__ == [f"3 finished frames are in {part}"]
    sequence = open_sequence(part)
    assert names(part) == ["frame_0.exr", "frame_1.exr", "frame_2.exr", "sequence.json"]
    assert sequence.unfinished and f"{part}: unfinished" in sequence.warnings()[0]
    assert contents(out) == before if earlier else not out.exists()
    if not earlier:
        with pytest.raises(GffeError, match=r"is unfinished: .* its frames are in .*out\.part"):
            open_sequence(out)
    with pytest.raises(GffeError, match="overwrite its input"):
        refuse_same_folder(out, part)
    write(out, 1)
    assert names(tmp_path) == ["out", "out/frame_0.exr", "out/sequence.json", "out/truth_0.exr"]


@pytest.mark.parametrize("fault", [ZeroDivisionError, GffeError("wrong")])
def test_failing_over_an_earlier_output(tmp_path, fault):
    out = write(tmp_path / "out", 2)
    (out / "notes.txt").write_text("mine")
    before = contents(out)
    with pytest.raises((ZeroDivisionError, GffeError)), SequenceWriter(out, W, H, 30) as writer:
        for i in range(4):
            writer.add(rendered(i), named_channels(*pixels(50 + i)))
        (writer.folder("stages") / "notes.txt").write_text("of the run")
        raise fault
    assert contents(out) == before


def test_interrupted_while_it_ends(tmp_path, monkeypatch):
    """Ctrl-C during the last steps waits for them: the result is complete."""
    real = OutputFolder._replace

    def replace(folder):
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.2)
        real(folder)

    monkeypatch.setattr(OutputFolder, "_replace", replace)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # shells have what runs behind them ignore it
    try:
        with pytest.raises(KeyboardInterrupt) as stop:
            write(tmp_path / "out")
    finally:
        signal.signal(signal.SIGINT, before)
    assert stop.value.__notes__ == [f"{tmp_path / 'out'} is complete"]
    assert len(open_sequence(tmp_path / "out").frames) == 6 and not open_sequence(tmp_path / "out").unfinished


def test_failing_writer_leaves_nothing(tmp_path):
    keep = tmp_path / "a" / "notes.txt"
    keep.parent.mkdir()
    keep.write_text("mine")
    with pytest.raises(ZeroDivisionError), SequenceWriter(tmp_path / "a" / "b" / "c", W, H, 30) as writer:
        writer.add(rendered(0), named_channels(*pixels()))
        writer.add(FrameEntry("sub/e.exr", 0.1, "extrapolated"), named_channels(pixels()[0]))
        raise ZeroDivisionError
    assert names(tmp_path) == ["a", "a/notes.txt"]


def test_wrong_shape_and_no_frames(tmp_path):
    shape = r"channel 'R' must have shape \(9, 13\), got \(8, 13\)"
    with pytest.raises(GffeError, match=shape), SequenceWriter(tmp_path / "out", W, H, 30) as writer:
        writer.add(rendered(0), named_channels(*pixels(0, H - 1)))
    with pytest.raises(GffeError, match="no frame was written"), SequenceWriter(tmp_path / "out", W, H, 30):
        pass
    with (
        pytest.raises(GffeError, match="is written twice"),
        SequenceWriter(tmp_path / "out", W, H, 30) as writer,
    ):
        writer.add(rendered(0), named_channels(*pixels()))
        writer.add(FrameEntry("frame_0.exr", 9.0, "extrapolated"), named_channels(*pixels()))
    with pytest.raises(GffeError, match="no channels"), SequenceWriter(tmp_path / "out", W, H, 30) as writer:
        writer.add(rendered(0), {})
    assert names(tmp_path) == []


@pytest.mark.parametrize("below", ["file", "file/out", "file/a/out"])
def test_impossible_output(tmp_path, below):
    (tmp_path / "file").write_text("a regular file")
    with pytest.raises(GffeError, match="expected a") as info, SequenceWriter(tmp_path / below, W, H, 30):
        pass
    assert str(tmp_path / below) in str(info.value) and names(tmp_path) == ["file"]


@pytest.mark.limits
def test_disk_full(tmp_path):
    """The last bytes do not reach the disk: a limit on the size of files stands in for a full one."""
    limit = 12_000
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    noise = np.random.default_rng(0).normal(size=(90, 91, 3)).astype(np.float32)
    with pytest.raises(GffeError, match=r"frame_0.exr: cannot be written") as info:
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
            with SequenceWriter(tmp_path / "out", 91, 90, 30) as writer:
                writer.add(rendered(0), named_channels(noise, noise[..., 0]))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "\n" not in str(info.value) and names(tmp_path) == []


def test_replaces_an_older_output(tmp_path):
    out = write(tmp_path / "out", 4)
    (out / "notes.txt").write_text("mine")
    with SequenceWriter(out, W, H, 30) as writer:
        assert len(open_sequence(out).rendered) == 4  # until the new one is whole
        writer.add(rendered(0), named_channels(*pixels(7)))
    assert names(out) == ["frame_0.exr", "notes.txt", "sequence.json"]
    sequence = open_sequence(out)
    assert np.array_equal(sequence.read_color(sequence.frames[0]), pixels(7)[0])


def test_replaces_a_killed_output(tmp_path):
    out = write(tmp_path / "out", 1)
    before = contents(out)
    writer = SequenceWriter(out, W, H, 30).__enter__()
    for i in range(3):
        writer.add(rendered(i), named_channels(*pixels(i)))
    writer._pool.shutdown()  # and then kill -9
    assert contents(out) == before and len(list((tmp_path / "out.part").glob("*.exr"))) == 3
    with SequenceWriter(out, W, H, 30) as writer:
        writer.add(rendered(1), named_channels(*pixels()))
    assert names(tmp_path) == ["out", "out/frame_1.exr", "out/sequence.json"]


@pytest.mark.parametrize("fails_at", [0, 8])
def test_an_earlier_output_stays_where_the_new_one_cannot_take_its_place(tmp_path, monkeypatch, fails_at):
    out = write(tmp_path / "out", 3)
    before, real, calls = contents(out), os.rename, []

    def broken(source, target):
        calls.append(source)
        if len(calls) == fails_at + 1:
            raise OSError(errno.EIO, "power cut")
        real(source, target)

    monkeypatch.setattr(os, "rename", broken)
    with pytest.raises(GffeError, match="power cut"):
        write(out, 2)
    assert contents(out) == before and [path.name for path in tmp_path.iterdir()] == ["out"]


def test_the_current_folder_can_be_written_to(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(Path("."), 2)
    write(Path("."), 1)
    assert os.getcwd() == str(tmp_path) and names(Path(".")) == ["frame_0.exr", "sequence.json", "truth_0.exr"]


def test_files_of_others_stay(tmp_path):
    """... in folders of the output, too."""
    with SequenceWriter(tmp_path / "out", W, H, 30) as writer:
        writer.add(FrameEntry("sub/a.exr", 0.0, "extrapolated"), named_channels(pixels()[0]))
    for name in ("sub/mine.txt", "own.txt", "more/mine.txt"):
        (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_text("mine")
    (tmp_path / "out" / "link").symlink_to(tmp_path)
    write(tmp_path / "out", 1)
    kept = ["link", "more", "more/mine.txt", "own.txt", "sub", "sub/mine.txt"]
    assert names(tmp_path / "out") == sorted([*kept, "frame_0.exr", "sequence.json", "truth_0.exr"])


def test_folders_of_others_are_not_cleared(tmp_path):
    (tmp_path / "out.part").mkdir()
    (tmp_path / "out.part" / "thesis.tex").write_text("mine")
    with pytest.raises(GffeError, match="was not written by gffe-cl"):
        write(tmp_path / "out")
    assert names(tmp_path) == ["out.part", "out.part/thesis.tex"]


@pytest.mark.parametrize("file", ["notes.txt/a.exr", "link/a.exr"])
def test_files_that_are_in_the_way(tmp_path, file):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    (tmp_path / "out" / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(GffeError, match="cannot be written there"), SequenceWriter(tmp_path / "out", W, H, 30) as out:
        out.add(FrameEntry(file, 0.0, "extrapolated"), named_channels(pixels()[0]))
    assert names(tmp_path) == ["elsewhere", "out", "out/link", "out/notes.txt"]


def test_leaves_other_peoples_files_alone(folder):
    edit(folder, lambda d: d.pop("generator"))
    before = names(folder)
    with pytest.raises(GffeError, match="was not written by gffe-cl"), SequenceWriter(folder, W, H, 30):
        pass
    (folder / "sequence.json").unlink()
    with pytest.raises(GffeError, match=r"frame_1.exr: exists"), SequenceWriter(folder, W, H, 30) as writer:
        writer.add(rendered(1), named_channels(*pixels()))
    before.remove("sequence.json")
    assert names(folder) == before


def test_link(folder, tmp_path, monkeypatch):
    source = open_sequence(folder)
    for copying in (False, False, True):  # twice: a link over a link of the same file
        if copying:
            monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(OSError(errno.EXDEV, "other device")))
        with SequenceWriter(tmp_path / "out", W, H, 30) as writer:
            for entry in source.rendered:
                writer.link(entry, folder / entry.file)
        out = open_sequence(tmp_path / "out")
        assert out.rendered == source.rendered
        assert os.path.samefile(folder / "frame_1.exr", tmp_path / "out" / "frame_1.exr") != copying
        assert names(tmp_path / "out") == ["frame_0.exr", "frame_1.exr", "frame_2.exr", "sequence.json"]
    shutil.rmtree(tmp_path / "out")
    assert open_sequence(folder)
    refused = pytest.raises(GffeError, match=r"frame_0.exr: cannot be written")
    with refused, SequenceWriter(tmp_path / "out", W, H, 30) as writer:
        writer.link(rendered(0), tmp_path / "nothing.exr")


def test_input_is_not_output(folder, tmp_path):
    refuse_same_folder(tmp_path / "out", folder)
    (tmp_path / "alias").symlink_to(folder)
    for alias in (folder, folder / "sequence.json", tmp_path / "alias", f"{folder}/../sequence"):
        with pytest.raises(GffeError, match="overwrite its input"):
            refuse_same_folder(alias, folder)


# ---- compression --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", exr_module.COMPRESSIONS)
def test_compressions(tmp_path, compression):
    """Whatever is chosen is what the file says; only dwaa and dwab change a bit, and of colors only."""
    color, depth, motion = pixels(0)
    with SequenceWriter(tmp_path / "out", W, H, 30, compression=compression) as writer:
        writer.add(rendered(0), named_channels(color, depth, motion))
    sequence = open_sequence(tmp_path / "out")
    entry = sequence.frames[0]
    stored = OpenEXR.File(str(tmp_path / "out" / entry.file), header_only=True).header()["compression"]
    assert stored == getattr(OpenEXR, f"{'NO' if compression == 'none' else compression.upper()}_COMPRESSION")
    frame = sequence.read(entry)
    assert np.array_equal(frame.depth, depth) and np.array_equal(frame.motion, motion)
    if compression.startswith("dwa"):
        np.testing.assert_allclose(frame.color, color, rtol=0.2, atol=0.2)
    else:
        assert np.array_equal(frame.color, color)


def test_unknown_compressions_are_refused(tmp_path, monkeypatch):
    with pytest.raises(GffeError, match=r'compression must be one of none, rle, .*, got "jpeg"'):
        SequenceWriter(tmp_path, W, H, 30, compression="jpeg")
    monkeypatch.delattr(OpenEXR, "HTJ2K256_COMPRESSION", raising=False)
    with pytest.raises(GffeError, match="'htj2k256' needs a newer OpenEXR"):
        SequenceWriter(tmp_path, W, H, 30, compression="htj2k256")


@pytest.mark.parametrize("dtype", [np.uint8, np.int64, np.bool_, np.complex64])
def test_color_is_light_as_a_pipeline_takes_it(tmp_path, dtype):
    """Other numbers would be light of 0 to 254."""
    color = (100 * np.ones((H, W, 3))).astype(dtype)
    with pytest.raises(GffeError, match="color must be floating point, got"):
        named_channels(color, *pixels(0)[1:])
    refused = pytest.raises(GffeError, match="channel 'R' must be floating point, got")
    with refused, SequenceWriter(tmp_path / "out", W, H, 30) as writer:
        writer.add(rendered(0), named_channels(*pixels(0)) | {"R": color[..., 0]})


def test_integers_of_a_format_are_what_it_says(tmp_path):
    """Depth of 24 bits in 32, vectors of 16 bits with a sign, color of 8 bits."""
    given = FrameFormat(depth="device", near_z=0.5, far_z=np.inf, depth_range=(1, 0), motion_unit="uv")
    color, depth, motion = (np.random.default_rng(1).random(s) for s in ((H, W, 3), (H, W), (H, W, 2)))
    codes = (color * 255).astype(np.uint8), (depth * 0xFFFFFF).astype(np.uint32) | 5 << 24, (motion * 999).astype("i2")
    with SequenceWriter(tmp_path, W, H, 30, format=given) as writer:
        for k in range(2):
            frame = RenderedFrame(*codes, rendered(k).render_camera, k / 30, reset=k == 0)
            writer.add_frame(rendered(k), frame)
    frame = list(open_sequence(tmp_path))[1]
    np.testing.assert_allclose(frame.color, codes[0] / 255, rtol=1e-6)
    np.testing.assert_allclose(frame.depth, 0.5 * 0xFFFFFF / (codes[1] & 0xFFFFFF), rtol=1e-6)
    np.testing.assert_allclose(frame.motion, codes[2] / 32767 * (W, H), rtol=1e-5)


def test_what_is_not_owned_is_copied_at_once(tmp_path):
    color, depth, motion = (np.array(array) for array in pixels(0))
    with SequenceWriter(tmp_path / "out", W, H, 30, threads=1) as writer:
        for k in range(4):
            depth[:] = k + 1
            writer.add(rendered(k), named_channels(color, depth, motion))
            writer.add(
                FrameEntry(f"owned_{k}.exr", rendered(k).time + 1e-3, "extrapolated"),
                {name: np.full((H, W), k, np.float32) for name in "RGB"},
                owned=True,
            )
    sequence = open_sequence(tmp_path / "out")
    assert [sequence.read(entry).depth.max() for entry in sequence.rendered] == [1, 2, 3, 4]
    assert [sequence.read_color(entry).max() for entry in sequence.extrapolated] == [0, 1, 2, 3]


def test_rendered_frames_of_several_sizes_are_refused(tmp_path):
    sizes = rf"one size \(frame_0.exr is {W}×{H}, frame_1.exr is {W - 1}×{H}\)"
    with pytest.raises(GffeError, match=sizes), SequenceWriter(tmp_path / "out", W, H, 30) as writer:
        writer.add(rendered(0), named_channels(*pixels(0)))
        smaller = FrameEntry("truth.exr", 0.01, "ground_truth", render_size=(W - 2, H))
        writer.add(smaller, named_channels(pixels(1, H, W - 2)[0]))
        entry = rendered(1)
        entry.render_size = (W - 1, H)
        writer.add(entry, named_channels(*pixels(1, H, W - 1)))
    assert not (tmp_path / "out").exists()
