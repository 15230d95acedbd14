"""The view of the picture: zoom and center, the pixel under the pointer, and images on the canvas."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping

import numpy as np

from ..engine import names
from ..engine.layers import FRAME_LAYERS
from ..engine.sources.preview import Preview
from ..picture import disocclusions, flip_map, invalid, regions
from ..picture.canvas import Canvas
from ..picture.current_frame import Contents
from ..picture.display_settings import Looks
from ..picture.displays import FrameInfo
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


class Pointing:
    """Requests about single pixels, and their answers.

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
        """Note that the pointer is over this display position, and request the values of its pixel; None: it is
        elsewhere."""
        pixel = None if at is None or not self.enabled else (math.floor(at[0]), math.floor(at[1]))
        pixel = pixel if self._is_inside(pixel) else None
        if pixel != self._hovered:
            self._hovered = pixel
            wanted = pixel or self.picked
            self.inspection = self.inspection if wanted else None
            if not self.story_due:  # or it would take the place of the picked pixel, after which it is asked for
                self._ask(wanted)

    def pick(self, pixel: tuple[int, int] | None) -> None:
        """Request the story of a pixel. None, or a pixel out of the picture: the picked one is forgotten."""
        self.picked, self.story = None, None
        self.inspection = self.inspection if self._hovered else None
        if pixel is not None and self._is_inside(pixel):
            self.picked = pixel[0], pixel[1]
            self._ask(self.picked)
        self.story_due = self.picked is not None

    def ask_again(self) -> None:
        """Repeat the requests for another slot."""
        self.story_due = self.picked is not None
        self._ask(self.picked or self._hovered)

    def open(self, size: tuple[int, int]) -> None:
        """Start with another picture, of `size` pixels."""
        self._size = size
        self.inspection = self.story = self.picked = None
        self.story_due = False

    def take(self, inspection) -> None:
        """Take an engine's Inspection of the present slot."""
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


# layers that come and go by themselves
_OF_OTHERS = {flip_map.NAME, regions.NAME, disocclusions.NAME, invalid.RENDERED, invalid.SHOWN}
_BUDGET = 0.02  # seconds per frame of the interface, but at least one image


class Screen:
    """Puts the images of `contents` on a canvas, and has `looks` meet them.

    Attributes
    ----------
    canvas : Canvas or None
        None: there is nothing to draw on.
    upload_ms : float
        What the last images took.
    """

    def __init__(self, contents: Contents, looks: Looks):
        self._contents, self._looks = contents, looks
        self._waiting: dict[str, np.ndarray] = {}
        self.canvas: Canvas | None = None
        self.upload_ms = 0.0

    @property
    def ready(self) -> bool:
        """Whether all images are on the canvas."""
        return not self._waiting

    def preview(self, preview: Preview) -> None:
        """Show a preview on the canvas before there are contents."""
        if self.canvas is not None:
            self.canvas.frame = FrameInfo(preview.color.shape[1::-1], exposure=preview.exposure)
            self.canvas.upload(names.FINAL, preview.color, FRAME_LAYERS[names.FINAL])

    def show(self, images: Mapping[str, np.ndarray], first: set[str]) -> None:
        """Show these images, with those of other settings, on the canvas, and remove all others, which belong to
        another time. Those of `first` are uploaded at once, the others as time permits."""
        second = self._contents.second if images else None
        others = {} if second is None else {names.of_second(name): image for name, image in second.images.items()}
        self._waiting, self.upload_ms = dict(images) | others, 0.0
        if self.canvas is not None:
            if images:
                self.canvas.frame = self._contents.frame_info()
            self.canvas.forget(self.canvas.layers.keys() - self._waiting.keys() - _OF_OTHERS)
        for name in first & self._waiting.keys():
            self._upload(name)
        self.proceed()

    def proceed(self) -> None:
        """Upload images that wait, as many as time permits. Call once per frame of the interface."""
        end = time.perf_counter() + _BUDGET
        while self._waiting:
            self._upload(next(iter(self._waiting)))
            if time.perf_counter() > end:
                return

    def _upload(self, name: str) -> None:
        start, image = time.perf_counter(), self._waiting.pop(name)
        if self.canvas is not None:
            own = [self._contents.frame_info(self._contents.second)] if names.is_second(name) else []
            spec = self._contents.spec(name)
            assert spec is not None  # there is an image of it
            self.canvas.upload(name, image, spec, *own)
        self.upload_ms += (time.perf_counter() - start) * 1e3
        if not names.is_second(name):
            self._looks.meet([name])
