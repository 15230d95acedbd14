"""Regions of errors: their map as a layer, and their figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.inspection import names
from gffe_cl.engine.inspection.layers import LayerSpec
from gffe_cl.lab.metrics import squared_error, to_display
from ..engine.background import Derived
from ..engine.figures import NEEDED, REGIONS, Part, parts_of, region_labels
from ..engine.messages import Frame
from .current_frame import Contents
from .view import View

NAME = "regions"
SPEC = LayerSpec(
    NAME, "Regions", "compare", "label", labels=tuple(enumerate(REGIONS)), description="where errors are counted"
)


@dataclass(frozen=True)
class RegionMap:
    """Map of regions. `labels`: (H, W) uint8, indices into `REGIONS`, as A's pipeline finds them; `a`, `b`: the parts
    of A's error in them, and of B's, if it is there."""

    labels: np.ndarray
    a: dict[str, Part]
    b: dict[str, Part] | None = None


def region_map(result: Frame, b: np.ndarray | None, exposure: float) -> RegionMap:
    """Return the map of regions of a generated slot of A with the layers `figures.NEEDED`. `b`: B's final colors
    (H, W, 4) of the same slot, if B is there."""
    labels = region_labels(result, exposure)
    true = to_display(result.images[names.TRUTH][..., :3], exposure)

    def parts(color: np.ndarray) -> dict[str, Part]:
        return parts_of(labels, squared_error(to_display(color[..., :3], exposure), true))

    return RegionMap(labels, parts(result.images[names.FINAL]), None if b is None else parts(b))


OVERLAY = "regions"


class Regions:
    """Regions of errors, found while the overlay "regions" is on.

    Attributes
    ----------
    map : RegionMap or None
        Of the slot that is shown, once it is known.
    """

    def __init__(self, view: View, contents: Contents):
        self._view, self._contents = view, contents
        self._maps = Derived("regions")
        self.map: RegionMap | None = None

    @property
    def on(self) -> bool:
        return self._view.overlay == OVERLAY

    def switch(self, on: bool) -> None:
        """Show the regions over the picture, or not."""
        self._view.overlay, self._view.region = OVERLAY if on else "none", -1

    @property
    def only(self) -> str | None:
        """The region that is seen alone."""
        return list(REGIONS)[self._view.region] if self.on and self._view.region >= 0 else None

    def see_only(self, name: str | None) -> None:
        """Show one region alone; None: all of them, each in its color. The region that is seen alone already: all of
        them."""
        again = name is not None and name == self.only
        self.switch(True)
        self._view.region = -1 if name is None or again else list(REGIONS).index(name)

    def why_not(self) -> str | None:
        """Return why there are no regions here; None if there can be."""
        contents = self._contents
        reason = contents.why_not(names.TRUTH)
        if reason or contents.result is None:
            return reason
        if not contents.result.moment.alpha:
            return "a rendered frame has no errors"
        known = self._contents.image(names.TRUTH) is not None or names.TRUTH not in contents.asked
        return None if known else "there is no ground truth at this time"

    @property
    def needed(self) -> frozenset[str]:
        """Layers to read back for the regions."""
        return NEEDED if self.on else frozenset()

    @property
    def ready(self) -> bool:
        """Whether the displayed regions belong to the present images."""
        return not self.on or self.why_not() is not None or self._maps.ready

    def update(self, canvas) -> str | None:
        """Take the result, and request the next. Call once per frame of the interface. Returns an error message, if
        any."""
        if not self.on:
            return None
        result, contents = self._contents.result, self._contents
        have = result is not None and NEEDED & result.specs.keys() <= result.images.keys()
        if not have or self.why_not() is not None:
            if self.map is not None and result is not None and self.why_not():
                self._maps.forget()
                self.map = None
                if canvas is not None:
                    canvas.forget([NAME])
            return None
        second = contents.image(names.of_second(names.FINAL))
        key = contents.changes, second is None
        try:
            made = self._maps.get(key, region_map, result, second, contents.source.exposure)
        except Exception as error:
            self.switch(False)
            return f"regions: {error}"
        if made is not None and made is not self.map:
            self.map = made
            if canvas is not None:
                canvas.upload(NAME, made.labels, SPEC)
        return None

    def close(self) -> None:
        self._maps.close()
