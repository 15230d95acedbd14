"""Every structural fault is one line that says what is wrong and where."""

import numpy as np
import OpenEXR
import pytest
from tiny_sequence import H, W, contiguous, edit, pixels, write

from gffe_cl.errors import GffeError
from gffe_cl.sequence import (
    named_channels,
    open_sequence,
)
from gffe_cl.sequence.exr_header import _Cursor, _parse


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "sequence")


def fault(folder):
    with pytest.raises(GffeError) as info:
        open_sequence(folder)
    assert "\n" not in str(info.value)
    return str(info.value)


@pytest.mark.parametrize("keep", [0, 3, 20, 150, 0.5, 0.9, -10, -1])
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
    with pytest.raises(GffeError, match=r"^frame_2.exr: damaged"):
        sequence.read(sequence.rendered[2])
    path.write_bytes(b"P6 480 270 255 not an exr at all")
    assert fault(folder) == "frame_2.exr: not an OpenEXR file"
    table = _parse(_Cursor(data))[0].end
    path.write_bytes(data[:table] + b"\0" * 8 + data[table + 8 :])
    assert "incomplete, 1 of 1 chunks" in fault(folder)


def test_missing_file_and_folder(folder, tmp_path):
    (folder / "truth_1.exr").unlink()
    assert fault(folder).startswith("truth_1.exr: no such file")
    (folder / "sequence.json").unlink()
    assert "no sequence.json in this folder" in fault(folder)
    assert "no such folder" in fault(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["Z", "R", "motion.y"])
def test_missing_channel(folder, name):
    channels = contiguous(named_channels(*pixels(1)))
    del channels[name]
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(folder / "frame_1.exr"))
    needed = "R, G, B, Z, motion.x, motion.y"
    assert fault(folder) == f"frame_1.exr: no channel '{name}' (rendered frames need {needed})"


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
    "non-finite camera": (set_camera({"fx": float("nan")}), "not finite"),
    "infinite camera": (set_camera({"cx": 1e999}), "not finite"),
    "huge camera": (set_camera({"cx": 10**400}), "not finite"),
    "camera of text": (set_camera({"fy": "wide"}), "must be numbers"),
    "3×3 camera": (set_camera({"world_to_view": [[1, 0, 0]] * 3}), "must be 4×4"),
    "camera without fx": (lambda d: d["frames"][2]["render_camera"].pop("fx"), "must have world_to_view"),
    "camera no object": (lambda d: d["frames"][2].update(render_camera=[1]), "must have world_to_view"),
    "same time": (lambda d: d["frames"][2].update(time=d["frames"][1]["time"]), "times must increase"),
    "time going back": (lambda d: d["frames"][2].update(time=-1), "times must increase"),
    "time NaN": (lambda d: d["frames"][2].update(time=float("nan")), "time must be a finite number"),
    "time missing": (lambda d: d["frames"][2].pop("time"), "time must be a finite number, got nothing"),
    "unknown kind": (lambda d: d["frames"][2].update(kind="drawn"), "kind must be one of"),
    "kind a list": (lambda d: d["frames"][2].update(kind=["rendered"]), "kind must be one of"),
    "reset a number": (lambda d: d["frames"][2].update(reset=1), "reset must be true or false"),
    "size of one": (lambda d: d["frames"][2].update(render_size=[W]), r"render_size must be"),
    "size zero": (lambda d: d["frames"][2].update(render_size=[0, H]), "whole pixels"),
    "alpha": (lambda d: d["frames"][2].update(alpha=0), "alpha must be greater than 0"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_frame(folder, name):
    change, expected = BROKEN[name]
    edit(folder, change)
    message = fault(folder)
    assert message.startswith("sequence.json, frame 2 (frame_1.exr)") and expected in message


@pytest.mark.parametrize("file", ["../frame_1.exr", "/etc/passwd", "a/../../b.exr", "..\\b.exr", "C:\\b.exr", "", 7])
def test_paths_stay_inside(folder, file):
    edit(folder, lambda d: d["frames"][2].update(file=file))
    message = fault(folder)
    assert "frame 2" in message and ("stay inside" in message or "must be the name" in message)


@pytest.mark.parametrize(
    "change, expected",
    [
        ({"version": 2}, "unknown version 2 (expected 1)"),
        ({"version": None}, "unknown version nothing"),
        ({"format": "film"}, "not a sequence"),
        ({"width": 0}, "width must be whole pixels"),
        ({"height": 9.5}, "height must be whole pixels"),
        ({"fps": 0}, "fps must be greater than 0"),
        ({"exposure": "bright"}, "exposure must be a finite number"),
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


def test_no_camera_at_all(folder):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, contiguous(named_channels(*pixels(1)))).write(
        str(folder / "frame_1.exr")
    )
    edit(folder, lambda d: d["frames"][2].pop("render_camera"))
    assert fault(folder).startswith("sequence.json, frame 2 (frame_1.exr): no render_camera")
    broken = {name: np.zeros((4, 4), np.float32) for name in ("worldToCamera", "worldToNDC")}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **broken}, contiguous(named_channels(*pixels(1)))).write(
        str(folder / "frame_1.exr")
    )
    assert "EXR header, camera: world_to_view is singular" in fault(folder)


def test_extrapolated_frames_may_coincide(folder):
    """With α = 1 an extrapolated frame has the time of the next rendered one."""

    def change(document):
        frames = document["frames"]
        frames.insert(3, {"file": "truth_0.exr", "kind": "extrapolated", "time": frames[2]["time"], "alpha": 1})

    edit(folder, change)
    assert open_sequence(folder).extrapolated[0].alpha == 1
