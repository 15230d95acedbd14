"""Reader of images in foreign captures: EXR, PNG, NPY and NPZ, recognized by their first bytes. Sizes are checked
before decoding."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Sequence as Ordered
from pathlib import Path
from typing import IO, Any

import numpy as np

from gffe_cl.captures.formats.layers import Place, layers_of
from gffe_cl.captures.formats.png import MAGIC as PNG_MAGIC
from gffe_cl.captures.formats.png import read_png, read_png_colors, read_png_header
from gffe_cl.captures.sequence.exr import decoded, place_of, require_parts
from gffe_cl.captures.sequence.exr_layout import ExrHeader, read_header
from gffe_cl.captures.sequence.header_attributes import carried
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import open_regular, require_moderate

Size = tuple[int, int]
_EXR_MAGIC, _NPY_MAGIC, _ZIP_MAGIC = b"\x76\x2f\x31\x01", b"\x93NUMPY", b"PK\x03\x04"
_RGBA = {"R": 0, "G": 1, "B": 2, "A": 3}
_MOST_HEADER = 1 << 16


def read_planes(path: Path, names: Ordered[str], label: str, size: Size, array: str | None = None) -> np.ndarray:
    """Return the channels `names` of the image at `path` as (H, W, C), in the type stored; `array` is the one of an NPZ
    file.

    Channels of PNG are R, G, B, A (gray is any of the first three), of NPY 0, 1, …, or R, G, B, A for the first four.
    Raises a GffeError that begins with `label` for a missing file or channel, another size than `size`, and damage.
    """
    return _read(path, names, label, size, array, decode=True)


def check_planes(
    path: Path, names: Ordered[str], label: str, size: Size, array: str | None = None
) -> tuple[ExrHeader, list[Place]] | None:
    """Check an image as `read_planes` does, by headers only: no pixel is decoded. Return the header of an EXR file and
    the places of the channels in it; None for other files."""
    return _read(path, names, label, size, array, decode=False)


def header_attributes(path: Path, names: Ordered[str]) -> dict[str, Any]:
    """Return attributes of the color channels `names` in a file that new frames get as well; also the primaries of PNG
    files."""
    with open_regular(path) as file:
        is_exr = file.read(8).startswith(_EXR_MAGIC)
    if is_exr:
        header = read_header(path, path.name)
        return carried(header.parts[_places(header, names, path.name)[0][0]])
    primaries = read_png_colors(path).chromaticities
    return {"chromaticities": primaries} if primaries else {}


def _read(path, names, label, size, array, decode) -> Any:
    try:
        with open_regular(path) as file:
            start = file.read(8)
        if start.startswith(_EXR_MAGIC):
            return _exr(path, names, label, size, decode)
        if start == PNG_MAGIC:
            return _png(path, names, label, size, decode)
        if start.startswith(_NPY_MAGIC):
            return _npy(path, names, label, size, decode)
        if start.startswith(_ZIP_MAGIC):
            return _npz(path, names, label, size, array, decode)
    except FileNotFoundError:
        raise GffeError(f"{label}: no such file in {path.parent}") from None
    except OSError as error:
        raise GffeError(f"{label}: cannot be read ({error.strerror or error})") from None
    raise GffeError(f"{label}: not an EXR, PNG, NPY or NPZ file")


def _exr(path, names, label, size, decode):
    header = read_header(path, label)
    places = _places(header, names, label)
    require_parts(header, {part for part, _ in places}, size, label)
    return np.stack(decoded(path, header, places, label), -1) if decode else (header, places)


def _places(header: ExrHeader, names, label) -> list[Place]:
    """Return the places of channels, given by their whole name, or by `part.name`; in files with a single channel that
    one."""
    layers, places = layers_of(header), []
    for name in names:
        layer, _, component = name.rpartition(".")
        place = (layers.get(layer, {}).get(component) if layer else None) or place_of(header, name, label)
        if place is None and len(header.channels) == 1:
            place = (0, header.channels[0])
        if place is None:
            raise _no_channel(name, header.channels, label)
        places.append(place)
    return places


def _png(path, names, label, size, decode):
    header = read_png_header(path, label)
    _require_size((header.width, header.height), size, label)
    order = []
    for name in names:
        gray = header.channels[0] == "Y" and name in ("R", "G", "B")
        if not gray and name not in header.channels:
            raise _no_channel(name, header.channels, label)
        order.append(0 if gray else header.channels.index(name))
    require_moderate(header.width * header.height * len(header.channels) * 2, math.prod(size), label)
    return read_png(path, header, label)[..., order] if decode else None


def _npy(path, names, label, size, decode):
    with open_regular(path) as file:
        return _array(file, names, label, size, decode)


def _npz(path, names, label, size, array, decode):
    try:
        with open_regular(path) as file, zipfile.ZipFile(file) as archive:
            held = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
            if array is None and len(held) == 1:
                array = held[0]
            if array not in held:
                listed = ", ".join(held[:12]) + (", …" if len(held) > 12 else "")
                raise GffeError(
                    f"{label}: no array '{array}' (expected \"array\" to name one; the file holds {listed})"
                )
            with archive.open(f"{array}.npy") as member:
                return _array(member, names, f"{label}, {array}", size, decode)
    except (GffeError, OSError):
        raise
    except Exception as error:  # whatever the decoders of its compressions meet
        reason = " ".join(str(error).split()) or type(error).__name__
        raise GffeError(f"{label}: damaged NPZ file ({reason})") from None


def _array(file: IO[bytes], names, label, size, decode):
    """Return the array of an NPY stream; no more is read than the pixels of an image of `size`."""
    shape, fortran, dtype = _array_header(file, label)
    if len(shape) not in (2, 3) or dtype.kind not in "fiub" or dtype.itemsize > 8:
        raise GffeError(f"{label}: an array of {dtype} and shape {shape} (expected numbers, (H, W) or (H, W, C))")
    _require_size((shape[1], shape[0]), size, label)
    channels = shape[2] if len(shape) == 3 else 1
    order = [_index(name, channels, label) for name in names]
    nbytes = math.prod(shape) * dtype.itemsize
    require_moderate(nbytes, math.prod(size), label)
    if not decode:
        return None
    data = bytearray()
    while len(data) < nbytes and (piece := file.read(nbytes - len(data))):
        data += piece
    if len(data) < nbytes:
        raise GffeError(f"{label}: truncated, {len(data)} of {nbytes} bytes")
    array = np.frombuffer(bytes(data), dtype).reshape(shape, order="F" if fortran else "C")
    array = array.astype(dtype.newbyteorder("="), copy=False).reshape(size[1], size[0], channels)
    return array[..., order]


def _array_header(file: IO[bytes], label) -> tuple[tuple[int, ...], bool, np.dtype]:
    try:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"version {version[0]}.{version[1]}")
        first = version == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        length = file.read(2 if first else 4)
        if int.from_bytes(length, "little") > _MOST_HEADER:
            raise ValueError(f"{int.from_bytes(length, 'little')} bytes")
        shape, fortran, dtype = read(io.BytesIO(length + file.read(int.from_bytes(length, "little"))))
        if min(shape, default=0) < 0 or not all(isinstance(n, int) for n in shape):
            raise ValueError(f"shape {shape}")
    except GffeError:
        raise
    except Exception as error:  # NumPy parses it as Python
        reason = " ".join(str(error).split())[:200]
        raise GffeError(f"{label}: damaged NPY header ({reason})") from None
    return shape, fortran, dtype


def _index(name: str, channels: int, label) -> int:
    index = int(name) if name.isdigit() and name.isascii() and len(name) < 6 else _RGBA.get(name, channels)
    if channels == 1 and name in _RGBA:
        index = 0
    if index >= channels:
        raise _no_channel(name, list(map(str, range(min(channels, 12)))), label)
    return index


def _no_channel(name: str, held: Ordered[str], label: str) -> GffeError:
    listed = ", ".join(held[:12]) + (", …" if len(held) > 12 else "")
    return GffeError(f"{label}: no channel '{name}' (the file holds {listed})")


def _require_size(given: Size, size: Size, label: str) -> None:
    if tuple(given) != tuple(size):
        raise GffeError(f"{label}: {given[0]}×{given[1]} pixels, expected {size[0]}×{size[1]}")
