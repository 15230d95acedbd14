"""Writes the tables of docs/results.md and of the README from a report of `gffe eval`.

    gffe eval --out report
    python docs/tools/make_results.py report/results.json    records what the tables need in docs/measured/eval.json
    python docs/tools/make_results.py                        the tables, from what is recorded

`TABLES` names them.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pages import DOCS, MEASURED, REPOSITORY, table, with_all, write_record

from gffe_cl.lab.table.cells import COLUMNS, PAPER, VIDEO_METRICS
from gffe_cl.lab.table.methods import FULL

PAGE, README, RECORD = DOCS / "results.md", REPOSITORY / "README.md", MEASURED / "eval.json"
SHOWN = ("psnr", "against", "ssim", "flip", "flicker", *VIDEO_METRICS)
SHORT = (
    FULL,
    "no-scn",
    "papers-way",
    "motion-vectors",
    "flow",
    "static-reprojection",
    "repeat",
    "guided",
    "interpolation",
)
README_ROWS = {  # and their titles there, where others than in the results
    "repeat": "",
    "motion-vectors": "motion vectors, in image space",
    "flow": "",
    "papers-way": "GFFE by the paper alone, with our network",
    "no-scn": "GFFE without its network",
    FULL: "",
    "interpolation": "",
}
TRAINED = ("corridor", "plaza", "room", "forest")  # scenes of which the network's training has variations
_KEPT = ("date", "command", "versions", "machine", "sequences", "methods", "means", "gains")


def recorded(results: dict[str, Any]) -> dict[str, Any]:
    """Return the parts of a report that the tables need."""
    found = {name: results[name] for name in _KEPT}
    found["cells"] = [{name: cell[name] for name in ("sequence", "method", "psnr")} for cell in results["cells"]]
    return found


def about_table(found: dict) -> str:
    sizes = sorted({"×".join(map(str, s["size"])) for s in found["sequences"]})
    moments = sorted({s["moments"] for s in found["sequences"]})
    rows = [
        ("made by", f"`{found['command']}`"),
        ("date", found["date"]),
        ("sequences", f"{len(found['sequences'])}, {', '.join(sizes)} pixels"),
        ("new frames of each", ", ".join(map(str, moments))),
        ("device", found["machine"]),
        ("versions", ", ".join(f"{name} {number}" for name, number in found["versions"].items())),
    ]
    return table(("", ""), rows)


def methods_table(found: dict) -> str:
    present = [COLUMNS[name] for name in SHOWN if any(mean.get(name) is not None for mean in found["means"])]
    return table(
        ("method", *(c.title for c in present)), [_method_row(found, mean, present) for mean in found["means"]]
    )


def short_table(found: dict) -> str:
    """Return mean PSNR of the scenes that the network was not trained on, and of those that it was."""
    values = {(cell["sequence"], cell["method"]): cell["psnr"] for cell in found["cells"]}
    names = [s["name"] for s in found["sequences"]]
    parts = [[n for n in names if (n.split(":")[0] in TRAINED) == trained] for trained in (False, True)]
    titles, rows = {m["name"]: m["title"] for m in found["methods"]}, []
    for method, title in README_ROWS.items():
        means = (sum(values[name, method] for name in part) / len(part) for part in parts)
        title = f"**{titles[method]}**" if method == FULL else title or titles[method]
        rows.append((title, *map(COLUMNS["psnr"].text, means)))
    heads = (", ".join(f"`{name.split(':')[0]}`" for name in part) for part in parts)
    return table(("mean PSNR, dB", *heads), rows)


def regions_table(found: dict) -> str:
    column, rows = COLUMNS["psnr"], []
    regions = list(found["sequences"][0]["shares"])
    for mean in found["means"]:
        figures = (column.text(mean["regions"][region]["psnr"]) for region in regions)
        rows.append((_title(found, mean), *figures))
    shares = {
        region: sum(s["shares"][region] for s in found["sequences"]) / len(found["sequences"]) for region in regions
    }
    heads = (f"{region} ({shares[region]:.1%})" for region in regions)
    return table(("PSNR, dB (share of the pixels)", *heads), rows)


def scenes_table(found: dict) -> str:
    values = {(cell["sequence"], cell["method"]): cell["psnr"] for cell in found["cells"]}
    titles = {m["name"]: m["title"] for m in found["methods"]}
    names = [m for m in SHORT if any(method == m for _, method in values)]
    rows = [
        (f"`{s['name']}`", *(COLUMNS["psnr"].text(values.get((s["name"], m))) for m in names))
        for s in found["sequences"]
    ]
    return table(("PSNR, dB", *(titles[m] for m in names)), rows)


def gains_table(found: dict) -> str:
    rows = [(g["title"], _db(g["mean"]), _db(g["in_region"]), g["region"], _db(g["paper"])) for g in found["gains"]]
    return table(("part", "whole frame, dB", "in its region, dB", "region", "the paper, whole frame, dB"), rows)


def errors_table(found: dict) -> str:
    """Return the regions' shares of the pixels and of GFFE's squared error, and the gain if one were perfect."""
    (of,) = (mean["regions"] for mean in found["means"] if mean["method"] == FULL)
    errors = {name: figures["share"] * 10 ** (-figures["psnr"] / 10) for name, figures in of.items()}
    rows, total = [], sum(errors.values())
    for name in sorted(errors, key=errors.__getitem__, reverse=True):
        share = errors[name] / total
        rows.append((name, f"{of[name]['share']:.1%}", f"{share:.1%}", _db(-10 * math.log10(1 - share))))
    return table(("region", "of the pixels", "of the squared error", "dB gained if it were perfect"), rows)


def paper_table(found: dict) -> str:
    """Return the paper's averages, as differences from its own method."""
    ours, rows = PAPER["Ours Full"], []
    for name, figures in PAPER.items():
        apart = (
            f"{figures[key] - ours[key]:+.{2 if key == 'psnr' else 4}f}".replace("-", "−") for key in ("psnr", "ssim")
        )
        if name != "Ours Full":
            rows.append((name, *apart))
    return table(("the paper, against its full method", "PSNR, dB", "SSIM"), rows)


TABLES: dict[str, Callable[[dict], str]] = {
    "eval-about": about_table,
    "eval-methods": methods_table,
    "eval-short": short_table,
    "eval-regions": regions_table,
    "eval-scenes": scenes_table,
    "eval-gains": gains_table,
    "eval-errors": errors_table,
    "eval-paper": paper_table,
}


def with_tables(text: str, found: dict | None = None) -> str:
    """Return a page with all its tables as they are recorded."""
    found = json.loads(RECORD.read_text("utf-8")) if found is None else found
    return with_all(text, {name: make(found) for name, make in TABLES.items()})


def _method_row(found: dict, mean: dict, columns: list) -> tuple[str, ...]:
    figures = (column.text(mean.get(column.name), column.name == "against").replace("-", "−") for column in columns)
    return (_title(found, mean), *figures)


def _title(found: dict, mean: dict) -> str:
    title = next(m["title"] for m in found["methods"] if m["name"] == mean["method"])
    count = len(found["sequences"])
    note = "" if mean["sequences"] == count else f" (on {mean['sequences']} of {count})"
    return f"**{title}**" if mean["method"] == FULL else title + note


def _db(value: float | None) -> str:
    return "" if value is None else f"{round(value, 2) + 0.0:+.2f}".replace("-", "−")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("report", nargs="?", type=Path)
    given = parser.parse_args()
    if given.report:
        found = recorded(json.loads(given.report.read_text("utf-8")))
        write_record("eval", found)
    for page in (PAGE, README):
        page.write_text(with_tables(page.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
