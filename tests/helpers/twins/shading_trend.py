"""Twin of the blur of shading_trend.cl."""

import numpy as np

from twins.common import F, kernel_constants

TREND = kernel_constants("shading_trend.cl")


def find_trend(changes, spacing):
    """Return (4, h, w): means over the neighborhood of what is known, and the share that is."""
    around = TREND.TREND_CELLS
    _, height, width = changes.shape
    padded = np.pad(changes, ((0, 0), *[(around * spacing,) * 2] * 2))
    changes = np.zeros_like(changes)
    for j, i in np.ndindex(2 * around + 1, 2 * around + 1):
        share = F((around + 1 - abs(j - around)) * (around + 1 - abs(i - around))) * F(1 / 81)
        changes += share * padded[:, j * spacing : j * spacing + height, i * spacing : i * spacing + width]
    share = np.maximum(changes[3], F(TREND.LEAST_SHARE))
    return np.concatenate([changes[:3] / share, changes[3:]])
