"""Standard attributes of EXR headers: which are carried on to new frames, and which are reported because nothing here
can use them. docs/formats.md lists all of them.

Attributes about the storage of pixels (windows, compression, tiles, views, cameras) are used by the readers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from gffe_cl.captures.sequence.exr_layout import ExrHeader, ExrPart
from gffe_cl.engine.core.errors import printable

# About the colors or the shape of pixels: as true of new frames as of the given ones.
_CARRIED = {
    "chromaticities": tuple, "whiteLuminance": float, "colorInteropID": str,
    "pixelAspectRatio": float, "renderingTransform": str, "lookModTransform": str,
}  # fmt: skip
_SQUARE = 1e-3  # of pixels' aspect
_SAME_RATE = 0.01  # relative
_PXR24, _B44, _B44A, _DWAA, _DWAB = 5, 6, 7, 8, 9
_DWA_COLORS = ("R", "G", "B", "Y", "RY", "BY")  # ends of names that DWA takes for colors
_COMPRESSIONS = {_PXR24: "pxr24", _B44: "b44", _B44A: "b44a", _DWAA: "dwaa", _DWAB: "dwab"}
_MOST_TEXT, _MOST_ASPECT, _MOST_CHROMATICITY = 4096, 100.0, 10.0  # of attributes that are carried on


def carried(part: ExrPart) -> dict[str, Any]:
    """Return the attributes of a part that new frames get: those about its colors."""
    found = {}
    for name, kind in _CARRIED.items():
        value = part.attributes.get(name)
        if isinstance(value, kind) and _is_sound(name, value):
            found[name] = value
    return found


def _is_sound(name: str, value: Any) -> bool:
    """Return whether an attribute can be written again, and is worth it."""
    if isinstance(value, str):
        return 0 < len(value) <= _MOST_TEXT and "\0" not in value
    if name == "pixelAspectRatio":
        return abs(value - 1) > _SQUARE and 1 / _MOST_ASPECT < value < _MOST_ASPECT
    if name == "chromaticities":
        return bool(np.abs(value).max() < _MOST_CHROMATICITY)
    return bool(np.isfinite(value).all())


class Remarks:
    """Sentences about contents of headers that are not supported, each with the first file of a sequence that has them.
    `fps`: of the description."""

    def __init__(self, fps: float | None = None):
        self._fps = fps
        self._files: dict[str, str] = {}  # by sentence

    def add(self, header: ExrHeader, file: str, exact: Iterable[tuple[int, str]] = ()) -> None:
        """Examine the header of `file`, whose `exact` channels hold depth or motion."""
        for text in _unsupported(header, list(exact), self._fps):
            self._files.setdefault(printable(text), file)

    @property
    def sentences(self) -> list[str]:
        return [f"{printable(file)}: {text}" for text, file in self._files.items()]


def _unsupported(header: ExrHeader, exact: list[tuple[int, str]], fps: float | None) -> Iterator[str]:
    """Yield sentences about `exact` channels that were approximated, pixels that are not square, and another
    frame rate than `fps`."""
    lossy = [(header.parts[index], name) for index, name in exact if _is_approximated(header.parts[index], name)]
    if lossy:
        part, names = lossy[0][0], ", ".join(dict.fromkeys(name for _, name in lossy))
        yield (
            f"compression {_COMPRESSIONS[part.compression]} approximates {names}, which holds depth or motion (expected"
            " zip, piz or none)"
        )
    first = header.parts[exact[0][0] if exact else 0]
    aspect = first.attributes.get("pixelAspectRatio")
    if isinstance(aspect, float) and not abs(aspect - 1) < _SQUARE:
        yield f"pixels are not square, pixelAspectRatio is {aspect:g}: cameras are taken as given"
    rate = frame_rate(first)
    if fps and rate and abs(rate / fps - 1) > _SAME_RATE:
        yield f"framesPerSecond is {rate:g} in the header, {fps:g} in the description, which is used"


def frame_rate(part: ExrPart, name: str = "framesPerSecond") -> float | None:
    """Return the frame rate in the attribute `name`, None if it is missing or invalid."""
    above, _, below = str(part.attributes.get(name, "")).partition("/")
    try:
        rate = float(above) / float(below or 1)
    except (ValueError, ZeroDivisionError):
        return None
    return rate if 0 < rate < 1e6 else None


def _is_approximated(part: ExrPart, channel: str) -> bool:
    kind = part.channels[channel]
    if kind == "uint32":
        return False
    if part.compression in (_DWAA, _DWAB):
        return channel.rpartition(".")[2] in _DWA_COLORS
    if part.compression in (_B44, _B44A):
        return kind == "float16"
    return part.compression == _PXR24 and kind == "float32"
