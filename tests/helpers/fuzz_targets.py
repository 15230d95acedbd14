"""Targets of fuzzing (test_fuzz.py): small valid inputs of everything that comes from outside, what
reads them, and mutations. A target takes bytes and must end well or with a GffeError of one line, else it is a fault.
"""

import copy
import json
import os
import shutil
import struct
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from foreign import Shot, write_blender
from foreign_sets import write_unreal
from PIL import Image

from gffe_cl import GffeError, open_capture
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.engine.core.errors import MOST
from gffe_cl.engine.frame.frame_format import FrameFormat
from gffe_cl.engine.selftest.scene import FPS, frames

W, H, COUNT = 12, 9, 2


@cache
def seen():
    return frames(W, H, count=COUNT, samples=1)


# ---- valid captures, one of each form: writers return the folder that is opened ----------------------------


def shots():
    return [Shot(f.time, "rendered", f.color, f.depth, f.motion, f.camera) for f in seen()]


def write_sequence(folder):
    with SequenceWriter(folder, W, H, FPS) as writer:
        for k, frame in enumerate(seen()):
            entry = FrameEntry(f"frame_{k}.exr", frame.time, reset=k == 0, render_camera=frame.camera)
            writer.add(entry, named_channels(frame.color, frame.depth, frame.motion))
    return folder


def write_encoded(folder):
    """Write a sequence as an engine stores it, with geometry of half the size, and return its folder."""
    given = FrameFormat(depth="logarithmic", near_z=0.01, far_z=100.0, motion_scale=(-1.0, 1.0), motion_dilated=True)
    with SequenceWriter(folder, W, H, FPS, format=given) as writer:
        for k, frame in enumerate(seen()):
            entry = FrameEntry(f"frame_{k}.exr", frame.time, reset=k == 0, render_camera=frame.camera)
            depth, motion = (np.ascontiguousarray(image[::2, ::2]) for image in (frame.depth / 100, frame.motion))
            size = {"geometry_size": depth.shape[::-1], "geometry_jitter": (0.25, -0.25)}
            writer.add_frame(entry, replace(frame, depth=depth, motion=motion, **size))
    return folder


def write_folder(folder):
    cameras = []
    for k, frame in enumerate(seen()):
        color = np.clip(frame.color.astype(np.float32) * 255, 0, 255).astype(np.uint8)
        Image.fromarray(color).save(folder / f"color_{k}.png")
        np.save(folder / f"depth_{k}.npy", frame.depth)
        np.save(folder / f"motion_{k}.npy", frame.motion)
        fx, fy, cx, cy = frame.camera.intrinsics
        cameras.append({"view": frame.camera.world_to_view.tolist(), "fx": fx, "fy": fy, "cx": cx, "cy": cy})
    document = {
        **{"format": "gffe-folder", "version": 2, "width": W, "height": H, "fps": FPS},
        **{"frames": {"first": 0, "count": COUNT}, "cameras": {"list": cameras}},
        **{"files": {"color": "color_%d.png", "depth": "depth_%d.npy", "motion": "motion_%d.npy"}},
    }
    (folder / "sequence.json").write_text(json.dumps(document))
    return folder


WRITERS = {
    "sequence": write_sequence,
    "encoded": write_encoded,
    "folder": write_folder,
    "blender": lambda folder: write_blender(folder, shots(), multi_part=False, data="ViewLayer"),
    "unreal": lambda folder: write_unreal(folder, shots()) and folder,
}
# Which file of each form is mutated, below the folder that the writer gets.
FILES = {
    "sequence": ("sequence.json", "frame_1.exr"),
    "encoded": ("sequence.json", "frame_1.exr"),
    "folder": ("sequence.json", "color_1.png", "depth_1.npy"),
    "blender": ("cameras.json", "frame_0001.exr"),
    "unreal": ("Shot.0018.exr",),
}


# ---- targets -----------------------------------------------------


@dataclass(frozen=True)
class Target:
    """`read` takes bytes, such as `seed`, or what `mutated` makes of it."""

    seed: bytes
    read: Callable[[bytes], None]
    is_json: bool = False


_valid = tempfile.TemporaryDirectory(prefix="gffe-fuzz-")


@cache
def valid(form):
    """Return a folder with a valid capture, and the folder in it that is opened."""
    root = Path(_valid.name) / form
    root.mkdir()
    return root, WRITERS[form](root).relative_to(root)


def read_capture(form, file, data):
    """Open a capture in which one file holds `data`, and read all of its frames."""
    root, inside = valid(form)
    with tempfile.TemporaryDirectory(prefix="gffe-fuzz-", dir=_valid.name) as temporary:
        copied = shutil.copytree(root, Path(temporary) / "in", copy_function=os.link)
        (copied / file).unlink()
        (copied / file).write_bytes(data)
        opened = open_capture(copied / inside)
        for entry in opened.rendered:
            opened.read(entry)
        opened.warnings()


# Names of frames, of which the number is a part; "{}" is the number.
@cache
def targets():
    """Return targets by name, such as "sequence:frame_1.exr"."""
    found = {}
    for form, files in FILES.items():
        for file in files:

            def read(data, form=form, file=file):
                read_capture(form, file, data)

            data = (valid(form)[0] / file).read_bytes()
            found[f"{form}:{Path(file).name}"] = Target(data, read, file.endswith(".json"))
    return found


def check(target, data):
    """Read `data`; raises, AssertionError or whatever it is, unless it ends well or with a GffeError of one line, and
    without warnings of NumPy's, which users would see."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            target.read(data)
        except GffeError as error:
            text = str(error)
            assert "\n" not in text and len(text) <= MOST, f"not one line: {text[:300]!r}"


# ---- mutations ---------------------------------------------------

VALUES = (
    None, True, False, 0, -1, 1, 2, 0.5, -0.0, 1e300, -1e300, 1e308, 2**31, 2**63, 10**400, float("nan"), float("inf"),
    "", "0", "nan", "../x", "/etc/passwd", "frame_0.exr", "a\0b", "%d", "%s%n", "\ud800", "é" * 300, [], {}, [[]],
    {"fx": 1}, [1, 2], [0] * 16, [[0, 0, 0, 0]] * 4, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
)  # fmt: skip
WORDS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7F800000, 0x7FC00000, 0x41414141)


def mutated(target, data, rng):
    """Return `data` with one to four changes."""
    for _ in range(int(rng.integers(1, 5))):
        change = json_mutated if target.is_json and rng.integers(4) else bytes_mutated
        data = change(data, rng)
    return data


def json_mutated(data, rng):
    """Return JSON with another value, without one, with one twice or with a key renamed; bytes are changed where it is
    no JSON."""
    try:
        document = json.loads(data)
        places = [((), document)]
        for path, value in places:  # grows meanwhile
            children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
            places += [((*path, key), child) for key, child in children]
    except (ValueError, RecursionError):
        return bytes_mutated(data, rng)
    path, _ = places[int(rng.integers(len(places)))]
    value = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
    if not path:
        document = value if rng.integers(4) == 0 else document
        return json.dumps(document).encode()
    parent = document
    for key in path[:-1]:
        parent = parent[key]
    kind = int(rng.integers(6))
    if kind == 0:
        del parent[path[-1]]
    elif kind == 1 and isinstance(parent, dict):
        parent[str(path[-1]) + "x"] = parent.pop(path[-1])
    elif kind == 1:
        parent.append(parent[path[-1]])
    elif kind == 2 and isinstance(parent[path[-1]], int | float) and abs(parent[path[-1]]) < 1e300:
        parent[path[-1]] = parent[path[-1]] * float(rng.choice([-1, 0, 1e-9, 1e9, 1.5]))
    else:
        parent[path[-1]] = value
    return json.dumps(document).encode()


def bytes_mutated(data, rng):
    if not data:
        return bytes(rng.integers(0, 256, 8, np.uint8))
    data, kind = bytearray(data), int(rng.integers(7))
    # Headers are at the start: half of the changes go there.
    at = int(rng.integers(min(len(data), 400) if rng.integers(2) else len(data)))
    if kind == 0:
        data[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        data[at] = int(rng.choice([0, 1, 0x7F, 0x80, 0xFF, 0x20, 0x2D]))
    elif kind == 2:
        form = str(rng.choice(["<I", ">I", "<H", "<Q"]))
        word = int(rng.choice(WORDS)) & (256 ** struct.calcsize(form) - 1)
        data[at : at + struct.calcsize(form)] = struct.pack(form, word)
    elif kind == 3:
        del data[at:]
    elif kind == 4:
        del data[at : at + int(rng.integers(1, 16))]
    elif kind == 5:
        data[at:at] = data[at : at + int(rng.integers(1, 64))]
    else:
        data[at:at] = bytes(rng.integers(0, 256, int(rng.integers(1, 9)), np.uint8))
    return bytes(data)
