"""Dilated motion vectors: pixels beside a nearer surface hold its vector."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.doctor.hypotheses.sampling import Clip
from gffe_cl.captures.sequence.post_effects import nearest_motion
from gffe_cl.engine.opencl.program import constants

_C = {name: np.float32(value) for name, value in constants("upload.cl").items()}
_NEAR, _APART = 0.25, 1.0  # of the difference of two surfaces' vectors, and its least length, pixels
_MOST = 3  # frames that are looked at
_FEWEST, _SHARE = 50, 0.7  # pixels that decide, and the share of them with the nearer surface's vector
_REACH = 2  # pixels from which dilation does not reach


def dilation_notes(clip: Clip, indices: list[int]) -> list[Finding]:
    """Return a note if motion vectors of `clip` are dilated. Frames `indices` are looked at. Raises GffeError if one
    cannot be read."""
    entries = clip.rendered
    counts = np.zeros(2, int)
    for k in [k for k in indices if k and not entries[k].reset][:_MOST]:
        frame = clip.read(entries[k])
        if frame.motion is not None:
            counts += count_beside_edges(np.asarray(frame.depth), np.asarray(frame.motion))
    dilated, total = counts.tolist()
    if total < _FEWEST or dilated < _SHARE * total:
        return []
    return [finding("motion: dilated", {"share": dilated / total}, share=dilated / total)]


def count_beside_edges(depth: np.ndarray, motion: np.ndarray) -> tuple[int, int]:
    """Return counts of pixels beside a nearer surface: those with its vector, and those with that or with the vector
    of their own surface `_REACH` pixels away, where the two differ. `depth` (H, W), `motion` (H, W, 2)."""
    height, width = depth.shape
    depth = np.asarray(depth, np.float32)
    around = nearest_motion(np.dstack([motion, depth]), depth)  # of the nearest of 3×3 pixels
    near_motion, nearest = around[..., :2], around[..., 2]
    with np.errstate(invalid="ignore"):
        beside = (depth > 0) & (nearest < _C["NEARER"] * depth)
        y, x = np.nonzero(beside)
        own, z = motion[y, x], depth[y, x]
        near = near_motion[y, x]
        dilated, undecided = 0, np.ones(len(y), bool)
        total = 0
        for step_y, step_x in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)):
            row, column = y + _REACH * step_y, x + _REACH * step_x
            use = undecided & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            row, column = np.where(use, row, 0), np.where(use, column, 0)
            other = depth[row, column]
            use &= np.where(np.isinf(z), np.isinf(other), np.abs(other - z) <= _C["SAME_SURFACE"] * z)
            far = motion[row, column]
            apart = np.linalg.norm(far - near, axis=-1)
            use &= ~beside[row, column] & (apart > _APART)
            of_near = use & (np.linalg.norm(own - near, axis=-1) < _NEAR * apart)
            of_far = use & (np.linalg.norm(own - far, axis=-1) < _NEAR * apart)
            dilated, total = dilated + int(of_near.sum()), total + int((of_near | of_far).sum())
            undecided &= ~(of_near | of_far)
    return dilated, total
