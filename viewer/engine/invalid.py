"""Pixels of a rendered frame that the pipeline cannot use, as a layer."""

from __future__ import annotations

import numpy as np

from gffe_cl.engine.frame.rendered_frame import BadPixels, RenderedFrame
from gffe_cl.engine.inspection.layers import FRAME_GROUP, LayerSpec

_KINDS = {  # by fields of `BadPixels`, each a bit of a mask
    "color": "its color is NaN or infinite, and counts as 0",
    "depth": "its depth is NaN, 0, negative or denormal, so it is left out",
    "motion": "its motion is NaN or infinite, so it is dynamic without history",
    "long": "its motion is longer than the image's diagonal, so it is dynamic without history",
}
INVALID = LayerSpec(
    "rendered.invalid",
    "Invalid pixels",
    FRAME_GROUP,
    "label",
    labels=((0, "valid"), (1, "color"), (2, "depth"), (4, "motion"), (8, "long motion")),
    description="pixels of the input that cannot be used, by what is wrong",
    grid="source",
)


def invalid_pixels(host: RenderedFrame, found: BadPixels) -> np.ndarray:
    """Return the mask of a rendered frame's invalid pixels, (H, W) uint8, a bit for each kind of fault; `found`: their
    counts."""
    mask = np.zeros(host.depth.shape, np.uint8)
    wrong = host.wrong if found else {}
    for bit, name in enumerate(_KINDS):
        if name in wrong:
            mask |= wrong[name].astype(np.uint8) << bit
    return mask


def fault_at(mask: np.ndarray | None, px: tuple[float, float] | None) -> str:
    """Return what is wrong with the pixel of a mask at this position, pixels; empty for a valid one, and outside."""
    if mask is None or px is None:
        return ""
    x, y = int(np.floor(px[0])), int(np.floor(px[1]))
    bits = int(mask[y, x]) if 0 <= x < mask.shape[1] and 0 <= y < mask.shape[0] else 0
    return "; ".join(text for bit, text in enumerate(_KINDS.values()) if bits >> bit & 1)
