"""Map of NVIDIA's FLIP error between two color layers."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.lab.metrics import flip_error, to_display

NAME = "flip error"
SPEC = LayerSpec(
    NAME, "FLIP error", "compare", "scalar", description="visible difference when A and B alternate, 0 to 1"
)


def flip_map(a: np.ndarray, b: np.ndarray, exposure: float) -> np.ndarray:
    """Return the map between linear colors `a` and `b` (H, W, 4): (H, W) float32 in 0 … 1."""
    return flip_error(*(to_display(color[..., :3], exposure) for color in (a, b)))
