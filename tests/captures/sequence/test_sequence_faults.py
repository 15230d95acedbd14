"""Every structural fault is one line that says what is wrong and where."""

import numpy as np
import OpenEXR
import pytest
from tiny_sequence import H, W, contiguous, edit, pixels, write

from gffe_cl.captures.sequence import named_channels, open_sequence
from gffe_cl.captures.sequence.exr import _Cursor, _parse
from gffe_cl.engine.core.errors import GffeError


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "sequence")


def fault(folder):
    with pytest.raises(GffeError) as info:
        open_sequence(folder)
    assert "\n" not in str(info.value)
    return str(info.value)


@pytest.mark.parametrize("keep", [3, 150, 0.5, -1])
def test_truncated(folder, keep, capfd):
    path = folder / "frame_2.exr"
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))] if isinstance(keep, float) else data[:keep])
    message = fault(folder)
    assert message.startswith("frame_2.exr: ") and ("truncated" in message or "not an OpenEXR" in message)
    assert capfd.readouterr() == ("", "")  # the library was never asked


def test_truncated_after_opening(folder):
    sequence = open_sequence(folder)
    path = folder / "frame_2.exr"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(GffeError, match=r"^frame_2.exr: truncated"):
        sequence.read(sequence.rendered[2])


def test_damaged_and_unfinished(folder):
    path = folder / "frame_2.exr"
    flat = dict.fromkeys(named_channels(*pixels()), np.ones((H, W), np.float32))  # so that it is compressed
    OpenEXR.File({"type": OpenEXR.scanlineimage}, flat).write(str(path))
    data = path.read_bytes()
    path.write_bytes(data[:-15] + b"\xff" * 15)
    sequence = open_sequence(folder)
    with pytest.raises(GffeError, match=r"^frame_2.exr: damaged, the pixels cannot be decoded") as info:
        sequence.read(sequence.rendered[2])
    assert "\n" not in str(info.value)
    path.write_bytes(b"P6 480 270 255 not an exr at all")
    assert fault(folder) == "frame_2.exr: not an OpenEXR file"
    table = _parse(_Cursor(data)).end
    path.write_bytes(data[:table] + b"\0" * 8 + data[table + 8 :])
    sequence = open_sequence(folder)  # nothing but the table is missing
    assert (sequence.read(sequence.rendered[2]).depth == 1).all()
    path.write_bytes(path.read_bytes()[:-1])
    assert "incomplete, 1 of 1 chunks" in fault(folder)


def test_names_are_shown_escaped(folder):
    """Neither a line break nor a terminal's control sequence of a file's name gets through."""
    name = "a\n\x1b[31mred\u202e.exr"
    edit(folder, lambda d: d["frames"][2].update(file=name))
    assert fault(folder).startswith(r"a\n\x1b[31mred\u202e.exr: no such file")
    edit(folder, lambda d: d["frames"][2].update(file="half \ud800.exr"))
    assert "file must be the name of an EXR file" in fault(folder)
    edit(folder, lambda d: d["frames"][2].update(file="not UTF-8 \udcff.exr"))  # but a name on disk
    assert fault(folder).startswith(r"not UTF-8 \udcff.exr: no such file")
    for name in ("../\x1b[2J", "\n/../.."):
        edit(folder, lambda d, name=name: d["frames"][2].update(file=name))
        assert fault(folder).isprintable()


def test_missing_file_and_folder(folder, tmp_path):
    (folder / "truth_1.exr").unlink()
    assert fault(folder).startswith("truth_1.exr: no such file")
    (folder / "sequence.json").unlink()
    assert "no sequence.json in this folder" in fault(folder)
    assert "no such folder" in fault(tmp_path / "nowhere")
    frame = folder / "frame_0.exr"
    assert fault(frame) == f"{frame}: not a folder (expected a folder with sequence.json, or that file)"


@pytest.mark.parametrize("name", ["Z", "R", "motion.y"])
def test_missing_channel(folder, name):
    channels = contiguous(named_channels(*pixels(1)))
    del channels[name]
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(folder / "frame_1.exr"))
    expected = f"frame_1.exr: no channel '{name}' (expected R, G, B, Z, motion.x, motion.y; the file holds "
    assert fault(folder).startswith(expected)


def test_missing_named_channel(folder):
    sequence = open_sequence(folder)
    with pytest.raises(GffeError, match=r"truth_0.exr: no channel 'mask.x'"):
        sequence.read_channels(sequence.ground_truth[0], ["mask.x"])
    with pytest.raises(GffeError, match=r"expected a rendered frame"):
        sequence.read(sequence.ground_truth[0])


@pytest.mark.parametrize("file", ["frame_1.exr", "truth_1.exr"])
def test_wrong_size(folder, file):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, contiguous(named_channels(*pixels(1, H + 1)))).write(
        str(folder / file)
    )
    assert fault(folder) == f"{file}: {W}×{H + 1} pixels, expected {W}×{H}"


def set_camera(value):
    return lambda d: d["frames"][2]["render_camera"].update(value)


BROKEN = {
    "singular camera": (set_camera({"world_to_view": [[0] * 4] * 3 + [[0, 0, 0, 1]]}), "singular"),
    "non-finite camera": (set_camera({"fx": float("nan")}), "must be a finite number"),
    "matrix of text": (set_camera({"world_to_view": np.eye(4).astype(str).tolist()}), "of numbers"),
    "camera without fx": (lambda d: d["frames"][2]["render_camera"].pop("fx"), "must have world_to_view"),
    "camera no object": (lambda d: d["frames"][2].update(render_camera=[1]), "must have world_to_view"),
    "same time": (lambda d: d["frames"][2].update(time=d["frames"][1]["time"]), "times must increase"),
    "time NaN": (lambda d: d["frames"][2].update(time=float("nan")), "time must be a finite number"),
    "time missing": (lambda d: d["frames"][2].pop("time"), "time must be a finite number, got nothing"),
    "unknown kind": (lambda d: d["frames"][2].update(kind="drawn"), "kind must be one of"),
    "reset a number": (lambda d: d["frames"][2].update(reset=1), "reset must be True or False"),
    "size zero": (lambda d: d["frames"][2].update(render_size=[0, H]), "whole pixels"),
    "alpha": (lambda d: d["frames"][2].update(alpha=0), "alpha must be greater than 0"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_frame(folder, name):
    change, expected = BROKEN[name]
    edit(folder, change)
    message = fault(folder)
    assert message.startswith("sequence.json, frame 2 (frame_1.exr)") and expected in message


@pytest.mark.parametrize(
    "change, expected",
    [
        ({"version": 3}, "unknown version 3 (expected 1 or 2)"),
        ({"version": None}, "unknown version nothing"),
        ({"format": "film"}, "not a sequence"),
        ({"width": 0}, "width must be a whole number"),
        ({"height": 9.5}, "height must be a whole number"),
        ({"fps": 0}, "fps must be greater than 0"),
        ({"exposure": 0}, "exposure must be a finite number from 1e-06 to 1e+06"),
        ({"fps": True}, "fps must be a finite number"),
        ({"width": True}, "width must be a whole number"),
        ({"unfinished": 1}, "unfinished must be True or False"),
        ({"frames": []}, "at least one frame"),
        ({"frames": [3]}, "frame 0: must be an object"),
    ],
)
def test_broken_document(folder, change, expected):
    edit(folder, lambda d: d.update(change))
    assert fault(folder).startswith("sequence.json") and expected in fault(folder)


@pytest.mark.parametrize("text", [b"", b"{", b'{"format": ', b"[1]", b"\xff\xfe{}", b"[" * 100000])
def test_unreadable_json(folder, text):
    (folder / "sequence.json").write_bytes(text)
    assert "sequence.json: not" in fault(folder)


def test_sizes_that_change_are_named_at_opening(folder):
    edit(folder, lambda said: said["frames"][2].update(render_size=[W + 1, H]))
    edit(folder, lambda said: said["frames"][4].update(render_size=[W + 2, H]))
    for file, width in (("frame_1.exr", W + 1), ("frame_2.exr", W + 2)):
        channels = contiguous(named_channels(*pixels(1, H, width)))
        OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(folder / file))
    said = rf"one size \(frame_0.exr is {W}×{H}, frame_1.exr is {W + 1}×{H}\)"
    with pytest.raises(GffeError, match=rf"{folder}: rendered frames must have {said}"):
        open_sequence(folder)


def test_no_camera_at_all(folder):
    edit(folder, lambda d: d["frames"][2].pop("render_camera"))
    assert fault(folder).startswith("sequence.json, frame 2 (frame_1.exr): no render_camera")


def test_extrapolated_frames_may_coincide(folder):
    """With α = 1 an extrapolated frame has the time of the next rendered one."""

    def change(document):
        frames = document["frames"]
        frames.insert(3, {"file": "truth_0.exr", "kind": "extrapolated", "time": frames[2]["time"], "alpha": 1})

    edit(folder, change)
    assert open_sequence(folder).extrapolated[0].alpha == 1
