"""What is on the canvas: images of one slot, uploaded without holding up the interface."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from gffe_cl.viewer.engine import names
from gffe_cl.viewer.engine.layers import FRAME_LAYERS
from gffe_cl.viewer.engine.preview import Preview
from gffe_cl.viewer.picture import flip_map, region_map
from gffe_cl.viewer.picture.canvas import Canvas
from gffe_cl.viewer.picture.displays import FrameInfo
from gffe_cl.viewer.state import disocclusions
from gffe_cl.viewer.state.contents import Contents
from gffe_cl.viewer.state.looks import Looks

_OF_OTHERS = {flip_map.NAME, region_map.NAME, disocclusions.NAME}  # layers that come and go by themselves
_BUDGET = 0.02  # seconds per frame of the interface, but at least one image


class Screen:
    """Puts the images of `contents` on a canvas, and has `looks` meet them.

    Attributes
    ----------
    canvas : Canvas or None
        None: there is nothing to draw on.
    upload_ms : float
        What the last images took.
    """

    def __init__(self, contents: Contents, looks: Looks):
        self._contents, self._looks = contents, looks
        self._waiting: dict[str, np.ndarray] = {}
        self.canvas: Canvas | None = None
        self.upload_ms = 0.0

    @property
    def ready(self) -> bool:
        """Whether all images are on the canvas."""
        return not self._waiting

    def preview(self, preview: Preview) -> None:
        """Something to look at before there are contents."""
        if self.canvas is not None:
            self.canvas.frame = FrameInfo(preview.color.shape[1::-1], exposure=preview.exposure)
            self.canvas.upload(names.FINAL, preview.color, FRAME_LAYERS[names.FINAL])

    def show(self, images: Mapping[str, np.ndarray], first: set[str]) -> None:
        """Have these images, with those of other settings, and no others, which would be of another time, on the
        canvas: those of `first` at once, the others as soon as there is time."""
        second = self._contents.second if images else None
        others = {} if second is None else {names.of_second(name): image for name, image in second.images.items()}
        self._waiting, self.upload_ms = dict(images) | others, 0.0
        if self.canvas is not None:
            if images:
                self.canvas.frame = self._contents.frame_info()
            self.canvas.forget(self.canvas.layers.keys() - self._waiting.keys() - _OF_OTHERS)
        for name in first & self._waiting.keys():
            self._upload(name)
        self.proceed()

    def proceed(self) -> None:
        """Once per frame of the interface."""
        end = time.perf_counter() + _BUDGET
        while self._waiting:
            self._upload(next(iter(self._waiting)))
            if time.perf_counter() > end:
                return

    def _upload(self, name: str) -> None:
        start, image = time.perf_counter(), self._waiting.pop(name)
        if self.canvas is not None:
            own = [self._contents.frame_info(self._contents.second)] if names.is_second(name) else []
            self.canvas.upload(name, image, self._contents.spec(name), *own)
        self.upload_ms += (time.perf_counter() - start) * 1e3
        if not names.is_second(name):
            self._looks.meet([name])
