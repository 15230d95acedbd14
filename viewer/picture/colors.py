"""False colors for depths, motions, masks and labels."""

from __future__ import annotations

import math

import numpy as np

from gffe_cl.engine.inspection.layers import LayerSpec

# "heat" is for errors, "diverging" for signed differences: blue below the middle, which is dark, and red above it
COLOR_MAPS = ("turbo", "viridis", "gray", "heat", "diverging")

Rgb = tuple[float, float, float]

SKY: Rgb = (0.62, 0.78, 0.95)
MASK_OFF: Rgb = (0.09, 0.09, 0.10)
WHEEL_CENTER = 0.08  # gray of a motion of no length
_LABEL_COLORS = (
    "29292e 3880de 29b880 f5db40 a043b8 85d1f5 751442 fab3c2 8c572e 006e73 7d851f 00f0f0 9ee659 ccb8ff fa7a10 e62442"
)
LABEL_COLORS: tuple[Rgb, ...] = tuple(  # of value & 15: 0 is the usual case; 14 and 15 are 254 and 255 of `filled_by`
    (red / 255, green / 255, blue / 255) for red, green, blue in map(bytes.fromhex, _LABEL_COLORS.split())
)


def label_flip(spec: LayerSpec) -> int:
    """Return the number that is XORed with the low bits of a label to choose its color: of sets of bits (no names) the
    full one is usual."""
    return 0 if spec.labels else 15


def color_table(name: str) -> np.ndarray:
    """Return (256, 3) float32 in [0, 1]: display values from low to high.

    "turbo": A. Mikhailov's, "viridis": S. van der Walt's and N. Smith's, both as polynomials.
    """
    t = np.linspace(0, 1, 256)[:, None]
    if name == "gray":
        rgb = np.repeat(t, 3, 1)
    elif name == "heat":
        rgb = 3 * t - (0, 1, 2)
    elif name == "diverging":
        sign, size = np.sign(2 * t - 1), abs(2 * t - 1)
        rgb = np.where(sign > 0, 1.6 * size - (0, 0.6, 1.4), 1.6 * size - (1.4, 0.6, 0))
    else:
        rgb = np.polynomial.polynomial.polyval(t[:, 0], np.transpose(_POLYNOMIALS[name])).T
    return np.clip(rgb, 0, 1).astype(np.float32)


_POLYNOMIALS = {  # of R, G and B; coefficients, constant first
    "turbo": (
        (0.13572138, 4.61539260, -42.66032258, 132.13108234, -152.94239396, 59.28637943),
        (0.09140261, 2.19418839, 4.84296658, -14.18503333, 4.27729857, 2.82956604),
        (0.10667330, 12.64194608, -60.58204836, 110.36276771, -89.90310912, 27.34824973),
    ),
    "viridis": (
        (0.27772733, 0.10509304, -0.33086183, -4.63423050, 6.22826994, 4.77638500, -5.43545586),
        (0.00540734, 1.40461353, 0.21484756, -5.79910097, 14.17993337, -13.74514538, 4.64585261),
        (0.33409981, 1.38459016, 0.09509516, -19.33244096, 56.69055260, -65.35303263, 26.31243525),
    ),
}


def wheel_color(direction: float, length: float) -> Rgb:
    """Return the display color of a motion: `direction` in turns from x (right) towards y (down), `length` in motion
    scales."""
    hue = [min(max(abs((direction * 6 + shift) % 6 - 3) - 1, 0), 1) for shift in (0, 4, 2)]
    share = math.sqrt(min(max(length, 0), 1))
    red, green, blue = (WHEEL_CENTER + (value - WHEEL_CENTER) * share for value in hue)
    return red, green, blue
