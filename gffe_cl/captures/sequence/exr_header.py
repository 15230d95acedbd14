"""Reader of OpenEXR headers that does not use the OpenEXR library, and the cameras in them.

For a truncated file the library prints to the console and returns a file without parts. On a full disk it reports no
error. So the header and the chunk offset table are checked here first. That is cheap (no pixels are read), and finds
every truncated file before the library opens it. The library's package for Python does not have the types of channels
either, unless it decodes them. Layout: https://openexr.com/en/latest/OpenEXRFileLayout.html

Cameras are the standard attributes `worldToCamera` and `worldToNDC`. OpenEXR's semantics: camera space is left-handed,
x right, y up, z forward; in NDC the upper left corner of the display window is (0, 0), the lower right one (1, 1);
vectors are rows, v·M. Some writers transpose.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.core.files import descriptor_of
from gffe_cl.engine.frame.camera import Camera

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
    matrices: dict[str, np.ndarray] = field(default_factory=dict)  # name → (4, 4) float64, as stored
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
            elif form in ("m44f", "m44d"):
                numbers = value.unpack("16f" if form == "m44f" else "16d")
                part.matrices[name] = np.array(numbers).reshape(4, 4)
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


_FLIP_Y = np.diag([1.0, -1.0, 1.0, 1.0])
_NAMES = ("worldToCamera", "worldToNDC")
_TOLERANCE = 1e-3


def camera_attributes(camera: Camera, width: int, height: int) -> dict[str, np.ndarray]:
    """Return the header attributes of `camera` for a display window of `width` × `height` pixels: (4, 4) float32, v·M.

    NDC depth is 1 − 1/z (z in world units); the standard leaves it open.
    """
    projection = np.array(
        [
            [camera.fx / width, 0, camera.cx / width, 0],
            [0, camera.fy / height, camera.cy / height, 0],
            [0, 0, 1, -1],
            [0, 0, 1, 0],
        ]
    )
    matrices = (_FLIP_Y @ camera.world_to_view, projection @ camera.world_to_view)
    return {name: np.ascontiguousarray(m.T, np.float32) for name, m in zip(_NAMES, matrices, strict=True)}


def has_camera(part: ExrPart) -> bool:
    return all(name in part.matrices for name in _NAMES)


def header_cameras(part: ExrPart) -> tuple[Camera, Camera]:
    """Return (render camera, display camera) of a part with both attributes, in pixels of its data window and of its
    display window; the data window may be larger (overscan) or lie elsewhere.

    Raises GffeError if the matrices are not finite, singular or do not belong together.
    """
    stored = [part.matrices[name] for name in _NAMES]
    if not all(np.isfinite(m).all() for m in stored):
        raise GffeError("camera: worldToCamera and worldToNDC must be finite")
    fits = [_decompose(*matrices) for matrices in ([m.T for m in stored], stored)]
    residual, world_to_view, projection = min(fits, key=lambda fit: fit[0])
    if residual > _TOLERANCE:
        Camera(_FLIP_Y @ stored[0].T, 1, 1, 0, 0)  # raises for a singular pose
        raise GffeError(
            "camera: worldToNDC is no pinhole projection of worldToCamera"
            " (expected OpenEXR's: z forward, y up, NDC (0, 0) at the upper left)"
        )
    (width, height), (left, top) = part.shown_size, part.offset
    display = Camera(
        world_to_view,
        projection[0, 0] * width,
        projection[1, 1] * height,
        projection[0, 2] * width,
        projection[1, 2] * height,
    )
    render = Camera(world_to_view, display.fx, display.fy, display.cx - left, display.cy - top)
    return render, display


def _decompose(world_to_camera, world_to_ndc):
    """Return (how far from a pinhole, world_to_view, (3, 3) projection to NDC) of column-vector matrices."""
    world_to_view = _FLIP_Y @ world_to_camera
    left, scale, right = np.linalg.svd(world_to_view[:3, :3])
    if np.abs(world_to_view[3] - (0, 0, 0, 1)).max() > 1e-5 or np.abs(scale - 1).max() > 1e-2:
        return np.inf, world_to_view, np.eye(3)
    world_to_view[:3, :3] = left @ right  # float32 leaves it a little off
    world_to_view[3] = (0, 0, 0, 1)
    to_ndc = world_to_ndc[[0, 1, 3]]
    projection = to_ndc[:, :3] @ world_to_view[:3, :3].T  # up to a factor
    if not (projection[2, 2] > 0 and projection[0, 0] and projection[1, 1]):
        return np.inf, world_to_view, projection
    offset = to_ndc[:, 3] - projection @ world_to_view[:3, 3]
    reach = np.abs(projection) @ (1 + np.abs(world_to_view[:3, 3]))
    skew = (projection[0, 1] / projection[0, 0], projection[1, 0] / projection[1, 1])
    skew += tuple(projection[2, :2] / projection[2, 2])
    residual = max(np.abs(skew).max(), (np.abs(offset) / reach).max())
    return residual, world_to_view, projection / projection[2, 2]
