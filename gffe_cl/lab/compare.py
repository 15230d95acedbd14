"""Comparison of extrapolated frames with ground truth, by one definition for every command."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gffe_cl.captures.sequence import FrameEntry, Sequence
from gffe_cl.captures.sequence.reader import read_ahead
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.frame.rendered_frame import is_shown_whole
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.stages.presentation import present
from gffe_cl.lab.metrics import METRICS, measurable, to_display

NO_HISTORY = 2  # rendered frames after a reset, itself included, that are followed by no counted frame
_THREADS = 2


@dataclass
class FrameScore:
    """Metrics of one frame: `values` by name, NaN where one is not defined (an empty mask, a tiny image)."""

    time: float
    file: str
    truth: str
    values: dict[str, float]
    counted: bool  # whether the means include it


@dataclass
class SequenceComparison:
    """Scores of all matched frames, by time; `notes` are sentences about the means."""

    frames: list[FrameScore]
    notes: list[str] = field(default_factory=list)

    @property
    def mean(self) -> dict[str, float]:
        """The mean of every metric by name, over the counted frames where it is defined; NaN where there are none."""
        return {name: self._mean(name) for name in METRICS}

    def to_json(self) -> dict:
        """Return {"mean": {"psnr", "ssim", …}, "frames": [{"time", "file", "truth", "psnr", "ssim", …, "counted"},
        …]}, and "notes" if there are any. Undefined or unavailable values are null."""
        document = {
            "mean": _nulls(self.mean),
            "frames": [
                {"time": frame.time, "file": frame.file, "truth": frame.truth}
                | _nulls({name: frame.values.get(name, float("nan")) for name in METRICS})
                | {"counted": frame.counted}
                for frame in self.frames
            ],
        }
        return {**document, "notes": list(self.notes)} if self.notes else document

    def _mean(self, name: str) -> float:
        values = [frame.values.get(name, float("nan")) for frame in self.frames if frame.counted]
        values = [value for value in values if not math.isnan(value)]
        return float(np.mean(values)) if values else float("nan")


@dataclass
class _Pair:
    entry: FrameEntry  # of A; a rendered one for the baseline
    truth: FrameEntry
    counted: bool


def compare(
    a: Sequence,
    b: Sequence,
    mask: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SequenceComparison:
    """Compare the extrapolated frames of `a` with the ground truth of `b`, and return their scores.

    Frames are matched by `Sequence.at`. The means leave out the frames that follow the first two rendered frames after
    a reset of `a`, the reset included (cuts that `gffe run` found are such resets, with a note); if nothing else is
    left they are over all frames, with a note. Display values take `b`'s exposure.

    Parameters
    ----------
    mask : str or None
        A channel of `a`'s frames: metrics are over the pixels where it is not 0.
    progress : callable or None
        Called with (frames done, frames in all).

    Raises
    ------
    GffeError
        Different sizes, no frames that match, or a fault in a file.
    """
    if (a.width, a.height) != (b.width, b.height):
        raise GffeError(f"{a.path}: {a.width}×{a.height} pixels, expected {b.width}×{b.height} as in {b.path}")
    if not a.extrapolated:
        raise GffeError(f"{a.path}: no extrapolated frames to compare")
    if not b.ground_truth:
        raise GffeError(f"{b.path}: no ground truth to compare with")
    history = _History(a if a.rendered else b)
    pairs, missed = [], []
    for entry in a.extrapolated:
        truth = b.at("ground_truth", entry.time)
        if truth:
            pairs.append(_Pair(entry, truth, history.suffices(entry)))
        elif text := b.near_miss("ground_truth", entry.time):
            missed.append(f"{entry.file} is left out (times rounded?): {text}")
    if not pairs:
        near = b.nearest("ground_truth", a.extrapolated[0].time)
        assert near is not None  # there is ground truth
        raise GffeError(
            f"{a.path}: no extrapolated frame has ground truth in {b.path} (expected times within 1/50 of an interval:"
            f" {a.extrapolated[0].file} is at {a.extrapolated[0].time:.6g} s, the nearest is at {near.time:.6g} s)"
        )
    notes = [missed[0] + (f"; {len(missed) - 1} more" if missed[1:] else "")] if missed else []
    notes += _resets_of_its_own(a, b)
    return _score(pairs, a, b, mask, progress, notes=notes)


def baseline_repeat(
    sequence: Sequence, progress: Callable[[int, int], None] | None = None, device: Device | None = None
) -> SequenceComparison:
    """Compare the last rendered frame, shown again, with each ground-truth frame of the same sequence, and return the
    scores.

    This is the lower bound for any extrapolation, by the definition of `compare`. Frames rendered through a window are
    presented on `device` (the default one if None). Raises GffeError.
    """
    rendered = sequence.rendered
    history = _History(sequence)
    pairs = []
    for truth in sequence.ground_truth:
        index = sequence.rendered_before(truth.time)
        if index is not None:
            pairs.append(_Pair(rendered[index], truth, history.suffices(rendered[index])))
    if not pairs:
        raise GffeError(f"{sequence.path}: no ground truth after a rendered frame")
    return _score(pairs, sequence, sequence, None, progress, device)


def shown_color(sequence: Sequence, entry: FrameEntry, device: Device | None = None) -> np.ndarray:
    """Return linear RGB (H, W, 3) of a frame as displayed: the display part of a frame rendered through a window."""
    size = (sequence.width, sequence.height)
    cameras: Any = entry.render_camera, entry.display_camera  # a rendered frame has both
    if entry.kind != "rendered" or (sequence.size_of(entry) == size and is_shown_whole(*cameras)):
        return sequence.read_color(entry)
    return present(sequence.read(entry), size=size, device=device).color


def _score(pairs, a, b, mask, progress, device=None, notes=()) -> SequenceComparison:
    metrics = measurable()  # slow imports: once, before the threads
    notes = list(notes)
    if a.exposure != b.exposure:
        notes.append(f"exposure {b.exposure:g} of {b.path} is used for both ({a.exposure:g} in {a.path})")
    if not any(pair.counted for pair in pairs):
        notes.append("means are over all frames: none has two rendered frames of history")
        for pair in pairs:
            pair.counted = True

    def score(pair):
        shown = to_display(shown_color(a, pair.entry, device), b.exposure)
        truth = to_display(b.read_color(pair.truth), b.exposure)
        if shown.shape != truth.shape:
            raise GffeError(
                f"{pair.entry.file}: {shown.shape[1]}×{shown.shape[0]} pixels,"
                f" expected {truth.shape[1]}×{truth.shape[0]} as in {pair.truth.file}"
            )
        pixels = a.read_channels(pair.entry, [mask])[mask] if mask else None
        return {metric.name: metric.measure(shown, truth, pixels) for metric in metrics}

    frames = []
    for pair, values in read_ahead(pairs, score, _THREADS):
        time = pair.truth.time if pair.entry.kind == "rendered" else pair.entry.time
        frames.append(FrameScore(time, pair.entry.file, pair.truth.file, values, pair.counted))
        if progress:
            progress(len(frames), len(pairs))
    return SequenceComparison(frames, notes)


class _History:
    """Rendered frames with enough frames before them, so that the frames after them count."""

    def __init__(self, sequence: Sequence):
        self._sequence, self._files, self._since_reset = sequence, {}, []
        since = 0
        for index, entry in enumerate(sequence.rendered):
            since = 0 if entry.reset else since + 1
            self._files[entry.file] = index
            self._since_reset.append(since)

    def suffices(self, entry: FrameEntry) -> bool:
        """Return whether the frame has enough frames before it: its source if it names one, else the last rendered
        frame before it."""
        index = self._files.get(entry.file if entry.kind == "rendered" else entry.source)
        if index is None:
            index = self._sequence.rendered_before(entry.time)
        return index is not None and self._since_reset[index] >= NO_HISTORY


def _resets_of_its_own(a: Sequence, b: Sequence) -> list[str]:
    """Return a note if `a` has resets that `b` lacks, such as cuts found by `gffe run`: then the means leave out other
    frames."""
    same = ((entry, b.at("rendered", entry.time)) for entry in a.rendered[1:] if entry.reset)
    found = [entry for entry, other in same if other and not other.reset]
    if not found:
        return []
    more = f" and {len(found) - 1} more" if found[1:] else ""
    return [f"{found[0].file}{more}: reset in {a.path}, not in {b.path}; the means leave out the frames right after it"]


def _nulls(values: dict[str, float]) -> dict[str, float | None]:
    return {name: None if math.isnan(value) else value for name, value in values.items()}
