"""Reader of OpenEXR headers that does not use the OpenEXR library.

For a truncated file the library prints to the console and returns a file without parts. On a full disk it reports no
error. So the header and the chunk offset table are checked here first. That is cheap (no pixels are read), and finds
every truncated file before the library opens it. Layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import descriptor_of

_MAGIC = b"\x76\x2f\x31\x01"
_TILED, _NON_IMAGE, _MULTI_PART = 0x200, 0x800, 0x1000
_FIRST_BYTES = 1 << 14
_MAX_HEADER = 1 << 26
_MOST_KNOWN = 4
_MOST_CHANNELS = 4096  # of all parts
_MOST_SIDE = 1 << 20
_TOO_MANY = 1 << 40  # chunks: no file holds their table
# Scan lines per chunk: no compression, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB, HTJ2K256, HTJ2K32
_CHUNK_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32)
_NUMBERS = {"int": "i", "float": "f", "double": "d", "rational": "iI"}
_TUPLES = {"chromaticities": "8f", "v2f": "2f", "v3f": "3f"}
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
    matrices: dict[str, tuple[str, bytes]] = field(default_factory=dict)  # name → type, bytes; see `matrix`
    texts: dict[str, str] = field(default_factory=dict)  # other attributes of text and numbers, by name
    attributes: dict[str, Any] = field(default_factory=dict)  # text, number or tuple of numbers, by name
    views: tuple[str, ...] = ()  # of channels that name their view: the first one is that of plain channels

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the data window."""
        x0, y0, x1, y1 = self.data_window
        return x1 - x0 + 1, y1 - y0 + 1

    def matrix(self, name: str) -> np.ndarray:
        """Return the matrix `name` of `matrices`, (4, 4) float64, as stored."""
        form, data = self.matrices[name]
        return np.frombuffer(data, "<f4" if form == "m44f" else "<f8", 16).astype(np.float64).reshape(4, 4)


@dataclass
class ExrHeader:
    parts: list[ExrPart]
    multi_part: bool = False
    end: int = 0  # bytes; the chunk offset table follows
    layout: object = None  # the same object for headers that are alike but for their matrices

    @cached_property
    def chunk_tables(self) -> list[struct.Struct | None]:
        """Chunk tables of each part; None where only the library can compute the number of chunks."""
        counts = map(_chunk_count, self.parts)
        return [None if n is None else struct.Struct(f"<{n if n >= 0 else _TOO_MANY}Q") for n in counts]

    @cached_property
    def views(self) -> list[str]:
        """The views in the file, as of a stereo camera: those with most channels first, of equals in their order."""
        if not any(part.views or "view" in part.texts for part in self.parts):
            return []
        counts = {view: 0 for part in self.parts for view in part.views}
        for part in self.parts:
            for channel in part.channels:
                view = _view_of(part, channel)[0]
                if view is not None:
                    counts[view] = counts.get(view, 0) + 1
        return sorted(filter(counts.__getitem__, counts), key=lambda view: -counts[view])

    def seen(self, view: str | None = None) -> list[tuple[int, str, str]]:
        """Return (part, channel, name without its view) of the channels of one view and of those of none. The default
        is the first of `views`."""
        chosen, found = view or next(iter(self.views), None), []
        for index, part in enumerate(self.parts):
            for channel in part.channels:
                owner, name = _view_of(part, channel)
                if owner in (None, chosen):
                    found.append((index, channel, name))
        return found

    def candidates(self, channel: str, view: str | None = None) -> list[tuple[int, str]]:
        """Return (part, name there) of all channels that are called so in one view; `part.channel` names a part's own,
        and whole names those of other views."""
        if not self.views:
            found = [(index, channel) for index, part in enumerate(self.parts) if channel in part.channels]
        else:
            found = [(index, name) for index, name, plain in self.seen(view) if plain == channel]
        if found:
            return found
        for index, part in enumerate(self.parts):
            name = channel.removeprefix(part.name + ".")
            if part.name and name != channel and name in part.channels:
                return [(index, name)]
        return [(index, channel) for index, part in enumerate(self.parts) if channel in part.channels][:1]

    def find(self, channel: str, view: str | None = None) -> tuple[int, str] | None:
        """Return the first of `candidates`, None if there are none."""
        return next(iter(self.candidates(channel, view)), None)

    @property
    def channels(self) -> list[str]:
        return [name for part in self.parts for name in part.channels]


def _view_of(part: ExrPart, channel: str) -> tuple[str | None, str]:
    """Return the view of a channel, None if it is of none, and the channel's name without it: a part has the attribute
    `view`, or `multiView` lists those that stand before the last word of names, as in left.R."""
    own = part.texts.get("view")
    *layers, name = channel.split(".")
    if own or not part.views:
        return own or None, channel
    if not layers:
        return part.views[0], channel
    if layers[-1] in part.views:
        return layers[-1], ".".join((*layers[:-1], name))
    return None, channel


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


class HeaderReader:
    """Reads headers. It is faster for those that equal one read before except for their matrices, as in a sequence."""

    def __init__(self):
        self._known: list[_Known] = []

    def read(self, path: str | Path, label: str, matrices: bool = True) -> ExrHeader:
        """Return the header of the EXR file at `path`, checked to be complete; `label` names the file in errors.
        Without `matrices` those may be another file's.

        Raises GffeError if the file is missing, no EXR, deep, or ends before its last chunk of pixels.
        """
        try:
            file, size = descriptor_of(path)
            try:
                data = os.read(file, _FIRST_BYTES)
                header = self._known_header(data, matrices) or self._parsed(file, data, size, label)
                _check_chunks(file, data, size, header, label)
            finally:
                os.close(file)
        except FileNotFoundError:
            raise GffeError(f"{label}: no such file in {Path(path).parent}") from None
        except OSError as error:
            raise GffeError(f"{label}: cannot be read ({error.strerror or error})") from None
        return header

    def _known_header(self, data: bytes, matrices: bool) -> ExrHeader | None:
        for known in self._known:
            header = known.header_of(data, matrices)
            if header:
                return header
        return None

    def _parsed(self, file, data, size, label) -> ExrHeader:
        header, spans = _read_parts(file, data, size, label)
        for part in header.parts:
            _check_part(part, label)
        if header.end <= len(data):
            header.layout = _Known(header, data, spans)
            self._known = [header.layout, *self._known[: _MOST_KNOWN - 1]]
        return header


def read_header(path: Path, label: str) -> ExrHeader:
    """Return the header of a single EXR file, checked as by `HeaderReader.read`. Raises GffeError as it does."""
    return HeaderReader().read(path, label)


class _Known:
    """A header, and the beginning of files that have the same one except for the values of its matrices."""

    def __init__(self, header: ExrHeader, data: bytes, spans: list[_Span]):
        self._header, self._spans = header, spans
        ends = [0, *(span.end for span in spans)]
        starts = [*(span.start for span in spans), header.end]
        self._same = [(a, b, data[a:b]) for a, b in zip(ends, starts, strict=True)]

    def header_of(self, data: bytes, matrices: bool = True) -> ExrHeader | None:
        for start, end, piece in self._same:
            if data[start:end] != piece:
                return None
        if not matrices or not self._spans:
            return self._header
        parts = [replace(part, matrices={}) for part in self._header.parts]
        for index, name, form, start, end in self._spans:
            parts[index].matrices[name] = (form, data[start:end])
        return ExrHeader(parts, self._header.multi_part, self._header.end, self)


class _Span(NamedTuple):
    """Position in a file of the values of a matrix."""

    part: int
    name: str
    form: str
    start: int
    end: int


def _read_parts(file, data, size, label) -> tuple[ExrHeader, list[_Span]]:
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


def _parse(cursor) -> tuple[ExrHeader, list[_Span]]:
    cursor.take(4)
    (version,) = cursor.unpack("I")
    multi_part = bool(version & _MULTI_PART)
    parts, spans = [], []
    while True:
        part = _parse_part(cursor, len(parts), spans)
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
    return ExrHeader(parts, multi_part, cursor.position), spans


def _check_part(part: ExrPart, label: str) -> None:
    if part.deep:
        raise GffeError(f"{label}: deep EXR data is not supported (expected flat images)")
    x0, y0, x1, y1 = part.display_window
    if x1 < x0 or y1 < y0:
        raise GffeError(f"{label}: the display window {x0} {y0} {x1} {y1} is empty (expected x0 ≤ x1 and y0 ≤ y1)")


def _parse_part(cursor, index: int, spans: list[_Span]) -> ExrPart | None:
    """Return the next header, of part `index`; None for the empty one that ends a multi-part list."""
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
            elif form in ("m44f", "m44d"):
                values = value.take(64 if form == "m44f" else 128)
                start = cursor.position - size
                part.matrices[name] = (form, values)
                spans.append(_Span(index, name, form, start, start + len(values)))
            elif (name, form) == ("multiView", "stringvector"):
                part.views = _parse_texts(value)
            elif form == "string":
                part.texts[name] = part.attributes[name] = value.data.decode("utf-8", "replace")
            elif form in _NUMBERS:
                numbers = value.unpack(_NUMBERS[form])
                part.texts[name] = "/".join(map(str, numbers))
                if len(numbers) == 1:
                    part.attributes[name] = numbers[0]
            elif form in _TUPLES:
                part.attributes[name] = value.unpack(_TUPLES[form])
            elif form == "envmap":
                part.attributes[name] = value.take(1)[0]
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
    for part, chunks in zip(header.parts, header.chunk_tables, strict=True):
        if chunks is None:
            return
        if table + chunks.size > size:
            raise GffeError(f"{label}: truncated, {size} bytes end inside the chunk table")
        offsets = chunks.unpack(_bytes_at(file, data, table, chunks.size))
        count = len(offsets)
        table += chunks.size
        missing = offsets.count(0)
        if missing:
            raise GffeError(f"{label}: incomplete, {missing} of {count} chunks were never written")
        if not count:
            continue
        last = max(offsets)
        before = 4 * header.multi_part + (16 if part.tile else 4)
        end = last + before + 4
        if end <= size:
            (length,) = struct.unpack("<i", _bytes_at(file, data, last + before, 4))
            end += max(length, 0)
        if end > size:
            raise GffeError(f"{label}: truncated, {size} bytes of at least {end}")


def _bytes_at(file, data: bytes, start: int, length: int) -> bytes:
    if start + length <= len(data):
        return data[start : start + length]
    os.lseek(file, start, os.SEEK_SET)
    return os.read(file, length)
