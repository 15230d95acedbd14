"""Pixels of OpenEXR files: reading those of any writer, writing our own."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

import numpy as np
import OpenEXR

from gffe_cl.errors import GffeError
from gffe_cl.sequence.exr_header import ExrHeader, read_header
from gffe_cl.sequence.library_messages import library_messages

_FLOAT_CHANNELS = ("Z", "motion.")  # always float32; any other channel keeps half if it is half


def read_channels(path: Path, names, label: str, size=None) -> dict[str, np.ndarray]:
    """Channels `names` of the EXR file at `path` as (H, W) arrays, float16, float32 or uint32 as stored.

    `size` is the expected (width, height). Raises GffeError, beginning with `label`, for missing channels,
    another size, and files that are truncated or damaged.
    """
    header = read_header(path, label)
    places = require_channels(header, names, label)
    require_size(header, names, size, label)
    said: list[str] = []
    try:
        with library_messages(path) as said, OpenEXR.File(str(path), separate_channels=True) as file:
            parts = [file.channels(i) for i in range(len(file.parts))]  # none if the library gave up
            if len(parts) != len(header.parts):
                raise ValueError("corrupt pixel data")
            arrays = [parts[part][name].pixels for part, name in places]
    except Exception as error:
        reason = "; ".join(dict.fromkeys((_one_line(error), *map(_one_line, said[:1]))))
        raise GffeError(f"{label}: damaged, the pixels cannot be decoded ({reason})") from None
    return dict(zip(names, arrays, strict=True))


def require_channels(header: ExrHeader, names, label: str) -> list[tuple[int, str]]:
    """(part, channel) for each of `names`; GffeError for the first that is not there."""
    places = [header.find(name) for name in names]
    for name, place in zip(names, places, strict=True):
        if place is None:
            held = _one_line(", ".join(header.channels[:12])) + (", …" if len(header.channels) > 12 else "")
            raise GffeError(f"{label}: no channel '{name}' (expected {', '.join(names)}; the file holds {held})")
    return places


def require_size(header: ExrHeader, names, size, label: str) -> None:
    """GffeError if a part that holds one of `names` is subsampled or not `size` = (width, height)."""
    for index, _ in require_channels(header, names, label):
        part = header.parts[index]
        if part.subsampled:
            raise GffeError(f"{label}: subsampled channels are not supported")
        if size is not None and part.size != tuple(size):
            raise GffeError(f"{label}: {_by(part.size)} pixels, expected {_by(size)}")


def stored_type(name: str, array) -> np.ndarray:
    """A copy of `array` in the type that channel `name` is stored in: half stays half, small integers and
    masks become half, Z, motion and everything else float32."""
    array = np.asarray(array)
    if name.startswith(_FLOAT_CHANNELS):
        return np.array(array, np.float32, order="C")
    if array.dtype in (np.float16, np.uint8, np.bool_):
        return np.array(array, np.float16, order="C")
    if array.dtype == np.uint32:
        return np.array(array, order="C")
    return np.array(array, np.float32, order="C")


def write_channels(path: Path, channels: dict[str, np.ndarray], attributes: dict | None = None) -> None:
    """Write (H, W) arrays as one ZIP-compressed EXR file, under a temporary name until it is whole.

    `attributes` are further header attributes. Raises OSError (disk full: ENOSPC), leaving nothing.
    """
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(attributes or {})}
    part_path = partial_name(path)
    try:
        try:
            # The library takes any array for a contiguous one.
            contiguous = {name: np.ascontiguousarray(channel) for name, channel in channels.items()}
            with library_messages(part_path):
                OpenEXR.File(header, contiguous).write(str(part_path))
        except RuntimeError as error:
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
    """Where `path` is kept until it is whole."""
    return path.with_name(f".{path.name}.part")


def _by(size) -> str:
    return f"{size[0]}×{size[1]}"


def _one_line(error) -> str:
    text = " ".join(str(error).split())
    return "".join(c if c.isprintable() else "?" for c in text) or type(error).__name__
