"""Intervals between rendered frames, and how many of them ahead new frames are made (α)."""

from __future__ import annotations

from collections.abc import Sequence

HELD_ALPHA = 2.0  # intervals: `Pacer` holds the picture from there on, unless it is told otherwise
FAR_ALPHA = 16.0  # beyond, new frames are no longer closer to the truth than the last rendered one in every scene
MOST_ALPHA = 1e6  # beyond, none is made


def interval_of(times: Sequence[float], fps: float) -> float:
    """Return the seconds between the last two rendered frames since a reset, from their `times`, newest first; 1/fps
    where there are no two."""
    return times[0] - times[1] if len(times) > 1 else 1.0 / fps
