"""Third pass: the order of frames. Cuts, gaps, frames that were recorded twice, and colors of another frame."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from gffe_cl.captures.doctor.findings import (
    Cut,
    Finding,
    FlippedInOneFrame,
    Gap,
    MisfitAtEnd,
    NeedlessResets,
    OffInOneFrame,
    OtherFrame,
    RepeatedColors,
    RepeatedFrames,
    TruthOfAnotherTime,
    UnevenTimes,
)
from gffe_cl.captures.doctor.readings import (
    GIVEN,
    NEXT,
    PREVIOUS,
    Clip,
    Look,
    Reading,
    of_other_frames,
    relinked,
    sampled,
    take_looks,
    turned,
)
from gffe_cl.captures.doctor.search import Bench, Search, Verdict
from gffe_cl.captures.sequence import FrameEntry, Sequence
from gffe_cl.captures.sequence.reader import read_ahead, uneven_intervals

_MOVES = 0.3  # pixels: vectors by which nothing stays as it is
_TEXTURED, _COLORS = 0.1, 16  # share of samples that show a texture, and distinct colors, at least
_FITTING, _LEAST = 0.5, 0.3  # share of samples that agree: of that in right pairs; in right pairs, at least
_AGREES, _FINEST = 0.1, 0.3  # of the motion's length, and pixels: residuals that agree
_SAME_SHOT = 0.7  # of the usual color scores
_COPIES, _NOISE = 3, 0.02  # copies of a frame in a row, at most; of encoded colors
_MOST = 12  # pairs that are looked at closely
_STALE = "it has the camera of the frame before"
_TRUTHS, _FEWEST, _CLEARLY = 40, 100, 0.6  # files that are read; samples, at least; error of the one at its own time
_FAR = 2.0  # pixels: vectors of which a half is told from the blur of sampling
_OTHER_TIMES = np.array([by for by in np.arange(-2, 2.01, 0.5) if by])  # intervals between rendered frames
_GAIN, _EACH, _GOOD = 0.06, 0.6, 1.2  # sums of color scores: gain by colors of another frame; frames; good ones


def repeated_frames(looks: dict[int, Look]) -> list[Finding]:
    """Return the frames of `looks` that repeat the one before, as far as samples and cameras tell: up to `_COPIES` in a
    row with its depth, camera and picture, but for noise, before and after which the camera moves."""
    copies, whole, color = {k for k, look in looks.items() if _is_copy(look)}, [], []
    runs: list[list[int]] = []
    for k in sorted(copies):
        runs[-1].append(k) if runs and runs[-1][-1] == k - 1 else runs.append([k])
    inner = [run for run in runs if NEXT in looks[run[-1]].neighbors and PREVIOUS in looks[run[0] - 1].neighbors]
    if any(len(run) <= _COPIES for run in inner):  # else the camera rests at first or at last
        whole = [k for run in runs if len(run) <= _COPIES for k in run]
    for index, look in looks.items():
        before = look.neighbors.get(PREVIOUS)
        if before is None or index in copies or look.motion is None or not np.array_equal(look.color, before.color):
            continue
        shows = look.textured.mean() > _TEXTURED and len(np.unique(look.color, axis=0)) > _COLORS
        if shows and np.nanmedian(np.linalg.norm(look.motion, axis=-1)) > _MOVES:
            color.append(index)
    made: list[Finding] = [RepeatedFrames(tuple(whole))] if whole else []
    return made + ([RepeatedColors(tuple(color))] if color and color not in ([1], [max(looks)]) else [])


def _is_copy(look: Look) -> bool:
    """Return whether a frame has depth and camera of the one before, and its picture but for noise."""
    before = look.neighbors.get(PREVIOUS)
    if before is None or look.camera != before.camera or not np.array_equal(look.depth, before.depth, equal_nan=True):
        return False
    return float(np.median(np.abs(look.color - before.color))) < _NOISE


def needless_resets(looks: dict[int, Look]) -> list[Finding]:
    """Return a fault if more than a quarter of the frames are resets although vectors, or depth and cameras, lead to
    the frame before and the picture moves."""
    found = []
    for k, look in looks.items():
        before = looks.get(k - 1)
        if before is None or not look.reset or look.size != before.size:
            continue
        pair = relinked({0: replace(before, index=0, neighbors={}), 1: replace(look, reset=False, neighbors={})})
        bench = Bench([pair[1]])
        static = bench.static(GIVEN.cameras, GIVEN.depth)
        moves = np.nanmedian(np.linalg.norm(static, axis=-1)[bench.solid]) > _MOVES if bench.solid.any() else False
        if look.motion is not None:
            fits = _share(pair[1], GIVEN, 0.0) > _FITTING
        else:
            along, still = (bench.color_scores(one, PREVIOUS) for one in (static, np.zeros_like(static)))
            fits = np.nanmean(along) > np.nanmean(still) + _GAIN if np.isfinite(along).any() else False
        if moves and fits:
            found.append(k)
    return [NeedlessResets(tuple(found))] if len(found) > max(1, len(looks) / 4) else []


def uneven_times(clip: Clip, left_out: set[int]) -> list[Finding]:
    """Return a note on rendered frames that do not come at the usual interval; `left_out`: frames that have a
    finding."""
    uneven, usual = uneven_intervals(clip.rendered)
    steps = {k: step for k, step in uneven.items() if k not in left_out}
    return [UnevenTimes(tuple(steps), usual, min(steps.values()), max(steps.values()))] if steps else []


def truth_of_another_time(clip: Clip, looks: dict[int, Look], left_out: set[int]) -> list[Finding]:
    """Return notes on ground truth between two of `looks` that clearly fits another time better: there its colors are
    those of the later frame along that frame's motion vectors, which are taken for steady. `left_out`: frames that
    have a finding."""
    times = [entry.time for entry in clip.rendered]
    pairs = [(bisect_right(times, truth.time), truth) for truth in getattr(clip, "ground_truth", ())]
    known = [(k, one) for k, one in pairs if k in looks and k not in left_out and PREVIOUS in looks[k].neighbors]
    found: dict[float, TruthOfAnotherTime] = {}
    for (k, truth), by in read_ahead(known[:: -(-len(known) // _TRUTHS) or 1], partial(_truth_is_off, clip, looks)):
        if by:
            one = found.get(by, TruthOfAnotherTime((), (), by))
            found[by] = replace(one, files=(*one.files, truth.file), frames=(*one.frames, k - 1))
    return [*found.values()]


def _truth_is_off(clip: Clip, looks: dict[int, Look], pair: tuple[int, FrameEntry]) -> float:
    """Return by how many intervals ground truth is of a later time; 0 where that is not clear."""
    (k, truth), sequence = pair, cast(Sequence, clip)
    look, before, image = looks[k], clip.rendered[k - 1], sequence.read_color(truth)
    camera, motion = truth.display_camera, look.motion
    if motion is None or image.shape[1::-1] != look.size or not camera or camera.intrinsics != look.camera.intrinsics:
        return 0.0
    moves = look.textured & look.solid & (np.linalg.norm(motion, axis=-1) > _FAR)
    alpha = (truth.time - before.time) / (clip.rendered[k].time - before.time)

    def error(at: float) -> float:
        there, inside = sampled(replace(look, image=image), (look.px + (1 - at) * motion)[moves])
        off = np.abs(there - look.color[moves]).mean(-1)[inside]
        return float(np.median(off)) if len(off) > _FEWEST else np.inf

    others = alpha + _OTHER_TIMES
    best = min(others, key=error)
    return float(round(best - alpha, 2)) if error(best) < _CLEARLY * error(alpha) else 0.0


def color_of_another_frame(search: Search, read: Verdict) -> list[Finding]:
    """Return a fault if colors fit well, and clearly better in most frames, as those of the frame before or after."""
    found, reading = {}, read.reading
    for by in (NEXT, PREVIOUS):
        if not search.chosen(reading.rows, ("color", by)):
            continue
        other = search.bench(reading.rows, ("color", by))
        given = Bench([look for look in search.shown(reading.rows, [one.index for one in other.looks])])
        after, before = _colors(other, reading), _colors(given, reading)
        known = np.isfinite(after) & np.isfinite(before)
        gains = (after - before)[known]
        if len(gains) > 1 and gains.mean() > _GAIN and np.mean(gains > 0) > _EACH and after[known].mean() > _GOOD:
            found[by] = float(gains.mean())
    return [OtherFrame("color", max(found, key=found.__getitem__))] if found else []


def _colors(bench: Bench, reading: Reading) -> np.ndarray:
    """Return the agreement (looks,) of colors along vectors and along depth and cameras."""
    made = []
    for motion in (bench.motion(reading.motion), bench.static(reading.cameras, reading.depth)):
        score = bench.color_scores(motion, PREVIOUS)
        made.append(bench.by_frame(score, np.isfinite(score) & bench.solid))
    return np.sum(made, 0)


def breaks(
    clip: Clip, looks: dict[int, Look], reading: Reading, step: float, left_out: set[int], exposure: float, samples: int
) -> list[Finding]:
    """Return findings on frames that do not follow the one before them although most pairs fit `reading`. `looks`: of
    all frames that are looked at; `step`: of quantized vectors, pixels; `left_out`: frames that have a finding."""
    if reading.motion.camera != "included" or reading.motion.to_next:
        return []
    shown = of_other_frames(looks, *reading.offset) if reading.offset[1] else looks
    fits = {k: _share(look, reading, step) for k, look in shown.items() if PREVIOUS in look.neighbors}
    known = [share for k, share in fits.items() if np.isfinite(share) and k not in left_out]
    usual = float(np.median(known)) if known else 0.0
    if usual < _LEAST:
        return []
    last, found = max(looks), []
    misfits = [k for k, share in fits.items() if share < _FITTING * usual and k not in left_out]
    stale = {k for k in misfits if shown[k].camera == shown[k].neighbors[PREVIOUS].camera}
    right = [k for k in fits if k not in misfits]
    misfits = [k for k in misfits if k - 1 not in stale]  # those come from a wrong place
    for k in misfits[:_MOST]:
        near = min(right, key=lambda other: abs(other - k))
        usual_colors = _along_both(clip, near, reading, exposure, samples)
        vectors, cameras = _along_both(clip, k, reading, exposure, samples)
        follows = vectors > _SAME_SHOT * usual_colors[0], cameras > _SAME_SHOT * usual_colors[1]
        if all(follows):
            follows = vectors > cameras, cameras > vectors
        file = shown[k].file
        motion = shown[k].motion
        moving = motion is not None and np.nanmedian(np.abs(motion)) > 0
        if len(misfits) == 1 and k in (1, last) and (follows[0] or follows[1]):
            found.append(MisfitAtEnd(k, file))
        elif follows[0] and not follows[1]:
            found.append(OffInOneFrame(k, file, _STALE if k in stale else OffInOneFrame.why))
        elif follows[1] and moving:
            axes = _flipped(shown[k], reading, step, _FITTING * usual)
            found.append(FlippedInOneFrame(k, file, axes) if axes else Gap(k, file))
        else:
            found.append(Cut(k, file))
    return found


def _share(look: Look, reading: Reading, step: float) -> float:
    """Return the share of samples whose motion agrees with depth and cameras; NaN without motion."""
    bench = Bench([look])
    motion = bench.motion(reading.motion)
    use = bench.solid & np.isfinite(motion).all(-1)
    if use.sum() < 16:
        return float("nan")
    if reading.rows == "up":
        bench = Bench([_upside_down(look)])
    off = np.linalg.norm(bench.static(reading.cameras, reading.depth) - motion, axis=-1)[use]
    scale = np.median(np.linalg.norm(motion[use], axis=-1))
    return float((off <= max(_AGREES * scale, _FINEST, step)).mean())


def _flipped(look: Look, reading: Reading, step: float, least: float) -> str:
    """Return the components of motion, x, y or both, with whose signs changed at least so many samples agree; empty
    without any."""
    signs, motion = {"y": (1, -1), "x": (-1, 1), "x and y": (-1, -1)}, look.motion
    if motion is None:
        return ""
    shares = {axes: _share(replace(look, motion=motion * by), reading, step) for axes, by in signs.items()}
    best = max(shares, key=lambda axes: shares[axes])
    return best if shares[best] > least else ""


def _upside_down(look: Look) -> Look:
    return turned({0: replace(look.neighbors[PREVIOUS], index=0), 1: replace(look, index=1, reset=False)})[1]


def _along_both(clip: Clip, k: int, reading: Reading, exposure: float, samples: int) -> np.ndarray:
    """Return the agreement (2,) of colors of frame `k` with the one before, along vectors and along depth and
    cameras."""
    beside = {n for n in (k - 1, k, k + 1) if 0 <= n < len(clip.rendered)}
    pair = take_looks(clip, beside, samples, beside, exposure)
    if reading.offset[1]:
        pair = of_other_frames(pair, *reading.offset)
    if reading.rows == "up":
        pair = turned(pair)
    if k not in pair or PREVIOUS not in pair[k].neighbors:
        return np.zeros(2)
    bench, found = Bench([pair[k]]), []
    for motion in (bench.motion(reading.motion), bench.static(reading.cameras, reading.depth)):
        score = bench.color_scores(motion, PREVIOUS)
        use = bench.solid & np.isfinite(score)
        found.append(score[use].mean() if use.any() else 0.0)
    return np.array(found)
