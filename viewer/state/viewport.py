"""The view of the picture: zoom and center, and the pixel under the pointer."""

from __future__ import annotations

import math

from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection, Story
from ..engine.messages import Failure, Key
from ..engine.store import Pixel, Store, Want
from ..picture.current_frame import Contents
from ..picture.view import View

Size = tuple[int, int]

_FIT = 0.98  # of the window that a fitted picture takes
_LEAST, _MOST = 0.05, 128.0  # zoom by hand


class Framing:
    """Moves the view. `due`: the picture is to be fitted when its size is known."""

    def __init__(self, view: View):
        self._view = view
        self.due = True
        self._fitted: tuple | None = None

    def fit(self, size: Size, display_size: Size) -> None:
        """Zoom so that the whole picture is seen in a canvas of `size` (screen pixels)."""
        view = self._view
        view.fit(size, display_size)
        view.zoom = max(view.zoom * _FIT, 0.01)
        self.due, self._fitted = False, (view.zoom, view.center)

    @property
    def is_fitted(self) -> bool:
        """Whether the user has neither zoomed nor panned since `fit`."""
        return self._fitted == (self._view.zoom, self._view.center)

    def zoom(self, factor: float) -> None:
        self._view.zoom = min(max(self._view.zoom * factor, _LEAST), _MOST)

    def zoom_in(self, size: Size, pixel: Pixel | None) -> None:
        """Zoom in at `pixel` if it is seen on a canvas of `size`, else at the center."""
        if pixel is not None:
            at = pixel[0] + 0.5, pixel[1] + 0.5
            if all(0 <= c < s for c, s in zip(self._view.screen_at(size, *at), size, strict=True)):
                self._view.center = at
        self.zoom(2.0)


class Pointing:
    """Values at single pixels of the picture.

    Attributes
    ----------
    inspection : Inspection or None
        Values of the pixel under the pointer, else of the picked one.
    pinned : Inspection or None
        Values of the picked pixel.
    picked : (int, int) or None
        The pixel whose `story` is told; the story is None until it is known.
    enabled : bool
        False: the pointer means nothing.
    """

    def __init__(self, store: Store, contents: Contents):
        self._store, self._contents = store, contents
        self._size = (0, 0)
        self.enabled = True
        self._wants: list[Want] = []
        self._hovered: Pixel | None = None
        self.inspection: Inspection | None = None
        self.pinned: Inspection | None = None
        self.story: Story | None = None
        self.picked: Pixel | None = None
        self._inspected: Key | None = None  # the slot of the inspection
        self._told: Key | None = None  # the slot of the story

    def hover(self, at: tuple[float, float] | None) -> None:
        """Note that the pointer is over this display position; None: it is elsewhere."""
        pixel = None if at is None or not self.enabled else (math.floor(at[0]), math.floor(at[1]))
        self._hovered = pixel if self._is_inside(pixel) else None
        self.inspection = self.inspection if self._pixel else None

    def pick(self, pixel: Pixel | None) -> None:
        """Tell the story of a pixel. None, or a pixel out of the picture: the picked one is forgotten."""
        self.picked = (pixel[0], pixel[1]) if pixel is not None and self._is_inside(pixel) else None
        self.story = self.pinned = self._told = None
        self.inspection = self.inspection if self._pixel else None

    def open(self, size: tuple[int, int]) -> None:
        """Start with another picture, of `size` pixels."""
        self._size, self._wants = size, []
        self.inspection = self.pinned = self.story = self.picked = self._inspected = self._told = None

    def wants(self, key: Key) -> list[Want]:
        """Return the pixels that are wanted of the awaited slot, the picked one first."""
        pixels = list(dict.fromkeys(pixel for pixel in (self.picked, self._hovered) if pixel is not None))
        self._wants = [Want(key, pixel=pixel, keep=False) for pixel in pixels]
        return self._wants

    def update(self) -> str:
        """Take what is there of the last `wants`. Returns why there is nothing; empty if nothing is wrong."""
        fault = ""
        for want in self._wants:
            made = self._store.get(want)
            if isinstance(made, Failure):
                fault = made.error
                self._told = want.key if want.pixel == self.picked else self._told
            elif isinstance(made, Inspection):
                if want.pixel == self.picked and (self.story is None or self._told != want.key):
                    self.story, self.pinned, self._told = made.story, made, want.key
                if want.pixel == self._pixel and self.inspection is not made:
                    self.inspection, self._inspected = made, want.key
        return fault

    @property
    def shows_values(self) -> bool:
        """Whether the values under the pointer belong to the displayed picture."""
        return self._is_shown(self._inspected)

    @property
    def story_is_due(self) -> bool:
        """Whether the story of the picked pixel is still that of another picture."""
        return self.picked is not None and not self._is_shown(self._told)

    @property
    def values(self) -> tuple[Inspection | None, bool]:
        """The values of the picked pixel, else of the one under the pointer; and whether they are still those of
        another picture."""
        return (self.pinned, self.story_is_due) if self.picked else (self.inspection, not self.shows_values)

    def _is_shown(self, key: Key | None) -> bool:
        result = self._contents.result
        return result is not None and key == result.key

    @property
    def _pixel(self) -> Pixel | None:
        return self._hovered or self.picked

    def _is_inside(self, pixel: Pixel | None) -> bool:
        return pixel is not None and all(0 <= at < size for at, size in zip(pixel, self._size, strict=True))
