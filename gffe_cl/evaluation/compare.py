"""Measuring extrapolated frames against ground truth, by one definition for every command (design §6)."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import numpy as np

from gffe_cl.errors import GffeError
from gffe_cl.frame import is_shown_whole
from gffe_cl.metrics import RegionErrors, display_values, focus_mask, psnr, ssim
from gffe_cl.opencl.device import Device
from gffe_cl.sequence import FrameEntry, Sequence
from gffe_cl.sequence.read_ahead import read_ahead
from gffe_cl.stages.presentation import present

_THREADS = 2
_NO_HISTORY = 2  # rendered frames after a reset, itself included, that are followed by no counted frame
FOCUS = "focus"  # the mask of pixels whose shading is wrong without shading correction
_SAME_TIME = 1e-3  # of 1/fps: times closer than this are one


@dataclass
class FrameScore:
    """Metrics of one frame. `psnr` is in dB; it is NaN for an empty mask, `ssim` for a tiny image."""

    time: float
    file: str
    truth: str
    psnr: float
    ssim: float
    counted: bool  # whether the means include it


@dataclass
class Comparison:
    """Scores of all matched frames, by time; `notes` are sentences about how the means came about; `regions`, for the
    mask "focus", figures pooled over the counted frames (`RegionErrors.figures`)."""

    frames: list[FrameScore]
    notes: list[str] = field(default_factory=list)
    regions: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def psnr(self) -> float:
        """Mean over the counted frames, dB."""
        return self._mean("psnr")

    @property
    def ssim(self) -> float:
        """Mean over the counted frames."""
        return self._mean("ssim")

    def to_json(self) -> dict:
        """{"mean": {"psnr", "ssim"}, "frames": [{"time", "file", "truth", "psnr", "ssim", "counted"}, …]},
        "notes" and "regions" where there are any; what is undefined is null."""
        document = {
            "mean": {"psnr": _or_null(self.psnr), "ssim": _or_null(self.ssim)},
            "frames": [
                {**asdict(frame), "psnr": _or_null(frame.psnr), "ssim": _or_null(frame.ssim)} for frame in self.frames
            ],
        }
        if self.regions:
            document["regions"] = {
                region: {name: _or_null(value) for name, value in figures.items()}
                for region, figures in self.regions.items()
            }
        return {**document, "notes": list(self.notes)} if self.notes else document

    def _mean(self, name) -> float:
        values = [getattr(frame, name) for frame in self.frames if frame.counted]
        values = [value for value in values if not math.isnan(value)]
        return float(np.mean(values)) if values else float("nan")


@dataclass
class _Pair:
    entry: FrameEntry  # of A; a rendered one for the baseline
    truth: FrameEntry
    counted: bool
    gae: FrameEntry | None = None  # of the sequence without shading correction


def compare(
    a: Sequence,
    b: Sequence,
    mask: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    gae: Sequence | None = None,
) -> Comparison:
    """Extrapolated frames of `a` against ground truth of `b`.

    Frames match whose times are within a quarter of the smallest step between frames of either sequence. The
    means leave out the frames that follow the first two rendered frames after a reset, the reset included;
    if nothing else is left they are over all frames, with a note. Display values take `b`'s exposure.

    Parameters
    ----------
    mask : str or None
        A channel of `a`'s frames: PSNR is over the pixels where it is not 0, SSIM over the whole frame. "focus" means
        the pixels whose shading is wrong in `gae`: `focus_mask`, less what is disoccluded.
    progress : callable or None
        Called with (frames done, frames in all).
    gae : Sequence or None
        For "focus": what `a` is without shading correction; `a` itself if None.

    Raises
    ------
    GffeError
        Different sizes, no frames that match, or a fault in a file.
    """
    _require_same_size(a, b)
    if not a.extrapolated:
        raise GffeError(f"{a.path}: no extrapolated frames to compare")
    if not b.ground_truth:
        raise GffeError(f"{b.path}: no ground truth to compare with")
    tolerance = _smallest_step(a, b) / 4
    history = _History(a if a.rendered else b)
    pairs = []
    for entry in a.extrapolated:
        truth = min(b.ground_truth, key=lambda t: abs(t.time - entry.time))
        if abs(truth.time - entry.time) <= tolerance:
            pairs.append(_Pair(entry, truth, history.suffices(entry)))
    if not pairs:
        raise GffeError(
            f"{a.path}: no extrapolated frame has ground truth in {b.path}"
            f" (expected times within {tolerance:.3g} s of each other)"
        )
    if gae is not None:
        _require_same_size(gae, b)
        for pair in pairs:
            pair.gae = min(gae.extrapolated, key=lambda e: abs(e.time - pair.entry.time), default=None)
            if pair.gae is None or abs(pair.gae.time - pair.entry.time) > tolerance:
                raise GffeError(f"{gae.path}: no extrapolated frame at {pair.entry.time:.6g} s, as {a.path} has")
    return _score(pairs, a, b, mask, progress, gae=gae)


def baseline_repeat(
    sequence: Sequence, progress: Callable[[int, int], None] | None = None, device: Device | None = None
) -> Comparison:
    """The last rendered frame, shown again, against each ground-truth frame of the same sequence.

    The floor of any extrapolation, by the definition of `compare`. Frames rendered through a window are presented on
    `device` (the default one if None). Raises GffeError.
    """
    rendered = sequence.rendered
    times = [entry.time for entry in rendered]
    history = _History(sequence)
    pairs = []
    for truth in sequence.ground_truth:
        index = bisect_right(times, truth.time) - 1
        if index >= 0:
            pairs.append(_Pair(rendered[index], truth, history.suffices(rendered[index])))
    if not pairs:
        raise GffeError(f"{sequence.path}: no ground truth after a rendered frame")
    return _score(pairs, sequence, sequence, None, progress, device)


def shown_color(sequence: Sequence, entry: FrameEntry, device: Device | None = None) -> np.ndarray:
    """Linear RGB (H, W, 3) of a frame as displayed: the display part of a frame rendered through a window."""
    size = (sequence.width, sequence.height)
    if entry.kind != "rendered" or (
        sequence.size_of(entry) == size and is_shown_whole(entry.render_camera, entry.display_camera)
    ):
        return sequence.read_color(entry)
    return present(sequence.read(entry), size=size, device=device).color


def _score(pairs, a, b, mask, progress, device=None, gae=None) -> Comparison:
    import skimage.metrics  # noqa: F401  slow to import: once, before the threads

    notes = []
    if a.exposure != b.exposure:
        notes.append(f"exposure {b.exposure:g} of {b.path} is used for both ({a.exposure:g} in {a.path})")
    if not any(pair.counted for pair in pairs):
        notes.append("means are over all frames: none has two rendered frames of history")
        for pair in pairs:
            pair.counted = True

    if mask == FOCUS and gae is None:
        notes.append(f"focus pixels are those of {a.path} itself: give the sequence without shading correction")

    def score(pair):
        shown = display_values(shown_color(a, pair.entry, device), b.exposure)
        truth = display_values(b.read_color(pair.truth), b.exposure)
        if shown.shape != truth.shape:
            raise GffeError(
                f"{pair.entry.file}: {shown.shape[1]}×{shown.shape[0]} pixels,"
                f" expected {truth.shape[1]}×{truth.shape[0]} as in {pair.truth.file}"
            )
        errors = RegionErrors()
        if mask == FOCUS:
            regions = _regions(pair, a, b, gae)
            errors.add(shown, truth, regions)
            pixels = regions[FOCUS]
        else:
            pixels = a.read_channels(pair.entry, [mask])[mask] if mask else None
        return psnr(shown, truth, pixels), ssim(shown, truth), errors

    frames, counted = [], []
    for pair, (decibel, similarity, errors) in read_ahead(pairs, score, _THREADS):
        if pair.counted:
            counted.append(errors)
        frames.append(
            FrameScore(
                pair.truth.time if pair.entry.kind == "rendered" else pair.entry.time,
                pair.entry.file,
                pair.truth.file,
                decibel,
                similarity,
                pair.counted,
            )
        )
        if progress:
            progress(len(frames), len(pairs))
    return Comparison(frames, notes, RegionErrors.pooled(counted).figures())


def _regions(pair: _Pair, a: Sequence, b: Sequence, gae: Sequence | None) -> dict[str, np.ndarray]:
    masks = a.read_channels(pair.entry, ["mask.dynamic", "mask.disoccluded"])
    color = gae.read_color(pair.gae) if gae else a.read_color(pair.entry)
    focus = focus_mask(color, b.read_color(pair.truth), masks["mask.dynamic"], b.exposure)
    return shading_regions(focus, masks["mask.disoccluded"])


def shading_regions(focus: np.ndarray, disoccluded: np.ndarray) -> dict[str, np.ndarray]:
    """Where shading correction is measured, masks (H, W): "focus" less disocclusions, these, and the "whole" frame."""
    holes = disoccluded != 0
    return {FOCUS: focus & ~holes, "disoccluded": holes, "whole": np.ones(focus.shape, bool)}


class _History:
    """Which rendered frames have enough before them for what follows them to be counted."""

    def __init__(self, sequence: Sequence):
        self._times, self._files, self._since_reset = [], {}, []
        since = 0
        for index, entry in enumerate(sequence.rendered):
            since = 0 if entry.reset else since + 1
            self._times.append(entry.time)
            self._files[entry.file] = index
            self._since_reset.append(since)
        self._slack = _SAME_TIME / sequence.fps

    def suffices(self, entry: FrameEntry) -> bool:
        """By the frame's source if it names one, else by the last rendered frame before it."""
        index = self._files.get(entry.file if entry.kind == "rendered" else entry.source)
        if index is None:
            index = bisect_right(self._times, entry.time - self._slack) - 1
        return index >= 0 and self._since_reset[index] >= _NO_HISTORY


def _smallest_step(*sequences: Sequence) -> float:
    """Seconds; the smallest difference between successive times within one sequence."""
    steps = []
    for sequence in sequences:
        times = np.sort([entry.time for entry in sequence.frames])
        steps += [step for step in np.diff(times) if step > _SAME_TIME / sequence.fps]
    return float(min(steps)) if steps else 1 / max(sequence.fps for sequence in sequences)


def _require_same_size(a: Sequence, b: Sequence) -> None:
    if (a.width, a.height) != (b.width, b.height):
        raise GffeError(f"{a.path}: {a.width}×{a.height} pixels, expected {b.width}×{b.height} as in {b.path}")


def _or_null(value: float) -> float | None:
    return None if math.isnan(value) else value
