"""Flicker: visible error when rendered and generated frames alternate.

At 60 Hz people do not see the error of a single frame. They see that every second frame has one: lit edges that pulse,
shadows that jump to and fro. The eye follows moving objects, so the difference between shown and true frame counts, not
that between successive frames; and at 30 Hz it is only sensitive to coarse patterns, falling to half at about three
cycles per degree (Kelly, Motion and vision II, JOSA 1979). So: error of the luma that is displayed (Rec. 709), blurred
by a Gaussian of 1/300 of the image's height (half at three cycles per degree, seen from three heights), and of that the
mean absolute change from each shown frame to the next, rendered ones included, in per cent of display white. A renderer
without generated frames has 0. An error that stays the same over time does not flicker.
"""

from __future__ import annotations

import numpy as np

LUMA = np.array((0.2126, 0.7152, 0.0722), np.float32)
_SIGMA = 1 / 300  # of the image's height


class Flicker:
    """Sum of flicker over the frames of a sequence in the order of display."""

    def __init__(self):
        self._before: np.ndarray | None = None
        self.sum, self.count = 0.0, 0

    def add(self, shown: np.ndarray, truth: np.ndarray) -> float | None:
        """Add display values (H, W, 3) of the next frame, as shown and as it should be. Return the change from the
        frame before, per cent; None for the first."""
        error = blurred((shown - truth) @ LUMA, _SIGMA * shown.shape[0])
        before, self._before = self._before, error
        if before is None:
            return None
        change = 100 * float(np.abs(error - before).mean())
        self.sum, self.count = self.sum + change, self.count + 1
        return change

    def cut(self) -> None:
        """Start a new sequence: the next frame is not displayed right after the last one added."""
        self._before = None

    @property
    def mean(self) -> float:
        """The mean over all changes; NaN if there were none."""
        return self.sum / self.count if self.count else float("nan")


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """Return (H, W) float32, blurred by a Gaussian of `sigma` pixels up to 4 sigma; the image is mirrored at its
    borders."""
    radius = int(4 * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    weights = (weights / weights.sum()).astype(np.float32)
    for _ in range(2):  # along columns, then along rows
        padded = np.pad(image, ((radius, radius), (0, 0)), mode="symmetric")
        sums = np.zeros_like(image)
        for k, weight in enumerate(weights):
            sums += weight * padded[k : k + len(image)]
        image = np.ascontiguousarray(sums.T)
    return image
