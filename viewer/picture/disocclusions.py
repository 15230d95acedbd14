"""Disocclusions over the picture: pixels without a fragment in a generated frame, also while the camera flies."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from ..engine.figures import out_of_screen
from ..engine.messages import Frame, Setup
from .current_frame import Contents
from .view import View

NAME = OVERLAY = "disocclusions"
KINDS = ("out of screen", "hidden")  # in this order: the labels, and the colors of regions of errors
NONE = 255
_NEEDED = frozenset({names.DEPTH, names.DISOCCLUDED})
_REMEMBERED = 60  # generated frames: a second of most flights
_SPEC = LayerSpec(NAME, "Disocclusions", "overlay", "label", labels=tuple(enumerate(KINDS)))


class Share(NamedTuple):
    """Shares of the picture, 0 to 1: pixels that are empty after crack closing, and those of them outside the
    rendered frame, which a larger rendering window would contain."""

    all: float
    out_of_screen: float

    def __str__(self) -> str:
        return f"{self.all:.1%} ({self.out_of_screen:.1%} out of screen)"


class Disocclusions:
    """Disocclusions of every slot, found before it is drawn, while the overlay "disocclusions" is on.

    Attributes
    ----------
    share : Share or None
        Of the slot that is shown, if it is a generated one.
    """

    def __init__(self, view: View, contents: Contents):
        self._view, self._contents = view, contents
        self._seen = -1
        self._shares: deque[Share] = deque(maxlen=_REMEMBERED)
        self._setup: Setup | None = None  # of which the shares are
        self.share: Share | None = None

    @property
    def on(self) -> bool:
        return self._view.overlay == OVERLAY

    def switch(self, on: bool) -> None:
        """Show the disocclusions over the picture, or not."""
        self._view.overlay = OVERLAY if on else "none"

    def forget(self) -> None:
        """Drop the result after a change of the source."""
        self._setup, self.share = None, None
        self._shares.clear()

    @property
    def needed(self) -> frozenset[str]:
        """Layers to read back for disocclusions."""
        return _NEEDED if self.on else frozenset()

    @property
    def mean(self) -> Share | None:
        """Mean share of the generated frames shown lately with these settings; None without any."""
        return Share(*np.mean(self._shares, 0).tolist()) if self._shares else None

    def text(self) -> str:
        """Return the result in words; empty without one."""
        parts = [f"disoccluded {self.share}"] if self.share else []
        if len(self._shares) > 1:
            parts.append(f"last {len(self._shares)} frames {self.mean}")
        return "   ".join(parts)

    def update(self, canvas) -> None:
        """Find the disocclusions of the present slot, and upload them. Call once per frame of the interface, after the
        images have come."""
        contents = self._contents
        if not self.on or contents.changes == self._seen:
            return
        self._seen, self.share = contents.changes, None
        result = contents.result
        labels = None if result is None else self._labels(result)
        if canvas is not None and labels is not None:
            canvas.upload(NAME, labels, _SPEC)
        elif canvas is not None:
            canvas.forget([NAME])

    def _labels(self, result: Frame) -> np.ndarray | None:
        """Return (H, W) uint8: indices into `KINDS`, and NONE; None for rendered frames."""
        if not (result.moment.alpha and result.images.keys() >= _NEEDED):
            return None
        holes = result.images[names.DISOCCLUDED] != 0
        outside = out_of_screen(result, holes)
        if result.setup != self._setup:
            self._setup = result.setup
            self._shares.clear()
        self.share = Share(*(np.count_nonzero(mask) / holes.size for mask in (holes, outside)))
        self._shares.append(self.share)
        return np.where(outside, np.uint8(0), np.where(holes, np.uint8(1), np.uint8(NONE)))
