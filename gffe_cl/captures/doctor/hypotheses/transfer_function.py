"""Test whether colors are linear, by antialiased silhouettes.

A pixel that a silhouette crosses holds a mixture of both surfaces, with the same share in red, green and blue. This
holds for linear colors: after a display curve the shares differ from channel to channel. Only silhouettes count, which
are visible in the depth: inside a surface the texture filter mixes colors, and renderers may filter encoded textures.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gffe_cl.captures.doctor.hypotheses.edges import lines_of, silhouettes
from gffe_cl.captures.doctor.hypotheses.sampling import Look
from gffe_cl.engine.frame.transfer_function import linear_values

_CONTRAST = 0.08  # least difference of the two sides in a channel
_FLAT = 0.15  # largest difference along one side, of the contrast
_TELLING = 0.03  # least difference of how well both readings fit
_MIXTURE = 0.25  # largest difference of the channels' shares in a mixture, by the better reading
_TIGHT = 0.06  # largest difference of clear ones
_LEAST = 50  # clear silhouettes
_MIXED = 0.25  # least share of silhouettes whose pixel is a mixture, or the image is not antialiased
_SURE, _DOUBTFUL = 0.75, 0.5  # shares of them that are evidence of a curve


def srgb_to_linear(color: np.ndarray) -> np.ndarray:
    """Return linear color, float32, of display values 0 … 1."""
    return linear_values(np.clip(np.asarray(color, np.float32), 0, 1))


class Votes(NamedTuple):
    """Counts of silhouettes between two flat sides: those that fit sRGB values better than linear ones, those that
    are evidence, those with a mixture between the sides, and all."""

    encoded: int = 0
    telling: int = 0
    mixed: int = 0
    silhouettes: int = 0

    @property
    def share(self) -> float:
        return self.encoded / max(self.telling, 1)

    @property
    def verdict(self) -> str:
        """Verdict of the votes: "display values", "doubtful", or "" for linear colors and without evidence."""
        if self.telling < _LEAST or self.mixed < _MIXED * self.silhouettes or self.share < _DOUBTFUL:
            return ""
        return "display values" if self.share >= _SURE else "doubtful"


def display_curve_votes(looks: list[Look]) -> Votes:
    """Return votes on the images of `looks`, which are given as linear; none where values beyond 0 … 1 show that they
    are no display values."""
    total = np.zeros(4, int)
    for look in looks:
        for color, _, depth in lines_of(look):
            color = np.nan_to_num(np.asarray(color, np.float32))
            if color.max() > 1.001 or color.min() < 0:
                return Votes()
            total += _of_lines(color, depth)
    return Votes(*total.tolist())


def _of_lines(color: np.ndarray, depth: np.ndarray) -> tuple[int, int, int, int]:
    """Return votes of vertical silhouettes one pixel wide."""
    at = silhouettes(depth)
    far_left, left, middle, right, far_right = (color[:, k : color.shape[1] - 4 + k][at] for k in range(5))
    contrast = np.abs(right - left)
    flat = np.maximum(np.abs(left - far_left), np.abs(right - far_right)) < _FLAT * contrast
    edge = ((contrast > _CONTRAST) & flat).all(-1)
    left, middle, right = left[edge], middle[edge], right[edge]
    given = _spread(left, middle, right)
    decoded = _spread(*(srgb_to_linear(c) for c in (left, middle, right)))
    with np.errstate(invalid="ignore"):
        best = np.fmin(given, decoded)
        mixed, telling = best < _MIXTURE, (best < _TIGHT) & (np.abs(given - decoded) > _TELLING)
    return int((decoded < given)[telling].sum()), int(telling.sum()), int(mixed.sum()), len(left)


def _spread(a: np.ndarray, m: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (N,) how much the shares of the channels (N, 3) differ; NaN where `m` is no mixture of `a` and `b`."""
    with np.errstate(all="ignore"):
        share = (m - a) / (b - a)
    inside = ((share > 0.1) & (share < 0.9)).all(-1)
    return np.where(inside, share.max(-1) - share.min(-1), np.nan)
