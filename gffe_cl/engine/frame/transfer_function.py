"""Transfer function of displays (sRGB, IEC 61966-2-1): linear scene-referred color to display values and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gffe_cl.engine.core.validation import as_float32, require_array, require_exposure

SRGB_TOE = np.float32(0.0031308)


def to_display(color: ArrayLike, exposure: float = 1.0) -> np.ndarray:
    """Return display values of linear scene-referred `color` (H, W, 3): sRGB(clip(exposure · color, 0, 1)), float32.

    NaN counts as 0. Raises GffeError for an exposure not within 1e-6 and 1e6, or no array. Metrics compare such values:

        gffe.psnr(gffe.to_display(made), gffe.to_display(truth))
    """
    color, factor = require_array(color, "to_display: color", ..., None), np.float32(require_exposure(exposure))
    with np.errstate(over="ignore"):
        linear = as_float32(color) * factor
    np.nan_to_num(linear, copy=False, nan=0.0)
    np.clip(linear, 0, 1, out=linear)
    curve = 1.055 * np.maximum(linear, SRGB_TOE) ** np.float32(1 / 2.4) - 0.055
    return np.where(linear <= SRGB_TOE, 12.92 * linear, curve)


def linear_values(display, exposure: float = 1.0) -> np.ndarray:
    """Return linear scene-referred color (H, W, 3) float32 that `to_display` shows as `display`, values in [0, 1]."""
    return linear_of_srgb(np.asarray(display, np.float32)) / np.float32(require_exposure(exposure))


def linear_of_srgb(values: np.ndarray) -> np.ndarray:
    """Return linear light of sRGB `values` in their type, of halves float32. Values above 1 continue the curve, those
    below 0 are linear."""
    values = as_float32(values) if values.dtype == np.float16 else values
    curve = ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, curve)
