"""Invalid pixels over the picture: a pattern where the input or the displayed layer has NaN or infinity, and their
places."""

from __future__ import annotations

from collections import deque

import numpy as np

from gffe_cl.engine.inspection.layers import LayerSpec
from ..engine.background import Background, Derived
from ..engine.messages import Frame
from .current_frame import Contents
from .displays import FrameInfo
from .view import INVALID_RENDERED, INVALID_SHOWN, View

_SPECS = {
    name: LayerSpec(name, "Invalid pixels", "input", "mask", grid=grid)
    for name, grid in ((INVALID_RENDERED, "source"), (INVALID_SHOWN, "target"))
}


class InvalidPixels:
    """Invalid pixels of every slot, marked in all layers while `View.mark_invalid` is on.

    Attributes
    ----------
    places : (N, 2) int array
        Display pixels (x, y) of the layer A that are invalid, row by row, once they are known.
    """

    def __init__(self, view: View, contents: Contents, background: Background):
        self._view, self._contents = view, contents
        self._derived = Derived(background)
        self._seen = -1
        self.places = np.empty((0, 2), int)

    def update(self, canvas, playing: bool) -> None:
        """Upload the masks of the present slot, and look for the places, but while it plays. Call once per frame of the
        interface, after the images have come."""
        contents, result = self._contents, self._contents.result
        if contents.changes != self._seen:
            self._seen, self.places = contents.changes, np.empty((0, 2), int)
            self._upload(canvas, result)
        if result is not None and not playing:
            spec, image = contents.spec(self._view.a), contents.image(self._view.a)
            if spec is not None and image is not None:
                key = contents.changes, self._view.a
                made = self._derived.get(key, _places, spec, image, contents.frame_info(), result)
                if self._derived.ready:
                    self.places = made

    def _upload(self, canvas, result: Frame | None) -> None:
        if canvas is None:
            return
        canvas.forget([INVALID_RENDERED, INVALID_SHOWN])
        if result is not None and result.invalid is not None:
            for name, mask in ((INVALID_RENDERED, result.invalid.rendered), (INVALID_SHOWN, result.invalid.shown)):
                canvas.upload(name, np.where(mask, np.uint8(255), np.uint8(0)), _SPECS[name])

    @property
    def count(self) -> int:
        """Invalid pixels of the layer A; while they are not known, those that the input's lead to."""
        result = self._contents.result
        if self._derived.ready or result is None or result.invalid is None:
            return len(self.places)
        return int(np.count_nonzero(result.invalid.shown))

    def text(self) -> str:
        return f"{self.count} invalid pixel{'s' * (self.count > 1)}" if self.count else ""

    def next(self, after: tuple[int, int] | None) -> tuple[int, int] | None:
        """Return the place after a pixel, row by row and round, which does not belong to the same group; None without
        any."""
        if not len(self.places):
            return None
        starts = _starts(self.places)
        x, y = after or (-1, -1)
        later = starts[(starts[:, 1] > y) | ((starts[:, 1] == y) & (starts[:, 0] > x))]
        found = later[0] if len(later) else starts[0]
        return int(found[0]), int(found[1])


def bad_values(spec: LayerSpec, image: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: the texels of one plane of a layer, (H, W, channels?), that hold NaN or infinity, as the
    shader marks them. Infinite depth is sky."""
    image = image.reshape(*image.shape[:2], -1)
    if spec.view in ("mask", "label") or image.dtype.kind != "f":
        return np.zeros(image.shape[:2], bool)
    if spec.view == "depth":
        return np.isnan(image[..., 0]) | np.isneginf(image[..., 0])
    used = {"color": 3, "motion": 2, "place": 2, "world": 3}.get(spec.view, image.shape[2])
    bad = np.asarray((~np.isfinite(image[..., :used])).any(-1))
    weighted = spec.view == "color" and spec.components[3:] == ("weight",)
    if weighted or spec.view == "world":
        bad &= image[..., 3] != 0
    return bad


def _places(spec: LayerSpec, image: np.ndarray, frame: FrameInfo, result: Frame) -> np.ndarray:
    """Return the invalid places of a layer of `result`, as `InvalidPixels.places`."""
    width, height = frame.display_size
    found = np.zeros((height, width), bool)
    plane = image[0] if spec.planes > 1 else image
    rows, columns = np.nonzero(bad_values(spec, plane))
    if len(rows):
        x0, y0, x1, y1 = frame.area(spec)
        x = ((columns + 0.5) / plane.shape[1] - x0) / (x1 - x0) * width
        y = ((rows + 0.5) / plane.shape[0] - y0) / (y1 - y0) * height
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        found[y[inside].astype(int), x[inside].astype(int)] = True
    if result.invalid is not None and not frame.is_true(spec):
        found |= result.invalid.shown != 0
    return np.argwhere(found)[:, ::-1]


def _starts(places: np.ndarray) -> np.ndarray:
    """Return the first place of each group of neighbors, row by row."""
    known, left = set(map(tuple, places.tolist())), []
    for place in map(tuple, places.tolist()):
        if place not in known:
            continue
        left.append(place)
        known.discard(place)
        around = deque([place])
        while around:
            x, y = around.popleft()
            for near in ((x + dx, y + dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)):
                if near in known:
                    known.discard(near)
                    around.append(near)
    return np.array(left)
