"""Invalid pixels of the input: NaN, infinity and other values that the pipeline replaces or leaves out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_KINDS = {  # by fields of `BadPixels`, each a bit of a mask
    "color": "its color is NaN or infinite, and counts as 0",
    "depth": "its depth is NaN, 0, negative or denormal, so it is left out",
    "motion": "its motion is NaN or infinite, so it is dynamic without history",
    "long": "its motion is longer than the image's diagonal, so it is dynamic without history",
}


@dataclass(frozen=True)
class Invalid:
    """Masks (H, W) uint8 with a bit for each fault: of the `rendered` image, and of the `shown` one where these pixels
    are seen."""

    rendered: np.ndarray
    shown: np.ndarray


def invalid_pixels(host: RenderedFrame) -> np.ndarray | None:
    """Return the mask of a rendered frame's invalid pixels, (H, W) uint8; None if all are valid."""
    mask = np.zeros(host.depth.shape, np.uint8)
    wrong = host.wrong
    for bit, name in enumerate(_KINDS):
        if name in wrong:
            mask |= wrong[name].astype(np.uint8) << bit
    return mask if mask.any() else None


def fault_at(mask: np.ndarray | None, px: tuple[float, float] | None) -> str:
    """Return what is wrong with the pixel of a mask at this position, pixels; empty for a valid one, and outside."""
    if mask is None or px is None:
        return ""
    x, y = int(np.floor(px[0])), int(np.floor(px[1]))
    bits = int(mask[y, x]) if 0 <= x < mask.shape[1] and 0 <= y < mask.shape[0] else 0
    return "; ".join(text for bit, text in enumerate(_KINDS.values()) if bits >> bit & 1)


def seen_through(mask: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return `mask` as a generated frame shows it: at each pixel that of the rendered one that its `motion` (H, W, 2),
    pixels, leads to."""
    height, width = motion.shape[:2]
    with np.errstate(invalid="ignore"):
        x = np.floor(motion[..., 0] + np.arange(0.5, width, dtype=np.float32))
        y = np.floor(motion[..., 1] + np.arange(0.5, height, dtype=np.float32)[:, None])
        inside = (x >= 0) & (x < mask.shape[1]) & (y >= 0) & (y < mask.shape[0])
    at = np.where(inside, y * np.float32(mask.shape[1]) + x, 0).astype(np.int64)
    return np.where(inside, mask.ravel()[at], np.uint8(0))


def seen_at(
    mask: np.ndarray, size: tuple[int, int], place: Callable[[float, float], tuple[float, float]]
) -> np.ndarray:
    """Return `mask` as a rendered frame of `size` pixels shows it; `place` gives the position in the rendered image of
    a displayed one."""
    (x0, y0), (x1, y1) = place(0.5, 0.5), place(1.5, 1.5)
    x = np.floor(x0 + (x1 - x0) * np.arange(size[0])).astype(int)
    y = np.floor(y0 + (y1 - y0) * np.arange(size[1])).astype(int)
    inside = ((y >= 0) & (y < mask.shape[0]))[:, None] & ((x >= 0) & (x < mask.shape[1]))
    return mask[np.clip(y, 0, mask.shape[0] - 1)][:, np.clip(x, 0, mask.shape[1] - 1)] * inside
