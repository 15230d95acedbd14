"""Pixels with the largest errors of the displayed slot, found when they are asked for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.lab.metrics import to_display
from ..engine.background import Derived
from .current_frame import Contents
from .display_settings import Looks
from .legends import value_text
from .view import View

_APART = 8  # pixels on each side of a found one that belong to it
_MOST = 50


class Worst(NamedTuple):
    """A pixel of the display and its `error`; `rank`: 1 is the worst. `labels`: A's and B's there, where the layer has
    labels and no numbers."""

    pixel: tuple[int, int]
    error: float
    rank: int
    labels: tuple[str, str] | None = None

    @property
    def text(self) -> str:
        x, y = self.pixel
        found = f"error {self.error:.4g}" if self.labels is None else f"A {self.labels[0]}, B {self.labels[1]}"
        return f"{found} at ({x}, {y}): number {self.rank} of the frame"


class WorstPixels:
    """Finds the worst pixel of the slot, and at each further request the next one: by the difference of A and B where
    these are compared, else of the final image and ground truth."""

    def __init__(self, view: View, contents: Contents, looks: Looks):
        self._view, self._contents, self._looks = view, contents, looks
        self._derived = Derived("worst")
        self._found: list[Worst] = []
        self._before: list[Worst] = []  # that the last request found
        self._next = 0
        self.due = False

    @property
    def pair(self) -> tuple[str, str]:
        """The layers that are compared."""
        view = self._view
        return (view.a, view.b) if view.compare != "off" and view.b else (names.FINAL, names.TRUTH)

    @property
    def needed(self) -> frozenset[str]:
        """Layers of A to read back for the search."""
        return frozenset(name for name in self.pair if not names.is_second(name)) if self.due else frozenset()

    def why_not(self) -> str | None:
        """Return why there is no worst pixel here; None if there can be."""
        contents, pair = self._contents, self.pair
        if pair != (names.FINAL, names.TRUTH):
            return None
        reason = contents.why_not(names.TRUTH)
        rendered = contents.result is not None and not contents.result.moment.alpha
        return reason or ("a rendered frame has no errors" if rendered else None)

    def update(self) -> tuple[Worst | None, str]:
        """Take the result, and request it. Call once per frame of the interface. Returns the pixel that was asked for,
        or a message why there is none; (None, "") while it is not known."""
        if not self.due:
            return None, ""
        contents = self._contents
        a, b = self.pair
        images = contents.image(a), contents.image(b)
        if images[0] is None or images[1] is None:
            if {a, b} <= contents.asked:
                self.due = False
                return None, self.why_not() or "A or B does not exist for this frame"
            return None, ""
        if images[0].shape != images[1].shape:
            self.due = False
            return None, "A and B have different sizes"
        plane = self._looks.of(a).plane
        key, exposure = (contents.changes, a, b, plane), contents.source.exposure
        made = self._derived.get(key, worst_pixels, contents.spec(a), *images, contents.size, exposure, plane)
        if not self._derived.ready:
            return None, ""
        self._found = made
        self._next = self._next if self._found == self._before else 0
        self._before, self.due = self._found, False
        if not self._found:
            return None, "A and B are equal here"
        found = self._found[self._next % len(self._found)]
        self._next += 1
        return found, ""

    def close(self) -> None:
        self._derived.close()


def worst_pixels(
    spec: LayerSpec, a: np.ndarray, b: np.ndarray, size: tuple[int, int], exposure: float, plane: int = 0
) -> list[Worst]:
    """Return the worst pixels of two images of a layer like `spec`, in order: of colors by the mean absolute difference
    of display values, of labels all that differ, else by the length of the values' difference. Positions are of the
    display of `size`; `plane`: of several."""
    labeled = spec.view == "label"
    if spec.view == "color":
        error = np.abs(to_display(a[..., :3], exposure) - to_display(b[..., :3], exposure)).mean(-1)
    else:
        if spec.planes > 1:
            a, b = a[min(plane, spec.planes - 1)], b[min(plane, spec.planes - 1)]
        a, b = (np.asarray(image, np.float32) for image in (a, b))
        with np.errstate(invalid="ignore", over="ignore"):
            apart = np.where(a == b, 0, np.abs(a - b)).reshape(*a.shape[:2], -1)
            error = np.linalg.norm(apart, axis=-1)
        if labeled:
            error = (error > 0).astype(np.float32)
    error = np.nan_to_num(error, nan=np.inf)
    found: list[Worst] = []
    while len(found) < _MOST:
        y, x = np.unravel_index(int(error.argmax()), error.shape)
        if not error[y, x] > 0:
            break
        scale = size[0] / error.shape[1], size[1] / error.shape[0]
        pixel = int((x + 0.5) * scale[0]), int((y + 0.5) * scale[1])
        labels = (value_text(spec, a[y, x]), value_text(spec, b[y, x])) if labeled else None
        found.append(Worst(pixel, float(error[y, x]), len(found) + 1, labels))
        error[max(y - _APART, 0) : y + _APART + 1, max(x - _APART, 0) : x + _APART + 1] = 0
    return found
