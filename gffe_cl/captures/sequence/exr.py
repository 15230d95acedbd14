"""Reader and writer of OpenEXR files: headers without the OpenEXR library; the pixels of any writer, and our own.
Sources of a sequence's pixels: EXR files of our own form, or a foreign capture's.

For a truncated file the library prints to the console and returns a file without parts. On a full disk it reports no
error. So the header and the chunk offset table are checked here first. That is cheap (no pixels are read), and finds
every truncated file before the library opens it. The library's package for Python does not have the types of channels
either, unless it decodes them. Layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from gffe_cl.captures.sequence.description import FrameEntry
from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.core.files import descriptor_of, require_moderate
from gffe_cl.engine.core.validation import as_float32, require_choice
from gffe_cl.engine.frame.rendered_frame import Overlays, color_of_planes

_MAGIC = b"\x76\x2f\x31\x01"
_TILED, _NON_IMAGE, _MULTI_PART = 0x200, 0x800, 0x1000
_FIRST_BYTES = 1 << 14
_MAX_HEADER = 1 << 26
_MOST_CHANNELS = 4096  # of all parts
_MOST_SIDE = 1 << 20
_TOO_MANY = 1 << 40  # chunks: no file holds their table
# Scan lines per chunk: no compression, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K256, HTJ2K32
_CHUNK_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32)
_NUMBERS = {"int": "i", "float": "f", "double": "d"}
_PIXEL_TYPES = ("uint32", "float16", "float32")


@dataclass
class ExrPart:
    """Header of one part. Windows are (x0, y0, x1, y1) in pixels, both ends included."""

    name: str = ""
    channels: dict[str, str] = field(default_factory=dict)  # name → NumPy type
    data_window: tuple[int, int, int, int] = (0, 0, -1, -1)
    display_window: tuple[int, int, int, int] = (0, 0, -1, -1)
    compression: int = 0
    chunk_count: int | None = None
    tile: tuple[int, int, int] | None = None  # width, height, level mode
    subsampled: bool = False
    deep: bool = False
    attributes: dict[str, Any] = field(default_factory=dict)  # others by name: text, number, tuple; "24/1"
    views: tuple[str, ...] = ()  # that its channels are of

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the data window."""
        return _size_of(self.data_window)

    @property
    def shown_size(self) -> tuple[int, int]:
        """Width and height of the display window."""
        return _size_of(self.display_window)

    @property
    def offset(self) -> tuple[int, int]:
        """Position of the data window in the display window, x and y."""
        return self.data_window[0] - self.display_window[0], self.data_window[1] - self.display_window[1]


def _size_of(window: tuple[int, int, int, int]) -> tuple[int, int]:
    x0, y0, x1, y1 = window
    return x1 - x0 + 1, y1 - y0 + 1


@dataclass
class ExrHeader:
    parts: list[ExrPart]
    multi_part: bool = False
    end: int = 0  # bytes; the chunk offset table follows

    def candidates(self, channel: str) -> list[tuple[int, str]]:
        """Return (part, name there) of all channels that are called so; `part.channel` names a part's own."""
        found = [(index, channel) for index, part in enumerate(self.parts) if channel in part.channels]
        if found:
            return found
        for index, part in enumerate(self.parts):
            name = channel.removeprefix(part.name + ".")
            if part.name and name != channel and name in part.channels:
                return [(index, name)]
        return []

    def find(self, channel: str) -> tuple[int, str] | None:
        """Return the first of `candidates`, None if there are none."""
        return next(iter(self.candidates(channel)), None)

    @property
    def channels(self) -> list[str]:
        return [name for part in self.parts for name in part.channels]


class _Short(Exception):
    """Exception: the bytes at hand end inside the header."""


class _Cursor:
    def __init__(self, data: bytes):
        self.data, self.position = data, 0

    def take(self, n: int) -> bytes:
        taken = self.data[self.position : self.position + n]
        if len(taken) < n:
            raise _Short
        self.position += n
        return taken

    def unpack(self, form: str):
        return struct.unpack("<" + form, self.take(struct.calcsize("<" + form)))

    def text(self) -> str:
        end = self.data.find(b"\0", self.position)
        if end < 0:
            raise _Short
        return self.take(end - self.position + 1)[:-1].decode("utf-8", "replace")


def read_header(path: str | Path, label: str) -> ExrHeader:
    """Return the header of the EXR file at `path`, checked to be complete; `label` names the file in errors.

    Raises GffeError if the file is missing, no EXR, deep, of several views, or ends before its last chunk of pixels.
    """
    try:
        file, size = descriptor_of(path)
        try:
            data = os.read(file, _FIRST_BYTES)
            header = _read_parts(file, data, size, label)
            _check_parts(header.parts, label)
            _check_chunks(file, data, size, header, label)
        finally:
            os.close(file)
    except FileNotFoundError:
        raise GffeError(f"{label}: no such file in {Path(path).parent}") from None
    except OSError as error:
        raise GffeError(f"{label}: cannot be read ({error.strerror or error})") from None
    return header


def _read_parts(file, data, size, label) -> ExrHeader:
    length = _FIRST_BYTES
    while True:
        if not data.startswith(_MAGIC[: len(data)]):
            raise GffeError(f"{label}: not an OpenEXR file")
        try:
            return _parse(_Cursor(data))
        except _Short:
            if length >= size:
                raise GffeError(f"{label}: truncated, {size} bytes end inside the header") from None
            if length >= _MAX_HEADER:
                raise GffeError(f"{label}: damaged EXR header") from None
            length *= 8
        except (struct.error, ValueError, IndexError) as error:
            reason = f" ({error})" if type(error) is ValueError and error.args else ""
            raise GffeError(f"{label}: damaged EXR header{reason}") from None
        data = _bytes_at(file, b"", 0, length)


def _parse(cursor) -> ExrHeader:
    cursor.take(4)
    (version,) = cursor.unpack("I")
    multi_part = bool(version & _MULTI_PART)
    parts = []
    while True:
        part = _parse_part(cursor)
        if part is None:
            break
        part.deep |= bool(version & _NON_IMAGE) and not multi_part
        if part.tile and not (multi_part or version & _TILED):
            part.tile = None
        if not part.channels or min(part.size) < 1:
            raise ValueError
        if max(part.size) > _MOST_SIDE:
            raise ValueError(f"{part.size[0]}×{part.size[1]} pixels, expected at most {_MOST_SIDE} a side")
        parts.append(part)
        if sum(len(one.channels) for one in parts) + len(parts) > _MOST_CHANNELS:
            raise ValueError(f"expected at most {_MOST_CHANNELS} channels and parts")
        if not multi_part:
            break
    return ExrHeader(parts, multi_part, cursor.position)


def _check_parts(parts: list[ExrPart], label: str) -> None:
    for part in parts:
        if part.deep:
            raise GffeError(f"{label}: deep EXR data is not supported (expected flat images)")
        if min(part.shown_size) < 1:
            window = " ".join(map(str, part.display_window))
            raise GffeError(f"{label}: the display window {window} is empty (expected x0 ≤ x1 and y0 ≤ y1)")
    views = sorted({view for part in parts for view in part.views})
    if len(views) > 1:
        raise GffeError(f"{label}: holds the views {printable(', '.join(views))} (expected a file for each view)")


def _parse_part(cursor) -> ExrPart | None:
    """Return the next part's header; None for the empty one that ends a multi-part list."""
    part, kind = ExrPart(), ""
    name = cursor.text()
    if not name:
        return None
    while name:
        form = cursor.text()
        (size,) = cursor.unpack("i")
        if size < 0:
            raise ValueError
        value = _Cursor(cursor.take(size))
        try:
            if (name, form) == ("channels", "chlist"):
                _parse_channels(value, part)
            elif (name, form) in (("dataWindow", "box2i"), ("displayWindow", "box2i")):
                box = value.unpack("4i")
                setattr(part, "data_window" if name == "dataWindow" else "display_window", box)
            elif name == "compression":
                part.compression = value.take(1)[0]
            elif (name, form) == ("chunkCount", "int"):
                (part.chunk_count,) = value.unpack("i")
            elif name == "tiles":
                part.tile = value.unpack("IIB")
            elif (name, form) in (("name", "string"), ("type", "string")):
                text = value.data.decode("utf-8", "replace")
                part.name, kind = (text, kind) if name == "name" else (part.name, text)
            elif (name, form) == ("multiView", "stringvector"):
                part.views += _parse_texts(value)
            elif form == "string":
                part.attributes[name] = text = value.data.decode("utf-8", "replace")
                if name == "view":
                    part.views += (text,)
            elif form in _NUMBERS:
                (part.attributes[name],) = value.unpack(_NUMBERS[form])
            elif form == "rational":
                part.attributes[name] = "{}/{}".format(*value.unpack("iI"))
        except _Short:
            raise ValueError from None
        name = cursor.text()
    part.deep = kind.startswith("deep")
    if kind == "scanlineimage":
        part.tile = None
    return part


def _parse_channels(value, part):
    name = value.text()
    while name:
        kind, _, x_sampling, y_sampling = value.unpack("iIii")
        part.channels[name] = _PIXEL_TYPES[kind]
        part.subsampled |= (x_sampling, y_sampling) != (1, 1)
        if len(part.channels) > _MOST_CHANNELS:
            raise ValueError(f"expected at most {_MOST_CHANNELS} channels")
        name = value.text()


def _parse_texts(value: _Cursor) -> tuple[str, ...]:
    found = []
    while value.position < len(value.data):
        (length,) = value.unpack("i")
        if length < 0:
            raise ValueError
        found.append(value.take(length).decode("utf-8", "replace"))
    return tuple(found)


def _chunk_count(part: ExrPart) -> int | None:
    """Return the number of chunks; None where only the library can compute it (mip maps, compressions not listed
    here)."""
    if part.chunk_count is not None:
        return part.chunk_count
    width, height = part.size
    if part.tile:
        tile_width, tile_height, mode = part.tile
        return -(-width // tile_width) * -(-height // tile_height) if mode & 15 == 0 else None
    if part.compression >= len(_CHUNK_LINES):
        return None
    return -(-height // _CHUNK_LINES[part.compression])


def _check_chunks(file, data, size, header, label):
    """Raise GffeError unless every chunk has been written, and the last one ends inside the file. `data`: its first
    bytes."""
    table = header.end
    for part in header.parts:
        count = _chunk_count(part)
        if count is None:
            return
        nbytes = 8 * (count if count >= 0 else _TOO_MANY)
        if table + nbytes > size:
            raise GffeError(f"{label}: truncated, {size} bytes end inside the chunk table")
        offsets = struct.unpack(f"<{count}Q", _bytes_at(file, data, table, nbytes))
        table += nbytes
        if not count:
            continue
        missing = offsets.count(0)
        plain = len(header.parts) == 1 and not part.tile
        if missing == count and plain and _ends_with_chunks(file, table, size, count):
            continue  # its writer did not go back to the table, and the library does without it
        if missing:
            raise GffeError(f"{label}: incomplete, {missing} of {count} chunks were never written")
        last = max(offsets)
        before = 4 * header.multi_part + (16 if part.tile else 4)
        end = last + before + 4
        if end <= size:
            (length,) = struct.unpack("<i", _bytes_at(file, data, last + before, 4))
            end += max(length, 0)
        if end > size:
            raise GffeError(f"{label}: truncated, {size} bytes of at least {end}")


def _ends_with_chunks(file, start: int, size: int, count: int) -> bool:
    """Return whether `count` chunks of scan lines follow one another from `start` to the end of the file."""
    for _ in range(count):
        if start + 8 > size:
            return False
        _, length = struct.unpack("<ii", _bytes_at(file, b"", start, 8))
        start += 8 + max(length, 0)
    return start == size


def _bytes_at(file, data: bytes, start: int, length: int) -> bytes:
    if start + length <= len(data):
        return data[start : start + length]
    os.lseek(file, start, os.SEEK_SET)
    return os.read(file, length)


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


class Pixels:
    """Pixels of frames, by their entries: of other formats, from their functions `rendered` and `color`. `size` is
    (width, height) of the image. All methods raise GffeError that names the file if it is missing or damaged. `notes`:
    warnings."""

    def __init__(self):
        self.notes: list[str] = []

    def read(
        self, entry: FrameEntry, size: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, Overlays | None]:
        """Return color (H, W, 3) float16 or float32, depth (H, W) float32 and motion (H, W, 2) float32 or None of a
        rendered frame, in the project's conventions; and its overlays, if it has any."""
        return *self.rendered(entry, size), None

    def rendered(self, entry: FrameEntry, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return color, depth and motion as `read` does."""
        raise NotImplementedError

    def color(self, entry: FrameEntry, size: tuple[int, int]) -> np.ndarray:
        """Return linear RGB (H, W, 3), float16 or float32, of any frame."""
        raise NotImplementedError

    def channels(self, entry: FrameEntry, names: Iterable[str], size: tuple[int, int]) -> dict[str, np.ndarray]:
        """Return channels of our own form by name, (H, W) each."""
        names = tuple(names)
        if set(names) <= set(COLOR):
            found: dict[str, np.ndarray] = dict(zip(COLOR, np.moveaxis(self.color(entry, size), -1, 0), strict=True))
        else:
            color, depth, motion = self.rendered(entry, size)
            found = {**dict(zip(COLOR, np.moveaxis(color, -1, 0), strict=True)), "Z": depth}
            if motion is not None:
                found |= dict(zip(MOTION, np.moveaxis(motion, -1, 0), strict=True))
        for name in names:
            if name not in found:
                raise GffeError(f"{entry.file}: no channel '{name}' (the capture gives {', '.join(found)})")
        return {name: found[name] for name in names}

    def exr_file(self, entry: FrameEntry) -> Path | None:
        """Return the frame's EXR file in the project's own format, None if there is none. Other sequences can link
        it."""
        return None


class OwnPixels(Pixels):
    """Pixels of our own form: one EXR file per frame, in `folder`."""

    def __init__(self, folder: Path):
        super().__init__()
        self._folder = folder

    def read(self, entry, size):
        path = self._folder / entry.file
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
            header = read_header(self._folder / entry.file, entry.file)
            part = header.parts[require_channels(header, COLOR, entry.file)[0][0]]
            if part.shown_size == tuple(size):
                channels = {name: placed(channel, part, 0.0) for name, channel in channels.items()}
        return stack_color(channels)

    def channels(self, entry, names, size):
        return read_channels(self._folder / entry.file, tuple(names), entry.file, size)

    def exr_file(self, entry):
        return self._folder / entry.file


def has_motion(header: ExrHeader) -> bool:
    return all(header.find(name) for name in MOTION)


def require_whole_overlays(header: ExrHeader, file: str, shown: bool) -> None:
    """Raise GffeError if only some channels of an overlay are there, or a user interface that cannot be in display
    pixels, unless the image is `shown` unchanged."""
    for layer, names in OVERLAY_CHANNELS.items():
        missing = [name for name in names if not header.find(name)]
        if missing and len(missing) < len(names):
            raise GffeError(f"{file}: no channel '{missing[0]}' (expected all of {', '.join(names)}, or none)")
        if layer == "ui" and not missing and not shown:
            raise GffeError(f"{file}: channels ui.* are in display pixels (expected render_size as the display's size)")
        if layer == "effects_motion" and not missing and not header.find(OVERLAY_CHANNELS["effects"][0]):
            raise GffeError(
                f"{file}: effects.motion without effects (expected {', '.join(OVERLAY_CHANNELS['effects'])})"
            )


def stack_color(channels: dict[str, np.ndarray]) -> np.ndarray:
    """Return color (H, W, 3), float16 or float32, from the channels R, G, B."""
    if all(channels[name].dtype == np.float16 for name in COLOR):
        return color_of_planes(channels[name] for name in COLOR)
    color = np.stack([channels[name] for name in COLOR], -1)
    return color if color.dtype in (np.float16, np.float32) else color.astype(np.float32)
