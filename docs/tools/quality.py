"""Compare the quality of new frames of two sides, by group of the corpus (docs/measured/corpus.toml).

    python docs/tools/quality.py                                  HEAD against the working tree: five minutes
    python docs/tools/quality.py --quick                          on a few sequences: under a minute
    python docs/tools/quality.py --before 02c79ada --after HEAD
    python docs/tools/quality.py --before . --after ". sharpness=false" --groups scenes lattices
    python docs/tools/quality.py --after "out/kernels preset=performance"
    python docs/tools/quality.py --before ". order=1" --after . --write order

A side is words: a commit or "." for the working tree, a folder of kernels in place of its own, and options of
`gffe_cl.Options` as NAME=VALUE, `preset` among them. `make quality` runs it after a change of kernels. Sequences and
figures are cached. The exit code is 1 where the mean of a group falls by more than 0.01 dB, or a sequence by more than
0.05 dB. `--write SLUG` stores both sides, the command and all values in docs/measured.

PSNR is that of a sequence's mean squared error of display values; SSIM is the mean over its frames. Detail is the
energy of fine detail of new frames over that of the truth, both against the rendered frames around them, which cancel
out: the mean square of the difference between a pixel's luma and the mean over itself and its four neighbors. Of the
truth's, the share that is right (the squared correlation) is what frames of the least error have: more costs PSNR.
"""

from __future__ import annotations

import argparse
import ast
import atexit
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from corpus import ALPHAS, CACHE, Line, corpus_lines, digest_of, rendered
from pages import REPOSITORY, checkout, table, write_record

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.opencl.device import open_device
from gffe_cl.engine.opencl.runtimes import keep_file
from gffe_cl.lab.metrics import LUMA, METRICS, REGIONS, RegionErrors, decibels, masks, to_display

VARIANTS = tuple(f"α {'½' if alpha == 0.5 else '1'}{end}" for alpha in ALPHAS for end in ("", ", no network"))
WORSE_GROUP, WORSE_SEQUENCE, CHANGED = 0.01, 0.05, 0.01  # dB
_VERSION = 2  # of cells
_SOURCES = "gffe_cl/__init__.py", "gffe_cl/engine", "kernels"
MOST_CELLS = 20_000  # in the cache, 6 kB each
_EXTREMES = 5  # sequences named as the best and the worst
KERNELS = os.environ.pop("GFFE_KERNELS", None)  # of the working tree; the corpus is rendered with its own


@dataclass(frozen=True)
class Side:
    """What makes new frames: a source tree, kernels, options; `text` names it."""

    text: str
    source: Path
    kernels: Path
    options: dict[str, object] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Side:
        """Return the side of words as in the module's docstring. Raises GffeError for words that are none of these."""
        source, kernels, options = REPOSITORY, None, {}
        text = text.strip() or "."
        for word in text.split():
            name, equals, value = word.partition("=")
            if equals:
                try:
                    options[name] = ast.literal_eval(
                        value.capitalize() if value in ("true", "false", "none") else value
                    )
                except (ValueError, SyntaxError):
                    options[name] = value
            elif (Path(word) / "common.h").is_file():
                kernels = Path(word).resolve()
            elif word != ".":
                commit, source = _export(word)
                text = text.replace(word, commit)
        own = KERNELS if source == REPOSITORY else None
        return cls(text, source, kernels or Path(own or source / "kernels").resolve(), options)

    @property
    def key(self) -> str:
        own = digest_of(self.source, _SOURCES[:2]) + digest_of(self.kernels, (".",))
        return hashlib.sha256(f"{_VERSION} {own} {sorted(self.options.items())}".encode()).hexdigest()[:24]


def _export(commit: str) -> tuple[str, Path]:
    """Return the short hash of a commit, and a folder with its sources. Raises GffeError if there is none."""
    command = ("git", "-C", REPOSITORY, "rev-parse", "--verify", f"{commit}^{{commit}}")
    found = subprocess.run(command, capture_output=True, text=True)
    if found.returncode:
        raise GffeError(f"{commit}: expected a commit, '.', a folder of kernels, or NAME=VALUE")
    full = found.stdout.strip()
    folder = Path(tempfile.mkdtemp(prefix=f"gffe-{full[:8]}-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    checkout(commit, folder, "gffe_cl", "kernels")
    return full[:8], folder


# ---- cells --------------------------------------------------------------------------------------------------------


def cells_of(side: Side, lines: list[Line], files: dict[str, Path], progress: Callable[[str], None]) -> dict[str, dict]:
    """Return the figures of a side by name of the sequence and variant; they are cached by the contents of the side.
    Processes of the side make the frames, threads here measure them."""
    key = side.key
    paths = {line.name: CACHE / f"cell-{key}-{files[line.name].stem}-{line.camera}.json" for line in lines}
    missing = [line for line in lines if not paths[line.name].exists()]
    waiting, done = iter(missing), []  # threads share the iterator

    def work() -> None:
        with tempfile.TemporaryDirectory() as folder, _Process(side, Path(folder)) as process:
            for line in waiting:
                if stopped.is_set():
                    break
                cell = measured(files[line.name], process.make(files[line.name], line.camera == "known"))
                keep_file(paths[line.name], json.dumps(cell).encode(), "cell-*.json", MOST_CELLS)
                done.append(line)
                progress(f"{side.text}: {len(done)} of {len(missing)} sequences")

    stopped, workers = threading.Event(), min(len(missing), os.cpu_count() or 1)
    with ThreadPoolExecutor(max(workers, 1)) as pool:
        try:
            for result in [pool.submit(work) for _ in range(workers)]:
                result.result()
        finally:
            stopped.set()
    return {name: json.loads(path.read_text("utf-8")) for name, path in paths.items()}


class _Process:
    """A process that makes new frames of a side (quality_side.py)."""

    def __init__(self, side: Side, folder: Path):
        self._side, self._target = side, folder / "made.npy"
        self._said = (folder / "said").open("w+b")  # closed with the process
        known = os.environ | {"PYTHONPATH": str(side.source), "GFFE_KERNELS": str(side.kernels)}
        command = [sys.executable, Path(__file__).with_name("quality_side.py"), json.dumps(side.options)]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, env=known, stdin=pipe, stdout=pipe, stderr=self._said, text=True)

    def __enter__(self) -> _Process:
        self._expect("ready")
        return self

    def __exit__(self, *error) -> None:
        self._process.kill()
        self._process.wait()
        self._said.close()

    def make(self, sequence: Path, known: bool) -> np.ndarray:
        print(json.dumps([str(sequence), known, str(self._target)]), file=self._process.stdin, flush=True)
        self._expect("written")
        return np.load(self._target)

    def _expect(self, word: str) -> None:
        if self._process.stdout.readline().strip() != word:
            self._said.seek(0)
            last = self._said.read().decode(errors="replace").strip().splitlines()[-1:]
            raise GffeError(f"{self._side.text}: {''.join(last) or 'its process has ended'}")


def measured(path: Path, made: np.ndarray) -> dict[str, dict]:
    """Return figures by variant: `psnr` (dB), `ssim`, `detail`, `right` (of it), `frames` [PSNR, SSIM], and `regions`
    [sum of the squared error, pixels]."""
    with np.load(path) as stored:
        truths, labels, exposure = stored["truth"], stored["labels"], float(stored["exposure"])
    metrics = METRICS["psnr"], METRICS["ssim"]
    figures = {}
    for number, variant in enumerate(VARIANTS):
        errors, frames, details = [], [], []
        for moment in range(number // 2, len(made), len(ALPHAS)):
            shown, truth = (to_display(c, exposure) for c in (made[moment, number % 2], truths[moment]))
            errors.append(RegionErrors())
            errors[-1].add(shown, truth, masks(labels[moment]), metrics)
            frames.append([round(errors[-1].figure(metric.name, "whole"), 5) for metric in metrics])
            fine, true = detail(shown), detail(truth)
            shows, has = (max(float(np.square(d).mean()), 1e-12) for d in (fine, true))
            details.append((shows / has, float((fine * true).mean()) ** 2 / (shows * has)))
        whole = RegionErrors.pooled(errors)
        figures[variant] = {
            "psnr": round(whole.figure("psnr", "whole"), 4),
            "ssim": round(whole.figure("ssim", "whole"), 5),
            **{name: round(mean([d[k] for d in details]), 4) for k, name in enumerate(("detail", "right"))},
            "frames": frames,
            "regions": {name: [whole.sums["psnr"][name], whole.counts["psnr"][name]] for name in REGIONS},
        }
    return figures


def detail(shown: np.ndarray) -> np.ndarray:
    """Return the fine detail of display values (H, W, 3), without the border's pixels."""
    luma = shown @ LUMA
    around = luma[1:-1, 1:-1] + luma[:-2, 1:-1] + luma[2:, 1:-1] + luma[1:-1, :-2] + luma[1:-1, 2:]
    return luma[1:-1, 1:-1] - around / 5


# ---- comparison ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """How a variant of a sequence has changed: dB, SSIM."""

    line: Line
    variant: str
    before: dict
    after: dict

    @property
    def db(self) -> float:
        return self.after["psnr"] - self.before["psnr"]

    @property
    def ssim(self) -> float:
        return self.after["ssim"] - self.before["ssim"]

    def region(self) -> str:
        """Return the region whose squared error has changed most in the direction of the whole, and its own dB."""
        before, after = self.before["regions"], self.after["regions"]
        name = max(REGIONS, key=lambda name: (before[name][0] - after[name][0]) * np.sign(self.db or 1))
        was, now = (decibels(part[name][0] / max(part[name][1], 1)) for part in (before, after))
        return f"{name} {signed(now - was)}"


def signed(value: float, digits: int = 2) -> str:
    return f"{round(value, digits) + 0.0:+.{digits}f}".replace("-", "−")


def groups_of(changes: list[Change]) -> dict[str, list[Change]]:
    """Return changes by group, those for proof after all others; more than one group also together."""
    found: dict[str, list[Change]] = {}
    for use in ("tuned", "proof"):
        of = [change for change in changes if change.line.use == use]
        names = dict.fromkeys(change.line.group for change in of)
        for name in names:
            found[f"{name}, proof" if use == "proof" else name] = [c for c in of if c.line.group == name]
        if len(names) > 1:
            found[f"all {use}"] = of
    return found


def groups_table(groups: dict[str, list[Change]]) -> str:
    """Return a line for each group: mean changes of PSNR and SSIM by variant, sequences that gain or lose, detail."""
    rows = []
    for name, changes in groups.items():
        row, of = [name], {v: [c for c in changes if c.variant == v] for v in VARIANTS}
        row.append(str(len(of[VARIANTS[0]])))
        for some in of.values():
            row.append(f"{signed(mean([c.db for c in some]), 3)} {signed(mean([c.ssim for c in some]), 4)}")
        plus, minus = (sum(s * c.db >= CHANGED for v in (0, 2) for c in of[VARIANTS[v]]) for s in (1, -1))
        row.append(f"{plus}, {minus} of {2 * len(of[VARIANTS[0]])}")
        for key in ("detail", "right"):
            was, now = (mean([getattr(c, s)[key] for c in of[VARIANTS[0]]]) for s in ("before", "after"))
            row.append(f"{was:.3f} → {now:.3f}")
        rows.append(row)
    return table(("dB, SSIM", "n", *VARIANTS, "gain, lose .01", "detail, α ½", "right"), rows)


def extremes(changes: list[Change], sign: int) -> list[str]:
    """Return lines that name the sequences that gain or lose most, each by its own most changed variant."""
    of = sorted((sign * c.db, k) for k, c in enumerate(changes) if sign * c.db > 0.0005)[::-1]
    chosen = {changes[k].line.name: changes[k] for _, k in of[::-1]}
    ranked = sorted(chosen.values(), key=lambda c: -sign * c.db)[:_EXTREMES]
    return [f"  {signed(c.db, 3)} dB  {c.line.name}, {c.variant}: {c.region()}" for c in ranked]


def network_lines(lines: list[Line], cells: dict[str, dict]) -> str:
    """Return what the network changes in single frames: how many it makes worse than without it, and the worst."""
    found = ["network against none, by frame"]
    for use in ("tuned", "proof"):
        for k, (unit, limit) in enumerate((("dB", 0.01), ("SSIM", 0.0005))):
            each = []
            for line in (line for line in lines if line.use == use):
                for with_it, without in (VARIANTS[:2], VARIANTS[2:]):
                    pairs = zip(*(cells[line.name][variant]["frames"] for variant in (with_it, without)), strict=True)
                    each += [(a[k] - b[k], line.name) for a, b in pairs]
            below = sum(change < -limit for change, _ in each)
            worst, name = min(each, default=(0.0, "none"))
            found.append(f"  {use}: {below} of {len(each)} lose {limit:g} {unit}; worst {signed(worst, 4)}, {name}")
    return "\n".join(found)


def rounded_mean(changes: list[Change], variant: str, key: str) -> float:
    return round(mean([getattr(change, key) for change in changes if change.variant == variant]), 4)


def mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def worse(changes: list[Change], groups: dict[str, list[Change]]) -> list[str]:
    """Return sentences about groups and sequences that are worse than allowed, each with its worst variant."""
    found = []
    for name, of in groups.items():
        means = {variant: mean([c.db for c in of if c.variant == variant]) for variant in VARIANTS}
        found.append((name, *min(means.items(), key=lambda item: item[1]), WORSE_GROUP))
    for name in dict.fromkeys(c.line.name for c in changes):
        least = min((c for c in changes if c.line.name == name), key=lambda c: c.db)
        found.append((name, least.variant, least.db, WORSE_SEQUENCE))
    return [f"{name}, {variant}: {signed(db, 3)} dB (allowed: −{limit:g})" for name, variant, db, limit in found
            if db < -limit]  # fmt: skip


def chosen_lines(groups: list[str] | None, quick: bool) -> list[Line]:
    """Return the lines of these groups (None: all). Raises GffeError for a group that is none."""
    lines = corpus_lines()
    known = dict.fromkeys(line.group for line in lines)
    for name in groups or ():
        if name not in known:
            raise GffeError(f"--groups: {name} is none of {', '.join(known)}")
    return [line for line in lines if (not groups or line.group in groups) and (line.quick or not quick)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", default="HEAD", help="a side; default: HEAD")
    parser.add_argument("--after", default=".", help="a side; default: the working tree")
    parser.add_argument("--groups", nargs="+", help="of the corpus; default: all")
    parser.add_argument("--quick", action="store_true", help="only the sequences that the corpus marks as quick")
    parser.add_argument("--write", metavar="SLUG", help="also store both sides' values in docs/measured")
    given = parser.parse_args()
    lines, device, files = chosen_lines(given.groups, given.quick), open_device(None), {}
    sides = Side.parse(given.before), Side.parse(given.after)
    for k, line in enumerate(lines):
        show_progress(f"corpus: {k} of {len(lines)} sequences, {line.name}")
        files[line.name] = rendered(line, device)
    before, after = (cells_of(side, lines, files, show_progress) for side in sides)
    show_progress("")
    changes = [Change(line, v, before[line.name][v], after[line.name][v]) for line in lines for v in VARIANTS]
    groups = groups_of(changes)
    same = "\nBoth sides are the same." if sides[0].key == sides[1].key else ""
    print(f"before: {sides[0].text}\nafter:  {sides[1].text}{same}\n\n{groups_table(groups)}\n")
    for title, sign in (("best", 1), ("worst", -1)):
        print("\n".join([title, *(extremes(changes, sign) or ["  none"])]))
    if given.write:
        keys = "psnr", "ssim", "detail"
        values = {
            line.name: {v: [side[line.name][v][key] for side in (before, after) for key in keys] for v in VARIANTS}
            for line in lines
        }
        shown = {
            "before": sides[0].text,
            "after": sides[1].text,
            "of": [f"{s} {k}" for s in ("before", "after") for k in keys],
        }
        gained = {
            name: {v: [rounded_mean(some, v, key) for key in ("db", "ssim")] for v in VARIANTS}
            for name, some in groups.items()
        }
        write_record(given.write, shown | {"gains": gained, "values": values})
    print(network_lines(lines, after))
    found = worse(changes, groups)
    print("\n".join(["", *(f"worse: {sentence}" for sentence in found)] if found else ["", "as good, or better"]))
    return int(bool(found))


def show_progress(text: str) -> None:
    print(f"\r{text:70}" if text else f"\r{'':70}\r", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except GffeError as error:
        print(f"\nerror: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
