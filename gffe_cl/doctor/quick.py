"""The quick form: whether the first frames fit at all, for those who are about to extrapolate them."""

from __future__ import annotations

import numpy as np

from gffe_cl.doctor.evidence import Bench, moving, trimmed
from gffe_cl.doctor.motions import MotionReading
from gffe_cl.doctor.samples import PREVIOUS, Clip, take_looks
from gffe_cl.doctor.search import Reading, Search

_FRAMES = 3
_SAMPLES = 800  # of each frame
_FITS = 0.45  # share of samples that agree: movers may be the rest
_AGREES = 0.1  # of the motion's length
_LEAST = 0.75  # pixels: residuals that do no harm, those of vectors in whole pixels among them
_COLORS = 0.1  # of colour scores, by which no motion at all must fit better


def quick_warning(clip: Clip, exposure: float = 1.0) -> str | None:
    """A sentence if the first rendered frames of `clip` do not fit: motion vectors and depth with cameras, or motion
    vectors and colours. Raises GffeError if a frame cannot be read."""
    count = min(_FRAMES, len(clip.rendered))
    if count < 2:
        return None
    looks = take_looks(clip, range(count), _SAMPLES, set(range(count - 1)), exposure)
    pairs = [look for look in looks.values() if PREVIOUS in look.neighbours and look.motion is not None]
    if not pairs:
        return None
    bench = Bench(pairs)
    motion, static = Search.motions(Reading(), bench)
    use = bench.solid & np.isfinite(motion).all(-1)
    off = np.nan_to_num(np.linalg.norm(motion - static, axis=-1)[use], nan=np.inf)
    if len(off) < 16:
        return None
    near = max(_AGREES * float(np.median(np.linalg.norm(motion[use], axis=-1))), _LEAST)
    if (off <= near).mean() < _FITS:
        return f"motion vectors do not fit depth and cameras (median {np.median(off):.3g} px)"
    if _contradicted(bench, motion):
        return "motion vectors do not fit the colours"
    return None


def _contradicted(bench: Bench, motion: np.ndarray) -> bool:
    """Whether the colours are met better without any motion than along the vectors."""
    scores = bench.color_scores(np.stack([motion, np.zeros_like(motion)]), MotionReading().step)
    use = np.isfinite(scores).all(0) & moving(motion) & (np.linalg.norm(np.nan_to_num(motion), axis=-1) > 1)
    if use.sum() < 64:
        return False
    along, still = (trimmed(bench.by_frame(score, use)) for score in scores)
    return bool(still > along + _COLORS)
