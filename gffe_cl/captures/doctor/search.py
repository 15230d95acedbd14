"""Second pass: changes of motion vectors, depth and cameras, ranked by the residual of vectors against depth and
cameras; colors decide between those that leave the same residual.

Samples of several frames lie one after the other: `Bench`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from gffe_cl.captures.doctor.findings import Ambiguous, Finding, JitterDiffers, Unexplained
from gffe_cl.captures.doctor.readings import (
    DISTANCE,
    GIVEN,
    LAWS,
    LINEAR,
    NEXT,
    PREVIOUS,
    Cameras,
    Depth,
    Look,
    Motion,
    Reading,
    cameras,
    fit_depth,
    motions,
    of_other_frames,
    rays,
    sampled,
    turned,
)

_STILL = 0.05  # share of the usual motion: samples with less are no evidence on motion vectors
_CHANCE = 0.2  # color score where nothing is known
_FEWEST_OFFSETS = 16  # samples
_SMALLEST = 0.02  # pixels: the unit of visible errors


@dataclass
class Reach:
    """Samples seen from the frame that motion leads to, after the camera's rotation and its translation.

    `turned` (N, 3): rays after the rotation; `shift` (N, 3): translation in view space of the other frame; `focal`,
    `center` (N, 2): of its camera, pixels; `ray` (N, 3): before the rotation.
    """

    ray: np.ndarray
    turned: np.ndarray
    shift: np.ndarray
    focal: np.ndarray
    center: np.ndarray

    def pixels(self, w: np.ndarray) -> np.ndarray:
        """Return pixel positions (N, 2) of static points at 1 / depth `w` (N,); NaN behind the camera."""
        v = self.turned + w[:, None] * self.shift
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            at = v[:, :2] / v[:, 2:] * self.focal + self.center
        at[~(v[:, 2] > 1e-6)] = np.nan
        return at

    def equations(self, px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a, b (N, 2) with a · w = b for points that are seen at `px`: their differences are in pixels at depth
        1."""
        u = (px - self.center) / self.focal
        a = u * self.shift[:, 2:] - self.shift[:, :2]
        b = self.turned[:, :2] - u * self.turned[:, 2:]
        return a * self.focal, b * self.focal


class Bench:
    """Samples of several looks, one after the other, every `thin`-th of each."""

    def __init__(self, looks: list[Look], thin: int = 1):
        self.looks, self._thin = looks, thin
        self._counts = [len(look.px[::thin]) for look in looks]
        self.frame = np.repeat(np.arange(len(looks)), self._counts)
        self.px, self.stored, self.solid, self.color, self.contrast, self.textured = (
            np.concatenate([getattr(look, name)[::thin] for look in looks])
            for name in ("px", "depth", "solid", "color", "contrast", "textured")
        )
        self._reaches: dict = {}
        self._motions: dict = {}
        self._scales: dict = {}

    @cached_property
    def has(self) -> dict[int, np.ndarray]:
        """Masks {step → (N,) bool} of samples that have a frame in that direction."""
        return {s: np.repeat([s in look.neighbors for look in self.looks], self._counts) for s in (PREVIOUS, NEXT)}

    def motion(self, reading: Motion) -> np.ndarray:
        """Return motion (N, 2) in pixels; NaN where the file has none."""
        if reading not in self._motions:
            found = []
            for look, count in zip(self.looks, self._counts, strict=True):
                v = reading.pixels(look)
                found.append(np.full((count, 2), np.nan) if v is None else v[:: self._thin])
            self._motions[reading] = np.concatenate(found)
        return self._motions[reading]

    def reach(self, reading: Cameras, step: int) -> Reach:
        key = reading, step
        if key not in self._reaches:
            self._reaches[key] = self._new_reach(reading, step)
        return self._reaches[key]

    def _new_reach(self, reading: Cameras, step: int) -> Reach:
        parts: tuple = ([], [], [], [], [])
        for look in self.looks:
            px = look.px[:: self._thin]
            other = look.neighbors.get(step, look)
            here, there = reading.read(look.camera, look.jitter), reading.read(other.camera, other.jitter)
            m, ray = here.to_view_of(there), rays(here, px)
            values = (ray, ray @ m[:3, :3].T, m[:3, 3], (there.fx, there.fy), (there.cx, there.cy))
            for part, value in zip(parts, values, strict=True):
                part.append(np.broadcast_to(value, (len(px), np.shape(value)[-1])))
        return Reach(*(np.concatenate(part) for part in parts))

    def static(self, cameras: Cameras, depth: Depth, step: int = PREVIOUS) -> np.ndarray:
        """Return the motion (N, 2), in pixels, of every sample if nothing but the camera moves; NaN where that is
        unknown."""
        reach = self.reach(cameras, step)
        moved = reach.pixels(depth.inverse(self.stored, reach.ray)) - self.px
        return np.where(self.has[step][:, None], moved, np.nan)

    def parts(self, chosen: np.ndarray) -> list[np.ndarray]:
        """Return the `chosen` samples (N,) of each look, as masks of all samples."""
        return [chosen & (self.frame == k) for k in range(len(self.looks))]

    def by_frame(self, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return the mean (looks,) of the chosen `values` (N,); NaN where there are few."""
        count = np.bincount(self.frame[chosen], minlength=len(self.looks))
        total = np.bincount(self.frame[chosen], values[chosen], minlength=len(self.looks))
        return np.where(count >= 8, total / np.maximum(count, 1), np.nan)

    def color_scores(self, motion: np.ndarray, step: int) -> np.ndarray:
        """Return (N,) the agreement of colors along `motion` (N, 2): 1 for equal ones, NaN without evidence."""
        score = np.full(len(motion), np.nan)
        for k, look in enumerate(self.looks):
            other = look.neighbors.get(step)
            use = (self.frame == k) & self.textured
            if other is None or other.image is None or not use.any():
                continue
            met, inside = sampled(other, self.px[use] + np.nan_to_num(motion[use], nan=1e9))
            off = np.abs(met - self.color[use]).mean(-1) / self.contrast[use]
            score[use] = np.where(inside, 1 / (1 + (off / 0.25) ** 2), _CHANCE)
        return score

    def colors_along(self, motion: np.ndarray, score: np.ndarray) -> float:
        """Return the mean `score` (N,) of colors along `motion` (N, 2), where it moves; NaN without evidence."""
        return trimmed(self.by_frame(score, np.isfinite(score) & _moving(motion)))

    def scale(self, reading: Motion, step: float) -> tuple[float, float]:
        """Return the coarsest and the finest residuals that are evidence, in pixels. Frames in which nearly nothing
        moves do not count. `step`: of quantized vectors."""
        if (reading, step) not in self._scales:
            self._scales[reading, step] = self._new_scale(reading, step)
        return self._scales[reading, step]

    def _new_scale(self, reading: Motion, step: float) -> tuple[float, float]:
        length = np.linalg.norm(self.motion(reading), axis=-1)
        known = np.isfinite(length)
        usual = np.array([np.median(length[part]) if part.any() else 0.0 for part in self.parts(known)])
        known &= (usual >= _STILL * usual.max())[self.frame]
        scale = max(float(np.median(length[known])) if known.any() else 0.0, _SMALLEST)
        return max(0.5 * scale, 2 * step), max(0.005 * scale, 0.5 * step)

    def offsets(self, off: np.ndarray, use: np.ndarray) -> np.ndarray:
        """Return the common offset (looks, 2) of most of `off` (N, 2) in each frame: the center of the densest
        region."""
        found = np.zeros((len(self.looks), 2))
        for k, part in enumerate(self.parts(use & np.isfinite(off).all(-1))):
            values = off[part]
            if len(values) < _FEWEST_OFFSETS:
                continue
            center = np.median(values, 0)
            for _ in range(8):
                apart = ((values - center) ** 2).sum(-1)
                weight = 1 / (1 + apart / max(float(np.quantile(apart, 0.4)), 1e-8)) ** 2
                center = weight @ values / weight.sum()
            found[k] = center
        return found


def trimmed(by_frame: np.ndarray) -> float:
    """Return the mean over frames without the worst third, because a few frames may have other faults; NaN without
    frames."""
    values = np.sort(by_frame[np.isfinite(by_frame)])
    return float(values[len(values) // 3 :].mean()) if len(values) else float("nan")


def _moving(motion: np.ndarray) -> np.ndarray:
    """Return the mask (N,) bool of samples whose motion is not zero."""
    length = np.linalg.norm(np.nan_to_num(motion), axis=-1)
    return length > _STILL * np.quantile(length, 0.95) if length.any() else np.zeros(len(length), bool)


def log_score(residual: np.ndarray, coarsest: float, finest: float) -> np.ndarray:
    """Return the score of residuals (pixels): 1 up to `finest`, 0 from `coarsest` on, logarithmic between; 0 for
    NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.log(coarsest / np.maximum(residual, finest)) / np.log(coarsest / finest)
    return np.nan_to_num(np.clip(score, 0, 1))


_PER_FRAME = 120  # samples of a frame on which all readings are compared
_PAIRS, _READINGS = 24, 10  # of motion and cameras whose depth is fitted; and readings that are judged on all samples
_GOOD, _RATHER_GOOD = 0.9, 0.8  # agreements that leave nothing to explain, or at most a buffer of another frame
_MARGIN, _ALIKE = 0.1, 0.04  # of agreements: least gain of a change, and difference that does not tell two apart
_WORSE_COLORS, _SAME_COLORS = 0.05, 0.015  # of color scores
_SAME_UNIT = 0.02  # units of depth that differ by less are one
_NEAR, _CLOSE, _LEAST = (0.1, 0.3), (0.05, 0.1), 0.4  # of motion, and pixels: residuals that agree; share of samples
_SOUND = 0.7  # share of samples that agree in any sound capture, and so after a repair
_BETTER = 0.8  # of a frame's residual as given
_RANGES, _FEWEST = 8, 24  # of depths; samples
_OFF, _MOST_OFF = (0.05, 0.1), 0.25  # of depth and pixels; share of samples
_STRICT = (0.2, 0.04)  # times these errors, of laws that are fitted, and of logarithms, which describe many roughly
_EXACT = 0.01, 0.02  # of the motion by depth, and pixels: usual error of a law that is fitted
_ALONG = 0.5  # of the error along epipolar lines: most error across them where depth is wrong
_HALVES = ((0.2, 0.55), (0.5, 0.95))  # share of samples that agree in one half of the picture, and in the other one
_MOST_WITH_ROWS = 2  # changes, if rows are one of them: a mirror image always fits as well
_JITTER, _MOST_JITTER, _ALTERNATES = 0.08, 1.6, 0.8  # pixels; and of the mean offset of a frame: of all together
_VISIBLE, _SEEN, _NOTHING, _MOVER = 0.3, 0.2, 2e-3, 0.05  # pixels; share; of the longest vectors
_MOST_HELD = 0.9  # of the samples: more of them are a picture that does not move
_TINY, _GARBAGE = 1e-7, 0.05  # pixels, not 0, as of numbers that are no vectors; share of the samples
_GAIN = 0.012  # of color scores, where they are the only evidence
_FOCALS, _LAST_STEP, _SAME_FOCAL, _SHARP = (
    np.geomspace(0.5, 2, 29),
    2e-4,
    0.004,
    0.05,
)  # factors; of their logarithm; residuals
_SKY, _AWAY, _FAR, _ABOVE, _SURE = 0.02, 0.1, 0.7, 0.04, 0.2  # shares of samples and of the image's height


@dataclass
class Verdict:
    """Evidence for a reading. `agreement` of vectors with depth and cameras and `color` along both, from 0 to 1;
    `median`: residual, pixels; `share` of the samples that agree; `fits`: whether the residual is within its threshold;
    `where`: the part of the picture that does not fit; `by_frame`: residuals of static points, pixels."""

    reading: Reading
    agreement: float
    color: float
    median: float
    share: float
    fits: bool
    where: str = ""
    by_frame: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)


@dataclass
class Outcome:
    """Result of the search: `findings`, the `reading` that they describe, and verdicts on the frames as given and as
    read."""

    findings: list[Finding]
    reading: Reading
    given: Verdict
    read: Verdict


class Search:
    """Search over readings of `looks`, of which `deep` are compared with the frames beside them. `step`: of quantized
    motion vectors, pixels, or 0. `undilated`: whether vectors were undilated, which leaves few where cameras are
    wrong."""

    def __init__(self, looks: dict[int, Look], deep: list[int], step: float, undilated: bool):
        self.looks, self.deep, self._step = looks, deep, step
        self._sound = _LEAST if undilated else _SOUND
        self._jittered = any(look.shift.any() for look in looks.values())
        self.bench = lru_cache(None)(self._bench)

    def _bench(self, rows: str = "down", offset: tuple[str, int] = ("", 0), thin: bool = False) -> Bench:
        chosen = self.chosen(rows, offset)
        return Bench(chosen, max(1, len(chosen[0].px) // _PER_FRAME) if thin and chosen else 1)

    def chosen(self, rows: str, offset: tuple[str, int]) -> list[Look]:
        """Return the looks that can be compared; none where a clip is too short for buffers of other frames."""
        looks, deep = self.looks, self.deep
        if offset[1]:
            looks = of_other_frames(looks, *offset)
            deep = [k + (offset[1] == PREVIOUS) for k in deep]
        if rows == "up":
            looks = turned(looks)
        return [looks[k] for k in deep if k in looks and (PREVIOUS in looks[k].neighbors or not offset[1])]

    def shown(self, rows: str, frames: list[int]) -> list[Look]:
        """Return the looks of `frames`, with their images as `rows` are read."""
        looks = turned(self.looks) if rows == "up" else self.looks
        return [looks[k] for k in frames]

    @cached_property
    def stored(self) -> np.ndarray:
        """Stored depths (N,) of surfaces."""
        bench = self.bench()
        return bench.stored[bench.solid]

    # ---- judging ---------------------------------------------------------------------------------------

    def _agreement(self, bench: Bench, motion: Motion, off: np.ndarray, sharp: float = 1.0) -> float:
        """Return the agreement of residuals `off` (N, 2) of vectors, pixels; with `sharp` below 1 small
        residuals count, too."""
        use = bench.solid & np.isfinite(bench.motion(motion)).all(-1)
        coarsest, finest = bench.scale(motion, self._step)
        score = log_score(np.linalg.norm(off, axis=-1), coarsest, sharp * finest)
        return trimmed(bench.by_frame(score, use))

    def verdict(self, reading: Reading) -> Verdict:
        """Return the evidence for `reading`, whose vectors include the camera's motion."""
        bench, step = self.bench(reading.rows, reading.offset), reading.motion.step
        motion, static = bench.motion(reading.motion), bench.static(reading.cameras, reading.depth, step)
        use = bench.solid & np.isfinite(motion).all(-1) & bench.has[step]
        off = np.nan_to_num(np.linalg.norm(motion - static, axis=-1), nan=np.inf)
        if not use.any():
            return Verdict(reading, 0.0, 0.0, np.inf, 0.0, False)
        scores = [bench.color_scores(one, step) for one in (motion, static)]
        use &= ~self._held(bench, reading, motion, off, scores, use)
        length = float(np.median(np.linalg.norm(motion[use], axis=-1)))
        near = max(_NEAR[0] * length, _NEAR[1], self._step)
        share, quarter = float((off[use] <= near).mean()), float(np.quantile(off[use], 0.25, method="lower"))
        fits = quarter <= max(_CLOSE[0] * length, _CLOSE[1], self._step) and share >= _LEAST
        where = _half(bench, off <= near, use) if reading == GIVEN else ""
        fits = fits and not where and not self._law_is_off(bench, reading, motion, use)
        known = np.nan_to_num([bench.colors_along(*pair) for pair in zip((motion, static), scores, strict=True)])
        quarters = [np.quantile(off[part], 0.25, method="lower") if part.any() else np.nan for part in bench.parts(use)]
        agrees = self._agreement(bench, reading.motion, motion - static)
        color, median = float(known.mean()), float(np.median(off[use]))
        return Verdict(reading, agrees, color, median, share, fits, where, np.array(quarters))

    def _held(self, bench: Bench, reading: Reading, motion, off, scores, use) -> np.ndarray:
        """Return which of the samples `use` (N,) travel with the camera, as a cab does: they stay where they are in the
        picture, by their vectors and by `scores` of colors along vectors and static motion; none if most others do."""
        reach = bench.reach(reading.cameras, reading.motion.step)
        fixed = reach.ray[:, :2] * reach.focal + reach.center - bench.px
        stays = np.linalg.norm(motion - fixed, axis=-1) <= max(_MOVER, 0.5 * self._step)
        held = use & stays & (off > max(_VISIBLE, 2 * self._step))
        gains = (scores[0] - scores[1])[held]
        gains = gains[np.isfinite(gains)]
        is_seen = len(gains) >= _FEWEST and gains.mean() > _GAIN and held.sum() < _MOST_HELD * use.sum()
        return held & is_seen

    def _law_is_off(self, bench: Bench, reading: Reading, motion: np.ndarray, use: np.ndarray) -> bool:
        """Return whether the depths of many of the samples `use` (N,) are off together from those by the vectors, along
        epipolar lines."""
        strictness = 1.0 if reading.depth == GIVEN.depth else _STRICT[reading.depth.law.name == "logarithmic"]
        reach = bench.reach(reading.cameras, reading.motion.step)
        a, b = reach.equations(bench.px + motion)
        w = reading.depth.inverse(bench.stored, reach.ray)
        with np.errstate(all="ignore"):
            reached = np.linalg.norm(a, axis=-1)
            parallax, off = reached * w, (a * b).sum(-1) / reached - reached * w
            across = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / reached
        use = use & np.isfinite(off) & (w > 0)
        if use.sum() < _RANGES * _FEWEST:
            return False
        parallax, off, across, w = parallax[use], off[use], across[use], w[use]
        if strictness < 1 and np.median(np.abs(off)) > max(
            _EXACT[0] * np.median(parallax), _EXACT[1], 0.5 * self._step
        ):
            return True
        of_range, wrong = np.searchsorted(np.quantile(w, np.arange(1, _RANGES) / _RANGES), w), 0
        for part in (of_range == k for k in range(_RANGES)):
            if part.sum() < _FEWEST:
                continue
            middle, usual = float(np.median(off[part])), float(np.median(parallax[part]))
            scatter = np.median(np.abs(off[part] - middle))
            least = max(strictness * _OFF[0] * usual, strictness * _OFF[1], 1.5 * scatter, 0.5 * self._step)
            if abs(middle) > least and np.median(across[part]) < _ALONG * abs(middle):
                wrong += int(part.sum())
        return wrong > _MOST_OFF * len(w)

    # ---- searching -------------------------------------------------------------------------------------

    def explain(self) -> Outcome:
        """Return the changes that explain the looks, or that none does."""
        given = self.verdict(GIVEN)
        if lacking := self._without_camera(given):
            return lacking
        if given.fits and given.agreement >= _GOOD:
            return self._of_color(given)
        rivals = self._better(given, map(self.verdict, self._other_frames()))
        if not given.fits or given.agreement < _RATHER_GOOD:
            rivals += self._better(given, map(self.verdict, self._candidates()))
            if focal := self._focal():
                rivals += self._better(given, [self.verdict(focal)])
        if (jitter := self._jitter(given, rivals)) is not None:
            return Outcome([JitterDiffers(jitter)], GIVEN, given, given)
        if not rivals:
            return Outcome([] if given.fits else [_unexplained(given)], GIVEN, given, given)
        best, others = self._best(rivals)
        if best.share < self._sound:
            return Outcome([_unexplained(given)], GIVEN, given, given)
        if not others:
            return Outcome(best.reading.findings(self.stored), best.reading, given, best)
        causes = tuple(_words(one.reading.findings(self.stored)) for one in (best, *others))
        return Outcome([Ambiguous(given.median, causes)], GIVEN, given, given)

    def _of_color(self, given: Verdict) -> Outcome:
        """Return the outcome for vectors that fit cameras: both may have the jitter, and color none."""
        if self._jittered:
            reading = Reading(Motion(other_jitter=True), cameras=Cameras(jitter="geometry_jitter"))
            read = self.verdict(reading)
            if read.fits and read.color > given.color + _WORSE_COLORS:
                return Outcome(reading.findings(self.stored), reading, given, read)
        return Outcome([], GIVEN, given, given)

    def _better(self, given: Verdict, verdicts: Iterable[Verdict]) -> list[Verdict]:
        """Return those of `verdicts` that fit, clearly better than `given`, in most frames, and with no worse
        colors."""
        found = []
        for one in verdicts:
            if not one.fits or one.agreement < given.agreement + _MARGIN or one.color < given.color - _WORSE_COLORS:
                continue
            same = one.reading.offset[1] != PREVIOUS and len(one.by_frame) == len(given.by_frame)
            gains = one.by_frame < _BETTER * given.by_frame if same else np.ones(1, bool)
            if 2 * gains.sum() > len(gains):
                found.append(one)
        return found

    def _best(self, rivals: list[Verdict]) -> tuple[Verdict, list[Verdict]]:
        """Return the best of `rivals`, and others with the same evidence."""
        most = max(one.agreement for one in rivals)
        rivals = [one for one in rivals if one.agreement > most - _ALIKE]
        colored = max(one.color for one in rivals)
        rivals = [one for one in rivals if one.color > colored - _WORSE_COLORS]
        fewest = min(one.reading.changes for one in rivals)
        colored = max(one.color for one in rivals if one.reading.changes == fewest)
        rivals = [one for one in rivals if one.reading.changes > fewest or one.color > colored - _SAME_COLORS]
        first = min(rivals, key=lambda one: (one.reading.changes, -one.agreement))
        mirrored = [one for one in rivals if _rows_differ(one.reading, first.reading)]
        if mirrored:
            upright = self._upright(first.reading)
            twin = min(mirrored, key=lambda one: (one.reading.changes, -one.agreement))
            if upright < -_SURE:
                first, twin = twin, first
            if abs(upright) > _SURE:
                mirrored = []
            else:
                mirrored = [twin] if twin.reading.changes <= first.reading.changes + 1 else []
        others = [
            one for one in rivals if one.reading.rows == first.reading.rows and not _is_near(one.reading, first.reading)
        ]
        others = [one for one in others if one.reading.changes == first.reading.changes and one not in mirrored]
        return first, mirrored + others[:2]

    def _candidates(self) -> list[Reading]:
        """Return the readings whose agreement is best on few samples."""
        pairs = []
        for rows in ("down", "up"):
            bench = self.bench(rows, thin=True)
            for one in cameras(bench.looks[0]):
                for motion in motions(self._jittered):
                    plain = Reading(motion, cameras=one, rows=rows)
                    if rows == "down" or plain.changes <= _MOST_WITH_ROWS:
                        pairs.append((self._across(bench, motion, one), plain))
        most = max(score for score, _ in pairs)
        pairs = [pair for pair in pairs if pair[0] > most - 2 * _ALIKE]
        pairs.sort(key=lambda pair: (pair[1].changes, -pair[0]))
        found: dict[Reading, float] = {}
        for _, plain in pairs[:_PAIRS]:
            bench = self.bench(plain.rows, thin=True)
            motion = bench.motion(plain.motion)
            for reading in (plain, *self._fitted(bench, plain)):
                static = bench.static(reading.cameras, reading.depth, reading.motion.step)
                found[reading] = self._agreement(bench, plain.motion, motion - static)
        most = max(found.values())
        ranked = sorted(found, key=lambda one: (round((most - found[one]) / _ALIKE), one.changes))
        chosen: list[Reading] = []
        for reading in ranked[:_READINGS]:
            bench, laws = self.bench(reading.rows), (reading.depth.law,)
            chosen += [reading] if reading.depth == GIVEN.depth else self._fitted(bench, reading, laws)
        return list(dict.fromkeys(one for one in chosen if one != GIVEN))

    def _across(self, bench: Bench, motion: Motion, one: Cameras) -> float:
        """Return the agreement of vectors with cameras at the best depth of every sample, which may be infinite."""
        vectors, reach = bench.motion(motion), bench.reach(one, motion.step)
        a, b = reach.equations(bench.px + vectors)
        with np.errstate(all="ignore"):
            w = np.maximum(np.nan_to_num((a * b).sum(-1) / (a * a).sum(-1)), 0)
        return self._agreement(bench, motion, a * w[:, None] - b)

    def _fitted(self, bench: Bench, reading: Reading, laws: Iterable = LAWS) -> list[Reading]:
        """Return readings with the depth that fits motion and cameras of `reading` best, by each of `laws`."""
        vectors, reach = bench.motion(reading.motion), bench.reach(reading.cameras, reading.motion.step)
        a, b = reach.equations(bench.px + vectors)
        use = bench.solid & np.isfinite(vectors).all(-1)
        found = []
        for law in laws:
            depth = fit_depth(law, law.basis(bench.stored[use], reach.ray[use]), a[use], b[use])
            if depth is None or not np.median(depth.inverse(bench.stored[use], reach.ray[use])) > 0:
                continue
            if law in (LINEAR, DISTANCE) and abs(depth.coefficients[0] - 1) < _SAME_UNIT:
                depth = replace(depth, coefficients=(1.0,))
            if depth != GIVEN.depth and depth.is_possible(self.stored):
                found.append(replace(reading, depth=depth))
        return found

    def _other_frames(self) -> list[Reading]:
        """Return readings with a buffer of another frame: alone, and with another change of the vectors."""
        found = []
        for buffer in ("camera", "depth", "motion"):
            for by in (NEXT, PREVIOUS):
                if not self.chosen("down", (buffer, by)):
                    continue
                bench = self.bench(offset=(buffer, by))
                plain = Reading(offset=(buffer, by))
                made = [replace(plain, motion=one) for one in motions(False)]
                made = [one for one in made if one.changes <= 2]
                scores = []
                for one in made:
                    vectors = bench.motion(one.motion)
                    static = bench.static(one.cameras, one.depth, one.motion.step)
                    scores.append(self._agreement(bench, one.motion, vectors - static))
                found.append(made[int(np.nanargmax(np.nan_to_num(scores)))])
        return found

    def _focal(self) -> Reading | None:
        """Return the reading with the focal lengths that fit best; None for those given."""
        bench = self.bench(thin=True)
        motion = bench.motion(GIVEN.motion)

        def agreement(scale: float) -> float:
            made = Cameras(focal_scale=float(scale))
            return self._agreement(bench, GIVEN.motion, motion - bench.static(made, GIVEN.depth), _SHARP)

        best, width = max(_FOCALS, key=agreement), float(np.log(_FOCALS[1] / _FOCALS[0]))
        while width > _LAST_STEP:
            best, width = max(best * np.exp(width * np.linspace(-1, 1, 5)), key=agreement), width / 2
        return None if abs(best - 1) < _SAME_FOCAL else Reading(cameras=Cameras(focal_scale=float(f"{best:.4g}")))

    def _jitter(self, given: Verdict, rivals: list[Verdict]) -> float | None:
        """Return the size of offsets of whole frames, pixels, if these explain the residuals as jitter; else None."""
        bench = self.bench()
        motion, static = bench.motion(GIVEN.motion), bench.static(GIVEN.cameras, GIVEN.depth)
        off = motion - static
        offsets = bench.offsets(off, bench.solid & np.isfinite(off).all(-1))
        size = float(np.sqrt(np.square(offsets).sum(-1).mean()))
        if not size > _JITTER or np.abs(offsets).max() > _MOST_JITTER or len(offsets) < 3:
            return None
        if np.linalg.norm(offsets.mean(0)) > _ALTERNATES * size:
            return None
        agrees = self._agreement(bench, GIVEN.motion, off - offsets[bench.frame])
        others = max((one.agreement for one in rivals), default=0.0)
        least = max(_MARGIN + given.agreement, others + _ALIKE)
        return size if agrees > least and agrees > 0.6 else None

    def _without_camera(self, given: Verdict) -> Outcome | None:
        """Return the outcome for vectors that lack the camera's part; None unless most are zero though the camera
        moves. Then colors alone judge cameras and depth."""
        bench = self.bench()
        motion, static = bench.motion(GIVEN.motion), bench.static(GIVEN.cameras, GIVEN.depth)
        length = np.linalg.norm(motion, axis=-1)
        solid = bench.solid & np.isfinite(length)
        if not solid.any():
            return None
        if np.mean((length > 0) & (length < _TINY), where=solid) > _GARBAGE:
            return None
        largest = float(np.quantile(length[solid], 0.999))
        seen = solid & (np.linalg.norm(np.nan_to_num(static), axis=-1) > max(_VISIBLE, 2 * self._step))
        if np.median(length[solid]) > _NOTHING * largest or seen.sum() < _SEEN * solid.sum():
            return None
        if np.median(length[seen]) > _NOTHING * largest:
            return None
        unknown = Outcome([_unexplained(given)], GIVEN, given, given)
        still = bench.color_scores(np.zeros_like(static), PREVIOUS)
        moved = bench.color_scores(static, PREVIOUS)
        use = seen & np.isfinite(still) & np.isfinite(moved) & (length <= _MOVER * max(largest, _VISIBLE))
        if not use.any() or np.mean(moved[use]) < np.mean(still[use]) + _GAIN:
            return None if given.fits else unknown
        movers = solid & (length > _MOVER * largest) if largest else np.zeros(len(length), bool)
        scores = [bench.color_scores(one, PREVIOUS) for one in (motion, motion + static)]
        movers &= np.isfinite(scores[0]) & np.isfinite(scores[1])
        gain = float(np.mean(scores[0][movers] - scores[1][movers])) if movers.sum() >= _FEWEST else 0.0
        readings = [Reading(Motion(camera=name)) for name in ("movers_only", "excluded")]
        if movers.any() and abs(gain) < _GAIN:
            causes = tuple(_words(one.findings(self.stored)) for one in readings)
            return Outcome([Ambiguous(given.median, causes)], GIVEN, given, given)
        reading = readings[bool(movers.any()) and gain < 0]
        return Outcome(reading.findings(self.stored), reading, given, replace(given, reading=reading))

    def _upright(self, reading: Reading) -> float:
        """Return evidence from −1 to 1 that the picture is upright by `reading`: sky is at the top, far surfaces are
        higher in the picture, and the world is right-handed with y or z up."""
        bench = self.bench(reading.rows)
        w = reading.depth.inverse(bench.stored, bench.reach(reading.cameras, reading.motion.step).ray)
        heights = np.repeat([look.size[1] for look in bench.looks], [len(look.px) for look in bench.looks])
        y = bench.px[:, 1] / heights - 0.5  # down
        known = np.isfinite(w)
        sky, evidence = known & (~bench.solid | (w <= 0)), 0.0
        if sky.mean() > _SKY and abs(y[sky].mean()) > _AWAY:
            evidence -= np.sign(y[sky].mean())
        far = known & (w <= np.quantile(w[known], 1 - _FAR)) if known.any() else known
        if far.any() and abs(y[far].mean()) > _ABOVE:
            evidence -= 0.5 * np.sign(y[far].mean())
        turns = [reading.cameras.read(look.camera, look.jitter).world_to_view[:3, :3] for look in bench.looks]
        up = -np.mean([m[1] for m in turns], 0)
        axis, handed = 1 + int(np.abs(up[1:]).argmax()), float(np.sign(np.linalg.det(turns[0])))
        if abs(up[axis]) > _FAR and handed == np.sign(up[axis]):
            evidence += handed
        return float(np.clip(evidence, -1, 1))


def _half(bench: Bench, agrees: np.ndarray, use: np.ndarray) -> str:
    """Return the half of the picture in which few samples agree in any frame, while most others do; else ""."""
    sizes = np.array([look.size for look in bench.looks])[bench.frame]
    for axis, names in enumerate((("left", "right"), ("upper", "lower"))):
        first = bench.px[:, axis] < sizes[:, axis] / 2
        for name, inside in zip(names, (first, ~first), strict=True):
            parts = [
                (agrees[part & inside], agrees[part & ~inside])
                for part in bench.parts(use)
                if min((part & inside).sum(), (part & ~inside).sum()) >= _FEWEST
            ]
            shares = [(one.mean(), other.mean()) for one, other in parts]
            if parts and any(all(a < most and b > least for a, b in shares) for most, least in _HALVES):
                return f" in the {name} half of the picture"
    return ""


def _rows_differ(one: Reading, other: Reading) -> bool:
    return one.rows != other.rows


def _is_near(one: Reading, other: Reading) -> bool:
    """Return whether two readings say the same, but for fitted numbers."""
    plain = replace(one, depth=other.depth, cameras=replace(one.cameras, focal_scale=other.cameras.focal_scale))
    return plain == other and one.depth.law.name == other.depth.law.name


def _words(findings: list[Finding]) -> str:
    return " with ".join(one.remedy or one.words() for one in findings)


def _unexplained(given: Verdict) -> Unexplained:
    return Unexplained(given.median, given.share, given.where)
