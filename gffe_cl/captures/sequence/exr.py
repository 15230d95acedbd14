"""Reader and writer of the pixels of OpenEXR files: it reads those of any writer, and writes our own. Sources of a
sequence's pixels: EXR files of our own form, or a foreign capture's.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Protocol

import numpy as np
import OpenEXR

from gffe_cl.captures.sequence.description import FrameEntry
from gffe_cl.captures.sequence.exr_header import ExrHeader, ExrPart, read_header
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import require_moderate
from gffe_cl.engine.core.validation import as_float32, require_choice
from gffe_cl.engine.frame.rendered_frame import Overlays, color_of_planes

_FLOAT_CHANNELS = ("Z", "motion.")  # always float32; any other channel keeps half if it is half
_BYTES = {"uint32": 4, "float16": 2, "float32": 4}
_HALVES = np.arange(256, dtype=np.float16)  # of small integers

COMPRESSIONS = {  # the library's name in lower case, and its use
    "none": "largest, quickest",
    "rle": "quick; only even areas get smaller",
    "zips": "as zip, line by line",
    "zip": "16 lines at a time; small, read by every program",
    "piz": "for grainy images",
    "htj2k256": "two thirds of zip's time; only programs with OpenEXR 3.4 or newer read it",
    "dwaa": "colors are approximated, everything else is exact; smallest",
    "dwab": "as dwaa, 256 lines at a time",
}
DEFAULT_COMPRESSION = "zip"


def read_channels(path: Path, names, label: str, size=None) -> dict[str, np.ndarray]:
    """Return the channels `names` of the EXR file at `path` as (H, W) arrays, float16, float32 or uint32 as stored.

    `size` is the expected (width, height). Raises GffeError, beginning with `label`, for missing channels,
    another size, and files that are truncated or damaged.
    """
    header = read_header(path, label)
    places = require_channels(header, names, label)
    require_parts(header, {part for part, _ in places}, size, label)
    return dict(zip(names, decoded(path, header, places, label), strict=True))


def decoded(path: Path, header: ExrHeader, places: list[tuple[int, str]], label: str) -> list[np.ndarray]:
    """Return the channels at `places`, (part, name), of the EXR file at `path`, as `read_channels` does."""
    sides = [part.size for part in header.parts]
    nbytes = sum(
        width * height * sum(_BYTES[kind] for kind in part.channels.values())
        for part, (width, height) in zip(header.parts, sides, strict=True)
    )
    # The library decodes all parts at once, also unrequested ones.
    require_moderate(nbytes, max((math.prod(sides[part]) for part, _ in places), default=0), label)

    try:
        with OpenEXR.File(os.fsencode(path), separate_channels=True) as file:
            parts = [file.channels(i) for i in range(len(file.parts))]  # none if the library gave up, and printed why
            if len(parts) != len(header.parts):
                raise ValueError("corrupt pixel data")
            return [parts[part][name].pixels for part, name in places]
    except UnicodeDecodeError:
        raise GffeError(f"{label}: its header has text that is not UTF-8 (expected names of channels in it)") from None
    except Exception as error:
        raise GffeError(f"{label}: damaged, the pixels cannot be decoded ({_one_line(error)})") from None


def place_of(header: ExrHeader, name: str, label: str) -> tuple[int, str] | None:
    """Return (part, channel) of the channel `name`, None if there is none. Raises GffeError if
    several parts have one."""
    places = header.candidates(name)
    if len(places) > 1:
        parts = [header.parts[index].name or f"number {index}" for index, _ in places]
        raise GffeError(
            f"{label}: channel '{name}' is in the parts {_one_line(', '.join(parts[:6]))}"
            f" (expected part.channel, as in {_one_line(parts[-1])}.{name})"
        )
    return places[0] if places else None


def require_channels(header: ExrHeader, names, label: str) -> list[tuple[int, str]]:
    """Return (part, channel) for each of `names`. Raises GffeError for the first that is not there, or in several
    parts."""
    places = []
    for name in names:
        place = place_of(header, name, label)
        if place is None:
            held = _one_line(", ".join(header.channels[:12])) + (", …" if len(header.channels) > 12 else "")
            raise GffeError(f"{label}: no channel '{name}' (expected {', '.join(names)}; the file holds {held})")
        places.append(place)
    return places


def require_parts(header: ExrHeader, indices: Iterable[int], size, label: str) -> None:
    """Raise GffeError unless parts, given by their numbers, have one place and the size `size` = (width, height), and
    every pixel."""
    indices = set(indices)
    for part in header.parts:  # the library decodes all of them
        if part.compression >= int(OpenEXR.NUM_COMPRESSION_METHODS):
            raise GffeError(
                f"{label}: compression number {part.compression} is unknown to OpenEXR {OpenEXR.OPENEXR_VERSION}"
                " (expected zip, piz or none)"
            )
    if len({header.parts[index].data_window for index in indices}) > 1 and size is not None:
        windows = ", ".join(_one_line(header.parts[index].name or index) for index in sorted(indices))
        if len({header.parts[index].size for index in indices}) == 1:
            raise GffeError(f"{label}: the parts {windows} have several data windows (expected one)")
    for index in sorted(indices):
        part = header.parts[index]
        if part.subsampled:
            raise GffeError(f"{label}: subsampled channels are not supported")
        if size is not None and part.size != tuple(size):
            raise GffeError(f"{label}: {_by(part.size)} pixels, expected {_by(size)}")


def require_shown(header: ExrHeader, indices: Iterable[int], size: tuple[int, int], label: str) -> None:
    """Raise GffeError unless parts, given by their numbers, show images of `size` = (width, height): their display
    windows have it."""
    require_parts(header, indices, None, label)
    for part in (header.parts[index] for index in sorted(set(indices))):
        if part.shown_size != tuple(size):
            windows = f"a data window of {_by(part.size)} in a display window of {_by(part.shown_size)} pixels"
            pixels = f"{_by(part.size)} pixels" if part.size == part.shown_size else windows
            raise GffeError(f"{label}: {pixels}, expected {_by(size)}")


def placed(array: np.ndarray, part: ExrPart, outside: float) -> np.ndarray:
    """Return the image (H, W) of the display window of `part`, from that of its data window: cropped, and `outside`
    where nothing is stored."""
    (width, height), (left, top) = part.shown_size, part.offset
    if part.size == (width, height) and not (left or top):
        return array
    kind = array.dtype if array.dtype.kind == "f" or outside == 0 else np.dtype(np.float64)
    made = np.full((height, width), outside, kind)
    x, y, right, bottom = max(left, 0), max(top, 0), min(left + part.size[0], width), min(top + part.size[1], height)
    if x < right and y < bottom:
        made[y:bottom, x:right] = array[y - top : bottom - top, x - left : right - left]
    return made


def stored_type(name: str, array, copy: bool = True) -> np.ndarray:
    """Return `array` in the type in which channel `name` is stored: half stays half, small integers and masks become
    half, Z, motion and everything else float32. It is a copy, or with `copy` off perhaps `array` itself."""
    array = np.asarray(array)
    floats = name.startswith(_FLOAT_CHANNELS)
    if not floats and array.dtype in (np.uint8, np.bool_):
        return _HALVES.take(array.view(np.uint8))  # several times as fast as a conversion
    kept = not floats and array.dtype in (np.float16, np.uint32)
    made = np.ascontiguousarray(array) if kept else as_float32(array)
    return made.copy() if copy and np.may_share_memory(made, array) else made


def require_compression(name: str) -> str:
    """Return `name`. Raises GffeError unless it is one of `COMPRESSIONS` that the installed library has."""
    require_choice(name, COMPRESSIONS, "compression")
    if not hasattr(OpenEXR, _constant(name)):
        raise GffeError(f"compression '{name}' needs a newer OpenEXR than {OpenEXR.OPENEXR_VERSION} (expected another)")
    return name


def _constant(compression: str) -> str:
    return f"{'no' if compression == 'none' else compression}_COMPRESSION".upper()


def write_channels(
    path: Path,
    channels: dict[str, np.ndarray],
    attributes: dict | None = None,
    compression: str = DEFAULT_COMPRESSION,
) -> None:
    """Write (H, W) arrays as one EXR file, under a temporary name until it is whole.

    `attributes` are further header attributes. Raises OSError (disk full: ENOSPC), leaving nothing.
    """
    method = getattr(OpenEXR, _constant(compression))
    header = {"compression": method, "type": OpenEXR.scanlineimage, **(attributes or {})}
    part_path = partial_name(path)
    try:
        try:
            # The library takes any array for a contiguous one.
            contiguous = {name: np.ascontiguousarray(channel) for name, channel in channels.items()}
            OpenEXR.File(header, contiguous).write(os.fsencode(part_path))
        except OSError:
            raise
        except Exception as error:  # whatever the library throws
            code = errno.ENOSPC if os.strerror(errno.ENOSPC) in str(error) else errno.EIO
            raise OSError(code, _one_line(error) if code == errno.EIO else os.strerror(code)) from None
        try:  # the library does not notice when the last bytes do not reach the disk
            read_header(part_path, path.name)
        except GffeError:
            raise OSError(errno.ENOSPC, "the file did not reach the disk whole, is it full?") from None
        os.replace(part_path, path)
    finally:
        with contextlib.suppress(OSError):
            part_path.unlink()


def partial_name(path: Path) -> Path:
    """Return the path at which `path` is kept until it is whole."""
    return path.with_name(f".{path.name}.part")


def _by(size) -> str:
    return f"{size[0]}×{size[1]}"


def _one_line(error) -> str:
    text = " ".join(str(error).split())
    return "".join(c if c.isprintable() else "?" for c in text) or type(error).__name__


COLOR = ("R", "G", "B")
MOTION = ("motion.x", "motion.y")
GEOMETRY = ("Z", *MOTION)
RENDERED = (*COLOR, *GEOMETRY)
RGBA = ("R", "G", "B", "A")
# Optional channels of a rendered frame, by the fields of `Overlays`: all channels of one, or none.
OVERLAY_CHANNELS = {
    "fixed_mask": ("mask.fixed",),
    "effects": tuple(f"effects.{name}" for name in RGBA),
    "effects_motion": ("effects.motion.x", "effects.motion.y"),
    "ui": tuple(f"ui.{name}" for name in RGBA),
}


class Pixels(Protocol):
    """Pixels of frames, by their entries. `size` is (width, height) of the image. All methods raise GffeError that
    names the file if it is missing or damaged. `notes`: warnings."""

    notes: list[str]

    def read(
        self, entry: FrameEntry, size: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, Overlays | None]:
        """Return color (H, W, 3) float16 or float32, depth (H, W) float32 and motion (H, W, 2) float32 or None of a
        rendered frame, in the project's conventions; and its overlays, if it has any."""
        ...

    def color(self, entry: FrameEntry, size: tuple[int, int]) -> np.ndarray:
        """Return linear RGB (H, W, 3), float16 or float32, of any frame."""
        ...

    def channels(self, entry: FrameEntry, names: Iterable[str], size: tuple[int, int]) -> dict[str, np.ndarray]:
        """Return channels of our own form by name, (H, W) each."""
        ...

    def exr_file(self, entry: FrameEntry) -> Path | None:
        """Return the frame's EXR file in the project's own format, None if there is none. Other sequences can link
        it."""


class OwnPixels:
    """Pixels of our own form: one EXR file per frame, in `folder`."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.notes = []

    def read(self, entry, size):
        path = self._folder / entry.place
        header = read_header(path, entry.file)
        names = RENDERED if has_motion(header) or not entry.reset else RENDERED[:4]
        over = {field: those for field, those in OVERLAY_CHANNELS.items() if header.find(those[0])}
        channels = read_channels(path, (*names, *chain(*over.values())), entry.file, size)
        depth = channels["Z"].astype(np.float32, copy=False)
        motion = None
        if len(names) == len(RENDERED):
            motion = np.stack([channels[name] for name in MOTION], -1).astype(np.float32, copy=False)
        layers = {field: np.stack([channels[name] for name in those], -1) for field, those in over.items()}
        if "fixed_mask" in layers:
            layers["fixed_mask"] = layers["fixed_mask"][..., 0] > 0
        return stack_color(channels), depth, motion, Overlays(**layers) if layers else None

    def color(self, entry, size):
        channels = self.channels(entry, COLOR, size)
        if entry.kind != "rendered":  # the camera of a rendered frame says where its data window is
            header = read_header(self._folder / entry.place, entry.file)
            part = header.parts[require_channels(header, COLOR, entry.file)[0][0]]
            if part.shown_size == tuple(size):
                channels = {name: placed(channel, part, 0.0) for name, channel in channels.items()}
        return stack_color(channels)

    def channels(self, entry, names, size):
        return read_channels(self._folder / entry.place, tuple(names), entry.file, size)

    def exr_file(self, entry):
        return self._folder / entry.place


class ForeignPixels:
    """Pixels of other formats, from their functions `rendered` and `color`."""

    def __init__(self):
        self.notes: list[str] = []

    def read(self, entry, size):
        return *self.rendered(entry, size), None

    def rendered(self, entry, size) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return color, depth and motion as `read` does."""
        raise NotImplementedError

    def color(self, entry, size) -> np.ndarray:
        """Return linear RGB (H, W, 3), float16 or float32, as `Pixels.color` does."""
        raise NotImplementedError

    def channels(self, entry, names, size):
        names = tuple(names)
        if set(names) <= set(COLOR):
            found = dict(zip(COLOR, np.moveaxis(self.color(entry, size), -1, 0), strict=True))
        else:
            color, depth, motion = self.rendered(entry, size)
            found = {**dict(zip(COLOR, np.moveaxis(color, -1, 0), strict=True)), "Z": depth}
            if motion is not None:
                found |= dict(zip(MOTION, np.moveaxis(motion, -1, 0), strict=True))
        for name in names:
            if name not in found:
                raise GffeError(f"{entry.file}: no channel '{name}' (the capture gives {', '.join(found)})")
        return {name: found[name] for name in names}

    def exr_file(self, entry):
        return None


def has_motion(header: ExrHeader) -> bool:
    return all(header.find(name) for name in MOTION)


def require_whole_overlays(header: ExrHeader, file: str, shown: bool) -> None:
    """Raise GffeError if only some channels of an overlay are there, or a user interface that cannot be in display
    pixels, unless the image is `shown` unchanged."""
    for field, names in OVERLAY_CHANNELS.items():
        missing = [name for name in names if not header.find(name)]
        if missing and len(missing) < len(names):
            raise GffeError(f"{file}: no channel '{missing[0]}' (expected all of {', '.join(names)}, or none)")
        if field == "ui" and not missing and not shown:
            raise GffeError(f"{file}: channels ui.* are in display pixels (expected render_size as the display's size)")
        if field == "effects_motion" and not missing and not header.find(OVERLAY_CHANNELS["effects"][0]):
            raise GffeError(
                f"{file}: effects.motion without effects (expected {', '.join(OVERLAY_CHANNELS['effects'])})"
            )


def stack_color(channels: dict[str, np.ndarray]) -> np.ndarray:
    """Return color (H, W, 3), float16 or float32, from the channels R, G, B."""
    if all(channels[name].dtype == np.float16 for name in COLOR):
        return color_of_planes(channels[name] for name in COLOR)
    color = np.stack([channels[name] for name in COLOR], -1)
    return color if color.dtype in (np.float16, np.float32) else color.astype(np.float32)
