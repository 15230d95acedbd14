"""The quick form: whether the first frames fit at all, for those who are about to extrapolate them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gffe_cl.core.validation import require_exposure, require_list
from gffe_cl.doctor.evidence import set_aside_unwritten, too_few_usable
from gffe_cl.doctor.findings import FAULT
from gffe_cl.doctor.hypotheses.edges import edge_agreement
from gffe_cl.doctor.hypotheses.sampling import BUFFERS, PREVIOUS, Clip, Look, take_looks, with_rows
from gffe_cl.doctor.hypotheses.scoring import Bench, moving, trimmed
from gffe_cl.doctor.hypotheses.search import Reading, Search
from gffe_cl.doctor.quantization import largest_step, motion_steps
from gffe_cl.frame.rendered_frame import RenderedFrame, host_arrays
from gffe_cl.sequence import FrameEntry

_FRAMES = 3
_SAMPLES = 800  # of each frame
_FITS = 0.45  # share of samples that agree: movers may be the rest
_AGREES = 0.1  # of the motion's length
_LEAST = 0.75  # pixels: residuals that do no harm
_COLORS = 0.1  # of color scores, by which no motion at all must fit better
_TURNED = 0.15  # of the share of samples and the color score, by which buffers must fit better upside down
_FEWEST = 64  # least number of samples with distinctive colors
_UPSIDE_DOWN = {(buffer,): f"{buffer} is upside down against the other buffers" for buffer in BUFFERS} | {
    BUFFERS: "y of motion vectors and cameras does not fit the rows of the buffers",
}


@dataclass
class _Fit:
    """`off` (N,): residuals in pixels; `share` of those that agree; `along`, `still`: color scores along the vectors
    and without any motion, NaN without evidence; `edges`: agreement of colors with depth at silhouettes."""

    off: np.ndarray
    share: float
    along: float
    still: float
    edges: float

    @property
    def score(self) -> float:
        return self.share + float(np.nan_to_num(self.along)) + self.edges


def check(frames: list[RenderedFrame], exposure: float = 1.0) -> str | None:
    """A sentence if rendered frames in memory do not fit, else None: motion vectors and depth with cameras, motion
    vectors and colors, or a buffer that is upside down. It is the quick form of `gffe check`: the first three frames
    count.

        assert gffe.check([first, second, third]) is None

    `frames`: in order of time, with NumPy arrays; `exposure`: factor on colors before display. GffeError for anything
    that is no such frame.
    """
    frames = require_list(frames, RenderedFrame, "check: frames", "a list of RenderedFrame")
    return quick_warning(_InMemory(frames[:_FRAMES]), require_exposure(exposure))


class _InMemory:
    """A clip of frames in memory."""

    def __init__(self, frames: list[RenderedFrame]):
        for frame in frames:
            host_arrays(frame)
        self._frames = {f"frame {k}": frame for k, frame in enumerate(frames)}
        self.rendered = [FrameEntry(name, frame.time, reset=frame.reset) for name, frame in self._frames.items()]

    def read(self, entry: FrameEntry) -> RenderedFrame:
        return self._frames[entry.file]


def quick_warning(clip: Clip, exposure: float = 1.0) -> str | None:
    """A sentence if the first rendered frames of `clip` do not fit: motion vectors and depth with cameras, motion
    vectors and colors, or a buffer that is upside down. Raises GffeError if a frame cannot be read."""
    count = min(_FRAMES, len(clip.rendered))
    if not count:
        return None
    looks = take_looks(clip, range(count), _SAMPLES, set(range(count - 1)), exposure)
    set_aside_unwritten(looks.values())
    for finding in too_few_usable(looks.values()):
        if finding.kind == FAULT:
            return str(finding)
    if count < 2:
        return None
    edges = edge_agreement([looks[0]])
    given = _fit(looks, edges)
    if given is None:
        return None
    turned = {}
    for rows in _UPSIDE_DOWN:
        fit = _fit(with_rows(looks, rows), edges if len(rows) > 1 or "motion" in rows else -edges)
        assert fit is not None  # as there is one of the same frames as given
        turned[rows] = fit.score
    best = max(turned, key=turned.__getitem__)
    if turned[best] > given.score + _TURNED:
        return _UPSIDE_DOWN[best]
    if given.share < _FITS:
        return f"motion vectors do not fit depth and cameras (median {np.median(given.off):.3g} px)"
    if given.still > given.along + _COLORS:
        return "motion vectors do not fit the colors"
    return None


def _fit(looks: dict[int, Look], edges: float) -> _Fit | None:
    """Return None if there is nothing to compare."""
    pairs = [look for look in looks.values() if PREVIOUS in look.neighbors and look.motion is not None]
    if not pairs:
        return None
    bench = Bench(pairs)
    motion, static = Search.motions(Reading(), bench)
    use = bench.solid & np.isfinite(motion).all(-1)
    off = np.nan_to_num(np.linalg.norm(motion - static, axis=-1)[use], nan=np.inf)
    if len(off) < 16:
        return None
    length, step = float(np.median(np.linalg.norm(motion[use], axis=-1))), largest_step(motion_steps(pairs))
    near = max(_AGREES * length, _LEAST, step)
    scores = bench.color_scores(np.stack([motion, np.zeros_like(motion)]), PREVIOUS)
    telling = np.isfinite(scores).all(0) & moving(motion) & (np.linalg.norm(np.nan_to_num(motion), axis=-1) > 1)
    along = still = float("nan")
    if telling.sum() >= _FEWEST:
        along, still = (trimmed(bench.by_frame(score, telling)) for score in scores)
    return _Fit(off, float((off <= near).mean()), along, still, edges)
