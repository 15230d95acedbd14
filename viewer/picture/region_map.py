"""Which region of errors each pixel of a generated slot belongs to, found beside the interface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.metrics import display_values, squared_error
from gffe_cl.viewer.engine import names
from gffe_cl.viewer.engine.figures import REGIONS, Part, parts_of, region_labels
from gffe_cl.viewer.engine.layers import LayerSpec
from gffe_cl.viewer.engine.messages import Result

NAME = "regions"
SPEC = LayerSpec(
    NAME, "Regions", "compare", "label", labels=tuple(enumerate(REGIONS)), description="where errors are counted"
)


@dataclass(frozen=True)
class RegionMap:
    """`labels`: (H, W) uint8, indices into `REGIONS`, as A's pipeline finds them; the parts of A's error in them, and
    of B's, if it is there."""

    labels: np.ndarray
    a: dict[str, Part]
    b: dict[str, Part] | None = None


def region_map(result: Result, b: np.ndarray | None, exposure: float) -> RegionMap:
    """Of a generated slot of A with the layers `figures.NEEDED`, and B's final colours (H, W, 4) of the same slot."""
    labels = region_labels(result, exposure)
    true = display_values(result.images[names.TRUTH][..., :3], exposure)
    parts = [
        None if color is None else parts_of(labels, squared_error(display_values(color[..., :3], exposure), true))
        for color in (result.images[names.FINAL], b)
    ]
    return RegionMap(labels, *parts)
