"""Maps of NVIDIA's FLIP error between two colour layers, computed beside the interface."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from gffe_cl.metrics import display_values, flip_error
from gffe_cl.viewer.engine.layers import LayerSpec

NAME = "flip error"
SPEC = LayerSpec(NAME, "FLIP error", "compare", "scalar", description="what people see when A and B alternate, 0 to 1")


class FlipMaps:
    """The map of the latest pair asked for; one is computed at a time, on a thread."""

    def __init__(self):
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gffe-viewer-flip")
        self._future: Future | None = None
        self._wanted = self._coming = self._made = None  # what they are of

    @property
    def ready(self) -> bool:
        """Whether the map made last is that of the pair asked for last."""
        return self._made is not None and self._made == self._wanted

    def want(self, key, a: np.ndarray, b: np.ndarray, exposure: float) -> None:
        """Ask for the map between colours `a` and `b` (H, W, 4), linear; `key` tells pairs apart."""
        self._wanted = key
        if self._future is None and key != self._made:
            self._coming = key
            self._future = self._pool.submit(_flip, a, b, exposure)

    def take(self) -> np.ndarray | None:
        """(H, W) float32 in 0 … 1 when one was made since the last call; raises what went wrong."""
        if self._future is None or not self._future.done():
            return None
        future, self._future, self._made = self._future, None, self._coming
        return future.result()

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)


def _flip(a: np.ndarray, b: np.ndarray, exposure: float) -> np.ndarray:
    return flip_error(*(display_values(color[..., :3], exposure) for color in (a, b)))
