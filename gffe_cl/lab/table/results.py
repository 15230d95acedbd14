"""Results of a filled table: one document, from which console, JSON, CSV and documentation are made."""

from __future__ import annotations

import csv
import datetime
import io
import math
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from gffe_cl.engine.core.public_names import __version__
from gffe_cl.lab.metrics import METRICS, REGIONS, RegionErrors
from gffe_cl.lab.table.cells import VIDEO_METRICS, Cell, Filled, finite
from gffe_cl.lab.table.methods import FULL, GAINS

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


@dataclass(frozen=True)
class Column:
    """A figure of the table: its key in JSON, its label and unit for people, and whether higher is better."""

    name: str
    title: str
    digits: int
    higher_is_better: bool

    def text(self, value: float | None, signed: bool = False) -> str:
        """Return a figure as text, "–" if undefined."""
        if value is None or not math.isfinite(value):
            return "–"
        return f"{round(value, self.digits) + 0.0:{'+' if signed else ''}.{self.digits}f}"


METRIC_COLUMNS = tuple(Column(m.name, m.title, m.digits, m.higher_is_better) for m in METRICS.values())
AGAINST = Column("against", f"against {FULL}, dB", 2, True)
FLICKER = Column("flicker", "flicker, %", 2, False)
VIDEO_COLUMNS = tuple(
    Column(m.name, f"{m.label}, {m.unit}" if m.unit else m.label, m.digits, m.higher_is_better)
    for m in VIDEO_METRICS.values()
)
TIME = Column("milliseconds", "ms", 1, False)
COLUMNS = {c.name: c for c in (METRIC_COLUMNS[0], AGAINST, *METRIC_COLUMNS[1:], FLICKER, *VIDEO_COLUMNS, TIME)}


def results_of(filled: Filled, command: str = "") -> dict:
    """Return all results, for JSON. `command`: how it was made."""
    cells = [_cell(sequence, name, cell) for (sequence, name), cell in filled.cells.items()]
    full = {cell["sequence"]: cell["psnr"] for cell in cells if cell["method"] == FULL}
    for cell in cells:
        known = cell["method"] != FULL and cell["sequence"] in full
        cell["against"] = cell["psnr"] - full[cell["sequence"]] if known else None
    names = [subject.name for subject in filled.subjects]
    means = [mean for name in filled.methods if (mean := _mean(name, cells, filled, names))]
    present = [c.name for c in COLUMNS.values() if any(mean.get(c.name) is not None for mean in means)]
    return {
        "generator": f"gffe-cl {__version__}",
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "command": command,
        "versions": versions(),
        "machine": filled.machine,
        "columns": [asdict(COLUMNS[name]) for name in present],
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
    figures = {column.name: finite(_average(cell, column.name)) for column in METRIC_COLUMNS}
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


def columns_of(results: dict) -> list[Column]:
    """Return the columns that have figures."""
    return [COLUMNS[column["name"]] for column in results["columns"]]
