"""Textures of layers on the GPU."""

from __future__ import annotations

import math

import moderngl
import numpy as np

from gffe_cl.engine.inspection.layers import LayerSpec
from .displays import FrameInfo

_DTYPES = {"uint8": "f1", "float16": "f2", "float32": "f4"}


class Texture:
    """A layer on the GPU: (planes, H, W, components) texels."""

    def __init__(self, ctx: moderngl.Context, texels: np.ndarray):
        planes, height, width, self.components = texels.shape
        self.size, self.format = (width, height), (texels.shape, texels.dtype)
        dtype = _DTYPES[texels.dtype.name]
        self.texels = ctx.texture_array((width, height, planes), self.components, alignment=1, dtype=dtype)
        self.texels.repeat_x = self.texels.repeat_y = False
        self.texels.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self.planes, self.unit = planes, 255.0 if dtype == "f1" else 1.0
        self.mipmaps = 0  # levels of the present texels, besides themselves
        self.spec: LayerSpec | None = None
        self.frame: FrameInfo | None = None

    def release(self) -> None:
        self.texels.release()

    def have_mipmaps(self, levels: int) -> None:
        """Make at least this many mipmaps for smaller display, with interpolation between two of them."""
        if levels > self.mipmaps:
            self.texels.build_mipmaps(max_level=levels)
            self.texels.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self.mipmaps = levels


def texels_of(array: np.ndarray, spec: LayerSpec, most: int) -> np.ndarray | None:
    """Return (planes, H, W, C) of one of _DTYPES, C-contiguous; None for an empty image."""
    array = np.asarray(array)
    if spec.planes == 1 and array.ndim < 4:
        array = array[None]
    array = array[..., None] if array.ndim == 3 else array[..., :4]
    if array.ndim != 4 or not array.size:
        return None
    step = math.ceil(max(array.shape[1:3]) / most)
    array = array[:, ::step, ::step]
    return np.ascontiguousarray(array, array.dtype if array.dtype.name in _DTYPES else np.float32)
