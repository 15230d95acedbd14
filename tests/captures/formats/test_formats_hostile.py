"""Captures that are made to hurt: a clear error at once, bounded memory, nothing written outside the output folder."""

import json
import struct
import time
import tracemalloc
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from foreign import H, W, edit_json, shots, write_blender, write_exr

from gffe_cl import GffeError, open_capture
from gffe_cl.captures.sequence.exr import ExrHeader, ExrPart, decoded
from gffe_cl.cli import commands

SECONDS, BYTES = 2, 100e6


def refused(path, words):
    tracemalloc.start()
    start = time.thread_time()
    try:
        with pytest.raises(GffeError, match=words) as error:
            open_capture(path)
        assert "\n" not in str(error.value) and len(str(error.value)) < 600
        assert time.thread_time() - start < SECONDS and tracemalloc.get_traced_memory()[1] < BYTES
    finally:
        tracemalloc.stop()


@pytest.fixture
def folder(tmp_path):
    return write_blender(tmp_path / "in", shots(), multi_part=False)


def window(name, box):
    """Replaces a window in the bytes of a header."""

    def change(data):
        at = data.index(name + b"\0box2i\0") + len(name) + 1 + 6 + 4
        return data[:at] + struct.pack("<4i", *box) + data[at + 16 :]

    return change


MOST = 2**31 - 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (window(b"dataWindow", (0, 0, MOST, MOST)), "at most 1048576 a side"),
        (window(b"dataWindow", (-(2**31), -(2**31), MOST, MOST)), "at most 1048576 a side"),
        (window(b"dataWindow", (0, 0, 600_000, 600_000)), "truncated|incomplete"),
        (window(b"dataWindow", (5, 5, 4, 4)), "damaged EXR header"),
        (window(b"dataWindow", (0, 0, -2, -2)), "damaged EXR header"),
        (window(b"displayWindow", (0, 0, -1, -1)), r"display window 0 0 -1 -1 is empty \(expected x0 ≤ x1"),
        (window(b"displayWindow", (-(2**31), 0, MOST, 3)), "pixels, expected 97×55"),
        (lambda data: data[:8] + b"x\0string\0" + struct.pack("<i", MOST) + data[8:], "truncated"),
        (lambda data: data[:8] + b"x\0string\0" + struct.pack("<i", -7) + data[8:], "damaged EXR header"),
        (lambda data: data[:8] + b"x" * 70_000 + data[8:], "damaged EXR header|truncated"),
        (lambda data: data[:8], "truncated"),
        (lambda data: b"", "truncated|not an OpenEXR file"),
        (lambda data: data[:4] + b"\xff\xff\xff\xff" + data[8:], "damaged|truncated|deep|incomplete"),
    ],
)
def test_headers(folder, change, words):
    path = folder / "frame_0002.exr"
    path.write_bytes(change(path.read_bytes()))
    refused(folder, rf"^frame_0002\.exr: .*({words})")


def test_thousands_of_channels(folder):
    names = b"".join(f"c{k:06d}".encode() + b"\0" + struct.pack("<iIii", 1, 0, 1, 1) for k in range(20_000)) + b"\0"
    path = folder / "frame_0000.exr"
    whole = path.read_bytes()
    at = whole.index(b"channels\0chlist\0") + 16
    (length,) = struct.unpack("<i", whole[at : at + 4])
    path.write_bytes(whole[:at] + struct.pack("<i", len(names)) + names + whole[at + 4 + length :])
    refused(folder, "at most 4096 channels")


def test_large_parts_that_nobody_asks_for_are_not_decoded():
    """The library decodes all parts of a file."""
    frame = ExrPart(channels={"R": "float16"}, data_window=(0, 0, W - 1, H - 1))
    unused = ExrPart(channels={"A": "float32"}, data_window=(0, 0, 8191, 8191))
    with pytest.raises(GffeError, match=rf"256 MiB to decode \(expected at most 64 MiB for {H * W} pixels\)"):
        decoded(Path("a.exr"), ExrHeader([frame, unused]), [(0, "R")], "a.exr")


def test_bombs_of_zeros_that_the_json_does_not_announce(folder):
    zeros = np.zeros((2000, 2000), np.float16)
    write_exr(folder / "frame_0002.exr", dict.fromkeys("RGB", zeros), compression=OpenEXR.ZIP_COMPRESSION)
    refused(folder, r"frame_0002\.exr: .*(Depth|2000×2000)")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"width": ' + "9" * 5000 + "}", "not valid JSON|whole number"),
        ('{"width": 1e999, "height": 3, "frames": [1]}', "whole number"),
        ("[" * 200_000, "not valid JSON"),
        ('{"a":' * 50_000, "not valid JSON"),
        ("\x00\x01", "not valid JSON"),
        ('{"width": 3, "height": 3, "frames": ' + json.dumps([0] * 140_000) + "}", "1 to 131072 frames"),
        ('{"width": 70000, "height": 3, "frames": [1]}', "from 1 to 32768"),
    ],
)
@pytest.mark.parametrize("name", ["cameras.json", "sequence.json"])
def test_json(tmp_path, name, text, words):
    start = '{"format": "gffe-folder", "version": 2, ' if name == "sequence.json" and text.startswith('{"width') else ""
    (tmp_path / name).write_text(start + (text[1:] if start else text))
    refused(tmp_path, f"({words}|not a sequence|must be an object|is missing|frames must be)")


@pytest.mark.parametrize("number", ["1e308", "1e-320", "NaN"])
def test_numbers_of_cameras(folder, number):
    for k, name in enumerate(("fx", "cx", "time")):
        text = (folder / "cameras.json").read_text()
        changed = json.loads(text)
        changed["frames"][1][name] = "PLACE"
        (folder / "cameras.json").write_text(json.dumps(changed).replace('"PLACE"', number))
        if number == "1e-320" and name != "fx":
            open_capture(folder) if k == 1 else None  # a small number as good as 0
        else:
            refused(folder, "cameras.json, frame 1|times must increase|listed")
        (folder / "cameras.json").write_text(text)
    edit_json(folder / "cameras.json", lambda d: d["frames"][1]["world_to_camera"][0].__setitem__(0, 7e77))
    refused(folder, "cameras.json, frame 1")


@pytest.mark.parametrize(
    "name",
    ["../escaped.exr", "/etc/passwd", "a/../../b.exr", "..\\b.exr", "C:\\b.exr", "sequence.json", "", "x\0y", "\ud800"],
)
def test_names_out_of_the_folder(folder, tmp_path, name):
    edit_json(folder / "cameras.json", lambda d: d["frames"][1].update(file=name))
    before = sorted(tmp_path.rglob("*"))
    refused(folder, "cameras.json, frame 1")
    for words in (["import", str(folder), str(tmp_path / "out")], ["run", str(folder), str(tmp_path / "out")]):
        with pytest.raises(GffeError):
            commands.invoke(words)
    assert sorted(tmp_path.rglob("*")) == before
