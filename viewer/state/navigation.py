"""Ways through a picture and a scene: zoom and center, pixels, and links of a story."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gffe_cl.engine.inspection.buffers import moved
from gffe_cl.engine.inspection.explain.motion_trail import WayPoint
from gffe_cl.engine.inspection.explain.pixel_explain_types import Inspection, Link, Story
from ..engine.messages import Failure, Key
from ..engine.store import Pixel, Store, Want
from ..picture.current_frame import Contents
from ..picture.shown_numbers import Rectangle
from ..picture.view import View
from .playback import Playback

Size = tuple[int, int]

_FIT = 0.98  # of the window that a fitted picture takes
_LEAST_ZOOM, _MOST_ZOOM = 0.05, 128.0  # zoom by hand


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
        self._view.zoom = min(max(self._view.zoom * factor, _LEAST_ZOOM), _MOST_ZOOM)

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
        The pixel whose `story` is told.
    rectangle : Rectangle or None
        The part of the display whose statistics are told.
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
        self.picked: Pixel | None = None
        self.rectangle: Rectangle | None = None
        self._inspected: Key | None = None  # the slot of the inspection
        self._told: Key | None = None  # the slot of the story

    def hover(self, at: tuple[float, float] | None) -> None:
        """Note that the pointer is over this display position; None: it is elsewhere."""
        pixel = None if at is None or not self.enabled else (math.floor(at[0]), math.floor(at[1]))
        self._hovered = pixel if self._is_inside(pixel) else None
        self.inspection = self.inspection if self.pixel else None

    def pick(self, pixel: Pixel | None) -> None:
        """Tell the story of a pixel. None, or a pixel out of the picture: the picked one is forgotten."""
        self.picked = (pixel[0], pixel[1]) if pixel is not None and self._is_inside(pixel) else None
        self.pinned = self._told = None
        self.inspection = self.inspection if self.pixel else None

    def mark(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Tell the statistics of the rectangle between two display positions; of nothing outside of the display."""
        (x0, x1), (y0, y1) = (sorted(map(math.floor, ends)) for ends in zip(start, end, strict=True))
        x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1 + 1, self._size[0]), min(y1 + 1, self._size[1])
        self.rectangle = (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None

    def open(self, size: tuple[int, int]) -> None:
        """Start with another picture, of `size` pixels."""
        self._size, self._wants, self.rectangle = size, [], None
        self.inspection = self.pinned = self.picked = self._inspected = self._told = None

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
                if want.pixel == self.picked and (self.pinned is None or self._told != want.key):
                    self.pinned, self._told = made, want.key
                if want.pixel == self.pixel and self.inspection is not made:
                    self.inspection, self._inspected = made, want.key
        return fault

    @property
    def story(self) -> Story | None:
        """The story of the picked pixel; None until it is known."""
        return None if self.pinned is None else self.pinned.story

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
    def pixel(self) -> Pixel | None:
        """The pixel under the pointer, else the picked one."""
        return self._hovered or self.picked

    def _is_inside(self, pixel: Pixel | None) -> bool:
        return pixel is not None and all(0 <= at < size for at, size in zip(pixel, self._size, strict=True))


_MOST = 50


@dataclass(frozen=True)
class _Place:
    """Remembered view: a place to go back to."""

    slot: int
    layer: str
    pixel: tuple[int, int] | None
    zoom: float
    center: tuple[float, float]


class Walk:
    """Walk along the links of stories, with the places from which they were followed."""

    def __init__(self, view: View, contents: Contents, playback: Playback, pointing: Pointing):
        self._view, self._contents, self._playback, self._pointing = view, contents, playback, pointing
        self._left: list[_Place] = []

    def forget(self) -> None:
        """Drop positions after a change of the source."""
        self._left.clear()

    def why_not(self, link: Link) -> str | None:
        """Return why a link leads nowhere; None if it can be followed."""
        if link.layer and (reason := self._contents.why_absent(link.layer)):
            return f"this layer is {reason}"
        if link.pixel is not None and not all(0 <= c < s for c, s in zip(link.pixel, self._contents.size, strict=True)):
            return "outside of the display"
        return None

    def follow(self, link: Link) -> None:
        """Go where a link leads."""
        if self.why_not(link) is not None:
            return
        self._leave()
        if link.layer:
            self._view.a = link.layer
        if link.frame is not None:
            self._playback.seek(link.frame * (self._playback.n + 1))
        if link.pixel is not None:
            self.look_at(link.pixel)

    def follow_way(self, point: WayPoint) -> None:
        """Go to where the fragment was in that rendered frame."""
        x, y = point.px
        self.follow(Link("", frame=point.k, pixel=(int(x // 1), int(y // 1))))

    def follow_input(self, k: int, px: tuple[int, int]) -> None:
        """Go to pixel `px` of the rendered image of frame `k` of a sequence."""
        entry = self._contents.source.sequence.rendered[k]
        x, y = moved((px[0] + 0.5, px[1] + 0.5), entry.render_camera, entry.display_camera)
        self.follow(Link("", frame=k, pixel=(math.floor(x), math.floor(y))))

    def next_layer(self, step: int) -> None:
        """Show the layer that many places further in the list."""
        found = [spec.name for spec in self._contents.showable()]
        if found:
            index = found.index(self._view.a) if self._view.a in found else 0
            self._view.a = found[(index + step) % len(found)]

    def go_to_pixel(self, pixel: tuple[int, int] | None) -> None:
        """Look at a pixel of this slot; None: stay."""
        if pixel is not None:
            self._leave()
            self.look_at(pixel)

    def look_at(self, pixel: tuple[int, int]) -> None:
        """Request the pixel's story. If only a part of the picture is visible, center it."""
        self._pointing.pick(pixel)
        view, size = self._view, self._contents.size
        if view.center != (size[0] / 2, size[1] / 2):
            view.center = (pixel[0] + 0.5, pixel[1] + 0.5)

    @property
    def can_go_back(self) -> bool:
        return bool(self._left)

    def back(self) -> None:
        """Go back to the place from which the last link was followed."""
        place = self._left.pop()
        self._view.a, self._view.zoom, self._view.center = place.layer, place.zoom, place.center
        if self._playback.slot != place.slot:
            self._playback.seek(place.slot)
        self._pointing.pick(place.pixel)

    def _leave(self) -> None:
        view = self._view
        place = _Place(self._playback.slot, view.a, self._pointing.picked, view.zoom, view.center)
        self._left = [*self._left[1 - _MOST :], place]
