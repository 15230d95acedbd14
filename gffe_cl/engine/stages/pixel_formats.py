"""Packed pixel formats of device buffers (by background.cl and mover_grid.h), and their conversion on the host."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.opencl.program import constants

_PX_UNITS = constants("background.cl")["PX_UNITS"]
_MOST_TRUST = constants("mover_grid.h")["MOST_TRUST"]


@dataclass(frozen=True)
class Packing:
    """A form in which pixels are stored: `name` as tables have it, `channels` of `dtype` each.

    `unpack` turns those of a block, (…, H, W, channels), into values (…, H, W, channels of the buffer), given column
    and row of its first texel and the side of a texel in pixels.
    """

    name: str
    dtype: type
    channels: int
    unpack: Callable[[np.ndarray, int, int, int], np.ndarray]


def _unpack_color(stored: np.ndarray, x: int, y: int, side: int) -> np.ndarray:
    bits = stored[..., 0]
    color = np.zeros((*bits.shape, 4), np.float16)
    unit = np.ldexp(np.float32(1), (bits >> 27).astype(np.int32) - 24)
    for channel in range(3):
        color[..., channel] = (bits >> 9 * channel & 511) * unit
    return color


def _unpack_place(stored: np.ndarray, x: int, y: int, side: int) -> np.ndarray:
    height, width = stored.shape[-3:-1]
    row, column = np.mgrid[y : y + height, x : x + width].astype(np.float32) + np.float32(0.5)
    unit = np.float32(side / _PX_UNITS)
    return np.stack([column, row], -1) * np.float32(side) + stored.astype(np.float32) * unit


def _unpack_trusted(stored: np.ndarray, x: int, y: int, side: int) -> np.ndarray:
    low, high = stored[..., 0], stored[..., 1]
    parts = [low & 0x7FFFF, low >> 19 | (high & 127) << 12, high >> 7 & 0x7FFFF]
    trust = (high >> 26).astype(np.int32)
    trusted = np.where(trust > _MOST_TRUST, np.float32(-1), trust / np.float32(_MOST_TRUST)).astype(np.float32)
    return np.stack([*((part << 13).astype(np.uint32).view(np.float32) for part in parts), trusted], -1)


RGB9E5 = Packing("RGB9E5", np.uint32, 1, _unpack_color)
OFFSET = Packing("int16 ×2", np.int16, 2, _unpack_place)
TRUSTED = Packing("3 × 19 bits + 6", np.uint32, 2, _unpack_trusted)
