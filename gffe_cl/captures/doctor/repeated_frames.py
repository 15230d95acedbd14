"""Frames that were recorded twice, and colors that were: equal to the bit although vectors move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding, frames_in_words
from gffe_cl.captures.doctor.hypotheses.sampling import PREVIOUS, Look

_MOVES = 0.3  # pixels: vectors by which nothing stays as it is
_TEXTURED, _COLORS = 0.1, 16  # share of samples that show a texture, and distinct colors, at least


@dataclass(frozen=True)
class RepeatedFrames:
    """Numbers of frames that repeat the frame before them: all of it, or its color alone; `count`: of all frames."""

    whole: list[int]
    color: list[int]
    count: int

    def findings(self) -> list[Finding]:
        found = []
        if self.whole:
            frames = frames_in_words(self.whole, "is", "are")
            found.append(finding("frames: recorded twice", {"frames": self.whole}, frames_are=frames))
        if self.color:
            is_open = self.color in ([1], [self.count - 1])  # so do colors that are all late, or early
            frames = frames_in_words(self.color, "has", "have")
            name = "color: of another frame" if is_open else "color: repeated"
            found.append(finding(name, {"frames": self.color}, frames_have=frames))
        return found


def repeated_frames(looks: dict[int, Look], count: int) -> RepeatedFrames:
    """Return the frames of `looks`, of `count` in all, that repeat the one before, as far as samples and cameras
    tell."""
    whole, color = [], []
    for index, look in looks.items():
        before = look.neighbors.get(PREVIOUS)
        if before is None or look.motion is None or not np.array_equal(look.color, before.color):
            continue
        if not np.nanmedian(np.linalg.norm(look.motion, axis=-1)) > _MOVES or not _shows_something(look):
            continue
        pairs = (look.depth, before.depth), (look.motion, before.motion)
        same = all(b is not None and np.array_equal(a, b, equal_nan=True) for a, b in pairs)
        (whole if same and look.camera == before.camera else color).append(index)
    return RepeatedFrames(whole, color, count)


def _shows_something(look: Look) -> bool:
    return bool(look.textured.mean() > _TEXTURED and len(np.unique(look.color, axis=0)) > _COLORS)
