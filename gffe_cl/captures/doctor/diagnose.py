"""The doctor's diagnosis: faults of a sequence, their certainty, and their repair (`gffe check`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from gffe_cl.captures.doctor.differences import faults_of, jitter_id, no_law_fault
from gffe_cl.captures.doctor.dilation import dilation_notes
from gffe_cl.captures.doctor.evidence import set_aside_unwritten, too_few_usable
from gffe_cl.captures.doctor.findings import (
    FAULT,
    NO_LAW,
    UNEXPLAINED,
    Finding,
    finding,
    frames_in_words,
    listed,
)
from gffe_cl.captures.doctor.format_keys import tell_keys
from gffe_cl.captures.doctor.geometry_jitter import geometry_jitter_notes
from gffe_cl.captures.doctor.hypotheses.camera_jitter import SURE
from gffe_cl.captures.doctor.hypotheses.edges import edge_agreement
from gffe_cl.captures.doctor.hypotheses.laws import settled
from gffe_cl.captures.doctor.hypotheses.missing_camera_motion import without_camera
from gffe_cl.captures.doctor.hypotheses.order import Order, Reordered, examine_order, shuffled_order
from gffe_cl.captures.doctor.hypotheses.row_order import search_rows
from gffe_cl.captures.doctor.hypotheses.sampling import NEXT, PREVIOUS, Clip, Look, take_looks, with_rows
from gffe_cl.captures.doctor.hypotheses.scoring import ResidualChange, color_gain, frame_offsets
from gffe_cl.captures.doctor.hypotheses.search import Reading, Search, Verdict
from gffe_cl.captures.doctor.hypotheses.transfer_function import display_curve_votes
from gffe_cl.captures.doctor.limits import set_aside_cut_off
from gffe_cl.captures.doctor.mends import Mend, MendedClip, OtherFrame, find_mend
from gffe_cl.captures.doctor.quantization import are_sums, largest_step, motion_finding, motion_steps, precision_notes
from gffe_cl.captures.doctor.repeated_frames import RepeatedFrames, repeated_frames
from gffe_cl.captures.doctor.repeated_pixels import repeated_pixel_notes
from gffe_cl.captures.doctor.user_interface import user_interface_notes
from gffe_cl.captures.sequence import FrameEntry
from gffe_cl.engine.core.validation import QUIETLY
from gffe_cl.engine.frame.rendered_frame import BadPixels

_DEEP = 5  # frames that are looked at closely, with those before and after them
_MOVES, _JUMPS = 0.1, 10.0  # of the camera's usual movement: frames with less are still, with more they are cuts
_SAMPLES = 2500  # of each frame
_MOST_READ, _MOST_PIXELS = 40, 80_000_000  # frames and pixels that are read, whichever is more
_DOUBTFUL = 0.5  # agreements below that make one look for another order of frames
_MARGIN = 0.06  # of the sum of scores, by which another reading must be better than the given one
_VISIBLE = 0.3  # least motion by the camera's rotation and by its translation, pixels
_UNEXPLAINED = 0.35  # share of samples that must agree roughly; below it there is an unknown fault
_STATIC, _EXACT = 0.25, (0.05, 0.1)  # quantile of residuals; share of the motion's length and pixels that it may be
_EXPLANATIONS = 6  # readings after the best one that are tried if that leaves a residual
_ALTERNATES = 0.8  # of the mean offset of a frame: most that the mean of all offsets of jitter is
_TELLING = 0.02  # of agreements: by less they do not decide
_COLORS_ALONE = 0.12  # of color scores, where they have to decide alone
_COMPARABLE = 0.5  # color score of static samples, below which movers' colors decide nothing
_ROUGHLY = 0.25, 1.5  # of the motion's length, and pixels
_ALIKE = 0.01  # difference of agreements below which two readings are equivalent
_CUT = 0.15  # share of samples that agree: frames with less do not follow the one before
_SAME_SHOT = 0.7  # of the usual color score along depth and cameras
_STRETCHED = 0.5  # pixels: least motion by depth and cameras with which vectors are compared in length
_MOST_GAPS = 12  # frames at which gaps are told from cuts
_SKY_STILL = 0.05  # pixels
_LATE, _STEADY = 1.5, 0.9  # of the usual interval: frames after more are late; share of frames that come as usual


@dataclass
class Diagnosis:
    """Result of a diagnosis.

    `findings`: faults, notes, and undecidable properties; `reading`: the best hypothesis about the meaning of the
    buffers; `given`, `best`: verdicts on the sequence as given and on `reading`; `others`: verdicts on the next best
    readings; `order`: of the frames; `residuals`: in pixels, as given and as read; `step`: of quantized vectors,
    pixels; `decodes_color`: colors are to be made linear, which only `gffe_cl.captures.doctor.selected` decides;
    `frames`: number of examined frames; `mends`: changes of the clip, the first one first, before it is read so.
    """

    findings: list[Finding]
    reading: Reading
    given: Verdict | None = None
    best: Verdict | None = None
    others: list[Verdict] = field(default_factory=list)
    order: Order | None = None
    residuals: dict[str, float] = field(default_factory=dict)
    step: float = 0.0
    decodes_color: bool = False
    frames: int = 0
    mends: list[Mend] = field(default_factory=list)
    looks: list[Look] = field(default_factory=list, repr=False)

    def of_kind(self, kind: str) -> list[Finding]:
        return [one for one in self.findings if one.kind == kind]

    @property
    def runner_up(self) -> Verdict | None:
        """The best verdict with another meaning. Verdicts that are indistinguishable from the best do not count."""
        best = self.best
        return next((v for v in self.others if best and abs(v.agreement - best.agreement) > _ALIKE), None)

    @property
    def faults(self) -> list[Finding]:
        return self.of_kind(FAULT)

    @property
    def is_doubtful(self) -> bool:
        """Whether a buffer of another frame is one of several faults, which another explanation may replace."""
        faults = [fault for fault in self.faults if fault.about in ("motion", "depth", "camera")]
        return len(faults) > 1 and any(isinstance(mend, OtherFrame) for mend in self.mends)

    @property
    def compared(self) -> bool:
        """Whether motion vectors were compared with depth and cameras at all."""
        return bool(self.residuals)

    @property
    def verdict(self) -> str:
        """Verdict in one word: "faults", "fits", or "unknown" where nothing was compared."""
        return "faults" if self.faults else "fits" if self.compared else "unknown"


@QUIETLY
def examine(clip: Clip, exposure: float = 1.0) -> Diagnosis:
    """Examine the rendered frames of `clip` and return the diagnosis. Raises GffeError if it has none, or if a file
    cannot be read."""
    count = len(clip.rendered)
    deep = _deep_frames(clip.rendered)
    beside = {k for index in deep for k in (index - 1, index, index + 1) if 0 <= k < count}
    looks = take_looks(clip, beside | set(_spread(count, _pixels(clip))), _SAMPLES, beside, exposure)
    found = Diagnosis([], Reading(), frames=len(looks))
    found.looks = [looks[k] for k in deep if looks[k].neighbors]
    _note_bad_pixels(found, looks)
    found.findings += [*set_aside_unwritten(looks.values()), *too_few_usable(looks.values())]
    _note_resets(found, clip.rendered)
    if found.faults:
        tell_keys(found.findings, getattr(clip, "settings", None))
        return found
    repeated = repeated_frames(looks, count)
    if repeated.whole:
        if len(looks) < count:
            repeated = repeated_frames(take_looks(clip, range(count), _SAMPLES, set(), exposure), count)
        return _examine_without(clip, exposure, repeated)
    found.findings += repeated.findings()
    if not any(PREVIOUS in look.neighbors for look in found.looks):
        found.findings.append(finding("frames: single frames"))
        return found
    steps = motion_steps(found.looks)
    step, added = largest_step(steps), False
    if step:
        given = Search(found.looks, step)
        motion, static = given.motions(Reading(), given.full)
        added = are_sums(motion[given.full.solid], static[given.full.solid], steps)
        step *= 1 + added
        found.findings.append(motion_finding(steps, found.looks, added))
    found.step = step
    found.findings += set_aside_cut_off(Search(found.looks, step), list(looks.values()))
    found.findings += precision_notes(found.looks, exposure)

    edges = edge_agreement(found.looks)

    @cache
    def search_of(rows: tuple[str, ...]) -> Search:
        turned = with_rows({k: looks[k] for k in beside}, rows)
        sign = 1 if ("color" in rows) == ("depth" in rows) else -1
        return Search([turned[look.index] for look in found.looks], step, rows, sign * edges)

    search = search_of(())
    found.given = search.verdict(Reading())
    mends = find_mend({k: looks[k] for k in beside}, deep, clip.rendered, step)
    mended = None if mends.mend is None else _examine_mended(clip, exposure, mends.mend, found, search_of)
    if mended is not None and not mended.is_doubtful:
        return mended
    if not found.given.agreement >= _DOUBTFUL:
        order = shuffled_order(looks, count, step)
        if order is not None:
            return _examine_reordered(clip, exposure, order, found)
    _judge(found, search_of)
    if mends.open and [fault.id for fault in found.faults] == [mends.open]:
        found.findings.remove(found.faults[0])
        found.best, found.reading = found.given, Reading()
    search = search_of(found.reading.rows)
    found.looks = search.full.looks
    found.order = examine_order(with_rows(looks, found.reading.rows), found.reading, count, step)
    _tell_residuals(found, search_of)
    _judge_order(found, looks, _breaks(found, clip, exposure), _ends(count, mends.steady))
    _note_late(found, clip.rendered)
    _note_sky(found, search)
    _judge_colors(found)
    if not found.faults:
        found.findings += dilation_notes(clip, deep)
        found.findings += user_interface_notes(clip, deep, exposure)
    found.findings += [*mends.findings, *repeated_pixel_notes(clip, deep)]
    if all(fault.is_of_jitter for fault in found.faults):
        found.findings += geometry_jitter_notes(clip, deep, exposure, bool(found.faults))
    _tell_unknown(found, search)
    tell_keys(found.findings, getattr(clip, "settings", None))
    return mended if mended is not None and any(fault.name == UNEXPLAINED for fault in found.faults) else found


def _examine_mended(clip: Clip, exposure: float, mend: Mend, given: Diagnosis, search_of) -> Diagnosis:
    found = examine(MendedClip(clip, mend), exposure)
    found.findings.insert(0, mend.finding)
    found.mends.insert(0, mend)
    before = replace(given, findings=[], residuals={})
    _tell_residuals(before, search_of)
    found.residuals |= {name: value for name, value in before.residuals.items() if name.startswith("given")}
    found.given = given.given
    tell_keys(found.findings, getattr(clip, "settings", None))
    return found


def _examine_without(clip: Clip, exposure: float, repeated: RepeatedFrames) -> Diagnosis:
    """Examine `clip` without the frames that were recorded twice, and return the diagnosis."""
    kept = [k for k in range(len(clip.rendered)) if k not in repeated.whole]
    found = examine(Reordered(clip, kept), exposure)
    for one in found.findings:
        if "frame" in one.figures:
            index = one.figures["frame"]
            one.sentence = one.sentence.replace(f"frame {index} (", f"frame {kept[index]} (")
            one.figures["frame"] = kept[index]
    order = found.order and found.order.order
    found.order = Order({}, [], [kept[k] for k in order] if order else kept)
    found.findings[:0] = replace(repeated, color=[]).findings()
    return found


def _examine_reordered(clip: Clip, exposure: float, order: list[int], given: Diagnosis) -> Diagnosis:
    found = examine(Reordered(clip, order), exposure)
    if found.order is not None and found.order.order is not None:
        order = [order[k] for k in found.order.order]
        found.findings = [one for one in found.findings if one.name != "out of order"]
    found.order, found.given = Order({}, [], order), given.given
    found.looks = given.looks
    _judge_order(found, {}, {}, {})
    return found


def _deep_frames(entries: list[FrameEntry]) -> list[int]:
    """Return frames that can be evidence, evenly spread: the camera moves before them, and it does not jump."""
    if len(entries) < 3:
        return list(range(len(entries)))
    inner = [k for k in range(1, len(entries) - 1) if not entries[k].reset]
    telling = [k for k, moves in zip(inner, _camera_moves(entries, inner), strict=True) if moves]
    chosen = _some(telling, _DEEP)
    return sorted(chosen + _some([k for k in inner if k not in telling], _DEEP - len(chosen)))


def _some(indices: list[int], most: int) -> list[int]:
    if len(indices) <= most:
        return indices
    return [indices[k - 1] for k in sorted(set(np.linspace(1, len(indices), most).round().astype(int).tolist()))]


def _camera_moves(entries: list[FrameEntry], indices: list[int]) -> np.ndarray:
    """Return (indices,) bool: whether the camera moves before the frame, and not so far that it must be a cut."""
    moved = np.zeros((len(indices), 2))  # how far it turns, and how far it goes
    for row, k in enumerate(indices):
        before, here = entries[k - 1].render_camera, entries[k].render_camera
        if before is not None and here is not None:
            step = here.world_to_view @ np.linalg.inv(before.world_to_view)
            moved[row] = np.linalg.norm(step[:3, :3] - np.eye(3)), np.linalg.norm(step[:3, 3])
    usual = [np.quantile(part[part > 0], 0.9, method="lower") if part.any() else np.inf for part in moved.T]
    least, most = np.multiply(_MOVES, usual), np.multiply(_JUMPS, usual)
    return np.logical_and((moved >= least).any(-1), (moved <= most).all(-1))


def _spread(count: int, pixels: int) -> list[int]:
    """Return the numbers of all frames, or of runs of frames in long sequences."""
    if count <= max(_MOST_READ, _MOST_PIXELS // pixels):
        return list(range(count))
    starts = np.linspace(0, count - 4, _MOST_READ // 4).astype(int)
    return sorted({int(start) + k for start in starts for k in range(4)})


def _pixels(clip: Clip) -> int:
    """Return the number of pixels of a rendered frame."""
    entries = clip.rendered
    return int(np.size(clip.read(entries[0]).depth)) if entries else 1


def _judge(found: Diagnosis, search_of: Callable[[tuple[str, ...]], Search]) -> None:
    bench, mirrored, unexplained = search_of(()).full, None, False
    assert found.given is not None  # judged before
    found.best = without_camera(search_of(()))
    if found.best is None or not _is_clear(found.best, search_of):
        ways = search_rows(search_of)
        found.best, unexplained = _explaining(ways.verdicts, found.given, search_of)
        found.others = [v for v in ways.verdicts if v.reading != found.best.reading]
        mirrored = ways.doubt(found.best.reading)
    whose = _whose_jitter(found.best.reading, search_of)
    if whose:
        found.best = replace(found.best, reading=replace(found.best.reading, jitter=whose))
    search, stored = search_of(found.best.reading.rows), bench.stored[bench.solid]
    found.reading, left = settled(search, found.best.reading)
    if found.reading != found.best.reading:
        found.best = search.verdict(found.reading)
    if left is not None:
        found.findings.append(no_law_fault(found.reading, stored, left))
        found.best, found.reading, mirrored = found.given, Reading(), None
    found.findings += faults_of(found.reading, stored)
    if unexplained and left is None:
        found.findings.append(finding("frames: unexplained"))
    if found.reading.jitter and not whose:
        _doubt_jitter(found)
    if mirrored is not None:
        instead = ", ".join(fault.id for fault in faults_of(mirrored, bench.stored[bench.solid]))
        found.findings.append(finding("frames: upside down", instead=instead))


def _explaining(
    verdicts: list[Verdict], given: Verdict, search_of: Callable[[tuple[str, ...]], Search]
) -> tuple[Verdict, bool]:
    """Return the best of `verdicts` that is clearly better than `given` and leaves static points no residual, else
    `given`; and whether that is far off although there is a better one."""
    first = _convincing(verdicts, given)
    if not _is_clear(first, search_of):
        return given, False
    others = [verdict for verdict in verdicts if verdict is not first and verdict.total > given.total + _MARGIN]
    for verdict in (first, *others[:_EXPLANATIONS]):
        if _explains(verdict.reading, search_of) and (verdict is first or _is_clear(verdict, search_of)):
            return verdict, False
    return given, not given.agreement >= _DOUBTFUL


def _convincing(verdicts: list[Verdict], given: Verdict) -> Verdict:
    """Return the best of `verdicts`, or `given` unless that is clearly worse. If the camera stands still, depth and
    cameras are no evidence. Then the colors of movers decide on signs, axes and units, if they are certain."""
    best = verdicts[0]
    if best.total < given.total + _MARGIN:
        return given
    gain = np.nansum([best.edges, best.camera_color, -given.edges, -given.camera_color])  # of colors with depth
    if best.agreement > given.agreement + _TELLING or (best.reading.rows and gain > _COLORS_ALONE):
        return best
    for verdict in verdicts:
        motion = verdict.reading.motion
        if verdict.reading == replace(Reading(), motion=motion) and motion.step == PREVIOUS and not motion.held_by:
            comparable = given.camera_color > _COMPARABLE  # static surfaces have equal colors: the exposure is constant
            return verdict if comparable and verdict.motion_color > given.motion_color + _COLORS_ALONE else given
    return given


def _is_clear(verdict: Verdict, search_of: Callable[[tuple[str, ...]], Search]) -> bool:
    """Return whether the reading of `verdict` is better than the given one in most of the frames that are evidence.
    Where vectors lack the camera's part, and where the camera stands still, colors are the evidence."""
    reading = verdict.reading
    if reading in (Reading(), Reading(rows=("color",))):
        return True
    before, after = search_of(()), search_of(reading.rows)
    given, read = before.motions(Reading(), before.full), after.motions(reading, after.full)
    solid = before.full.solid
    compared = [ResidualChange.of(given, read, part, before.step) for part in before.full.parts(solid)]
    telling = [one for one in compared if one is not None]
    if telling and 2 * sum(one.is_better for one in telling) <= len(telling):
        return False
    if telling and not reading.motion.adds_camera:
        return True
    scores = []
    for bench, motion, step in ((before.full, given[0], PREVIOUS), (after.full, read[0], reading.motion.step)):
        score = bench.color_scores(motion, step)
        scores.append(bench.by_frame(score, np.isfinite(score) & bench.solid))
    gains = [gain for gain, one in zip(scores[1] - scores[0], compared, strict=True) if one or not telling]
    known = np.array(gains)[np.isfinite(gains)]
    return bool(2 * (known > 0).sum() > len(known))


def _explains(reading: Reading, search_of: Callable[[tuple[str, ...]], Search]) -> bool:
    """Return whether static points, a quarter of the samples at least, fit `reading` as vectors fit cameras in a good
    sequence, and whether offsets that it takes for jitter alternate."""
    search = search_of(reading.rows)
    motion, static = search.motions(reading, search.full)
    use = search.full.solid & np.isfinite(motion).all(-1) & np.isfinite(static).all(-1)
    if reading.motion.adds_camera or not use.any():
        return True
    off = float(np.quantile(np.linalg.norm(motion - static, axis=-1)[use], _STATIC))
    length = float(np.median(np.linalg.norm(static, axis=-1)[use]))
    if off > max(_EXACT[0] * length, _EXACT[1], search.step):
        return False
    if not reading.jitter:
        return True
    motion, static = search.motions(replace(reading, jitter=""), search.full)
    offsets = frame_offsets(search.full, motion - static, use)
    size = float(np.sqrt(np.square(offsets).sum(-1).mean()))
    return len(offsets) < 3 or float(np.linalg.norm(offsets.mean(0))) <= _ALTERNATES * size


def _whose_jitter(reading: Reading, search_of: Callable[[tuple[str, ...]], Search]) -> str:
    """Return the part whose jitter is wrong, if vectors and cameras differ by jitter: that from which colors differ. ""
    if they do not decide."""
    if not reading.jitter:
        return ""
    search = search_of(reading.rows)
    plain = search.motions(replace(reading, jitter=""), search.full)[1]
    jittered = search.motions(replace(reading, jitter="camera"), search.full)[1]
    sure = color_gain(search.full, jittered, plain, reading.motion.step)
    return "" if abs(sure) < SURE else "camera" if sure > 0 else "motion"


def _doubt_jitter(found: Diagnosis) -> None:
    """Take back which part lacks jitter, or has too much of it."""
    part = found.reading.jitter
    place = next(k for k, fault in enumerate(found.findings) if fault.id == jitter_id(part))
    found.findings[place] = finding(f"{part}: jitter differs")


def _tell_residuals(found: Diagnosis, search_of: Callable[[tuple[str, ...]], Search]) -> None:
    """Set the residuals of vectors, as given and as read, and find vectors that nothing explains."""
    misfits = found.order.misfits if found.order else []
    cuts = [place for place, look in enumerate(found.looks) if look.index in misfits]
    for name, reading in (("given", Reading()), ("read", found.reading)):
        search = search_of(reading.rows)
        motion, static = search.motions(reading, search.full)
        use = search.full.solid & np.isfinite(motion).all(-1) & ~np.isin(search.full.frame, cuts)
        if not use.any():
            found.findings.append(finding("frames: nothing usable"))
            found.residuals.clear()
            return
        off = np.nan_to_num(np.linalg.norm(motion - static, axis=-1)[use], nan=np.inf)
        length = np.linalg.norm(motion[use], axis=-1)
        near = max(0.1 * float(np.median(length)), 0.3, search.step)
        found.residuals[f"{name}_median"] = float(np.median(off))
        found.residuals[f"{name}_inliers"] = float((off <= near).mean())
    roughly = max(_ROUGHLY[0] * float(np.median(length)), _ROUGHLY[1])
    explained = any(fault.name in (UNEXPLAINED, NO_LAW) for fault in found.faults)
    if (off <= roughly).mean() < _UNEXPLAINED and not explained:
        found.findings.append(finding("frames: unexplained"))


def _breaks(found: Diagnosis, clip: Clip, exposure: float) -> dict[int, float | None]:
    """Return the frames that follow the one before although depth and cameras do not fit the vectors. Gaps, at which
    depth and cameras lead to the same colors and the vectors elsewhere, have their `_stretch`."""
    assert found.order is not None and found.best is not None  # examined before
    gaps: dict[int, float | None] = {}
    for index in found.order.misfits[:_MOST_GAPS]:
        pair = with_rows(take_looks(clip, (index - 1, index), _SAMPLES, {index - 1}, exposure), found.reading.rows)
        look = pair[index]
        if look.motion is not None and np.nanmedian(np.abs(look.motion)) > 0:
            search = Search([look])
            if search.camera_color(found.reading.camera, found.reading.depth) > _SAME_SHOT * found.best.camera_color:
                gaps[index] = _stretch(search, found.reading)
    return gaps


def _stretch(search: Search, reading: Reading) -> float | None:
    """Return how many times as long vectors are as those by depth and cameras; None if they are no multiple."""
    motion, static = search.motions(reading, search.full)
    length = np.linalg.norm(static, axis=-1)
    use = search.full.solid & np.isfinite(motion).all(-1) & (length > _STRETCHED)
    if not use.any():
        return None
    factor = float(np.median((motion[use] * static[use]).sum(-1) / length[use] ** 2))
    off = np.linalg.norm(motion[use] - factor * static[use], axis=-1)
    return factor if (off <= 0.1 * length[use]).mean() > 0.5 else None


def _ends(count: int, steady: set[int]) -> dict[int, str]:
    """Return the frames that do not fit, of `count`, where vectors or cameras are of another frame but all others move
    too steadily to show it: with the words for that. `steady`: of `find_mend`."""
    ends = {NEXT: (1, "late"), PREVIOUS: (count - 1, "early")}
    return {ends[by][0]: ends[by][1] for by in steady}


def _judge_order(
    found: Diagnosis, looks: dict[int, Look], breaks: dict[int, float | None], ends: dict[int, str]
) -> None:
    """Add findings about frames that do not follow the one before them. `breaks`: of `_breaks`; `ends`: frames that
    another fault explains as well."""
    order = found.order
    assert order is not None  # examined before
    if order.order is not None:
        moved = listed(k for k, at in enumerate(order.order) if k != at)
        found.findings.append(finding("frames: out of order", frames=moved))
        return

    def add(entry: str, index: int, **values) -> None:
        found.findings.append(finding(entry, {"frame": index}, frame=index, file=looks[index].file, **values))

    for index in [k for k in order.misfits if k in ends]:
        add("frames: misfit at the end", index, when=ends[index])
    breaks = {index: one for index, one in breaks.items() if index not in ends}
    for index, factor in breaks.items():
        length = f"; they are {factor:.2f} times as long as by depth and cameras" if factor else ""
        add("frames: gap", index, length=length, doubt="" if factor and factor > 1 else "; a frame may be missing")
    for index in (k for k in order.misfits if order.fits[k] < _CUT and k not in breaks and k not in ends):
        add("frames: cut", index)


def _note_bad_pixels(found: Diagnosis, looks: dict[int, Look]) -> None:
    total, where, places = BadPixels(), {}, {}
    for look in looks.values():
        total = total + look.bad
        for name, (x, y) in look.first_bad.items():
            where.setdefault(name, f"{look.file} at {x}, {y}")
            places.setdefault(name, (look.index, x, y))
    total.long, _ = 0, where.pop("long", None)  # these have a note of their own
    if total:
        first = "; ".join(f"{name} in {place}" for name, place in where.items())
        note = finding("frames: bad pixels", dict(vars(total)), counts=total, first=first)
        note.places = {name: places[name] for name in where}
        found.findings.append(note)


def _note_resets(found: Diagnosis, entries: list[FrameEntry]) -> None:
    """Add a note about frames after the first that are marked as resets."""
    resets = [k for k, entry in enumerate(entries) if k and entry.reset]
    if resets:
        frames = frames_in_words(resets, "is a reset", "are resets")
        found.findings.append(finding("frames: reset", {"frames": len(resets)}, frames_are=frames))


def _note_late(found: Diagnosis, entries: list[FrameEntry]) -> None:
    """Frames later than usual before which the camera rests: vectors of static points are zero there, whatever frame
    they lead to."""
    intervals = np.diff([entry.time for entry in entries])
    usual = np.median(intervals) if len(intervals) > 2 else 0.0
    if usual <= 0 or (np.abs(intervals - usual) <= (_LATE - 1) * usual).mean() < _STEADY:
        return
    moves = _camera_moves(entries, list(range(1, len(entries))))
    named = {one.figures.get("frame") for one in found.findings}
    for k in (np.flatnonzero((intervals > _LATE * usual) & ~moves) + 1).tolist():
        if not entries[k].reset and k not in named:
            late = {"frame": k, "file": entries[k].file, "intervals": intervals[k - 1] / usual}
            found.findings.append(finding("frames: late", {"frame": k}, **late))


def _note_sky(found: Diagnosis, search: Search) -> None:
    """Add a note about sky whose vectors are zero while the camera turns."""
    bench = search.full
    ray = bench.reach(found.reading.camera, found.reading.motion.step).ray
    with np.errstate(invalid="ignore"):
        sky = ~bench.solid | (found.reading.depth.inverse(bench.stored, ray) <= 0)
    motion = bench.motion(found.reading.motion)
    static = bench.static(found.reading.camera, found.reading.depth, found.reading.motion.step)
    sky &= np.isfinite(motion).all(-1) & np.isfinite(static).all(-1)
    turning = sky & (np.linalg.norm(static, axis=-1) > _VISIBLE)
    if turning.sum() < 16 or found.reading.motion.adds_camera:
        return
    if np.median(np.linalg.norm(motion[turning], axis=-1)) < _SKY_STILL:
        found.findings.append(finding("motion: sky without motion"))


def _judge_colors(found: Diagnosis) -> None:
    votes = display_curve_votes(found.looks)
    if votes.verdict:
        entry = "color: display values" + ("" if votes.verdict == "display values" else "/perhaps")
        found.findings.append(finding(entry, votes._asdict(), share=votes.share, telling=votes.telling))


def _tell_unknown(found: Diagnosis, search: Search) -> None:
    """Report the properties that a static or only turning camera leaves open."""
    reading, bench = found.reading, search.full
    still = np.zeros(len(bench.px))
    reach = bench.reach(reading.camera, PREVIOUS)
    turned = np.linalg.norm(reach.pixels(still) - bench.px, axis=-1)
    with np.errstate(invalid="ignore"):
        shifted = np.linalg.norm(
            bench.static(reading.camera, reading.depth) - (reach.pixels(still) - bench.px), axis=-1
        )
    use = bench.solid & np.isfinite(shifted) & np.isfinite(turned)
    if not use.any():
        return
    if np.quantile(shifted[use], 0.9) < _VISIBLE:
        still = np.quantile(turned[use], 0.9) < _VISIBLE
        found.findings.append(finding("camera: still camera" if still else "depth: rotation only"))
