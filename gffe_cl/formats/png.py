"""PNG files: sizes from the header before anything is decoded, and 16 bits per channel.

Pillow keeps 8 of 16 bits in color: its decoder is asked for the upper bytes, then for the lower ones.
Layout: https://www.w3.org/TR/png-3/
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from gffe_cl.core.errors import GffeError
from gffe_cl.core.files import open_regular

MAGIC = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: ("Y",), 2: ("R", "G", "B"), 3: ("R", "G", "B", "A"), 4: ("Y", "A"), 6: ("R", "G", "B", "A")}
_PALETTE = 3


class PngHeader(NamedTuple):
    width: int
    height: int
    bits: int
    color_type: int

    @property
    def channels(self) -> tuple[str, ...]:
        return _CHANNELS[self.color_type]


def read_png_header(path: Path, label: str) -> PngHeader:
    """Read a PNG's header. Raises GffeError if the file at `path` is no PNG, or of an unsupported kind."""
    with open_regular(path) as file:
        start = file.read(29)
    if len(start) < 29 or not start.startswith(MAGIC) or start[12:16] != b"IHDR":
        raise GffeError(f"{label}: damaged PNG header")
    width, height, bits, kind = struct.unpack(">IIBB", start[16:26])
    if kind not in _CHANNELS or bits not in (1, 2, 4, 8, 16) or not (width and height):
        raise GffeError(f"{label}: damaged PNG header")
    return PngHeader(width, height, bits, kind)


def read_png(path: Path, header: PngHeader, label: str) -> np.ndarray:
    """(H, W, C) uint8, or uint16 where the file has 16 bits per channel. GffeError if it is damaged."""
    try:
        if header.bits < 16 or header.channels == ("Y",):
            array = _decoded(path, "RGBA" if header.color_type == _PALETTE else "L" if header.bits == 1 else None)
        elif header.channels == ("Y", "A"):  # four bytes
            array = _decoded(path, raw="RGBA").view(">u2")
        else:
            upper, lower = (_decoded(path, raw=f"{''.join(header.channels)};16{order}") for order in "BL")
            array = upper.astype(np.uint16) << 8 | lower
        array = array.astype(np.uint16 if header.bits == 16 else np.uint8, copy=False)
        return array.reshape(header.height, header.width, len(header.channels))
    except GffeError:
        raise
    except Exception as error:  # whatever the decoder meets in a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise GffeError(f"{label}: damaged, the pixels cannot be decoded ({reason})") from None


def _decoded(path: Path, mode: str | None = None, raw: str | None = None) -> np.ndarray:
    """Decode the file, converted to Pillow's `mode`, or with `raw` in place of the raw mode by which it unpacks."""
    with open_regular(path) as file, Image.open(file, formats=["PNG"]) as image:
        if raw:
            image.tile = [image.tile[0]._replace(args=raw)]
        return np.asarray(image.convert(mode) if mode else image)
