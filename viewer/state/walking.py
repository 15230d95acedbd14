"""Walking along a pixel's story: following its links, and back again."""

from __future__ import annotations

from dataclasses import dataclass

from gffe_cl.viewer.engine.story import Link
from gffe_cl.viewer.engine.way import WayPoint
from gffe_cl.viewer.picture.view import View
from gffe_cl.viewer.state.contents import Contents
from gffe_cl.viewer.state.playback import Playback
from gffe_cl.viewer.state.pointing import Pointing

_MOST = 50


@dataclass(frozen=True)
class _Place:
    """What was looked at."""

    slot: int
    layer: str
    pixel: tuple[int, int] | None
    zoom: float
    centre: tuple[float, float]


class Walk:
    """The places from which links were followed."""

    def __init__(self, view: View, contents: Contents, playback: Playback, pointing: Pointing):
        self._view, self._contents, self._playback, self._pointing = view, contents, playback, pointing
        self._left: list[_Place] = []

    def forget(self) -> None:
        """There is another source."""
        self._left.clear()

    def why_not(self, link: Link) -> str | None:
        """Why a link leads nowhere."""
        if link.layer and self._contents.spec(link.layer) is None:
            return "this layer is not made with these options"
        if link.pixel is not None and not all(0 <= c < s for c, s in zip(link.pixel, self._contents.size, strict=True)):
            return "outside of what is displayed"
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

    def go_to_pixel(self, pixel: tuple[int, int]) -> None:
        """Look at a pixel of this slot."""
        self._leave()
        self.look_at(pixel)

    def look_at(self, pixel: tuple[int, int]) -> None:
        """Tell its story; where only a part of the picture is seen, have it in the middle."""
        self._pointing.pick(pixel)
        view, size = self._view, self._contents.size
        if view.centre != (size[0] / 2, size[1] / 2):
            view.centre = (pixel[0] + 0.5, pixel[1] + 0.5)

    @property
    def can_go_back(self) -> bool:
        return bool(self._left)

    def back(self) -> None:
        """To where the last link was followed."""
        place = self._left.pop()
        self._view.a, self._view.zoom, self._view.centre = place.layer, place.zoom, place.centre
        if self._playback.slot != place.slot:
            self._playback.seek(place.slot)
        self._pointing.pick(place.pixel)

    def _leave(self) -> None:
        view = self._view
        place = _Place(self._playback.slot, view.a, self._pointing.picked, view.zoom, view.centre)
        self._left = [*self._left[1 - _MOST :], place]
