"""The rectangle that is drawn over the picture, and what is in it."""

from __future__ import annotations

import math

from gffe_cl.viewer.picture.latest import Latest
from gffe_cl.viewer.picture.rectangle import NEEDED, Rectangle, Statistics, statistics
from gffe_cl.viewer.state.contents import Contents


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
        self._latest = Latest("rectangle")
        self.rectangle: Rectangle | None = None
        self.statistics: Statistics | None = None

    def draw(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Between two display positions; all pixels that it touches."""
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
        """Layers to read back for it."""
        return NEEDED if self.rectangle else frozenset()

    @property
    def ready(self) -> bool:
        """Whether the statistics are those of the present images."""
        return self.rectangle is None or self._latest.ready

    def update(self) -> str | None:
        """Once per frame of the interface. Returns what went wrong."""
        try:
            made = self._latest.take()
        except Exception as error:
            self.forget()
            return f"rectangle: {error}"
        if made is not None and self.rectangle is not None:
            self.statistics = made
        result = self._contents.result
        if self.rectangle is not None and result is not None and self._contents.asked >= NEEDED:
            key = self._contents.changes, self.rectangle
            self._latest.want(key, statistics, result, self.rectangle, self._contents.source.exposure)
        return None

    def close(self) -> None:
        self._latest.close()
