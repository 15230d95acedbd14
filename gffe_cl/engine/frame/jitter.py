"""Camera jitter: principal points that move by parts of a pixel from frame to frame, for temporal anti-aliasing.

Before rendering frame k an engine does this:

    camera = jitter.camera(shown.scaled(0.5, 0.5), k)  # the render camera: its cx and cy carry the jitter

and passes the camera without jitter as `display_camera`. Motion vectors connect the images as rendered, jitter
included. Generated frames have none: they are seen through display cameras.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_kind, require_whole
from gffe_cl.engine.frame.camera import Camera

_BASES = (2, 3)
_MOST = 1024


@dataclass(frozen=True)
class Jitter:
    """Camera jitter by Halton's sequence of bases 2 and 3, its first `length` points over and over. A length of 1 is
    the middle of the pixel.

    Raises GffeError unless `length` is a whole number from 1 to 1024.
    """

    length: int = 1

    def __post_init__(self):
        object.__setattr__(self, "length", require_whole(self.length, "jitter: length", 1, _MOST))

    @classmethod
    def parse(cls, text: str) -> Jitter:
        """Return the jitter of a text: "halton:16" (16 points) or "off". Raises GffeError for others."""
        if require_kind(text, str, "jitter", "a text") == "off":
            return cls()
        kind, _, length = text.partition(":")
        if kind != "halton" or not re.fullmatch("[0-9]{1,9}", length) or not 2 <= int(length) <= _MOST:
            raise GffeError(f"jitter must be off or halton:LENGTH, LENGTH 2 to {_MOST}, got '{text}'")
        return cls(int(length))

    def offset(self, number: int) -> tuple[float, float]:
        """Return the jitter of frame `number`: pixels from the middle of each pixel to where it is sampled, −½ to ½ for
        x and y. Raises GffeError unless `number` is a whole number."""
        number = require_whole(number, "jitter: number")
        if self.length == 1:
            return 0.0, 0.0
        x, y = (_radical_inverse(number % self.length + 1, base) - 0.5 for base in _BASES)
        return x, y

    def camera(self, camera: Camera, number: int) -> Camera:
        """Return the jittered camera of frame `number`; `camera` (render pixels) is the one without jitter."""
        require_kind(camera, Camera, "jitter: camera")
        x, y = self.offset(number)
        return replace(camera, cx=camera.cx - x, cy=camera.cy - y) if x or y else camera


def without_jitter(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return `camera` of an image of `size` (width, height) with the principal point at the center if it is within a
    pixel of it. Other cameras, such as those of windows, are unchanged."""
    middle = size[0] / 2, size[1] / 2
    if max(abs(camera.cx - middle[0]), abs(camera.cy - middle[1])) > 1:
        return camera
    return replace(camera, cx=middle[0], cy=middle[1])


def _radical_inverse(number: int, base: int) -> float:
    value, digit = 0.0, 1.0 / base
    while number:
        number, rest = divmod(number, base)
        value += rest * digit
        digit /= base
    return value
