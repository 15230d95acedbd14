"""Jitter of depth under color that has none: edges of depth move against edges of color."""

from __future__ import annotations

import numpy as np

from gffe_cl.captures.doctor.findings import Finding, finding
from gffe_cl.captures.doctor.hypotheses.sampling import Clip, encoded
from gffe_cl.engine.frame.rendered_frame import RenderedFrame

_NEARER, _EVEN = 0.9, 1.05  # of depth: what is nearer is another surface; most change within one
_FLAT, _CONTRAST = 0.1, 0.1  # of the colors' difference at an edge: most change beside it; and its least length
_FEWEST_FRAMES, _FEWEST = 3, 30  # edges of each direction
_MOVES = 0.15  # pixels, standard deviation from frame to frame


def geometry_jitter_notes(clip: Clip, indices: list[int], exposure: float, is_jittered: bool) -> list[Finding]:
    """Return a note if depth in frames `indices` of `clip` is jittered and color is not, although no frame says so.
    `is_jittered`: whether vectors or cameras show that something is. Raises GffeError if a frame cannot be read."""
    frames = [clip.read(clip.rendered[k]) for k in indices]
    if any(any(frame.geometry_jitter) for frame in frames):
        return []
    found = [(frame, shift) for frame in frames if (shift := edge_shift(frame, exposure)) is not None]
    if len(found) < _FEWEST_FRAMES:
        return [finding("depth: jittered/unclear")] if is_jittered else []
    size = float(np.linalg.norm(np.std([shift for _, shift in found], 0)))
    if size < _MOVES:
        return []
    camera = np.array([(frame.camera.cx, frame.camera.cy) for frame, _ in found])
    where = "out of the cameras and into" if np.linalg.norm(camera.std(0)) > _MOVES / 2 else "into"
    return [finding("depth: jittered", {"size": size}, size=size, where=where)]


def edge_shift(frame: RenderedFrame, exposure: float) -> np.ndarray | None:
    """Return how far edges of color lie to the right of and below those of depth, (2,) pixels, in the mean of all clear
    edges; None if there are few. A jitter of depth by j shifts them by −j/2 to −j: of mixed colors the
    brighter one counts more."""
    color = encoded(np.asarray(frame.color)[..., :3], exposure)
    depth = np.asarray(frame.depth, np.float32)
    means = []
    for image, z in ((color, depth), (color.swapaxes(0, 1), depth.T)):
        for sign in (1, -1):  # near surfaces before and behind the edge
            shifts = _shifts(image[:, ::sign], np.where(z > 0, z, np.inf)[:, ::sign])
            if len(shifts) < _FEWEST:
                return None
            means.append(sign * shifts.mean())
    return np.array([means[0] + means[1], means[2] + means[3]]) / 2


def _shifts(color: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return how far the nearer color (H, W, 3) reaches beyond edges of depth (H, W), each between three nearer and
    three farther pixels of a row, in pixels: (N,). The colors beside an edge must be flat and differ."""
    count = max(depth.shape[1] - 5, 0)
    z, c = ([array[:, k : k + count] for k in range(6)] for array in (depth, color))
    near, far = np.max(z[:3], 0), np.min(z[3:], 0)
    with np.errstate(invalid="ignore"):
        edges = np.isfinite(near) & (near < _NEARER * far) & (near < _EVEN * np.min(z[:3], 0))
    before, two_before, *mixed, two_behind, behind = (image[edges] for image in c)
    change = before - behind
    squared = np.square(change).sum(-1)
    clear = squared > _CONTRAST**2
    for one, other in ((before, two_before), (behind, two_behind)):
        clear &= np.square(one - other).sum(-1) < _FLAT**2 * squared
    shares = [((one - behind) * change).sum(-1)[clear] / squared[clear] for one in mixed]
    return np.clip(shares, 0, 1).sum(0) - 1
