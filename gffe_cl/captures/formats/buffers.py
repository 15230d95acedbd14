"""Buffers of a `gffe-folder`: their files, and the meaning of their numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.captures.formats.cameras import UNITS, FoundCamera
from gffe_cl.captures.formats.images import Size, check_planes, read_planes
from gffe_cl.captures.formats.json_schema import Keys
from gffe_cl.captures.formats.layers import Place
from gffe_cl.captures.formats.numbering import with_ending
from gffe_cl.captures.sequence.description import reference
from gffe_cl.captures.sequence.exr_layout import ExrHeader
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_bool, shown
from gffe_cl.engine.frame.conventions import DIRECTIONS, decides_depth_range, depth_from_device, depth_from_distance

# How several 8-bit channels hold one number from 0 to 1: the weight of each, the first one first.
PACKINGS = {
    "none": None,
    "big-endian": lambda n: [256.0 ** (n - 1 - k) * 255 / (256.0**n - 1) for k in range(n)],
    "little-endian": lambda n: [256.0**k * 255 / (256.0**n - 1) for k in range(n)],
    "unity": lambda n: [255.0**-k for k in range(n)],  # EncodeFloatRG, EncodeFloatRGBA
}
COLOR_ENCODINGS = ("linear", "srgb", "gamma")
DEPTH_ENCODINGS = ("linear", "distance", "inverse", "device", "logarithmic")
TO_NEXT = "to_next"
_EQUAL = 1e-6  # relative: of numbers in a file and in JSON
_NUMBER = re.compile(r"%(0\d{1,2})?d")


@dataclass(frozen=True)
class Buffer:
    """Position of a buffer's numbers, and a linear map to their values: (v − offset) · scale."""

    pattern: str  # path of its files, with %d or %04d for the frame's number
    channels: tuple[str, ...]
    packing: str
    normalized: bool  # integers are 0 … 1
    bottom_up: bool
    offset: tuple[float, ...]
    scale: tuple[float, ...]
    valid: str | None = None  # a channel that is 0 where nothing was written
    unknown: tuple[float, ...] | None = None  # what stands in place of values that were never written
    unknown_from: float | None = None  # values of that magnitude or more are none

    def file(self, number: int) -> str:
        return _NUMBER.sub(lambda found: found[0] % number, self.pattern)

    def path(self, folder: Path, number: int) -> Path:
        """Return the path of the file, whose ending may be in capital letters."""
        return with_ending(folder / self.file(number))

    def check(self, folder: Path, number: int, size: Size) -> tuple[ExrHeader, list[Place]] | None:
        """Check the file by its headers, and return that of an EXR file with the places of the channels. Raises
        GffeError if it cannot be read."""
        return check_planes(self.path(folder, number), self._planes, self.file(number), size)

    @property
    def _planes(self) -> tuple[str, ...]:
        return self.channels if self.valid is None else (*self.channels, self.valid)

    def read(self, folder: Path, number: int, size: Size) -> np.ndarray:
        """Return (H, W, components) float64, or float16 and float32 where the file stores these unchanged; NaN where
        nothing was written."""
        planes = read_planes(self.path(folder, number), self._planes, self.file(number), size)
        if self.bottom_up:
            planes = planes[::-1]
        unwritten = None
        if self.valid is not None:
            unwritten, planes = planes[..., -1] == 0, planes[..., :-1]
        values = self._values(planes)
        for wrong in (unwritten, self._is_unknown(values)):
            if wrong is not None and wrong.any():
                values = np.where(wrong[..., None], values.dtype.type(np.nan), values)
        plain = not any(self.offset) and all(s == 1 for s in self.scale)
        if plain and values.dtype in (np.float16, np.float32):
            return values
        return (values - np.array(self.offset)) * np.array(self.scale)

    def _is_unknown(self, values: np.ndarray) -> np.ndarray | None:
        """Return where `values` (H, W, components), before offset and scale, mark unknown ones; None if nothing marks
        them."""
        found = None
        if self.unknown is not None:
            near = _EQUAL * np.abs(self.unknown)
            found = np.asarray((np.abs(values.astype(np.float64) - self.unknown) <= near).all(-1))
        if self.unknown_from is not None:
            large = np.asarray((np.abs(values) >= self.unknown_from).any(-1))
            found = large if found is None else found | large
        return found

    def _values(self, planes: np.ndarray) -> np.ndarray:
        """Return the numbers in `planes`, before offset and scale: unpacked, integers from 0 to 1."""
        kind = planes.dtype
        if kind.kind in "iub" and self.normalized:
            planes = planes / (1.0 if kind.kind == "b" else float(np.iinfo(kind).max))
        if self.packing != "none":
            each = planes.shape[-1] // len(self.scale)
            weights = np.array(PACKINGS[self.packing](each))
            planes = planes.reshape(*planes.shape[:2], len(self.scale), each) @ weights
        return planes if planes.dtype.kind == "f" else planes.astype(np.float64)


def parse_buffer(keys: Keys, default: tuple[str, ...], unwritten: bool = False) -> Buffer:
    """Return the common part of all buffers; `default` are the channels, one for each component. With `unwritten` keys
    may specify the values that were never written."""
    count = len(default)
    pattern = keys.text("file")
    if pattern is None or len(_NUMBER.findall(pattern)) != 1 or "%" in _NUMBER.sub("", pattern):
        raise GffeError(
            f"{keys.label}, file must be a name with %d or %04d for the frame's number, got {shown(pattern)}"
        )
    name_on_disk, elsewhere = reference(pattern, keys.label)
    channels = keys.take("channels", list(default))
    if not isinstance(channels, list) or not channels or not all(isinstance(c, str) for c in channels):
        raise GffeError(f"{keys.label}, channels must be a list of names, got {shown(channels)}")
    packing = keys.choice("packing", tuple(PACKINGS), "none")
    right = len(channels) % count == 0 and len(channels) <= 4 if packing != "none" else len(channels) == count
    if not right:
        raise GffeError(f"{keys.label}, channels must be {count} names, or with packing up to 4, got {shown(channels)}")
    normalized = keys.choice("values", ("normalized", "raw"), "normalized") == "normalized"
    if packing != "none" and not normalized:
        raise GffeError(f"{keys.label}: packed values are from 0 to 1 (expected no values: raw)")
    return Buffer(
        elsewhere or name_on_disk,
        tuple(channels),
        packing,
        normalized,
        keys.choice("origin", ("top-left", "bottom-left"), "top-left") == "bottom-left",
        keys.numbers("offset", count, (0.0,) * count),
        keys.numbers("scale", count, (1.0,) * count),
        valid=keys.text("valid") if unwritten else None,
        unknown=keys.numbers("unknown", count, None) if unwritten else None,
        unknown_from=keys.number("unknown_from") if unwritten else None,
    )


@dataclass(frozen=True)
class ColorBuffer:
    """Description of color: `buffer`, and the encoding that is undone after it."""

    buffer: Buffer
    encoding: str
    gamma: float
    told: bool = True  # by the description, not by default

    def read(self, folder: Path, number: int, size: Size) -> np.ndarray:
        """Return linear RGB (H, W, 3), float16 as stored or float32."""
        color = self.buffer.read(folder, number, size)
        if self.encoding == "srgb":
            color = np.where(color <= 0.04045, color / 12.92, ((np.maximum(color, 0) + 0.055) / 1.055) ** 2.4)
        elif self.encoding == "gamma":
            color = np.maximum(color, 0) ** self.gamma
        return color if color.dtype == np.float16 else color.astype(np.float32)


def parse_color(document: Any, name: str = "color") -> ColorBuffer:
    keys = Keys(document, name)
    buffer, told = parse_buffer(keys, ("R", "G", "B")), isinstance(document, dict) and bool(document.get("encoding"))
    made = ColorBuffer(buffer, keys.choice("encoding", COLOR_ENCODINGS, "linear"), keys.number("gamma", 2.2), told)
    keys.done()
    return made


@dataclass(frozen=True)
class DepthBuffer:
    """Description of depth: `buffer`, and the conversion by `encoding` after it."""

    buffer: Buffer
    encoding: str
    near: float | None
    far: float
    reversed: bool
    opengl_buffer: bool | None  # None: as the convention has it
    sky: float | None
    sky_from: float | None
    convention: str

    def read(self, folder: Path, number: int, size: Size, found: FoundCamera) -> np.ndarray:
        """Return planar depth (H, W) float32 in world units, +inf for sky; `found` is the camera of that frame."""
        values = self.buffer.read(folder, number, size)[..., 0]
        nothing = np.zeros(values.shape, bool)
        if self.sky is not None:
            nothing |= values == self.sky
        if self.encoding == "device":
            depth = self._from_device(values, found)
        elif self.encoding == "logarithmic":
            depth = self._from_logarithmic(values)
        elif self.encoding == "inverse":
            with np.errstate(divide="ignore"):
                depth = 1.0 / values.astype(np.float64)
        elif self.encoding == "distance":
            depth = depth_from_distance(values.astype(np.float64), found.camera)
        else:
            depth = values
        if self.sky_from is not None:
            nothing |= depth >= self.sky_from
        return np.where(nothing, np.inf, depth).astype(np.float32)

    def range_note(self, found: FoundCamera) -> str | None:
        """Return a sentence where neither the description nor the projection determines the range of a depth buffer of
        OpenGL, else None."""
        if self.encoding != "device" or self.near is not None or found.projection is None:
            return None
        if self.convention != "opengl" or self.opengl_buffer is not None or decides_depth_range(found.projection):
            return None
        return (
            "depth: the matrix does not tell whether 0 … 1 in the buffer is −1 … 1 in device coordinates: it is taken"
            ' for that, as without glClipControl (expected "opengl_buffer": true or false)'
        )

    def _from_device(self, values: np.ndarray, found: FoundCamera) -> np.ndarray:
        if self.near is None:
            opengl = self.convention == "opengl" if self.opengl_buffer is None else self.opengl_buffer
            depth = depth_from_device(values, found.projection, layout="row-major", opengl_buffer=opengl)
            return depth * np.float32(found.scale)
        values = np.asarray(values, np.float64)
        beyond = values if self.reversed else 1 - values  # 0 at the far plane
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = self.near / (beyond + self.near / self.far * (1 - beyond))
        return np.where(beyond <= 0, np.inf, depth)

    def _from_logarithmic(self, values: np.ndarray) -> np.ndarray:
        """Return depth of log(z / near) / log(far / near) or, without near, of log(1 + z) / log(1 + far)."""
        values = np.asarray(values, np.float64)
        part = 1 - values if self.reversed else values  # 1 at the far plane
        near, unit = self.near or 0.0, self.near or 1.0
        with np.errstate(over="ignore"):
            depth = near + unit * np.expm1(np.log1p((self.far - near) / unit) * part)
        return np.where(part >= 1, np.inf, depth)


def parse_depth(document: Any, convention: str) -> DepthBuffer:
    keys = Keys(document, "depth")
    buffer = parse_buffer(keys, ("R",), unwritten=True)
    encoding = keys.choice("encoding", DEPTH_ENCODINGS, "linear")
    near, far = keys.number("near"), keys.take("far", "infinite")
    far = np.inf if far == "infinite" else far
    if not isinstance(far, int | float) or isinstance(far, bool) or (near is not None and not 0 < near < far):
        raise GffeError(f'depth: expected 0 < near < far, far a number or "infinite", got {shown(near)}, {shown(far)}')
    if encoding == "logarithmic" and not 0 < far < np.inf:
        raise GffeError(f'depth: logarithmic depth needs "far", a number greater than 0, got {shown(far)}')
    made = DepthBuffer(
        buffer,
        encoding,
        near,
        float(far),
        keys.flag("reversed"),
        None if (opengl := keys.take("opengl_buffer")) is None else require_bool(opengl, "depth, opengl_buffer"),
        keys.number("sky"),
        keys.number("sky_from"),
        convention,
    )
    keys.done()
    return made


@dataclass(frozen=True)
class MotionBuffer:
    """Description of motion: `buffer`, then unit, direction and y."""

    buffer: Buffer
    unit: str
    direction: str
    y_up: bool
    jitter_removed: bool

    @property
    def to_next(self) -> bool:
        """Whether a frame's vectors lead to the next frame, so that those of the previous frame are inverted."""
        return self.direction == TO_NEXT

    def read(self, folder: Path, number: int, size: Size) -> np.ndarray:
        """Return motion (H, W, 2) float32, pixels, y down: (previous − here), or with `to_next` (next − here)."""
        motion = self.buffer.read(folder, number, size).astype(np.float64)
        return (motion * self.factors(size)).astype(np.float32)

    def factors(self, size: Size) -> tuple[float, float]:
        """Return the factors from the buffer's x and y to pixels of an image of `size`."""
        across, down = UNITS[self.unit](size)
        sign = DIRECTIONS.get(self.direction, 1.0)
        return sign * across, sign * down * (-1 if self.y_up else 1)


def parse_motion(document: Any) -> MotionBuffer:
    keys = Keys(document, "motion")
    made = MotionBuffer(
        parse_buffer(keys, ("R", "G"), unwritten=True),
        keys.choice("unit", tuple(UNITS), "pixels"),
        keys.choice("direction", (*DIRECTIONS, TO_NEXT), "to_previous"),
        keys.choice("y", ("down", "up"), "down") == "up",
        keys.choice("jitter", ("included", "removed"), "included") == "removed",
    )
    keys.done()
    return made
