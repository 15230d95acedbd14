"""Image metrics. Images are (H, W, 3) float arrays; PSNR and SSIM are taken on display values in [0, 1]."""

from __future__ import annotations

import numpy as np

PSNR_CAP = 100.0
_SMAPE_EPSILON = 0.01  # the paper's: keeps black pixels from counting fully
_SRGB_TOE = np.float32(0.0031308)
_SSIM_WINDOW = 7  # scikit-image's default


def display_values(color, exposure: float = 1.0) -> np.ndarray:
    """What is shown of linear scene-referred `color` (H, W, 3): sRGB(clip(exposure · color, 0, 1)), float32.

    NaN counts as 0. Transfer function: IEC 61966-2-1.
    """
    linear = np.asarray(color).astype(np.float32)
    linear *= np.float32(exposure)
    np.nan_to_num(linear, copy=False, nan=0.0)
    np.clip(linear, 0, 1, out=linear)
    curve = 1.055 * np.maximum(linear, _SRGB_TOE) ** np.float32(1 / 2.4) - 0.055
    return np.where(linear <= _SRGB_TOE, 12.92 * linear, curve)


def psnr(a, b, mask=None) -> float:
    """Peak signal-to-noise ratio in dB for peak 1, over all pixels and channels, at most 100.

    `mask` (H, W) restricts it to the pixels where it is not 0; NaN if there are none.
    """
    squared = np.square(np.subtract(a, b, dtype=np.float32))
    if mask is not None:
        squared = squared[np.asarray(mask) != 0]
    if squared.size == 0:
        return float("nan")
    error = float(squared.mean(dtype=np.float64))
    return PSNR_CAP if error <= 10 ** (-PSNR_CAP / 10) else float(-10 * np.log10(error))


def ssim(a, b) -> float:
    """Structural similarity, mean over pixels and channels: scikit-image's default with data_range=1.

    NaN for images smaller than its window, 7×7. Source: Wang et al., Image Quality Assessment, TIP 2004.
    """
    from skimage.metrics import structural_similarity

    a, b = np.asarray(a), np.asarray(b)
    if min(a.shape[:2]) < _SSIM_WINDOW:
        return float("nan")
    return float(structural_similarity(a, b, data_range=1, channel_axis=-1))


def smape(a, b, exposure: float = 1.0) -> np.ndarray:
    """Symmetric mean absolute percentage error per pixel: (H, W) float32 in [0, 2).

    The mean over RGB of 2|a−b| / (|a|+|b|+0.01) on exposed linear colour; NaN counts as 0.
    """
    a, b = (np.nan_to_num(np.asarray(x).astype(np.float32) * np.float32(exposure), nan=0.0) for x in (a, b))
    return (2 * np.abs(a - b) / (np.abs(a) + np.abs(b) + np.float32(_SMAPE_EPSILON))).mean(-1)
