"""Computation of one cell of the table: a method on a sequence, run, measured and timed."""

from __future__ import annotations

import io
import math
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache

import numpy as np

from gffe_cl.engine.opencl.device import Device, open_device
from gffe_cl.engine.timing.bench import Copier
from gffe_cl.lab.metrics import RegionErrors, measurable, psnr, ssim, to_display
from gffe_cl.lab.metrics.flicker import Flicker
from gffe_cl.lab.metrics.regions import REGIONS, masks
from gffe_cl.lab.report import error_image, to_image
from gffe_cl.lab.table.datasets import Footage, Moment, Shot, Subject, at_full_size, open_subject
from gffe_cl.lab.table.labels import find_labels
from gffe_cl.lab.table.methods import GIVEN, Method, chosen_methods
from gffe_cl.lab.table.pipelines import DeviceRunner, PipelineRunner
from gffe_cl.lab.table.videos import VIDEO_METRICS, measured_or_reason

_QUALITY = 90  # of pictures, WebP
_REGION_COLORS = np.array(
    [(230, 70, 60), (250, 160, 50), (250, 220, 70), (90, 200, 120), (70, 160, 250), (190, 110, 240), (40, 40, 44)]
)


@dataclass
class Cell:
    """Stored result of a cell: `document` for JSON, `pictures` (WebP) by name, and `timing`, which belongs to a
    machine."""

    document: dict
    pictures: dict[str, bytes] = field(default_factory=dict)
    timing: dict | None = None

    @property
    def errors(self) -> RegionErrors:
        """Errors by region, pooled over frames."""
        return RegionErrors(**self.document["errors"])


@lru_cache(maxsize=1)
def _device(name: str | None) -> Device:
    return open_device(name, profiling=True)


@lru_cache(maxsize=1)
def _bandwidth(name: str | None) -> float:
    """Return GB/s of copying, read and written: the median of a few."""
    copier = Copier(_device(name))
    return statistics.median(copier.bandwidth() for _ in range(5))


@lru_cache(maxsize=1)
def _footage(subject: Subject, device: str | None) -> Footage:
    """Return the footage of a subject. One at a time is cached: its cells are computed one after the other."""
    footage = open_subject(subject, _device(device))
    if subject.encoding:
        footage.labels = _exact_labels(replace(subject, encoding=""), device)
    else:
        footage.labels = list(find_labels(footage, _device(device)))
    return footage


@lru_cache(maxsize=1)
def _exact_labels(subject: Subject, device: str | None) -> list[np.ndarray]:
    """Return labels of the frames before they are encoded: all encodings are measured in the same regions."""
    return list(find_labels(open_subject(subject, _device(device)), _device(device)))


def machine_of(device: str | None) -> str:
    """Return the machine that times belong to."""
    info = _device(device).info
    return f"{info.name} ({info.platform})"


def compute_cell(
    subject: Subject,
    method: str | None,
    onnx: tuple[str, ...] = (),
    videos: tuple[str, ...] = (),
    device: str | None = None,
    network: tuple[str | None, str | None] = (None, None),
    on_moment: Callable[[], None] = lambda: None,
) -> Cell:
    """Return the cell of the method of that name; None for the values that all methods share. It may run in any
    process and opens its own OpenCL device. `videos`: names of `VIDEO_METRICS` to measure in addition."""
    footage = _footage(subject, device)
    if method is None:
        return _describe(footage)
    chosen = chosen_methods([method], onnx, network=network)[method]
    return _measure(footage, chosen, device, videos, on_moment)


def _describe(footage: Footage) -> Cell:
    """Return the description of a sequence: shares of the regions, and pictures of the moment that shows most of
    them."""
    counts = np.zeros(len(REGIONS), np.int64)
    for labels in footage.labels:
        counts += np.bincount(labels.ravel(), minlength=len(REGIONS))
    number = picture_of(footage)
    shot, moment = _moment_number(footage, number)
    images = {
        "truth": to_display(moment.truth, footage.exposure),
        "rendered": to_display(shot.shown, footage.exposure),
        "regions": _REGION_COLORS[footage.labels[number]] / 255,
    }
    shares = dict(zip(REGIONS, (counts / max(counts.sum(), 1)).tolist(), strict=True))
    document = {
        "size": [footage.width, footage.height],
        "exact": footage.exact,
        "moments": len(footage.labels),
        "shares": shares,
        "picture": {"time": moment.time, "alpha": moment.alpha, "turn": moment.turn},
    }
    return Cell(document, {name: _webp(image) for name, image in images.items()})


def picture_of(footage: Footage) -> int:
    """Return the number of the moment for pictures: the one with the fewest pixels of "rest"."""
    interesting = [np.count_nonzero(labels != len(REGIONS) - 1) for labels in footage.labels]
    return int(np.argmax(interesting))


def _measure(
    footage: Footage, method: Method, device: str | None, videos: Iterable[str], on_moment: Callable[[], None]
) -> Cell:
    runner, clock = method.runner(footage, _device(device)), _Clock()
    metrics, picture = measurable(), picture_of(footage)
    frames, errors, flicker, pictures = [], [], Flicker(), {}
    shown_all: list[tuple[np.ndarray, np.ndarray, bool]] = []
    upscaled: list[dict[str, float]] = []
    ui = footage.encoding.user_interface((footage.width, footage.height))
    parts = {} if ui is None else {"ui_psnr": ui[..., 3] > 0, "scene_psnr": ui[..., 3] == 0}
    number = 0
    for shot in footage.shots(method.window):
        given = shot if isinstance(runner, PipelineRunner) else at_full_size(shot)
        with _lap(clock.submits):
            runner.submit(given)
        if not shot.moments:
            flicker.cut()
            _finish(runner)
            continue
        in_order = footage.knows_rendered and not any(moment.turn for moment in shot.moments)
        if in_order:
            pair = _rendered_pair(footage, runner, shot)
            flicker.add(*pair)
            if videos:
                shown_all.append((*pair, False))
            if footage.upscale or method.window not in (GIVEN, "off"):
                upscaled.append({"rendered_psnr": psnr(*pair), "rendered_ssim": ssim(*pair)})
        for moment in shot.moments:
            _finish(runner)
            with _lap(clock.makes):
                color = runner.make(moment)
            shown, truth = (to_display(c, footage.exposure) for c in (color, moment.truth))
            one = RegionErrors()
            one.add(shown, truth, masks(footage.labels[number]), metrics)
            errors.append(one)
            row = {metric.name: _number(one.figure(metric.name, "whole")) for metric in metrics}
            row["flicker"] = flicker.add(shown, truth) if in_order else None
            row |= {name: _number(psnr(shown, truth, part)) for name, part in parts.items()}
            frames.append({"time": moment.time, "alpha": moment.alpha, "turn": moment.turn} | row)
            if number == picture:
                pictures = {"shown": _webp(shown), "error": _webp(error_image(shown, truth))}
            if videos:
                shown_all.append((shown, truth, True))
            number += 1
            on_moment()
    figures, skipped = _videos(videos, shown_all, footage)
    document = {
        "frames": frames,
        "errors": asdict(RegionErrors.pooled(errors)),
        "flicker": _number(flicker.mean),
        "rendered": {name: float(np.mean([row[name] for row in upscaled])) for name in upscaled[0]} if upscaled else {},
        "videos": figures,
        "skipped": skipped,
        "device": machine_of(device),
    }
    return Cell(document, pictures, clock.timing(footage, runner, device))


def _rendered_pair(footage: Footage, runner, shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """Return display values of a rendered frame as the method shows it, and as it is."""
    truth = to_display(shot.shown, footage.exposure)
    present = getattr(runner, "present", None)
    return (to_display(present(), footage.exposure) if present else truth), truth


def _videos(names: Iterable[str], frames: list[tuple], footage: Footage) -> tuple[dict, dict]:
    figures, skipped = {}, {}
    for name in names:
        metric = VIDEO_METRICS[name]
        if not (metric.generated_only or footage.knows_rendered):
            skipped[name] = f"{metric.label} needs the truth of rendered frames"
            continue
        used = [frame for frame in frames if frame[2] or not metric.generated_only]
        shown, truth = ([frame[k] for frame in used] for k in (0, 1))
        per_rendered = len(frames) / max(sum(not made for _, _, made in frames), 1)
        value, reason = measured_or_reason(metric, shown, truth, footage.fps * per_rendered)
        if reason:
            skipped[name] = reason
        else:
            figures[name] = value
    return figures, skipped


@dataclass
class _Clock:
    """Milliseconds of wall time of submitting a rendered frame, and of making a new one."""

    submits: list[float] = field(default_factory=list)
    makes: list[float] = field(default_factory=list)

    def timing(self, footage: Footage, runner, device: str | None) -> dict:
        """Return medians for one rendered frame with one new one, and bytes per pixel: time × bandwidth ÷ pixels."""
        submit = _median(self.submits[1:])
        wall = milliseconds = submit + _median(self.makes[1:])
        of = "wall time"
        if isinstance(runner, DeviceRunner):
            milliseconds, of = _median(runner.milliseconds[1:]), "kernels and network"
        bandwidth = _bandwidth(device)
        figures = {
            "wall": wall,
            "submit": submit,
            "milliseconds": milliseconds,
            "bandwidth": bandwidth,
            "bytes_per_pixel": milliseconds * bandwidth * 1e6 / (footage.width * footage.height),
        }
        return {"machine": machine_of(device), "of": of} | {name: _number(value) for name, value in figures.items()}


@contextmanager
def _lap(into: list[float]) -> Iterator[None]:
    """Append the milliseconds that the block takes."""
    start = time.perf_counter()
    yield
    into.append(1e3 * (time.perf_counter() - start))


def _finish(runner) -> None:
    """Wait until a device has finished its work for the rendered frame."""
    if isinstance(runner, DeviceRunner):
        runner.finish()


def _moment_number(footage: Footage, number: int) -> tuple[Shot, Moment]:
    for shot in footage.shots():
        if number < len(shot.moments):
            return shot, shot.moments[number]
        number -= len(shot.moments)
    raise IndexError(number)


def _median(values: list[float]) -> float:
    return statistics.median(values) if values else float("nan")


def _number(value: float | None) -> float | None:
    """Return the value for JSON: None for NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


def _webp(image: np.ndarray) -> bytes:
    stream = io.BytesIO()
    to_image(image).save(stream, "WEBP", quality=_QUALITY, method=4)
    return stream.getvalue()
