"""Writers that are interrupted, that fail, and that meet files of others."""

import errno
import os
import resource
import shutil
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from tiny_sequence import H, W, edit, names, pixels, rendered, write

from gffe_cl.errors import GffeError
from gffe_cl.sequence import (
    FrameEntry,
    SequenceWriter,
    named_channels,
    open_sequence,
    refuse_same_folder,
)
from gffe_cl.sequence import exr as exr_module
from gffe_cl.sequence.exr_header import read_header


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "sequence")


def test_interrupted_writer_keeps_what_was_finished(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt), SequenceWriter(out, W, H, 30) as writer:
        for i in range(5):
            writer.add(rendered(i), named_channels(*pixels(i)))
            if i == 2:
                raise KeyboardInterrupt
    sequence = open_sequence(out)
    assert [entry.file for entry in sequence.frames] == ["frame_0.exr", "frame_1.exr", "frame_2.exr"]
    assert names(out) == ["frame_0.exr", "frame_1.exr", "frame_2.exr", "sequence.json"]


def test_interrupted_before_the_first_frame(tmp_path):
    with pytest.raises(KeyboardInterrupt), SequenceWriter(tmp_path / "out", W, H, 30):
        raise KeyboardInterrupt
    assert names(tmp_path) == []


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
        writer.add(FrameEntry("frame_0.exr", 9.0, "extrapolated"), {})
    assert names(tmp_path) == []


@pytest.mark.parametrize("below", ["file", "file/out", "file/a/out"])
def test_impossible_output(tmp_path, below):
    (tmp_path / "file").write_text("a regular file")
    with pytest.raises(GffeError, match="expected a") as info, SequenceWriter(tmp_path / below, W, H, 30):
        pass
    assert str(tmp_path / below) in str(info.value) and names(tmp_path) == ["file"]


@pytest.mark.skipif(os.name != "posix" or not Path("/proc/self").exists(), reason="needs /proc")
def test_unwritable_output():
    for path in ("/proc", "/proc/gffe"):
        with pytest.raises(GffeError, match="cannot be written to"), SequenceWriter(path, W, H, 30):
            pass


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


class FullDisk:
    """Stands in for OpenEXR.File: writes half a file, or fails as the library does."""

    real = OpenEXR.File

    def __init__(self, header, channels):
        self.file = FullDisk.real(header, channels)

    def write(self, path):
        self.file.write(path)
        os.truncate(path, os.path.getsize(path) - 5)
        if not FullDisk.silent:
            raise RuntimeError(f'Failed to write "{path}".\n{os.strerror(errno.ENOSPC)}.')


@pytest.mark.parametrize("silent", [True, False])
def test_disk_full_as_the_library_says_it(tmp_path, monkeypatch, silent):
    FullDisk.silent = silent
    out = write(tmp_path / "out")
    monkeypatch.setattr(exr_module.OpenEXR, "File", FullDisk)
    with pytest.raises(GffeError, match=r"frame_0.exr: cannot be written \((No space|.*full)"):
        write(out)
    assert not out.exists() or names(out) == []


def test_disk_full_for_the_json(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(GffeError, match=r"sequence.json: cannot be written"):
        write(tmp_path / "out")
    assert names(tmp_path) == []


def test_replaces_an_older_output(tmp_path):
    out = write(tmp_path / "out", 4)
    (out / "notes.txt").write_text("mine")
    with SequenceWriter(out, W, H, 30) as writer:
        assert not (out / "sequence.json").exists()
        writer.add(rendered(0), named_channels(*pixels(7)))
    assert names(out) == ["frame_0.exr", "notes.txt", "sequence.json"]
    sequence = open_sequence(out)
    assert np.array_equal(sequence.read_color(sequence.frames[0]), pixels(7)[0])


def test_replaces_a_killed_output(tmp_path):
    writer = SequenceWriter(tmp_path, W, H, 30).__enter__()
    for i in range(3):
        writer.add(rendered(i), named_channels(*pixels(i)))
    writer._pool.shutdown()  # and then kill -9: no sequence.json
    assert len(list(tmp_path.glob("*.exr"))) == 3
    with SequenceWriter(tmp_path, W, H, 30) as writer:
        writer.add(rendered(1), named_channels(*pixels()))
    assert names(tmp_path) == ["frame_1.exr", "sequence.json"]


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


def test_header_of_written_file(folder):
    (part,) = read_header(folder / "frame_1.exr", "").parts
    assert part.size == (W, H) and part.compression == 3
    assert part.channels == {
        **dict.fromkeys("BGR", "float16"),
        **dict.fromkeys(["Z", "motion.x", "motion.y"], "float32"),
    }
    assert set(part.matrices) == {"worldToCamera", "worldToNDC"}
