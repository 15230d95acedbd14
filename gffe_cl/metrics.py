"""Image metrics. Images are (H, W, 3) float arrays; PSNR and SSIM are taken on display values in [0, 1]."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

PSNR_CAP = 100.0
_HALF_MAX = 65504.0
FOCUS_SMAPE = 0.5  # the paper's: errors above this are the shading correction network's business
SMAPE_EPSILON = 0.01  # the paper's: keeps black pixels from counting fully
SRGB_TOE = np.float32(0.0031308)
_SSIM_WINDOW = 7  # scikit-image's default


def display_values(color, exposure: float = 1.0) -> np.ndarray:
    """What is shown of linear scene-referred `color` (H, W, 3): sRGB(clip(exposure · color, 0, 1)), float32.

    NaN counts as 0. Transfer function: IEC 61966-2-1.
    """
    linear = np.asarray(color).astype(np.float32)
    linear *= np.float32(exposure)
    np.nan_to_num(linear, copy=False, nan=0.0)
    np.clip(linear, 0, 1, out=linear)
    curve = 1.055 * np.maximum(linear, SRGB_TOE) ** np.float32(1 / 2.4) - 0.055
    return np.where(linear <= SRGB_TOE, 12.92 * linear, curve)


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
    return (2 * np.abs(a - b) / (np.abs(a) + np.abs(b) + np.float32(SMAPE_EPSILON))).mean(-1)


def focus_mask(color, truth, dynamic, exposure: float = 1.0) -> np.ndarray:
    """(H, W) bool: not `dynamic`, and SMAPE > 0.5 against each of the 3×3 pixels of the truth around (M_focus).

    `color` and `truth` are linear (H, W, 3); what kernels/shading.cl computes on devices.
    """
    shown, true = (_finite(image) * np.float32(exposure) for image in (color, truth))
    height, width = shown.shape[:2]
    padded = np.pad(true, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)  # beyond the image nothing is alike
    least = np.full((height, width), np.inf, np.float32)
    for dy in range(3):
        for dx in range(3):
            near = padded[dy : dy + height, dx : dx + width]
            error = 2 * np.abs(shown - near) / (np.abs(shown) + np.abs(near) + np.float32(SMAPE_EPSILON))
            least = np.fmin(least, error[..., 0] + error[..., 1] + error[..., 2])
    return (least > np.float32(3 * FOCUS_SMAPE)) & (np.asarray(dynamic) == 0)


def flip_map(shown, truth) -> np.ndarray | None:
    """NVIDIA's FLIP between display values (H, W, 3), 0 … 1: (H, W) float32; None where flip-evaluator is missing."""
    try:
        from flip_evaluator import evaluate
    except Exception:  # whatever a binary package throws
        return None
    images = (np.ascontiguousarray(image, np.float32) for image in (truth, shown))
    return evaluate(*images, "LDR", applyMagma=False)[0][..., 0]


@dataclass
class RegionErrors:
    """Errors of images against the truth, pooled over frames, by region of the image.

    By name of the region: `pixels`, `squared` (summed squared error of display values, mean over RGB) and `flip`
    (summed FLIP, empty where that is not measured).
    """

    pixels: dict[str, int] = field(default_factory=dict)
    squared: dict[str, float] = field(default_factory=dict)
    flip: dict[str, float] = field(default_factory=dict)

    def add(self, shown, truth, regions: dict[str, np.ndarray]) -> None:
        """One image: display values (H, W, 3) and masks (H, W) by name."""
        squared, flip = np.square(np.subtract(shown, truth, dtype=np.float32)).mean(-1), flip_map(shown, truth)
        for name, mask in regions.items():
            here = np.asarray(mask) != 0
            self.pixels[name] = self.pixels.get(name, 0) + int(here.sum())
            self.squared[name] = self.squared.get(name, 0.0) + float(squared[here].sum(dtype=np.float64))
            if flip is not None:
                self.flip[name] = self.flip.get(name, 0.0) + float(flip[here].sum(dtype=np.float64))

    @classmethod
    def pooled(cls, several: Iterable[RegionErrors]) -> RegionErrors:
        total = cls()
        for one in several:
            for name in ("pixels", "squared", "flip"):
                into = getattr(total, name)
                for region, value in getattr(one, name).items():
                    into[region] = into.get(region, 0) + value
        return total

    def figures(self) -> dict[str, dict[str, float]]:
        """By region: `share` of the region named "whole", `psnr` in dB, mean `flip`; NaN where there is nothing."""
        return {
            name: {
                "share": count / max(self.pixels["whole"], 1),
                "psnr": min(PSNR_CAP, -10 * float(np.log10(self.squared[name] / count + 1e-30))) if count else np.nan,
                "flip": self.flip[name] / count if count and self.flip else np.nan,
            }
            for name, count in self.pixels.items()
        }


def _finite(color) -> np.ndarray:
    color = np.nan_to_num(np.asarray(color)[..., :3].astype(np.float32), nan=0.0, posinf=np.inf, neginf=-np.inf)
    return np.clip(color, -_HALF_MAX, _HALF_MAX)
