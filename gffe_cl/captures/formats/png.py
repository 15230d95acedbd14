"""Reader of PNG files: sizes from the header before anything is decoded, and 16 bits per channel.

Pillow keeps 8 of 16 bits in color: its decoder is asked for the upper bytes, then for the lower ones.
Layout: https://www.w3.org/TR/png-3/
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from gffe_cl.engine.core.errors import GffeError, printable
from gffe_cl.engine.core.files import open_regular

MAGIC = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: ("Y",), 2: ("R", "G", "B"), 3: ("R", "G", "B", "A"), 4: ("Y", "A"), 6: ("R", "G", "B", "A")}
_PALETTE = 3
_MOST_CHUNKS, _MOST_CHUNK = 1000, 1 << 16  # before the pixels
_NEAR_GAMMA, _NEAR_CHROMATICITY = 0.1, 2e-3
_TRANSFERS = {8: "linear", 13: "srgb", 1: "BT.709", 16: "PQ", 18: "HLG"}  # of cICP, by ITU-T H.273
_SRGB = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


class PngColors(NamedTuple):
    """Color information in the header of a PNG: `transfer` "linear", "srgb" or "gamma" with `gamma`, None if missing;
    `words` for messages; `chromaticities` as in EXR headers: x, y of red, green, blue and white; and whether there is a
    `profile`, which is not applied."""

    transfer: str | None = None
    gamma: float = 1.0
    words: str = ""
    chromaticities: tuple[float, ...] | None = None
    profile: bool = False

    def contradicts(self, encoding: str, gamma: float) -> bool:
        """Return whether the header specifies another encoding than this `encoding`."""
        if self.transfer is None:
            return False
        powers = {"linear": 1.0, "srgb": 2.2, "gamma": gamma}
        mine = self.gamma if self.transfer == "gamma" else powers[self.transfer]
        return abs(mine - powers[encoding]) > _NEAR_GAMMA


class PngHeader(NamedTuple):
    width: int
    height: int
    bits: int
    color_type: int

    @property
    def channels(self) -> tuple[str, ...]:
        return _CHANNELS[self.color_type]


def read_png_header(path: Path, label: str) -> PngHeader:
    """Return a PNG's header. Raises GffeError if the file at `path` is no PNG, or of an unsupported kind."""
    with open_regular(path) as file:
        start = file.read(29)
    if len(start) < 29 or not start.startswith(MAGIC) or start[12:16] != b"IHDR":
        raise GffeError(f"{label}: damaged PNG header")
    width, height, bits, kind = struct.unpack(">IIBB", start[16:26])
    if kind not in _CHANNELS or bits not in (1, 2, 4, 8, 16) or not (width and height):
        raise GffeError(f"{label}: damaged PNG header")
    return PngHeader(width, height, bits, kind)


def read_png_colors(path: Path) -> PngColors:
    """Return the color information in the header of a PNG; nothing for files of other kinds."""
    try:
        with open_regular(path) as file:
            chunks = dict(_chunks(file))
    except OSError:
        return PngColors()
    given = chunks.get(b"cHRM", b"")
    chromaticities = None
    if len(given) >= 32:
        numbers = [n / 1e5 for n in struct.unpack(">8I", given[:32])]
        chromaticities = (*numbers[2:], *numbers[:2])
        if np.abs(np.subtract(chromaticities, _SRGB)).max() < _NEAR_CHROMATICITY or max(numbers) > 1:
            chromaticities = None  # as of every file without
    if len(coded := chunks.get(b"cICP", b"")) >= 4:
        transfer = _TRANSFERS.get(coded[1], f"curve {coded[1]}")
        known = transfer in ("linear", "srgb")
        return PngColors(transfer if known else None, 1.0, f"cICP: {transfer}", chromaticities, not known)
    if b"sRGB" in chunks:
        return PngColors("srgb", 1.0, "sRGB", chromaticities)
    if b"iCCP" in chunks:
        name = printable(chunks[b"iCCP"].split(b"\0")[0].decode("latin-1")[:80])
        if "srgb" in name.lower() and "linear" not in name.lower():
            return PngColors("srgb", 1.0, f"profile {name}", chromaticities)
        return PngColors(None, 1.0, f"profile {name}", chromaticities, True)
    if len(gamma := chunks.get(b"gAMA", b"")) >= 4 and (power := struct.unpack(">I", gamma[:4])[0]):
        if abs(1e5 / power - 1) <= _NEAR_GAMMA:
            return PngColors("linear", 1.0, f"gAMA: {power / 1e5:g}", chromaticities)
        return PngColors("gamma", 1e5 / power, f"gAMA: {power / 1e5:g}", chromaticities)
    return PngColors(chromaticities=chromaticities)


def _chunks(file) -> Iterator[tuple[bytes, bytes]]:
    """Yield the names of the chunks before the pixels, with their first bytes."""
    if file.read(8) != MAGIC:
        return
    for _ in range(_MOST_CHUNKS):
        start = file.read(8)
        if len(start) < 8 or start[4:] in (b"IDAT", b"IEND"):
            return
        (length,) = struct.unpack(">I", start[:4])
        data = file.read(min(length, _MOST_CHUNK))
        yield start[4:], data
        file.seek(length - len(data) + 4, 1)


def read_png(path: Path, header: PngHeader, label: str) -> np.ndarray:
    """Return the pixels (H, W, C) uint8, or uint16 where the file has 16 bits per channel. Raises GffeError if it is
    damaged."""
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
    """Return the decoded pixels, converted to Pillow's `mode`, or with `raw` in place of the raw mode by which it
    unpacks."""
    with open_regular(path) as file, Image.open(file, formats=["PNG"]) as image:
        if raw:
            image.tile = [image.tile[0]._replace(args=raw)]
        return np.asarray(image.convert(mode) if mode else image)
