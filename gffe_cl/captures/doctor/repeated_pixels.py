"""Geometry that was rendered smaller than color, and made larger by repeating its pixels."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.doctor.hypotheses.sampling import Clip

_FRAMES = 3  # at most so many are looked at
_RATIOS = (4.0, 3.0, 2.0, 1.5)  # pixels of color for each one of geometry, each way
_FEWEST, _DIFFER = 8, 0.25  # lines that differ from the one before, and the share of them: others may be sky


def repeated_pixel_notes(clip: Clip, indices: list[int]) -> list[Finding]:
    """Return a note if the pixels of depth, or of motion vectors, are repeated in those of the frames `indices` of
    `clip` that are looked at. Raises GffeError if a frame cannot be read."""
    frames = [clip.read(clip.rendered[k]) for k in indices[:_FRAMES]]
    found = []
    for buffer in ("depth", "motion"):
        images = [np.asarray(image) for frame in frames if (image := getattr(frame, buffer)) is not None]
        sizes = {distinct_size(image) for image in images}
        size = sizes.pop() if len(sizes) == 1 else None
        if size is not None:
            height, width = images[0].shape[:2]
            figures = {"width": size[0], "height": size[1]}
            found.append(finding(f"{buffer}: repeated", figures, **figures, all=f"{width}×{height}"))
    return found


def distinct_size(image: np.ndarray) -> tuple[int, int] | None:
    """Return (width, height) of the smaller image whose pixels are repeated, evenly, in `image` (H, W[, C]); None if
    there is none."""
    bits = np.ascontiguousarray(image, np.float32).view(np.uint32).reshape(*image.shape[:2], -1)
    columns, rows = (bits[:, 1:] == bits[:, :-1]).all((0, 2)), (bits[1:] == bits[:-1]).all((1, 2))
    for ratio in _RATIOS:
        width, height = _distinct(columns, ratio), _distinct(rows, ratio)
        if width and height:
            return width, height
    return None


def _distinct(equal: np.ndarray, ratio: float) -> int:
    """Return how many lines there were before each was repeated `ratio` times; 0 if they were not. `equal` (N − 1,):
    whether a line is as the one before it."""
    source = (np.arange(len(equal) + 1) / ratio).astype(int)
    repeated = source[1:] == source[:-1]
    differ = np.count_nonzero(~equal & ~repeated)
    if not equal[repeated].all() or differ < max(_FEWEST, _DIFFER * np.count_nonzero(~repeated)):
        return 0
    return int(source[-1]) + 1
