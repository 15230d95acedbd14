"""Hypotheses about cameras: matrices and view axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from gffe_cl.engine.frame.camera import Camera


def _inverted(m: np.ndarray) -> np.ndarray:
    return np.linalg.inv(m)


def _rotation_transposed(m: np.ndarray) -> np.ndarray:
    made = m.copy()
    made[:3, :3] = m[:3, :3].T
    return made


def _position_given(m: np.ndarray) -> np.ndarray:
    made = m.copy()
    made[:3, 3] = -m[:3, :3] @ m[:3, 3]
    return made


_LAYOUTS: dict[tuple[str, ...], Callable] = {
    (): lambda m: m,
    ("inverted",): _inverted,
    ("rotation transposed",): _rotation_transposed,
    ("position instead of translation",): _position_given,
    ("inverted", "rotation transposed"): lambda m: _rotation_transposed(_inverted(m)),
}
_FLIPS = {(1, -1, -1): "OpenGL axes", (1, -1, 1): "y up", (1, 1, -1): "z backward", (-1, 1, 1): "x left"}
_DIRECTIONS = (("right", "left"), ("down", "up"), ("forward", "backward"))


@dataclass(frozen=True)
class CameraReading:
    """One way to read camera matrices: `axes` · layout(`axes_before` · stored), axes being signed permutations.

    `focal` divides focal lengths; `scale` multiplies translations (both are found by fitting).
    """

    parts: tuple[str, ...] = ()
    layout: tuple[str, ...] = ()
    axes: tuple = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    axes_before: tuple | None = None
    focal: float = 1.0

    def read(self, camera: Camera) -> Camera:
        """Return the camera with this hypothesis applied."""
        matrix = camera.world_to_view
        if self.axes_before is not None:
            matrix = _four(self.axes_before) @ matrix
        matrix = _four(self.axes) @ _LAYOUTS[self.layout](matrix)
        return Camera(matrix, camera.fx / self.focal, camera.fy / self.focal, camera.cx, camera.cy)

    @property
    def is_usual(self) -> bool:
        """Whether no two axes are swapped, which is rare."""
        return all(axes[k][k] for axes in (self.axes, self.axes_before or self.axes) for k in range(3))

    def opposite(self) -> CameraReading:
        """Return this reading with all three axes reversed."""
        before = None if self.axes_before is None else np.array(self.axes_before)
        made = _reading(self.layout, -np.array(self.axes), before)
        return replace(made, focal=self.focal)

    def mirrored(self) -> CameraReading:
        """Return this reading with y reversed."""
        before = None if self.axes_before is None else np.array(self.axes_before)
        return replace(_reading(self.layout, np.diag([1, -1, 1]) @ np.array(self.axes), before), focal=self.focal)

    def keeping(self, parts: tuple[str, ...]) -> CameraReading:
        """Return this reading with only those of its parts, and "field of view", that are among `parts`."""
        one = np.eye(3)
        before = None if self.axes_before is None else np.array(self.axes_before)
        if before is not None and not set(_named(before)) & set(parts):
            before = None
        axes = np.array(self.axes) if set(_named(np.array(self.axes))) & set(parts) else one
        layout = tuple(part for part in self.layout if part in parts)
        return replace(_reading(layout, axes, before), focal=self.focal if "field of view" in parts else 1.0)

    def with_focal(self, focal: float) -> CameraReading:
        return replace(self, focal=float(focal))


CAMERA_AS_GIVEN = CameraReading()


def _four(axes) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3] = axes
    return made


def axes_in_words(axes) -> str:
    """Return in words the view axes of stored matrices that `axes` converts to ours."""
    stored = np.array(axes).T  # rows: our axes by theirs
    words = []
    for letter, row in zip("xyz", stored.T.tolist(), strict=True):
        k = next(i for i, value in enumerate(row) if value)
        words.append(f"{letter} {_DIRECTIONS[k][row[k] < 0]}")
    return ", ".join(words)


def camera_readings() -> list[CameraReading]:
    """Return all hypotheses to try, the usual one first. Of two with opposite axes only one is listed: `opposite`
    returns the other, and negative depths decide between them."""
    flips = [np.diag(signs) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))]
    found = []
    for layout in _LAYOUTS:
        found += [_reading(layout, flip) for flip in flips]
        if layout == ("rotation transposed",):
            found += [_reading(layout, np.eye(3), flip) for flip in flips[1:]]
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            found += [_reading((), np.eye(3)[list(order)] @ flip) for flip in flips]
    return found


def _reading(layout: tuple, axes: np.ndarray, before: np.ndarray | None = None) -> CameraReading:
    parts = (*(() if before is None else _named(before)), *layout, *_named(axes))
    return CameraReading(parts, layout, _as_tuple(axes), None if before is None else _as_tuple(before))


def _named(axes: np.ndarray) -> tuple[str, ...]:
    if (axes == np.eye(3)).all():
        return ()
    x, y, z = (int(n) for n in np.diag(axes))
    signs = x, y, z
    return (_FLIPS.get(signs, "axes"),) if (axes == np.diag(signs)).all() else ("axes",)


def _as_tuple(axes: np.ndarray) -> tuple:
    return tuple(tuple(int(n) for n in row) for row in axes)
