"""Whether colours are linear: antialiased edges tell.

A pixel that an edge crosses holds a mixture of both sides, with the same share in red, green and blue. So it is
of linear colours: after a display curve the shares differ from channel to channel.
"""

from __future__ import annotations

import numpy as np

_CONTRAST = 0.08  # least difference of the two sides in a channel
_FLAT = 0.15  # largest difference along one side, of the contrast
_TELLING = 0.01  # least difference of how well both readings fit
_LEAST = 150  # edges
_PIXELS = 200_000  # of an image are looked at, in whole lines
_SHARE = 0.65  # of them that speak for a curve


def srgb_to_linear(color: np.ndarray) -> np.ndarray:
    """Display values 0 … 1 → linear; float32."""
    c = np.clip(np.asarray(color, np.float32), 0, 1)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4).astype(np.float32)


def display_curve_votes(images: list[np.ndarray]) -> tuple[int, int] | None:
    """(edges that fit sRGB values better than linear ones, edges that tell) of linear images (H, W, 3); None where
    values beyond 0 … 1 show that they are no display values."""
    wins = count = 0
    for image in images:
        every = max(1, image.shape[0] * image.shape[1] // _PIXELS)
        for turned in (image, image.swapaxes(0, 1)):
            color = np.nan_to_num(np.asarray(turned[::every], np.float32))
            if color.max() > 1.001 or color.min() < 0:
                return None
            given, decoded, telling = _spreads(color)
            wins += int((decoded < given)[telling].sum())
            count += int(telling.sum())
    return wins, count


def is_encoded(votes: tuple[int, int] | None) -> bool:
    return votes is not None and votes[1] >= _LEAST and votes[0] > _SHARE * votes[1]


def _spreads(color: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of vertical edges one pixel wide: how much the shares of the channels differ, as given and decoded; and which
    edges tell."""
    far_left, left, middle, right, far_right = (color[:, k : color.shape[1] - 4 + k] for k in range(5))
    contrast = np.abs(right - left)
    flat = np.maximum(np.abs(left - far_left), np.abs(right - far_right)) < _FLAT * contrast
    edge = ((contrast > _CONTRAST) & flat).all(-1)
    left, middle, right = left[edge], middle[edge], right[edge]

    def spread(a, m, b) -> np.ndarray:
        with np.errstate(all="ignore"):
            share = (m - a) / (b - a)
        inside = ((share > 0.1) & (share < 0.9)).all(-1)
        return np.where(inside, share.max(-1) - share.min(-1), np.nan)

    given = spread(left, middle, right)
    decoded = spread(*(srgb_to_linear(c) for c in (left, middle, right)))
    with np.errstate(invalid="ignore"):
        telling = np.abs(given - decoded) > _TELLING
    return given, decoded, telling
