"""Registry of all supported formats of captures, and their recognition by the files in a folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gffe_cl.captures.formats import blender, folder, unreal
from gffe_cl.captures.sequence.description import FILE_NAME
from gffe_cl.captures.sequence.output_folder import PART, why_unfinished
from gffe_cl.captures.sequence.reader import Sequence, open_sequence
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import is_video
from gffe_cl.engine.core.validation import require_path


@dataclass(frozen=True)
class Format:
    """A form of captures on disk, with its name, description and example."""

    name: str
    sentence: str
    example: str  # what the folder holds
    recognizes: Callable[[Path], bool]  # a folder that has no sequence.json, by the names of its files
    open: Callable[[Path], Sequence]


_JSON_FILES = (FILE_NAME, blender.FILE_NAME)
FORMATS = {
    one.name: one
    for one in (
        Format(
            "gffe-sequence",
            "The project's own form, which every command writes: sequence.json and one EXR per frame",
            "sequence.json\nframe_000000.exr\ntruth_000000_0500.exr …",
            lambda folder: False,
            open_sequence,
        ),
        Format(
            "gffe-folder",
            "Images of any convention, EXR, PNG or NPY, which a short sequence.json describes (docs/formats.md)",
            'sequence.json: {"format": "gffe-folder", …}\ncolor/0000.png …\ndepth/0000.exr …\nmotion/0000.npy …',
            lambda folder: False,
            folder.open_folder,
        ),
        Format(
            "blender",
            "Blender (Cycles): multilayer EXR, with the cameras.json of docs/blender/export_gffe.py",
            "cameras.json\nframe_0000.exr\nframe_0001.exr …",
            blender.is_blender,
            blender.open_blender,
        ),
        Format(
            "unreal",
            "Unreal's Movie Render Queue: multilayer EXR with the passes WorldDepth and MotionVectors",
            "Shot.0000.exr\nShot.0001.exr …",
            unreal.is_unreal,
            unreal.open_unreal,
        ),
    )
}


def open_capture(path: str | os.PathLike[str]) -> Sequence:
    """Open the capture in the folder `path` (or whose JSON file is `path`), of any form in `gffe formats`, and return
    it as a `Sequence`. The form is recognized by the files.

    Everything that can be checked without decoding pixels is checked. Frames are converted to our own conventions, so
    the result is like that of `open_sequence`. Raises GffeError, also for a folder of no known form.
    """
    path = require_path(path, "open_capture: path")
    place = path.parent if path.name in _JSON_FILES and not path.is_dir() else path
    try:
        if is_video(path) and path.is_file():
            needed = "expected a capture with these, see `gffe formats`"
            raise GffeError(f"{path}: a video has no depth, motion vectors and cameras ({needed})")
        if not place.is_dir():
            return open_sequence(path)
        described = place / FILE_NAME
        if described.exists():
            opened = folder.open_folder if folder.is_folder(described) else open_sequence
            return opened(place)
        known = next((one for one in FORMATS.values() if one.recognizes(place)), None)
    except OSError as error:
        raise GffeError(f"{path}: cannot be read ({error.strerror or error})") from None
    if known is None:
        if why_unfinished(place):
            return open_sequence(place)  # says so
        raise GffeError(
            f"{path}: no {FILE_NAME} in this folder, and no other known form (expected one of `gffe formats`)"
        )
    return known.open(place)


def captures_in(folder: Path) -> list[Path]:
    """Return the folders in `folder` that hold captures, by name; none if it is no folder, or a capture itself. Folders
    that a run is writing into are left out."""
    if not folder.is_dir() or _is_capture(folder):
        return []
    return [one for one in sorted(folder.iterdir()) if one.is_dir() and one.suffix != PART and _is_capture(one)]


def _is_capture(folder: Path) -> bool:
    try:
        return (folder / FILE_NAME).exists() or any(one.recognizes(folder) for one in FORMATS.values())
    except OSError:
        return False
