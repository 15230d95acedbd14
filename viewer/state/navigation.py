"""Ways through a scene: flying its camera, and following the links of a pixel's story."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.inspection.buffers import moved
from gffe_cl.engine.inspection.explain.motion_trail import WayPoint
from gffe_cl.engine.inspection.explain.pixel_explain_types import Link
from ..picture.current_frame import Contents
from ..picture.view import View
from .playback import Playback
from .viewport import Pointing

_SPEED = 2.0  # world units per second
_STEEPEST = math.radians(85)
_LONGEST = 0.15  # seconds that are flown at once


class Flight(NamedTuple):
    """Steering of one interface frame: (right, up, forward) in −1 … 1 and times faster; turns in degrees, and `spin`,
    (yaw, pitch) in degrees per second."""

    move: tuple[float, float, float]
    faster: float
    yaw: float
    pitch: float
    spin: tuple[float, float] = (0.0, 0.0)


class Flyer:
    """A camera that is steered; `pose` is where it is now (display pixels)."""

    def __init__(self, start: Camera):
        self.active = True
        self._start = start
        self._position = start.position.copy()
        direction = start.direction
        self._yaw = math.atan2(direction[0], -direction[2])
        self._pitch = math.asin(min(max(direction[1], -1.0), 1.0))
        self._then: float | None = None
        self.moved = True  # since it was last set to False
        self.flight = 0  # number of the pose at `slot`, see Recipe
        self.slot = -1  # for which it is flown
        self.pose = start

    def steer(self, flight: Flight, now: float) -> None:
        """Move on by the time since the last call (seconds) and turn."""
        elapsed = 0.0 if self._then is None else min(now - self._then, _LONGEST)
        self._then = now
        yaw, pitch = (turn + elapsed * spin for turn, spin in zip((flight.yaw, flight.pitch), flight.spin, strict=True))
        moving = any(flight.move) and elapsed > 0
        if not (moving or yaw or pitch):
            return
        self.moved = True
        self._yaw += math.radians(yaw)
        self._pitch = min(max(self._pitch - math.radians(pitch), -_STEEPEST), _STEEPEST)
        level = math.cos(self._pitch)
        forward = np.array([math.sin(self._yaw) * level, math.sin(self._pitch), -math.cos(self._yaw) * level])
        right = np.array([math.cos(self._yaw), 0.0, math.sin(self._yaw)])
        axes = np.stack([right, (0.0, 1.0, 0.0), forward])
        self._position += np.asarray(flight.move) @ axes * (_SPEED * flight.faster * elapsed)
        self.pose = Camera.from_pose(self._position, forward, (0.0, 1.0, 0.0), *self._start.intrinsics)


class Flights:
    """Flying of the camera; `flyer` is None while it has not been flown."""

    def __init__(self, contents: Contents, playback: Playback):
        self._contents, self._playback = contents, playback
        self._numbers = itertools.count(1)
        self.flyer: Flyer | None = None

    def toggle(self) -> None:
        """Fly from where the camera is, or stop where it is."""
        if self.flyer is not None and self.flyer.active:
            self.flyer.active = False
        elif self._contents.result is not None:
            self.flyer = Flyer(self._contents.result.moment.camera)
            self._playback.play()

    def steer(self, flight: Flight | None, now: float) -> None:
        """Steer the camera; `now`: of the clock that playback goes by, seconds."""
        if self.flyer is not None and flight is not None:
            self.flyer.steer(flight, now)

    def at(self, slot: int) -> Flyer:
        """Return the camera, whose pose has a new number if it is another one, or for another slot."""
        flyer = self.flyer
        assert flyer is not None  # it flies
        if flyer.moved or flyer.slot != slot:
            flyer.moved, flyer.slot, flyer.flight = False, slot, next(self._numbers)
        return flyer


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
