"""Maps of NVIDIA's FLIP error between two color layers, computed in the background."""

from __future__ import annotations

import numpy as np

from gffe_cl.lab.metrics import flip_error, to_display
from ..engine.layers import LayerSpec
from .latest import Latest

NAME = "flip error"
SPEC = LayerSpec(
    NAME, "FLIP error", "compare", "scalar", description="visible difference when A and B alternate, 0 to 1"
)


class FlipMaps:
    """The map of the latest pair asked for; one is computed at a time, on a thread."""

    def __init__(self):
        self._latest = Latest("flip")
        self.take, self.close = self._latest.take, self._latest.close

    @property
    def ready(self) -> bool:
        """Whether the map made last is that of the pair asked for last."""
        return self._latest.ready

    def want(self, key, a: np.ndarray, b: np.ndarray, exposure: float) -> None:
        """Request the map between colors `a` and `b` (H, W, 4), linear; `key` identifies the pair. `take` returns
        it, (H, W) float32 in 0 … 1."""
        self._latest.want(key, _flip, a, b, exposure)


def _flip(a: np.ndarray, b: np.ndarray, exposure: float) -> np.ndarray:
    return flip_error(*(to_display(color[..., :3], exposure) for color in (a, b)))
