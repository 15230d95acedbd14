"""Displayed content: the open source, the slot that was computed last, and its images on the canvas."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import FRAME_LAYERS, LayerSpec
from ..engine.messages import Frame
from ..engine.sources.preview import Preview
from ..engine.sources.source import FrameSource
from .canvas import Canvas
from .displays import FrameInfo, area_of


class Contents:
    """Contents of the picture and of the list of layers.

    Attributes
    ----------
    source : FrameSource or None
    result : Frame or None
        Of the slot computed last; None until there is one of this source.
    second : Frame or None
        Of the same slot by other settings, where these are compared; its layers are named by `names.of_second`.
    layers : list of LayerSpec
        All that can be shown.
    cuts : frozenset of int
        Rendered frames that were found to be cuts so far, in computing ahead, too.
    changes : int
        How often there were other images.
    """

    def __init__(self):
        self.source: Any = None  # a FrameSource, once something is open
        self.result: Frame | None = None
        self.second: Frame | None = None
        self.layers: list[LayerSpec] = []
        self.cuts: frozenset[int] = frozenset()
        self.changes = 0

    def open(self, source: FrameSource) -> None:
        self.source, self.result, self.second = source, None, None
        self.changes += 1

    def take(self, result: Frame, second: Frame | None = None) -> None:
        self.result, self.second, self.layers = result, second, list(result.specs.values())
        self.changes += 1

    @property
    def images(self) -> dict[str, np.ndarray]:
        """All images, those of the second frame under the names of `names.of_second`."""
        found = {} if self.result is None else dict(self.result.images)
        second = {} if self.second is None else self.second.images
        return found | {names.of_second(name): image for name, image in second.items()}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the display, pixels."""
        return self.source.width, self.source.height

    @property
    def resets(self) -> dict[int, str]:
        """Rendered frames that start without history, with the reason: those marked in the input, and cuts found so
        far."""
        return dict.fromkeys(sorted(self.cuts), "a cut was found here") | dict.fromkeys(self.source.resets[1:], "reset")

    @property
    def asked(self) -> frozenset[str]:
        """Layers that the present images were asked for."""
        asked = self.result.layers if self.result is not None else frozenset()
        return asked | {names.of_second(name) for name in (self.second.layers if self.second else ())}

    def spec(self, name: str | None) -> LayerSpec | None:
        if names.is_second(name):
            name = names.plain(name)
            if self.second is not None:
                return self.second.specs.get(name)
        return next((spec for spec in self.layers if spec.name == name), None)

    def image(self, name: str | None) -> np.ndarray | None:
        if names.is_second(name):
            return None if self.second is None else self.second.images.get(names.plain(name))
        return None if self.result is None or name is None else self.result.images.get(name)

    def find(self, text: str) -> str | None:
        """Return the full name of a layer, given by it or by the buffer's name alone; None if there is none."""
        found = [spec.name for spec in self.layers]
        if text in found:
            return text
        return next((name for name in found if name.partition(".")[2] == text), None)

    def why_not(self, name: str) -> str | None:
        """Return why a layer cannot be shown in this sequence; None if it can."""
        name = names.plain(name)
        if name in (names.TRUTH, names.FOCUS_TRUTH) and self.source is not None and not self.source.has_truth:
            return "this sequence has no ground truth"
        return None

    def showable(self) -> list[LayerSpec]:
        return [spec for spec in self.layers if self.why_not(spec.name) is None]

    def frame_info(self, result: Frame | None = None) -> FrameInfo:
        """Return the frame of reference of the result's layers, for display; by default of A's."""
        result = result or self.result
        assert result is not None
        source, moment, rendered = self.source, result.moment, result.render_size
        area = area_of(moment.render_camera, rendered, moment.display_camera, self.size)
        cameras = moment.render_camera, moment.previous_camera
        generated = moment.alpha > 0
        return FrameInfo(
            self.size, rendered, self.size, source.exposure, *cameras, source_area=area, generated=generated
        )


_BUDGET = 0.02  # seconds per frame of the interface, but at least one image


class Screen:
    """Puts the images of `contents` on a canvas.

    Attributes
    ----------
    canvas : Canvas or None
        None: there is nothing to draw on.
    upload_ms : float
        What the images on the canvas took.
    """

    def __init__(self, contents: Contents):
        self._contents = contents
        self._on_canvas: dict[str, np.ndarray] = {}
        self._uploaded: set[str] = set()  # names, with those whose images are other ones by now
        self._changes = self._coming = 0  # of the contents that are on the canvas, and of those that come
        self.canvas: Canvas | None = None
        self.upload_ms = 0.0

    @property
    def ready(self) -> bool:
        """Whether all images are on the canvas."""
        return self._changes == self._contents.changes

    def preview(self, preview: Preview) -> None:
        """Show a preview on the canvas before there are contents."""
        if self.canvas is not None:
            self.canvas.frame = FrameInfo(preview.color.shape[1::-1], exposure=preview.exposure)
            self.canvas.upload(names.FINAL, preview.color, FRAME_LAYERS[names.FINAL])
            self._uploaded.add(names.FINAL)

    def update(self, first: set[str]) -> None:
        """Upload the images of the contents that are not on the canvas yet, and remove all others, which belong to
        another time: those of `first` at once, the others as time permits. Call once per frame of the interface, and
        after the contents have changed."""
        if self.ready:
            return
        images = self._contents.images
        if self._coming != self._contents.changes:
            self._coming, self.upload_ms = self._contents.changes, 0.0
            if self.canvas is not None:
                if self._contents.result is not None:
                    self.canvas.frame = self._contents.frame_info()
                self.canvas.forget(self._uploaded - images.keys())
                self._uploaded &= images.keys()
        self._on_canvas = {name: image for name, image in self._on_canvas.items() if images.get(name) is image}
        end = time.perf_counter() + _BUDGET
        left = sorted(images.keys() - self._on_canvas.keys(), key=lambda name: name not in first)
        for place, name in enumerate(left):
            if place and name not in first and time.perf_counter() > end:
                return
            self._upload(name, images[name])
        self._changes = self._contents.changes

    def _upload(self, name: str, image: np.ndarray) -> None:
        start = time.perf_counter()
        if self.canvas is not None:
            own = [self._contents.frame_info(self._contents.second)] if names.is_second(name) else []
            spec = self._contents.spec(name)
            assert spec is not None  # there is an image of it
            self.canvas.upload(name, image, spec, *own)
            self._uploaded.add(name)
        self._on_canvas[name] = image
        self.upload_ms += (time.perf_counter() - start) * 1e3
