"""Zoom and centre of the view."""

from __future__ import annotations

from gffe_cl.viewer.picture.view import View

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
        self.due, self._fitted = False, (view.zoom, view.centre)

    @property
    def is_fitted(self) -> bool:
        """Whether nobody has zoomed or panned since `fit`."""
        return self._fitted == (self._view.zoom, self._view.centre)

    def zoom(self, factor: float) -> None:
        self._view.zoom = min(max(self._view.zoom * factor, _LEAST), _MOST)
