"""Correspondences between two rendered frames without cameras: positions of the samples of one in the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_SAMPLES = 2500  # of a frame


@dataclass(frozen=True)
class Correspondences:
    """Samples of a frame that motion vectors find in the rendered frame before it.

    Attributes
    ----------
    px, px_prev : (N, 2) float64
        Pixel positions in the frame and in the one before.
    depth : (N,) float64
        View depth in the frame, world units; 1 for sky.
    sky : (N,) bool
        Whether the sample is infinitely far: it turns, but does not move.
    """

    px: np.ndarray
    px_prev: np.ndarray
    depth: np.ndarray
    sky: np.ndarray

    def __len__(self):
        return len(self.depth)

    def some(self, count: int, rng: np.random.Generator) -> Correspondences:
        """Return at most `count` of them, drawn at random."""
        if len(self) <= count:
            return self
        chosen = rng.choice(len(self), count, replace=False)
        return Correspondences(self.px[chosen], self.px_prev[chosen], self.depth[chosen], self.sky[chosen])


def correspondences(depth: np.ndarray, motion: np.ndarray) -> Correspondences:
    """Return about 2,500 samples on a lattice, from depth (H, W), world units, and motion (H, W, 2), pixels, to the
    rendered frame before. Pixels with invalid depth or motion are left out, and so are points far outside the
    previous image."""
    height, width = depth.shape
    step = max(1.0, np.sqrt(width * height / _SAMPLES))
    x, y = ((np.arange(0.5 * step, n, step)).astype(int) for n in (width, height))
    x, y = (a.ravel() for a in np.meshgrid(x, y))
    z, moved = depth[y, x].astype(np.float64), motion[y, x].astype(np.float64)
    px = np.stack([x, y], -1) + 0.5
    use = (z > 0) & np.isfinite(moved).all(-1)
    use &= (np.abs(np.where(use[:, None], moved, 0)) < 4 * max(width, height)).all(-1)
    px, z, moved = px[use], z[use], moved[use]
    sky = np.isinf(z)
    return Correspondences(px, px + moved, np.where(sky, 1.0, z), sky)
