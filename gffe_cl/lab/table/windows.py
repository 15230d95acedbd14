"""Rendering windows that the table compares: those of `WindowChooser`, and two that render more pixels."""

from __future__ import annotations

from collections.abc import Iterable

from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.window import Window, WindowChooser

# Rendered pixels are as small as the display's: so many times as many of them, each way.
DENSER = {"adaptive, dense": 1.2, "wide": 1.5}


def rendered_size(mode: str, size: tuple[int, int]) -> tuple[int, int]:
    """Return width and height of frames rendered through a window, for a display of `size`, pixels. Whole pixels are
    added on both sides: rendered pixels lie on those of the display."""
    width, height = (n + 2 * round((DENSER.get(mode, 1) - 1) / 2 * n) for n in size)
    return width, height


def chooser_of(mode: str, size: tuple[int, int], alphas: Iterable[float]) -> WindowChooser:
    """Return the chooser of a mode of `WindowChooser` or `DENSER`. Raises GffeError for others."""
    return _Grown(mode, size, alphas) if mode in DENSER else WindowChooser(mode, size, alphas)


class _Grown(WindowChooser):
    """Chooser of the adaptive window, or for "wide" of none, grown evenly to the size at which rendered pixels are the
    display's."""

    def __init__(self, mode: str, size: tuple[int, int], alphas: Iterable[float]):
        self._render_size = rendered_size(mode, size)
        most = min(r / s for r, s in zip(self._render_size, size, strict=True))
        super().__init__("off" if mode == "wide" else "adaptive", size, alphas, most)

    def choose(self, current: Camera, previous: Camera | None) -> Window:
        window = super().choose(current, previous)
        low, high = [], []
        for k in range(2):
            shown, rendered = self.size[k], self._render_size[k]
            middle = (window[k] + window[k + 2]) / 4 * shown + shown / 2  # display pixels
            start = min(max(round(middle - rendered / 2), shown - rendered), 0)
            low.append(2 * start / shown - 1)
            high.append(2 * (start + rendered) / shown - 1)
        return Window(*low, *high)
