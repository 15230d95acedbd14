"""Search for a set of hypotheses with which motion, depth, cameras and colors fit each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gffe_cl.captures.doctor.hypotheses.cameras import CAMERA_AS_GIVEN, CameraReading, camera_readings
from gffe_cl.captures.doctor.hypotheses.coarse_search import WideField
from gffe_cl.captures.doctor.hypotheses.depths import AS_GIVEN, MODELS, PLANAR, RARE, DepthReading, fit_depth
from gffe_cl.captures.doctor.hypotheses.motions import MOTION_AS_GIVEN, MotionReading, motion_readings
from gffe_cl.captures.doctor.hypotheses.sampling import BUFFERS, PREVIOUS, Look
from gffe_cl.captures.doctor.hypotheses.scoring import Bench, frame_offsets, log_score, mostly_nothing, moving, trimmed

EDIT = 0.02  # cost of every part of a hypothesis, in units of the scores
_REFINING, _PER_FRAME = 600, 120  # samples per frame, while parameters are refined and while the field is wide
_MOTIONS, _MOST_MOTIONS, _JOINT, _REFINED = 7, 80, 8, 2
_MOTION_MARGIN = 0.12  # motion readings whose colors fit so much worse than the best one's are not looked at
GOOD = 0.8  # an agreement that leaves nothing to explain
FOCALS = (0.6, 0.75, 0.87, 0.94, 1.0, 1.06, 1.15, 1.33, 1.67)
_FIRST_STEP, _LAST_STEP = 0.06, 2e-4  # of the logarithm of focal lengths
_SAME_UNIT = 0.02  # units of depth and translation that differ by less are one
_SAME_FOCAL = 0.004  # the same for focal lengths
_SHARP = 0.05  # of the finest residuals, where parameters are fitted
_SMALLEST = 0.02  # pixels: the unit of visible errors
_STILL = 0.05  # of the motion in the frame that moves most: frames with less do not set the scale of residuals
_MOST_JITTER = 1.6  # pixels between two frames


@dataclass(frozen=True)
class Reading:
    """A hypothesis about motion vectors, cameras and depth together. `jitter`: the part with missing or doubled
    jitter, "motion", "camera" or ""; `rows`: the BUFFERS whose rows are stored from the bottom up."""

    motion: MotionReading = MOTION_AS_GIVEN
    camera: CameraReading = CAMERA_AS_GIVEN
    depth: DepthReading = AS_GIVEN
    jitter: str = ""
    rows: tuple[str, ...] = ()

    @property
    def edits(self) -> float:
        """Number of differences from the sequence as given."""
        depth = 0 if self.depth == AS_GIVEN else self.depth.model.cost
        focal = self.camera.focal != 1
        rest = depth + focal + 2 * bool(self.jitter) + bool(self.rows)
        return len(self.motion.parts) + len(self.camera.parts) + rest

    def mirrored(self) -> Reading:
        """Return the equivalent reading for pictures turned upside down: it turns exactly the buffers whose rows
        this one leaves, and negates y of motion vectors and cameras."""
        rows = tuple(name for name in BUFFERS if name not in self.rows)
        return replace(self, motion=self.motion.mirrored(), camera=self.camera.mirrored(), rows=rows)


@dataclass
class Verdict:
    """Evidence for a reading: each score is from 0 to 1.

    `agreement`: motion vectors with cameras and depth; `motion_color`, `camera_color`: each of them with the colors;
    `edges`: colors with depth, from −1 to 1 (`edge_agreement`).
    """

    reading: Reading
    agreement: float
    motion_color: float
    camera_color: float
    edges: float = 0.0

    @property
    def colors(self) -> float:
        """Evidence from colors in total."""
        return float(np.nansum([self.motion_color, self.camera_color, self.edges]))

    @property
    def total(self) -> float:
        return float(np.nan_to_num(self.agreement)) + self.colors - EDIT * self.reading.edits


def misread_focals(look: Look) -> list[float]:
    """Return the factors on focal lengths by usual mistakes about the field of view: the vertical angle taken for the
    horizontal one or the other way, and an angle in radians taken for degrees."""
    (width, height), camera = look.size, look.camera
    found = [width / height, height / width]
    for side, focal in ((width, camera.fx), (height, camera.fy)):
        angle = np.degrees(2 * np.arctan(side / 2 / focal))
        if 0 < angle < np.pi:
            found.append(float(2 * focal / side * np.tan(angle / 2)))
    return found


class Search:
    """Search over the looks of one clip, in which the buffers `rows` have been turned upside down. `step`: of quantized
    motion vectors, pixels, or 0; `edges`: how colors agree with depth at silhouettes."""

    def __init__(self, looks: list[Look], step: float = 0.0, rows: tuple[str, ...] = (), edges: float = 0.0):
        self.plain, self.edges = Reading(rows=rows), edges
        self.full = Bench(looks)
        self.step = step
        self._color: dict = {}

    @cached_property
    def middle(self) -> Bench:
        """Samples on which parameters are refined."""
        return self._thinned(_REFINING)

    @cached_property
    def thin(self) -> Bench:
        """Few samples, on which all readings are compared."""
        return self._thinned(_PER_FRAME)

    def _thinned(self, per_frame: int) -> Bench:
        looks = self.full.looks
        return Bench(looks, max(1, len(looks[0].px) // per_frame))

    def agreement(self, bench: Bench, motion: np.ndarray, static: np.ndarray, jitter="", sharp=False) -> float:
        """Return the agreement of motion vectors with depth and cameras, relative to the vectors' length. With
        `sharp` small residuals count too."""
        use = bench.solid & np.isfinite(motion).all(-1)
        off = motion - static
        if jitter:
            offsets = frame_offsets(bench, off, use)
            if np.abs(offsets).max() > _MOST_JITTER:
                return 0.0
            off = off - offsets[bench.frame]
        coarsest, finest = self._scale(bench, motion)
        score = log_score(np.linalg.norm(off, axis=-1), coarsest, finest * (_SHARP if sharp else 1))
        return trimmed(bench.by_frame(score, use))

    def _scale(self, bench: Bench, motion: np.ndarray) -> tuple[float, float]:
        """Return the coarsest and the finest residuals that are evidence, in pixels. Frames in which nearly nothing
        moves do not count."""
        length = np.linalg.norm(motion, axis=-1)
        known = np.isfinite(length)
        usual = np.array([np.median(length[part]) if part.any() else 0.0 for part in bench.parts(known)])
        known &= (usual >= _STILL * usual.max())[bench.frame]
        scale = max(float(np.median(length[known])) if known.any() else 0.0, _SMALLEST)
        return max(0.5 * scale, 2 * self.step), max(0.005 * scale, 0.5 * self.step)

    @staticmethod
    def motions(reading: Reading, bench: Bench) -> tuple[np.ndarray, np.ndarray]:
        """Return (N, 2) each, pixels: motion vectors, and the motion of static points, both to the frame that the
        reading's vectors lead to."""
        motion = bench.motion(reading.motion)
        static = bench.static(reading.camera, reading.depth, reading.motion.step)
        if reading.motion.adds_camera:
            motion = motion + static
        if reading.jitter:
            off = motion - static
            offsets = frame_offsets(bench, off, bench.solid & np.isfinite(off).all(-1))[bench.frame]
            motion, static = (motion - offsets, static) if reading.jitter == "motion" else (motion, static + offsets)
        return motion, static

    def motion_color(self, reading: MotionReading) -> float:
        """Return the agreement of colors along motion vectors, where there is motion."""
        if reading not in self._color:
            self._color[reading] = self._along(self.full.motion(reading), reading.step)
        return self._color[reading]

    def _along(self, motion: np.ndarray, step: int) -> float:
        score = self.full.color_scores(motion, step)
        return trimmed(self.full.by_frame(score, np.isfinite(score) & moving(motion)))

    def static_color(self, static: np.ndarray, step: int) -> float:
        """Return how well the colors of surfaces agree along `static` (N, 2) pixels."""
        score = self.full.color_scores(np.nan_to_num(static, nan=1e9), step)
        return trimmed(self.full.by_frame(score, np.isfinite(score) & self.full.solid))

    def camera_color(self, camera: CameraReading, depth: DepthReading) -> float:
        """Return the agreement of colors along the static motion by depth and cameras."""
        key = camera, depth
        if key not in self._color:
            self._color[key] = self.static_color(self.full.static(camera, depth), PREVIOUS)
        return self._color[key]

    def verdict(self, reading: Reading) -> Verdict:
        motion, static = self.motions(replace(reading, jitter=""), self.full)
        agrees = self.agreement(self.full, motion, static, reading.jitter)
        if not reading.jitter:
            color = self.motion_color(reading.motion), self.camera_color(reading.camera, reading.depth)
            return Verdict(reading, agrees, *color, self.edges)
        motion, static = self.motions(reading, self.full)
        step = reading.motion.step
        return Verdict(reading, agrees, self._along(motion, step), self.static_color(static, step), self.edges)

    def fitted(self, bench: Bench, reading: Reading, models=MODELS) -> list[Reading]:
        """Return readings with the depth that fits motion and camera of `reading` best, by each of `models`."""
        vectors, reach = bench.motion(reading.motion), bench.reach(reading.camera, reading.motion.step)
        a, b = reach.equations(bench.px + vectors)
        use = bench.solid & np.isfinite(vectors).all(-1)
        if not use.any():
            return []
        found, frame = [], bench.frame[use] if reading.jitter else None
        for model in models:
            depth = fit_depth(model, model.basis(bench.stored[use], reach.ray[use]), a[use], b[use], frame)
            if depth is not None and depth.is_possible:
                found.append(self._facing(replace(reading, depth=depth)))
        return found

    def candidates(self) -> list[Verdict]:
        """Return readings that may be right, the best first; the plain one is always among them."""
        found = {self.plain: self.verdict(self.plain)}

        def good() -> bool:
            return max(found.values(), key=lambda v: v.total).agreement >= GOOD

        def add(readings) -> None:
            for reading in readings:
                if reading not in found and reading.depth.has_meaning:
                    found[reading] = self.verdict(reading)

        def refine() -> None:
            for _ in range(2):
                best = sorted(found.values(), key=lambda v: -v.total)[:_REFINED]
                add(reading for verdict in best for reading in self._refined(verdict.reading))

        near = self._near_motions()
        motions = near[:_MOTIONS]
        usual = [c for c in camera_readings() if c.is_usual]
        add(self._joint(motions, camera_readings()))
        if not good():
            best = sorted(found.values(), key=lambda v: -v.total)[:_REFINED]
            add(one for verdict in best for one in self.fitted(self.full, verdict.reading, RARE))
        if not good():
            focals = [*FOCALS, *misread_focals(self.full.looks[0])]
            add(self._joint(motions, [CAMERA_AS_GIVEN.with_focal(k) for k in focals if k != 1]))
            refine()
        if not good() and len(near) > _MOTIONS:
            found_among_all = self._joint(near, usual)
            add(found_among_all)
            motions = list(dict.fromkeys([*(r.motion for r in found_among_all), *motions]))[:_MOTIONS]
        if not good():
            add(self._joint(motions, [c.with_focal(k) for c in usual for k in FOCALS if k != 1]))
        refine()
        if not good() and not self._lacks_motion():
            jittered = self._joint(motions, usual, "?")
            add(replace(reading, jitter=which) for reading in jittered for which in ("motion", "camera"))
            refine()
        return sorted(found.values(), key=lambda v: -v.total)

    def _lacks_motion(self) -> bool:
        """Return whether vectors are mostly zero: then a constant per frame would explain anything."""
        length = np.linalg.norm(self.full.motion(MOTION_AS_GIVEN), axis=-1)
        return mostly_nothing(length[self.full.solid & np.isfinite(length)])

    def _near_motions(self) -> list[MotionReading]:
        """Return the motion readings along which the colors fit about as well as along the best, and the usual one
        first."""
        scores = self._motion_colors(motion_readings())
        cost = {reading: EDIT * len(reading.parts) - score for reading, score in scores.items()}
        ranked = sorted(cost, key=cost.__getitem__)
        near = [m for m in ranked if cost[m] < cost[ranked[0]] + _MOTION_MARGIN]
        return list(dict.fromkeys([MOTION_AS_GIVEN, *near]))[:_MOST_MOTIONS]

    def _motion_colors(self, readings: list[MotionReading]) -> dict[MotionReading, float]:
        """Return the agreement of colors, as `motion_color` does, for many readings at once on few samples."""
        groups: dict = {}
        for reading in readings:
            groups.setdefault((reading.step, reading.held_by), []).append(reading)
        found = {}
        for (step, _), group in groups.items():
            base = [self.thin.motion(reading) for reading in group]
            scores = self.thin.color_scores(np.stack(base), step)
            for reading, motion, score in zip(group, base, scores, strict=True):
                use = np.isfinite(score) & moving(motion)
                found[reading] = float(np.nan_to_num(trimmed(self.thin.by_frame(score, use)), nan=0.0))
        return found

    def _joint(self, motions: list[MotionReading], cameras: list[CameraReading], jitter: str = "") -> list[Reading]:
        """Return the best readings of all combinations of `motions` with `cameras` and depths."""
        fields = {step: WideField(self.thin, cameras, step) for step in {m.step for m in motions}}
        found = []
        for motion in motions:
            vectors, color = self.thin.motion(motion), np.nan_to_num(self.motion_color(motion))
            for agrees, camera, depth in fields[motion.step].scores(
                vectors, self._scale(self.thin, vectors), bool(jitter)
            ):
                reading = self._facing(replace(self.plain, motion=motion, camera=camera, depth=depth, jitter=jitter))
                found.append((agrees + color - EDIT * reading.edits, reading))
        found.sort(key=lambda pair: -pair[0])
        return list(dict.fromkeys(reading for _, reading in found))[:_JOINT]

    def _facing(self, reading: Reading) -> Reading:
        """Return the reading with positive depths: negative ones under some axes are positive under the opposite
        axes."""
        if reading.depth.model.added is not None:  # logarithms are of positive depths
            return reading
        bench, ray = self.thin, self.thin.reach(reading.camera, reading.motion.step).ray
        if reading.depth != AS_GIVEN and np.nanmedian(reading.depth.inverse(bench.stored, ray)[bench.solid]) < 0:
            depth = replace(reading.depth, coefficients=tuple(-c for c in reading.depth.coefficients))
            reading = replace(reading, depth=depth, camera=reading.camera.opposite())
        if reading.depth.model is PLANAR and abs(reading.depth.coefficients[0] - 1) < _SAME_UNIT:
            return replace(reading, depth=AS_GIVEN)
        return reading

    def _refined(self, reading: Reading) -> list[Reading]:
        """Return `reading` with parameters fitted to all samples: as it is, and with the focal length that fits
        best."""
        models = [reading.depth.model]

        def fits(focal: float) -> list[tuple[float, Reading]]:
            plain = replace(reading, camera=reading.camera.with_focal(focal))
            made = []
            for one in [plain] if reading.depth == AS_GIVEN else self.fitted(self.middle, plain, models):
                static = self.middle.static(one.camera, one.depth, one.motion.step)
                made.append(
                    (self.agreement(self.middle, self.middle.motion(one.motion), static, one.jitter, True), one)
                )
            return made

        found = [] if reading.depth == AS_GIVEN else self.fitted(self.full, reading, models)
        focal, width = reading.camera.focal, _FIRST_STEP
        while width > _LAST_STEP:
            near = [fit for f in focal * np.exp(width * np.linspace(-1, 1, 3)) for fit in fits(f)]
            if not near:
                return found
            focal, width = max(near, key=lambda fit: fit[0])[1].camera.focal, width / 2
        if abs(focal - 1) <= _SAME_FOCAL:
            return found
        best = replace(reading, camera=reading.camera.with_focal(focal))
        return found + ([best] if reading.depth == AS_GIVEN else self.fitted(self.full, best, models))
