"""The interface as its panels see it: what they draw with, and what they remember from one frame to the next."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from imgui_bundle import ImVec2

from ..picture.canvas import Canvas, Rectangle
from ..picture.view import View
from ..state.actions import Actions
from ..state.model import Model


@dataclass
class Spot:
    """Place of the picture in the window: `origin` in the window's pixels; `covers`, rectangles in the picture's own
    pixels that other content covers; `hovered`: by the mouse."""

    view: View
    origin: tuple[int, int]
    size: tuple[int, int]
    covers: list[Rectangle]
    hovered: bool


class Interface:
    """State and tools that all panels share. The window is a subclass (`app.App`).

    Attributes
    ----------
    canvas : Canvas
        Made when there is a GL context.
    clock : callable
        Clock of playback, seconds.
    spot : Spot or None
        Set with each frame of the interface; None where more than the picture changes, or where something lies over it.
    foot : tuple or None
        Middle of the picture's lower edge, screen pixels.
    """

    canvas: Canvas

    def __init__(self, model: Model):
        self.model, self.actions = model, Actions()
        self.clock: Callable[[], float] = time.perf_counter
        self.spot: Spot | None = None
        self.foot: tuple[float, float] | None = None
        self.canvas_size: tuple[int, int] = (0, 0)  # screen pixels
        self.drags, self.pressed_at = "nothing", ImVec2()  # by the mouse, in the picture
        self.row_seen = ""  # of the list of layers: it was scrolled to this one
        self.display_height = 200.0  # of the display settings below the list of layers, as last drawn
        self.inspected: tuple = (None, [])  # an inspection, and its rows in the inspector
        self.row_canvas: Canvas | None = None  # of the panel that shows a row over time
        self.lists_equal = False  # layers that do not differ, among those that do
        self._current_at = -math.inf  # clock, when the picture was the requested one

    def stale_for(self, seconds: float) -> bool:
        """Return whether the picture has not been the requested one for longer than that. Call once per frame of the
        interface."""
        model = self.model
        if model.current or model.saving.work is not None:
            self._current_at = self.clock()
        return self.clock() - self._current_at > seconds
