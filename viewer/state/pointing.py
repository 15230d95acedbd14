"""The pixel under the pointer and the one that was clicked: values and stories, asked of the engine."""

from __future__ import annotations

import math
from collections.abc import Callable


class Pointing:
    """What is asked about single pixels, and what is known.

    Parameters
    ----------
    inspect : callable
        Asks the engine what it holds at (x, y).

    Attributes
    ----------
    inspection : Inspection or None
        Values of the pixel under the pointer, else of the picked one.
    picked : (int, int) or None
        The pixel whose `story` is told; the story is None until it is known.
    enabled : bool
        False: the pointer means nothing.
    """

    def __init__(self, inspect: Callable[[int, int], None]):
        self._inspect = inspect
        self._size = (0, 0)
        self.enabled = True
        self.inspection = self.story = self.picked = None
        self.story_due = False  # the engine was asked for the story of the picked pixel
        self._hovered: tuple[int, int] | None = None

    def hover(self, at: tuple[float, float] | None) -> None:
        """The pointer is over this display position; values of its pixel are asked for."""
        pixel = None if at is None or not self.enabled else (math.floor(at[0]), math.floor(at[1]))
        pixel = pixel if self._is_inside(pixel) else None
        if pixel != self._hovered:
            self._hovered = pixel
            wanted = pixel or self.picked
            self.inspection = self.inspection if wanted else None
            if not self.story_due:  # or it would take the place of the picked pixel, after which it is asked for
                self._ask(wanted)

    def pick(self, pixel: tuple[int, int] | None) -> None:
        """Tell the story of a pixel."""
        self.picked, self.story = None, None
        self.inspection = self.inspection if self._hovered else None
        if self._is_inside(pixel):
            self.picked = tuple(pixel)
            self._ask(self.picked)
        self.story_due = self.picked is not None

    def ask_again(self) -> None:
        """There is another slot."""
        self.story_due = self.picked is not None
        self._ask(self.picked or self._hovered)

    def open(self, size: tuple[int, int]) -> None:
        """There is another picture, of `size` pixels."""
        self._size = size
        self.inspection = self.story = self.picked = None
        self.story_due = False

    def take(self, inspection) -> None:
        """An engine's Inspection of the present slot."""
        if inspection.pixel == self.picked:
            self.story, self.story_due = inspection.story, False
            if self._hovered != self.picked:
                self._ask(self._hovered)
        if inspection.pixel == (self._hovered or self.picked):
            self.inspection = inspection

    def _ask(self, pixel: tuple[int, int] | None) -> None:
        if pixel is not None:
            self._inspect(*pixel)

    def _is_inside(self, pixel: tuple[int, int] | None) -> bool:
        return pixel is not None and all(0 <= at < size for at, size in zip(pixel, self._size, strict=True))
