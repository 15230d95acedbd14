"""All forms of captures that are read, and how one is told from another: by what is in the folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gffe_cl.errors import GffeError
from gffe_cl.formats import blender
from gffe_cl.sequence.description import FILE_NAME
from gffe_cl.sequence.reader import Sequence, open_sequence


@dataclass(frozen=True)
class Format:
    """A form of captures on disk."""

    name: str
    sentence: str
    example: str  # what the folder holds
    recognises: Callable[[Path], bool]  # by the names of files and their first bytes; never raises GffeError
    open: Callable[[Path], Sequence]


FORMATS = {
    one.name: one
    for one in (
        Format(
            "blender",
            "Blender (Cycles): multilayer EXR, with the cameras.json of docs/blender/export_gffe.py",
            "cameras.json\nframe_0000.exr\nframe_0001.exr …",
            blender.is_blender,
            blender.open_blender,
        ),
        Format(
            "gffe-sequence",
            "the project's own: what every command writes",
            "sequence.json\nframe_000000.exr\ntruth_000000_0500.exr …",
            lambda folder: True,
            open_sequence,
        ),
    )
}


def open_capture(path) -> Sequence:
    """Open the capture in the folder `path` (or whose JSON file is `path`), of any form in `gffe formats`:
    which one it is, its files tell.

    Everything that can be checked without decoding pixels is. Frames are read in our own conventions, whatever theirs
    are: a `Sequence` as `open_sequence` gives it. Raises GffeError, also for a folder of no known form.
    """
    path = Path(path)
    folder = path.parent if path.suffix == ".json" and not path.is_dir() else path
    try:
        if not folder.is_dir() or (folder / FILE_NAME).exists():
            return open_sequence(path)
        known = next(one for one in FORMATS.values() if one.recognises(folder))
    except OSError as error:
        raise GffeError(f"{path}: cannot be read ({error.strerror or error})") from None
    return known.open(folder)
