"""Reader of images in foreign captures: EXR, PNG and NPY, recognized by their first bytes. Sizes are checked
before decoding."""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Sequence as Ordered
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gffe_cl.captures.formats.capture import Place, Size, layers_of
from gffe_cl.captures.sequence.exr import decoded, place_of, placed, require_shown
from gffe_cl.captures.sequence.exr_header import ExrHeader, read_header
from gffe_cl.engine.core.errors import GffeError, require_packages
from gffe_cl.engine.core.files import open_regular, require_moderate

_MOST_HEADER = 1 << 16
_EXR_MAGIC, _NPY_MAGIC, _PNG_MAGIC = b"\x76\x2f\x31\x01", b"\x93NUMPY", b"\x89PNG\r\n\x1a\n"
_PNG_HEADER, _PNG_CHANNELS = 26, {0: "Y", 2: "RGB", 3: "RGBA", 4: "YA", 6: "RGBA"}
_RGBA = {"R": 0, "G": 1, "B": 2, "A": 3}


def read_planes(path: Path, names: Ordered[str], label: str, size: Size, outside: float = 0.0) -> np.ndarray:
    """Return the channels `names` of the image at `path` as (H, W, C), in the type stored.

    Channels of PNG are R, G, B, A (gray is any of the first three), of NPY 0, 1, …, or R, G, B, A for the first four.
    In EXR files pixels lie in the display window where the data window says; `outside` of it they are that value.
    Raises a GffeError that begins with `label` for a missing file or channel, another size than `size`, and damage.
    """
    return _read(path, names, label, size, outside, decode=True)


def check_planes(path: Path, names: Ordered[str], label: str, size: Size) -> None:
    """Check an image as `read_planes` does, by headers only: no pixel is decoded."""
    _read(path, names, label, size, 0.0, decode=False)


def _read(path, names, label, size, outside, decode) -> Any:
    try:
        with open_regular(path) as file:
            start = file.read(8)
        if start.startswith(_EXR_MAGIC):
            return _exr(path, names, label, size, outside, decode)
        if start == _PNG_MAGIC:
            return _png(path, names, label, size, decode)
        if start.startswith(_NPY_MAGIC):
            return _npy(path, names, label, size, decode)
    except FileNotFoundError:
        raise GffeError(f"{label}: no such file in {path.parent}") from None
    except OSError as error:
        raise GffeError(f"{label}: cannot be read ({error.strerror or error})") from None
    raise GffeError(f"{label}: not an EXR, PNG or NPY file")


def _exr(path, names, label, size, outside, decode):
    header = read_header(path, label)
    places = _places(header, names, label)
    require_shown(header, {part for part, _ in places}, size, label)
    if not decode:
        return None
    found = decoded(path, header, places, label)
    parts = [header.parts[part] for part, _ in places]
    return np.stack([placed(array, part, outside) for array, part in zip(found, parts, strict=True)], -1)


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
    with open_regular(path) as file:
        data = file.read(_PNG_HEADER)
        width, height, bits, held = _png_header(data, label)
        _require_size((width, height), size, label)
        order = []
        for name in names:
            gray = held[0] == "Y" and name in ("R", "G", "B")
            if not gray and name not in held:
                raise _no_channel(name, held, label)
            order.append(0 if gray else held.index(name))
        require_moderate(width * height * len(held) * 2, math.prod(size), label)
        if not decode:
            return None
        data += file.read()
    by_opencv = bits == 16 and held != "Y"  # Pillow keeps 8 of 16 bits in color
    if by_opencv:
        require_packages(f"{label}: a PNG of 16 bits", "opencv", "cv2")
    try:
        return (_by_opencv if by_opencv else _by_pillow)(data, held, bits)[..., order]
    except Exception as error:  # whatever the decoder meets in a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise GffeError(f"{label}: damaged, the pixels cannot be decoded ({reason})") from None


def _png_header(data: bytes, label: str) -> tuple[int, int, int, str]:
    """Return width, height, bits and channels from the first bytes of a PNG (https://www.w3.org/TR/png-3/)."""
    if len(data) == _PNG_HEADER and data[12:16] == b"IHDR":
        width, height, bits, kind = struct.unpack(">IIBB", data[16:])
        if kind in _PNG_CHANNELS and bits in (1, 2, 4, 8, 16) and width and height:
            return width, height, bits, _PNG_CHANNELS[kind]
    raise GffeError(f"{label}: damaged PNG header")


def _by_pillow(data: bytes, held: str, bits: int) -> np.ndarray:
    with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
        if bits == 16:
            return np.asarray(image).astype(np.uint16)[..., None]
        return np.atleast_3d(np.asarray(image.convert(held.replace("Y", "L"))))


def _by_opencv(data: bytes, held: str, bits: int) -> np.ndarray:
    import cv2

    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if found is None or found.dtype != np.uint16:
        raise ValueError("not decoded")
    return found[..., {"YA": [0, -1], "RGB": [2, 1, 0], "RGBA": [2, 1, 0, 3]}[held]]


def _npy(path, names, label, size, decode):
    """Return channels of the array in an NPY file, which is mapped: no more is read than they need."""
    with open_regular(path) as file:
        start = file.read(12)
    length = int.from_bytes(start[8 : 10 if start[6:7] == b"\1" else 12], "little")
    if length > _MOST_HEADER:  # NumPy would make room for it
        raise GffeError(f"{label}: damaged NPY file (a header of {length} bytes)")
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # NumPy parses its header as Python
        raise GffeError(f"{label}: damaged NPY file ({' '.join(str(error).split())[:200]})") from None
    if array.ndim not in (2, 3) or array.dtype.kind not in "fiub" or array.dtype.itemsize > 8:
        kind = f"an array of {array.dtype} and shape {array.shape}"
        raise GffeError(f"{label}: {kind} (expected numbers, (H, W) or (H, W, C))")
    _require_size((array.shape[1], array.shape[0]), size, label)
    channels = array.shape[2] if array.ndim == 3 else 1
    order = [_index(name, channels, label) for name in names]
    require_moderate(array.nbytes, math.prod(size), label)
    if not decode:
        return None
    found = np.asarray(array).reshape(size[1], size[0], channels)[..., order]
    return found.astype(found.dtype.newbyteorder("="), copy=False)


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
