"""The game of docs/examples/panda3d_live.py, which moves its camera by itself, with antialiasing and without."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from unseen.recording import Picture

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from panda3d_live import Game


class PandaLive:
    """One sample for each pixel.

    Parameters
    ----------
    width, height : int
        Of the image, pixels.
    """

    fps = 15.0
    samples = 1  # along a side of a pixel

    def __init__(self, width: int = 480, height: int = 270, frames: int = 14):
        self.width, self.height, self.frames = width, height, frames
        self._game = Game((width * self.samples, height * self.samples), offscreen=True)
        self._states = {}  # of the game, by time

    def picture(self, time: float, previous: float | None) -> Picture:
        """Return what is seen at `time` (seconds), with motion since `previous`: colors are means of the samples, depth
        and motion are those of the sample in the middle."""
        game, n = self._game, self.samples
        game.cut = previous is None
        game.kept = self._states.get(previous)
        camera = game.look(time)
        color, depth, motion = game.draw(time, camera)
        self._states[time] = game.latest
        color = color.reshape(self.height, n, self.width, n, 3).mean((1, 3))
        middle = slice(n // 2, None, n)
        motion = None if previous is None else motion[middle, middle] / np.float32(n)
        return Picture(color, depth[middle, middle], motion, camera.scaled(1 / n, 1 / n))

    def close(self) -> None:
        """Close Panda3D's offscreen window."""
        self._game.base.destroy()


class PandaLiveAntialiased(PandaLive):
    """3×3 samples for each pixel."""

    samples = 3
