"""The selected rectangle and its statistics."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.stages.buffers import FILLED_BY
from gffe_cl.lab.metrics import METRICS, squared_error, to_display
from ..engine.background import Derived
from ..engine.messages import Frame
from .current_frame import Contents

NEEDED = frozenset({names.FINAL, names.TRUTH, names.FILLED_BY, names.MOTION})
BINS = 16

Rectangle = tuple[int, int, int, int]  # left, top, right, bottom: display pixels, the last two excluded


@dataclass(frozen=True)
class Statistics:
    """Statistics of `count` pixels.

    Attributes
    ----------
    filled : dict
        Shares of the pixels by what filled them, the largest first; empty for rendered frames.
    psnr, mean_error, largest_error : float or None
        In dB; of display values, mean and largest of |shown − true| over RGB; None without ground truth.
    worst : (int, int) or None
        The pixel with the largest error.
    lengths, edges : (BINS,), (BINS + 1,) arrays
        Histogram of the lengths of motion, in pixels; `edges` of its bins.
    motion : (float, float) or None
        Median motion, pixels; None where none is finite.
    """

    count: int
    filled: dict[str, float]
    psnr: float | None
    mean_error: float | None
    largest_error: float | None
    worst: tuple[int, int] | None
    lengths: np.ndarray
    edges: np.ndarray
    motion: tuple[float, float] | None


def statistics(result: Frame, rectangle: Rectangle, exposure: float) -> Statistics:
    """Return the statistics of the pixels in `rectangle`, of a slot with the layers `NEEDED`, as far as there are."""
    left, top, right, bottom = rectangle
    images = {name: image[top:bottom, left:right] for name, image in result.images.items() if name in NEEDED}
    generated = result.moment.alpha > 0
    filled, errors = {}, (None, None, None, None)
    if generated and names.FILLED_BY in images:
        values, counts = np.unique(images[names.FILLED_BY], return_counts=True)
        told, total = dict(FILLED_BY), counts.sum()
        order = np.argsort(-counts, kind="stable")
        filled = {told.get(int(values[i]), str(values[i])): float(counts[i] / total) for i in order}
    if generated and names.TRUTH in images:
        errors = _errors(images[names.FINAL], images[names.TRUTH], exposure, (left, top))
    motion = images.get(names.MOTION) if generated else None
    lengths, edges, median = _motion(motion)
    return Statistics((right - left) * (bottom - top), filled, *errors, lengths, edges, median)


def _errors(final, truth, exposure: float, corner: tuple[int, int]):
    shown, true = (to_display(image[..., :3], exposure) for image in (final, truth))
    error = np.abs(shown - true).mean(-1)
    y, x = np.unravel_index(int(error.argmax()), error.shape)
    psnr = METRICS["psnr"].of_mean(float(squared_error(shown, true).mean()))
    return psnr, float(error.mean()), float(error.max()), (corner[0] + int(x), corner[1] + int(y))


def _motion(motion: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, tuple[float, float] | None]:
    flat = np.zeros((0, 2)) if motion is None else motion[..., :2].reshape(-1, 2)
    flat = flat[np.isfinite(flat).all(-1)]
    if not len(flat):
        return np.zeros(BINS), np.linspace(0, 1, BINS + 1), None
    lengths = np.hypot(*flat.T)
    high = max(float(lengths.max()), 1e-3)
    counts, edges = np.histogram(lengths, BINS, (0.0, high))
    x, y = np.median(flat, 0)
    return counts.astype(np.float64), edges, (float(x), float(y))


class Selection:
    """Statistics of the pixels of a rectangle, of every slot that is shown.

    Attributes
    ----------
    rectangle : (int, int, int, int) or None
        Left, top, right and bottom in display pixels, the last two excluded.
    statistics : Statistics or None
        None until they are known.
    """

    def __init__(self, contents: Contents):
        self._contents = contents
        self._derived = Derived("rectangle")
        self.rectangle: Rectangle | None = None
        self.statistics: Statistics | None = None

    def draw(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Select the rectangle between two display positions, with all pixels that it touches."""
        sides = []
        for a, b, size in zip(start, end, self._contents.size, strict=True):
            low, high = math.floor(min(a, b)), math.floor(max(a, b)) + 1
            sides.append((min(max(low, 0), size - 1), min(max(high, 1), size)))
        (left, right), (top, bottom) = sides
        self.rectangle = left, top, right, bottom

    def forget(self) -> None:
        self.rectangle = self.statistics = None

    @property
    def needed(self) -> frozenset[str]:
        """Layers to read back for the statistics."""
        return NEEDED if self.rectangle else frozenset()

    @property
    def ready(self) -> bool:
        """Whether the statistics are those of the present images."""
        return self.rectangle is None or self._derived.ready

    def update(self) -> str | None:
        """Take the result, and request the next. Call once per frame of the interface. Returns an error message, if
        any."""
        result = self._contents.result
        if self.rectangle is None or result is None or not self._contents.asked >= NEEDED:
            return None
        key = self._contents.changes, self.rectangle
        try:
            made = self._derived.get(key, statistics, result, self.rectangle, self._contents.source.exposure)
        except Exception as error:
            self.forget()
            return f"rectangle: {error}"
        if self._derived.ready:
            self.statistics = made
        return None

    def close(self) -> None:
        self._derived.close()
