"""μ-law that encodes color for the shading correction network (paper: 'Shading Correction Network')."""

from __future__ import annotations

import math

import numpy as np

MU = 5000.0
HEADROOM = 8.0  # exposed color that is encoded as 1: three stops above display white


def color_law(exposure: float) -> np.ndarray:
    """Return (4,) float32 for kernels: μ · exposure / 8, 1 / ln(1 + μ), and their reciprocals."""
    gain, log = MU * exposure / HEADROOM, math.log1p(MU)
    return np.array([gain, 1 / log, 1 / gain, log], np.float32)
