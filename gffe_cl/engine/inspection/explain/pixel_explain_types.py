"""Types of a pixel's explanation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gffe_cl.engine.inspection.explain.motion_trail import WayPoint


@dataclass(frozen=True)
class Link:
    """Link of a step of a story: to `layer`, if it is named, of this slot or of rendered frame `frame`; there to
    display pixel `pixel`, by default the same."""

    label: str
    layer: str = ""
    frame: int | None = None
    pixel: tuple[int, int] | None = None


class Claim(str):
    """Claim of a story, with its links."""

    links: tuple[Link, ...]

    def __new__(cls, text: str, *links: Link):
        step = super().__new__(cls, text)
        step.links = links
        return step


@dataclass(frozen=True)
class Story:
    """Explanation of how a display pixel came about.

    Attributes
    ----------
    pixel : (int, int)
    filled_by : str
        Which stage its color comes from.
    source : (float, float) or None
        Where the warp's motion points to, in pixels of the rendered image.
    trajectory : tuple of (float, float)
        Display pixels: the known positions P_i … P_1 and P_0 of its fragment as seen at the rendered frame, then where
        it is now.
    dynamic : bool or None
        None where no fragment of the rendered frame is shown.
    residual, threshold : float or None
        Pixels: how far its motion is from that of a static surface, and from where on it is dynamic.
    level : int or None
        Of the background that it was filled from.
    level_px : (float, float) or None
        Where that fragment lies in the rendered image, pixels.
    corrected : bool or None
        Whether shading correction changed its color; None for rendered frames and where that is off.
    sentences : tuple of Claim or str
    fragment : (int, int) or None
        Its pixel of the rendered image, where it is a fragment of that.
    way : tuple of WayPoint
        Of that fragment through the last rendered frames, from the present one back.
    """

    pixel: tuple[int, int]
    filled_by: str
    source: tuple[float, float] | None
    trajectory: tuple[tuple[float, float], ...] = ()
    dynamic: bool | None = None
    residual: float | None = None
    threshold: float | None = None
    level: int | None = None
    level_px: tuple[float, float] | None = None
    corrected: bool | None = None
    sentences: tuple[Claim | str, ...] = ()
    fragment: tuple[int, int] | None = None
    way: tuple[WayPoint, ...] = ()


@dataclass(frozen=True)
class Inspection:
    """Values of a computed slot at display pixel `pixel`.

    `values` are (planes?, channels) by layer, as the picture shows them at the pixel. `source` is the position in the
    rendered image (pixels) that the warp's motion points to, and `origin` the values there of the layers on that image;
    of a rendered slot, whose pixels come from where they are, there are none. `fault`: why the pixel at `source` is
    invalid; empty if it is not.
    """

    pixel: tuple[int, int]
    slot: int
    source: tuple[float, float] | None
    values: dict[str, np.ndarray]
    story: Story
    fault: str = ""
    origin: dict[str, np.ndarray] = field(default_factory=dict)

    def of(self, layers: frozenset[str] | None) -> Inspection:
        """Return the same with the values of `layers` alone; None: of all."""
        if layers is None:
            return self
        values, origin = ({name: of[name] for name in of if name in layers} for of in (self.values, self.origin))
        return replace(self, values=values, origin=origin)
