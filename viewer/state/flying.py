"""Flying the camera of a built-in scene."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gffe_cl.camera import Camera

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
        self.moved = True  # since somebody last set it to False
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
