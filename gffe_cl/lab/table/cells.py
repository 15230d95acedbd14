"""Cells of the table: a method on a sequence, run, measured and timed; the cache of them on disk; and results, one
document from which console, JSON, CSV and documentation are made.

Cells are found by a hash of everything that they depend on, and are always complete on disk.
"""

from __future__ import annotations

import csv
import datetime
import hashlib
import importlib
import io
import json
import math
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import read_bounded, replacing
from gffe_cl.engine.core.public_names import __version__
from gffe_cl.engine.opencl.device import device_of_process
from gffe_cl.engine.opencl.program import package_digest
from gffe_cl.lab.cluster import Cluster
from gffe_cl.lab.metrics import (
    METRICS,
    REGIONS,
    Figure,
    Flicker,
    RegionErrors,
    masks,
    measurable,
    measured_or_reason,
    to_display,
)
from gffe_cl.lab.table.footage import (
    FolderSubject,
    Footage,
    SceneSubject,
    Shot,
    Subject,
    find_labels,
    open_subject,
)
from gffe_cl.lab.table.methods import FULL, GAINS, DeviceRunner, Method, PipelineRunner, chosen_methods

_VERSION = 3
_MOST_BYTES = 64 << 20  # of a file


@dataclass
class Cell:
    """Stored result of a cell: `document` for JSON, and `timing`, which belongs to a machine."""

    document: dict
    timing: dict | None = None

    @property
    def errors(self) -> RegionErrors:
        """Errors by region, pooled over frames."""
        return RegionErrors(**self.document["errors"])


# ---- metrics of whole sequences -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class VideoMetric(Figure):
    """Metric of a whole sequence, by a network of its own: optional and slow, and skipped with the reason where it
    cannot run. `measure(shown, truth, fps)` takes lists of display values (H, W, 3), rendered and
    generated frames in the order of display, and the rate of display in frames per second; generated frames alone if
    `generated_only`."""

    measure: Callable[[list[np.ndarray], list[np.ndarray], float], float]
    generated_only: bool = False


def _difference(package: str, metric: str, shown, truth, fps) -> float:
    """Return the figure of a metric of that package, in just-objectionable differences."""
    made = getattr(importlib.import_module(package), metric)(display_name="standard_fhd", heatmap=None)
    volumes = (np.stack(images).astype(np.float32) for images in (shown, truth))
    return float(made.predict(*volumes, dim_order="FHWC", frames_per_second=fps)[0])


def _lpips(shown, truth, fps) -> float:
    import lpips  # pyright: ignore[reportMissingImports]  # an extra
    import torch

    network = lpips.LPIPS(net="alex", verbose=False)
    values = []
    with torch.no_grad():
        for a, b in zip(shown, truth, strict=True):
            pair = [torch.from_numpy(image.transpose(2, 0, 1)[None] * 2 - 1).float() for image in (a, b)]
            values.append(float(network(*pair)))
    return float(np.mean(values))


VIDEO_METRICS = {
    metric.name: metric
    for metric in (
        VideoMetric("fvvdp", "FovVideoVDP", "JOD", measure=partial(_difference, "pyfvvdp", "fvvdp")),
        VideoMetric("cvvdp", "ColorVideoVDP", "JOD", measure=partial(_difference, "pycvvdp", "cvvdp")),
        VideoMetric("lpips", "LPIPS", digits=4, higher_is_better=False, measure=_lpips, generated_only=True),
    )
}


# ---- computing ---------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _footage(subject: Subject, device: str | None) -> Footage:
    """Return the footage of a subject. One at a time is cached: its cells are computed one after the other."""
    footage = open_subject(subject, device_of_process(device))
    footage.labels = list(find_labels(footage, device_of_process(device)))
    return footage


def machine_of(device: str | None) -> str:
    """Return the machine that times belong to."""
    info = device_of_process(device).info
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
    """Return the cell of the method of that name; None for the values that all methods share. `videos`: names of
    `VIDEO_METRICS` to measure in addition."""
    footage = _footage(subject, device)
    if method is None:
        return _describe(footage)
    chosen = chosen_methods([method], onnx, network)[method]
    return _measure(footage, chosen, device, videos, on_moment)


def cell_on_worker(_, scene: dict | None, folder: list, method: str | None, onnx: list, model: Any, **rest) -> dict:
    """Return the cell of `compute_cell`, or why there is none, for JSON. Subject and networks are as in `_sent`."""
    made: Any = scene and scene | {"alphas": tuple(scene["alphas"])}
    subject = SceneSubject(**made) if scene else FolderSubject(*folder)
    networks, provider = tuple(f"{name}={path}" for name, path in onnx), rest.pop("provider")
    try:
        return vars(compute_cell(subject, method, networks, network=(model and str(model), provider), **rest))
    except GffeError as error:
        return {"error": str(error)}


def _sent(work: Work, order: TableOrder, device: str | None) -> dict:
    """Return the arguments of `cell_on_worker`: paths are those of files that travel."""
    subject, (model, provider) = work.subject, order.network
    return {
        "scene": asdict(subject) if isinstance(subject, SceneSubject) else None,
        "folder": [Path(subject.path), subject.moments] if isinstance(subject, FolderSubject) else [],
        "method": work.method,
        "onnx": [(name, Path(path)) for name, _, path in (text.partition("=") for text in order.onnx)],
        "model": model and Path(model),
        "provider": provider,
        "videos": order.videos,
        "device": device,
    }


def _describe(footage: Footage) -> Cell:
    """Return the description of a sequence, with the shares of the regions."""
    counts = np.zeros(len(REGIONS), np.int64)
    for labels in footage.labels:
        counts += np.bincount(labels.ravel(), minlength=len(REGIONS))
    document = {
        "size": [footage.width, footage.height],
        "exact": footage.exact,
        "moments": len(footage.labels),
        "shares": dict(zip(REGIONS, (counts / max(counts.sum(), 1)).tolist(), strict=True)),
    }
    return Cell(document)


def _measure(
    footage: Footage, method: Method, device: str | None, videos: Iterable[str], on_moment: Callable[[], None]
) -> Cell:
    runner = method.runner(footage, device_of_process(device))
    clock, metrics, flicker = _Clock(), measurable(), Flicker()
    frames, errors = [], []
    shown_all: list[tuple[np.ndarray, np.ndarray, bool]] = []
    for shot in footage.shots(method.window):
        with _lap(clock.submits):
            runner.submit(shot)
        if not shot.moments:
            flicker.cut()
            _finish(runner)
            continue
        pair = _rendered_pair(footage, runner, shot)
        flicker.add(*pair)
        if videos:
            shown_all.append((*pair, False))
        for moment in shot.moments:
            _finish(runner)
            with _lap(clock.makes):
                color = runner.make(moment)
            shown, truth = (to_display(c, footage.exposure) for c in (color, moment.truth))
            one = RegionErrors()
            one.add(shown, truth, masks(footage.labels[len(errors)]), metrics)
            errors.append(one)
            row = {metric.name: finite(one.figure(metric.name, "whole")) for metric in metrics}
            row["flicker"] = flicker.add(shown, truth)
            frames.append({"time": moment.time, "alpha": moment.alpha} | row)
            if videos:
                shown_all.append((shown, truth, True))
            on_moment()
    figures, skipped = _videos(videos, shown_all, footage)
    document = {
        "frames": frames,
        "errors": asdict(RegionErrors.pooled(errors)),
        "flicker": finite(flicker.mean),
        "videos": figures,
        "skipped": skipped,
    }
    return Cell(document, {"machine": machine_of(device)} | clock.timing(runner))


def _rendered_pair(footage: Footage, runner, shot: Shot) -> tuple[np.ndarray, np.ndarray]:
    """Return display values of a rendered frame as the method shows it, and as it is."""
    truth = to_display(shot.shown, footage.exposure)
    shown = to_display(runner.present(), footage.exposure) if isinstance(runner, PipelineRunner) else truth
    return shown, truth


def _videos(names: Iterable[str], frames: list[tuple], footage: Footage) -> tuple[dict, dict]:
    figures, skipped = {}, {}
    for name in names:
        metric = VIDEO_METRICS[name]
        used = [frame for frame in frames if frame[2] or not metric.generated_only]
        shown, truth = ([frame[k] for frame in used] for k in (0, 1))
        per_rendered = len(frames) / max(sum(not made for _, _, made in frames), 1)
        value, reason = measured_or_reason(metric.measure, shown, truth, footage.fps * per_rendered)
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

    def timing(self, runner) -> dict:
        """Return the milliseconds of one rendered frame with one new one: the median, and what they are of."""
        if isinstance(runner, DeviceRunner):
            return {"milliseconds": _median(runner.milliseconds[1:]), "of": "kernels and network"}
        submit, make = _median(self.submits[1:]), _median(self.makes[1:])
        return {"milliseconds": None if submit is None or make is None else submit + make, "of": "wall time"}


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


def _median(values: list[float]) -> float | None:
    return statistics.median(values) if values else None


def finite(value: float | None) -> float | None:
    """Return the value for JSON: None for NaN and infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


# ---- cache -------------------------------------------------------------------------------------------------------


class Cache:
    """Cache of cells in the folder `path`, as files named by their keys. Raises GffeError where it cannot be written
    to."""

    def __init__(self, path: Path):
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GffeError(f"{path}: cannot be made ({error.strerror or error})") from None

    def read(self, key: str) -> Cell | None:
        """Return the cell; None if it is not there, or damaged."""
        try:
            document = json.loads(read_bounded(self.path / f"{key}.json", _MOST_BYTES))
            timing = document.pop("timing")
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return Cell(document, timing)

    def write(self, key: str, cell: Cell) -> None:
        try:
            with replacing(self.path / f"{key}.json") as part:
                part.write_text(json.dumps(cell.document | {"timing": cell.timing}, allow_nan=False), "utf-8")
        except OSError as error:
            raise GffeError(f"{self.path}: cannot be written to ({error.strerror or error})") from None


def key_of(subject: dict, method: dict | None) -> str:
    """Return the key of the cell of a method on a subject, by their identities and the sources of the program."""
    known = {
        "version": _VERSION,
        "subject": subject,
        "method": method,
        "package": package_digest(),
    }
    return hashlib.sha256(json.dumps(known, sort_keys=True, default=str).encode()).hexdigest()[:32]


# ---- filling -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Work:
    """A cell to compute; `method` None stands for the description of the sequence."""

    subject: Subject
    method: str | None
    key: str


@dataclass
class Filled:
    """The table: cells by (name of the sequence, name of the method), the description of each sequence, and reasons
    for missing cells; `broken`: reasons by name for sequences that cannot be measured; `computed`: number of cells
    not taken from the cache."""

    methods: dict[str, Method]
    subjects: list[Subject]
    machine: str
    cells: dict[tuple[str, str], Cell] = field(default_factory=dict)
    described: dict[str, Cell] = field(default_factory=dict)
    skipped: dict[tuple[str, str], str] = field(default_factory=dict)
    broken: dict[str, str] = field(default_factory=dict)
    computed: int = 0

    def drop(self, name: str, reason: str) -> None:
        """Leave out a sequence that cannot be measured."""
        self.broken.setdefault(name, reason)
        self.subjects = [subject for subject in self.subjects if subject.name != name]
        self.described.pop(name, None)
        for table in (self.cells, self.skipped):
            for key in [key for key in table if key[0] == name]:
                del table[key]


@dataclass(frozen=True)
class TableOrder:
    """Requested evaluation. `methods`, `onnx`, `network` as of `chosen_methods`; `videos`: names of `VIDEO_METRICS`;
    `recompute`: ignore cached cells."""

    subjects: tuple[Subject, ...]
    methods: tuple[str, ...] | None = None
    onnx: tuple[str, ...] = ()
    videos: tuple[str, ...] = ()
    recompute: bool = False
    network: tuple[str | None, str | None] = (None, None)


def fill(
    order: TableOrder,
    folder: Path,
    device: str | None = None,
    on_plan: Callable[[int], Callable[[], None]] = lambda total: lambda: None,
    cluster: Cluster | None = None,
) -> Filled:
    """Fill the table, on the workers of a cluster if there is one, and return it; cells are cached in `folder`.
    `on_plan` takes the number of moments to come and returns a function that is called after each of them. Finished
    cells survive an interrupt. Sequences with faults are left out. Raises GffeError if all have faults."""
    names = [subject.name for subject in order.subjects]
    if len(set(names)) < len(names):
        raise GffeError(f"eval: two sequences have one name, {next(n for n in names if names.count(n) > 1)}")
    methods = chosen_methods(order.methods, order.onnx, order.network)
    filled = Filled(methods, list(order.subjects), machine_of(device))
    cells, missing = Cache(folder), []
    for subject in order.subjects:
        try:
            identity = subject.identity()
        except OSError as error:
            filled.drop(subject.name, f"{error.filename}: {error.strerror or error}")
            continue
        for name in (None, *methods):
            method = methods[name] if name else None
            if method and name and (reason := method.missing(subject)):
                filled.skipped[subject.name, name] = reason
                continue
            work = Work(subject, name, key_of(identity, method and method.identity()))
            cell = None if order.recompute else cells.read(work.key)
            if cell and set(order.videos if method else ()) <= _tried(cell):
                _take(filled, work, cell)
            else:
                missing.append(work)
    advance = on_plan(sum(work.subject.moments for work in missing if work.method))
    answers = cluster.map(cell_on_worker, (_sent(work, order, device) for work in missing)) if cluster else None
    for work in missing:
        answer = next(answers)[0] if answers else {}
        if work.subject.name in filled.broken:
            continue
        try:
            if "error" in answer:
                raise GffeError(answer["error"])
            if answers:
                cell = Cell(**answer)
                for _ in range(work.subject.moments if work.method else 0):
                    advance()
            else:
                cell = compute_cell(
                    work.subject, work.method, order.onnx, order.videos, device, order.network, on_moment=advance
                )
        except GffeError as error:
            filled.drop(work.subject.name, str(error))
            continue
        cells.write(work.key, cell)
        filled.computed += 1
        _take(filled, work, cell)
    if filled.broken and not filled.subjects:
        raise GffeError("; ".join(f"{name}: {reason}" for name, reason in filled.broken.items()))
    return filled


def _tried(cell: Cell) -> set[str]:
    """Return the names of the video metrics that were measured, or could not be."""
    return {*cell.document.get("videos", {}), *cell.document.get("skipped", {})}


def _take(filled: Filled, work: Work, cell: Cell) -> None:
    if work.method is None:
        filled.described[work.subject.name] = cell
    else:
        filled.cells[work.subject.name, work.method] = cell


_PACKAGES = (
    "gffe-cl",
    "numpy",
    "pyopencl",
    "onnxruntime",
    "scikit-image",
    "flip-evaluator",
    "opencv-python-headless",
    "torch",
)

# The paper's averages over its eight scenes: its tables 'Quantitative' and 'Ablation study'.
PAPER = {
    "Ours Full": {"psnr": 24.20, "ssim": 0.8593, "lpips": 0.0967, "fvvdp": 7.65},
    "w/o ME": {"psnr": 23.44, "ssim": 0.8521, "lpips": 0.1036, "fvvdp": 7.57},
    "w/o BGC": {"psnr": 24.11, "ssim": 0.8591, "lpips": 0.0979, "fvvdp": 7.62},
    "w/o AW": {"psnr": 24.15, "ssim": 0.8591, "lpips": 0.0971, "fvvdp": 7.62},
    "w/o SCN": {"psnr": 23.93, "ssim": 0.8586, "lpips": 0.0923, "fvvdp": 7.60},
    "w/o FM": {"psnr": 23.86, "ssim": 0.8139, "lpips": 0.3563, "fvvdp": 7.49},
    "IFRNet (interpolation)": {"psnr": 24.24, "ssim": 0.8439, "lpips": 0.1801, "fvvdp": 7.17},
    "UPR-Net (interpolation)": {"psnr": 24.87, "ssim": 0.8495, "lpips": 0.2841, "fvvdp": 7.55},
    "ExtraSS-E (G-buffers)": {"psnr": 24.64, "ssim": 0.8793, "lpips": 0.1556, "fvvdp": 7.19},
    "DMVFN": {"psnr": 21.73, "ssim": 0.7609, "lpips": 0.2078, "fvvdp": 6.80},
}


_PSNR, *_OTHERS = METRICS.values()
_AGAINST = Figure("against", f"against {FULL}", "dB")
_FLICKER, _TIME = Figure("flicker", "flicker", "%", 2, False), Figure("milliseconds", "ms", "", 1, False)
COLUMNS = {c.name: c for c in (_PSNR, _AGAINST, *_OTHERS, _FLICKER, *VIDEO_METRICS.values(), _TIME)}


def results_of(filled: Filled, command: str = "") -> dict:
    """Return all results, for JSON. `command`: how it was made."""
    cells = [_cell(sequence, name, cell) for (sequence, name), cell in filled.cells.items()]
    full = {cell["sequence"]: cell["psnr"] for cell in cells if cell["method"] == FULL}
    for cell in cells:
        known = cell["method"] != FULL and cell["sequence"] in full
        cell["against"] = cell["psnr"] - full[cell["sequence"]] if known else None
    names = [subject.name for subject in filled.subjects]
    means = [mean for name in filled.methods if (mean := _mean(name, cells, filled, names))]
    present = [c for c in COLUMNS.values() if any(mean.get(c.name) is not None for mean in means)]
    return {
        "generator": f"gffe-cl {__version__}",
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "command": command,
        "versions": versions(),
        "machine": filled.machine,
        "columns": [
            {"name": c.name, "title": c.title, "digits": c.digits, "higher_is_better": c.higher_is_better}
            for c in present
        ],
        "regions": REGIONS,
        "methods": [{"name": m.name, "title": m.title, "group": m.group} for m in filled.methods.values()],
        "sequences": [{"name": name, **filled.described[name].document} for name in names],
        "cells": cells,
        "means": means,
        "gains": gains(filled),
        "skipped": _skipped(filled),
    }


def versions() -> dict[str, str]:
    """Return versions of Python and of the installed packages that figures depend on."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def gains(filled: Filled) -> list[dict]:
    """Return each of `GAINS`, pooled over the sequences that have both rows: the increase of PSNR in dB over the
    whole frame, over its region and in the mean of the frames, and the paper's gain."""
    found = []
    for gain in GAINS:
        both = [
            (filled.cells[s.name, gain.with_it], filled.cells[s.name, gain.without])
            for s in filled.subjects
            if (s.name, gain.with_it) in filled.cells and (s.name, gain.without) in filled.cells
        ]
        if not both:
            continue
        errors = [RegionErrors.pooled(cell.errors for cell in cells) for cells in zip(*both, strict=True)]
        row: dict[str, Any] = {
            "title": gain.title,
            "with": gain.with_it,
            "without": gain.without,
            "region": gain.region,
        }
        for key, region in (("whole", "whole"), ("in_region", gain.region)):
            row[key] = finite(errors[0].figure("psnr", region) - errors[1].figure("psnr", region))
        row["mean"] = float(np.mean([_average(a, "psnr") - _average(b, "psnr") for a, b in both]))
        row["paper"] = round(PAPER["Ours Full"]["psnr"] - PAPER[gain.paper]["psnr"], 2) if gain.paper else None
        found.append(row)
    return found


def to_csv(results: dict) -> str:
    """Return one figure a line: sequence, method, region, metric, value."""
    stream = io.StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    lines.writerow(("sequence", "method", "region", "metric", "value"))
    for cell in results["cells"]:
        place = cell["sequence"], cell["method"]
        for column in results["columns"]:
            if cell.get(column["name"]) is not None:
                lines.writerow((*place, "whole", column["name"], repr(cell[column["name"]])))
        for region, figures in cell["regions"].items():
            lines.writerows((*place, region, name, repr(value)) for name, value in figures.items() if value is not None)
    return stream.getvalue()


def _cell(sequence: str, method: str, cell: Cell) -> dict:
    document, timing = cell.document, cell.timing or {}
    figures = {name: finite(_average(cell, name)) for name in METRICS}
    regions = {
        region: {name: finite(value) for name, value in values.items()}
        for region, values in cell.errors.figures().items()
        if region != "whole"
    }
    timed = {"milliseconds": timing.get("milliseconds"), "timed": timing.get("of"), "timed_on": timing.get("machine")}
    whole = {"sequence": sequence, "method": method, **figures, "flicker": document["flicker"]} | document["videos"]
    return whole | timed | {"regions": regions, "frames": document["frames"]}


def _mean(name: str, cells: list[dict], filled: Filled, names: list[str]) -> dict | None:
    """Return the means over sequences; regions are pooled. None without any cell."""
    own = [cell for cell in cells if cell["method"] == name]
    if not own:
        return None
    mean = {"method": name, "sequences": len(own)}
    for column in COLUMNS:
        values = [cell[column] for cell in own if cell.get(column) is not None]
        mean[column] = float(np.mean(values)) if values else None
    pooled = RegionErrors.pooled(filled.cells[cell["sequence"], name].errors for cell in own)
    figures = pooled.figures()
    mean["regions"] = {region: {key: finite(value) for key, value in figures[region].items()} for region in REGIONS}
    return mean


def _skipped(filled: Filled) -> list[dict]:
    """Return why cells are missing: once for each reason."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for (sequence, method), reason in filled.skipped.items():
        reasons.setdefault((method, reason), []).append(sequence)
    for cell in filled.cells.values():
        for name, reason in cell.document["skipped"].items():
            reasons.setdefault((VIDEO_METRICS[name].label, reason), [])
    reasons |= {(name, reason): [] for name, reason in filled.broken.items()}
    return [{"what": what, "reason": reason, "sequences": where} for (what, reason), where in reasons.items()]


def _average(cell: Cell, name: str) -> float:
    """Return the mean of defined values over frames."""
    values = [frame[name] for frame in cell.document["frames"] if frame.get(name) is not None]
    return float(np.mean(values)) if values else float("nan")


def columns_of(results: dict) -> list[Figure]:
    """Return the columns that have figures."""
    return [COLUMNS[column["name"]] for column in results["columns"]]
