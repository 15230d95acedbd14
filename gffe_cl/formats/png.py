"""PNG files: sizes from the header before anything is decoded, and 16 bits per channel, which Pillow halves in colour.

Layout: https://www.w3.org/TR/png-3/
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from gffe_cl.core.errors import GffeError
from gffe_cl.core.files import open_regular

MAGIC = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: ("Y",), 2: ("R", "G", "B"), 3: ("R", "G", "B", "A"), 4: ("Y", "A"), 6: ("R", "G", "B", "A")}
_PALETTE = 3
_MOST_FILE = 1 << 30
_FEW_BYTES = 256  # on a diagonal, in the mean: quicker one by one


class PngHeader(NamedTuple):
    width: int
    height: int
    bits: int
    color_type: int
    interlaced: bool

    @property
    def channels(self) -> tuple[str, ...]:
        return _CHANNELS[self.color_type]

    @property
    def is_deep(self) -> bool:
        """Whether there are colours, or grey with alpha, of 16 bits."""
        return self.bits == 16 and len(self.channels) > 1


def read_png_header(path: Path, label: str) -> PngHeader:
    """GffeError if the file at `path` is none, or is of a kind that is not read."""
    with open_regular(path) as file:
        start = file.read(29)
    if len(start) < 29 or not start.startswith(MAGIC) or start[12:16] != b"IHDR":
        raise GffeError(f"{label}: damaged PNG header")
    width, height, bits, kind, _, _, interlace = struct.unpack(">IIBBBBB", start[16:29])
    if kind not in _CHANNELS or bits not in (1, 2, 4, 8, 16) or not (width and height):
        raise GffeError(f"{label}: damaged PNG header")
    header = PngHeader(width, height, bits, kind, bool(interlace))
    if header.is_deep and interlace:
        raise GffeError(f"{label}: interlaced PNG of 16 bits per channel is not supported (expected another)")
    return header


def read_png(path: Path, header: PngHeader, label: str) -> np.ndarray:
    """(H, W, C) uint8, or uint16 where the file has 16 bits per channel. GffeError if it is damaged."""
    try:
        if header.is_deep:
            return _deep(path, header)
        with open_regular(path) as file, Image.open(file, formats=["PNG"]) as image:
            if header.color_type == _PALETTE:
                image = image.convert("RGBA")
            elif header.bits == 1:
                image = image.convert("L")
            array = np.asarray(image)
        array = array.astype(np.uint16) if header.bits == 16 else array.astype(np.uint8)
        return array.reshape(header.height, header.width, len(header.channels))
    except GffeError:
        raise
    except Exception as error:  # whatever the decoder meets in a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise GffeError(f"{label}: damaged, the pixels cannot be decoded ({reason})") from None


def _deep(path: Path, header: PngHeader) -> np.ndarray:
    """(H, W, C) uint16 of a file with 16 bits in each of several channels."""
    pixel = 2 * len(header.channels)
    line = 1 + header.width * pixel
    lines = np.frombuffer(_inflated(path, header.height * line), np.uint8).reshape(header.height, line)
    filters, coded = lines[:, 0], lines[:, 1:].reshape(header.height, header.width, pixel)
    if filters.max(initial=0) > 4:
        raise ValueError(f"filter {filters.max()}")
    plain = _unfiltered(filters, coded)
    return plain.reshape(header.height, header.width, -1, 2).view(">u2")[..., 0].astype(np.uint16)


def _inflated(path: Path, nbytes: int) -> bytes:
    """The `nbytes` of filtered lines; never more are inflated than that."""
    inflater, made = zlib.decompressobj(), []
    left = nbytes
    with open_regular(path) as file:
        if os.fstat(file.fileno()).st_size > _MOST_FILE:
            raise ValueError(f"more than {_MOST_FILE} bytes")
        data = file.readall()
    position = len(MAGIC)
    while left and position + 8 <= len(data):
        length, kind = struct.unpack(">I4s", data[position : position + 8])
        if kind == b"IEND":
            break
        if kind == b"IDAT":
            made.append(inflater.decompress(data[position + 8 : position + 8 + length], left))
            left -= len(made[-1])
        position += 12 + length
    if left:
        raise ValueError(f"{left} of {nbytes} bytes are missing")
    return b"".join(made)


def _unfiltered(filters: np.ndarray, coded: np.ndarray) -> np.ndarray:
    """(H, W, B) uint8 from lines as they are filtered: each byte is added to what its filter says of the bytes to the
    left, above and above left. Where that is all of them, pixels with one x + y at a time: they need earlier ones."""
    height, width, depth = coded.shape
    if filters.max() <= 2:  # of the left or above alone: whole lines at a time
        plain = coded.copy()
        for y, kind in enumerate(filters):
            if kind == 1:
                np.cumsum(coded[y], axis=0, dtype=np.uint8, out=plain[y])
            elif kind == 2 and y:
                plain[y] += plain[y - 1]
        return plain
    if coded.size <= _FEW_BYTES * (width + height):
        return _unfiltered_bytes(filters, coded)
    diagonals = np.zeros((width + height, height + 1, depth), np.int16)  # [x + y + 1, y + 1]: a border of zeros
    for at in range(width + height - 1):
        first, last = max(0, at - width + 1), min(at, height - 1) + 1
        rows = np.arange(first, last)
        left, above = diagonals[at, first + 1 : last + 1], diagonals[at, first:last]
        corner = diagonals[at - 1, first:last]
        said = _guessed(filters[first:last, None], left, above, corner)
        diagonals[at + 1, first + 1 : last + 1] = (coded[rows, at - rows] + said) & 255
    y, x = np.mgrid[:height, :width]
    return diagonals[x + y + 1, y + 1].astype(np.uint8)


def _unfiltered_bytes(filters: np.ndarray, coded: np.ndarray) -> np.ndarray:
    """As `_unfiltered`, one byte at a time."""
    depth, above = coded.shape[2], bytearray(coded[0].size + coded.shape[2])
    plain = []
    for kind, line in zip(filters.tolist(), coded.reshape(len(coded), -1), strict=True):
        made = bytearray(depth)  # a border of zeros
        for at, byte in enumerate(line.tolist()):
            left, up, corner = made[at], above[at + depth], above[at]
            if kind == 4:
                slope = left + up - corner
                near = min((abs(slope - left), 0, left), (abs(slope - up), 1, up), (abs(slope - corner), 2, corner))
                said = near[2]
            else:
                said = (0, left, up, (left + up) >> 1)[kind]
            made.append((byte + said) & 255)
        plain.append(np.frombuffer(made, np.uint8)[depth:])
        above = made
    return np.stack(plain).reshape(coded.shape)


def _guessed(kind: np.ndarray, left: np.ndarray, above: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """What the filters 0 … 4 (none, left, above, mean, Paeth) expect."""
    slope = left + above - corner
    to_left, to_above, to_corner = abs(slope - left), abs(slope - above), abs(slope - corner)
    upper = np.where(to_above <= to_corner, above, corner)
    paeth = np.where((to_left <= to_above) & (to_left <= to_corner), left, upper)
    return np.select([kind == 1, kind == 2, kind == 3, kind == 4], [left, above, (left + above) >> 1, paeth], 0)
