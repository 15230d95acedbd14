"""Comparison of silhouettes: where the depth jumps from one surface to another, colors change as well if rows match."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.hypotheses.sampling import Look, encoded

_STEP = 5  # a silhouette's depths are so many times as far apart as those along one side
_LEAST = 150  # least number of clear silhouettes per image
_PIXELS = 200_000  # of an image are looked at, in whole lines
_SILENT = 0.08  # agreement below this may be chance


def lines_of(look: Look) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return (color, color upside down, depth) of lines across the image of `look`, and of lines down."""
    assert look.image is not None and look.deep is not None  # kept of the looks that are asked for
    image, deep = look.image, np.nan_to_num(look.deep, posinf=0.0, neginf=0.0)
    every = max(1, deep.size // _PIXELS)
    across = image[::every], image[::-1][::every], deep[::every]
    down = (array[:, ::every].swapaxes(0, 1) for array in (image, image[::-1], deep))
    turned, upside_down, depths = down
    return [across, (turned, upside_down, depths)]


def silhouettes(depth: np.ndarray) -> np.ndarray:
    """Return (H, W − 4) bool: of every five pixels in a line, whether the first two and the last two show two surfaces,
    whatever the depth means."""
    first, second, _, fourth, fifth = (depth[:, k : depth.shape[1] - 4 + k] for k in range(5))
    along = np.maximum(np.abs(second - first), np.abs(fifth - fourth))
    apart = np.abs(fourth - second)
    return (apart > _STEP * along) & (apart > 1e-6 * np.abs(second + fourth))


def edge_agreement(looks: list[Look]) -> float:
    """Return how much better color edges match silhouettes than they would upside down, from −1 to 1. Below 0 color
    and depth have different row orders. 0 without enough evidence."""
    found = []
    for look in looks:
        if look.image is None or min(look.size) < 8:
            continue
        changes, count = np.zeros(2), 0
        for *colors, depth in lines_of(look):
            at = silhouettes(depth)
            count += int(at.sum())
            for k, color in enumerate(colors):
                before, after = (encoded(side[at], look.exposure) for side in (color[:, 1:-3], color[:, 3:-1]))
                changes[k] += np.abs(after - before).mean(-1).sum()
        if count >= _LEAST and changes.sum() > 0:
            found.append((changes[0] - changes[1]) / changes.sum())
    agreement = float(np.median(found)) if found else 0.0
    return agreement if abs(agreement) > _SILENT else 0.0
