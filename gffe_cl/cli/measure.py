"""Commands that measure pictures: `gffe compare`, and `gffe eval`, which fills the table of methods and sequences."""

from __future__ import annotations

import json
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    DeviceOption,
    JsonOption,
    OverwriteOption,
    app,
    named,
    out,
    parse_numbers,
    parse_size,
    plain,
    progress_bars,
    steps,
    takes_scheduler,
    warn,
    write_json,
)
from gffe_cl.engine.core.errors import GffeError, require_packages
from gffe_cl.engine.core.files import require_output_file, write_text

if TYPE_CHECKING:
    from gffe_cl.captures.sequence import Sequence
    from gffe_cl.lab.table.footage import Subject


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(help="Folder of the sequence with extrapolated frames.")],
    b: Annotated[Path, typer.Argument(help="Folder of the sequence with ground truth.")],
    mask: Annotated[
        str | None,
        typer.Option(help="Mask of the measured pixels: a channel of A that is not 0 there, such as mask.dynamic."),
    ] = None,
    fail_under: Annotated[
        float | None, typer.Option(help="Lowest mean PSNR for exit code 0, dB; below it the exit code is 1.")
    ] = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Measure extrapolated frames of A against the ground truth of B."""
    from gffe_cl.lab.compare import compare as compare_sequences
    from gffe_cl.lab.metrics import measurable, missing_metrics

    first, second = (_opened(folder) for folder in (a, b))
    for sequence in (first, second):
        if sequence.unfinished:
            warn(sequence.warnings()[0])
    with progress_bars() as progress:
        advance = steps(progress)("Comparing", len(first.extrapolated))
        result = compare_sequences(first, second, mask, lambda done, total: advance())
    metrics = measurable()
    table = Table("frame", *(metric.title for metric in metrics), box=None, header_style="bold")
    for frame in result.frames:
        figures = (metric.text(frame.values[metric.name]) for metric in metrics)
        table.add_row(plain(frame.file), *figures, style=None if frame.counted else "dim")
    out.print(table)
    for note in result.notes:
        out.print(plain(note))
    left_out = sum(not frame.counted for frame in result.frames)
    dim = f" ({left_out} frames without history left out)" if left_out else ""
    means = (metric.sentence(result.mean[metric.name]) for metric in metrics)
    out.print(f"[bold]mean[/]{dim}: {', '.join(means)}")
    for reason in missing_metrics():
        out.print(plain(reason))
    write_json(json_path, result.to_json())
    if fail_under is not None and not result.mean["psnr"] >= fail_under:
        raise typer.Exit(1)


def _opened(folder: Path) -> Sequence:
    """Return the sequence in `folder`. Raises GffeError, which names the folder."""
    from gffe_cl.captures.formats import open_capture

    try:
        return open_capture(folder)
    except GffeError as error:
        raise GffeError(named(folder, str(error))) from None


@app.command("eval")
@takes_scheduler
def evaluate(
    subjects: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE|SEQUENCE]...",
            help="Built-in scenes and situations (forest, or forest:3 with a seed), and folders with ground truth"
            " [dim](default: the eight scenes)[/].",
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(help="Number N of seeds, 0 … N−1, of each built-in scene that is named without a seed.")
    ] = 1,
    output: Annotated[Path, typer.Option("--out", help="Folder for the results and the finished cells.")] = Path(
        "report"
    ),
    methods: Annotated[
        str | None,
        typer.Option(
            help="Methods or groups, separated by commas: gffe, preset, ablation, deviation, baseline [dim](default:"
            " all)[/]."
        ),
    ] = None,
    onnx: Annotated[
        list[str] | None,
        typer.Option(help="Network to measure as one more method: NAME=FILE; may be given several times."),
    ] = None,
    scn_model: Annotated[
        Path | None, typer.Option(help="Shading correction network, an ONNX file, in place of the package's own.")
    ] = None,
    scn_provider: Annotated[
        str | None, typer.Option(help="Runner of the shading correction network, as for `gffe run`.")
    ] = None,
    metrics: Annotated[
        str | None,
        typer.Option(help="Slow metrics to measure as well, separated by commas: fvvdp, cvvdp, lpips."),
    ] = None,
    size: Annotated[str, typer.Option(help="Frame size of built-in scenes: width × height, pixels.")] = "480x270",
    frames: Annotated[int, typer.Option(help="Number of rendered frames of built-in scenes.")] = 16,
    fps: Annotated[float, typer.Option(help="Frame rate of built-in scenes, rendered frames per second.")] = 30.0,
    alpha: Annotated[
        str,
        typer.Option(
            help="Times of the new frames of built-in scenes, in intervals of rendered frames, separated by commas."
        ),
    ] = "0.5",
    regions: Annotated[
        bool, typer.Option("--regions", help="Regions of the picture: print the PSNR of every method in each.")
    ] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Finished cells: compute them again.")] = False,
    device: DeviceOption = None,
    overwrite: OverwriteOption = False,
    *,
    cluster: Any,
) -> None:
    """Measure the quality and time of methods on sequences. Finished cells are kept."""
    require_packages("eval", "lab", "skimage", "scipy")
    from gffe_cl.captures.scenes import SCENES, is_scene
    from gffe_cl.lab.table.cells import TableOrder, fill, results_of

    if not (4 <= frames <= 10_000 and 0 < fps <= 1e6 and 1 <= seeds <= 10_000):
        raise GffeError(
            "eval: --frames must be 4 to 10000, --fps positive and --seeds 1 to 10000,"
            f" got {frames}, {fps:g} and {seeds}"
        )
    videos = _videos(metrics)
    alphas = tuple(parse_numbers(alpha, "--alpha"))
    if not alphas or len(set(alphas)) < len(alphas) or not all(0 < a <= 8 for a in alphas):
        raise GffeError(f"--alpha must be different numbers within 0 and 8, got '{alpha}'")
    scenes = parse_size(size), frames, fps, alphas
    named = []
    for text in subjects or SCENES:
        named += [f"{text}:{seed}" for seed in range(seeds)] if seeds > 1 and is_scene(text) else [text]
    chosen, broken = _subjects(named, *scenes)
    words = tuple(methods.split(",")) if methods else None
    network = (str(scn_model) if scn_model else None, scn_provider)
    output = _folder(output)
    for name in ("results.json", "results.csv"):
        require_output_file(output / name, "--out", overwrite)
    with cluster as workers, progress_bars() as bars:
        order = TableOrder(chosen, words, tuple(onnx or ()), videos, fresh, network)
        filled = fill(order, output / "cells", device, partial(steps(bars), "Measuring"), workers)
    for name, reason in broken.items():
        filled.drop(name, reason)
    results = results_of(filled, shlex.join(["gffe", *sys.argv[1:]]))
    _write(output, results)
    _print(results, regions)
    if filled.broken:
        raise GffeError(
            f"eval: {len(filled.broken)} of the sequences could not be measured: {', '.join(filled.broken)}"
        )


def _subjects(texts, *scenes) -> tuple[tuple[Subject, ...], dict[str, str]]:
    """Return the subjects, and why folders among several cannot be opened, by their names."""
    from gffe_cl.lab.table.footage import parse_subject

    chosen, broken = [], {}
    for text in texts:
        try:
            chosen.append(parse_subject(text, *scenes))
        except GffeError as error:
            if len(texts) == 1 or not Path(text).is_dir():
                raise
            broken[text] = str(error)
    if not chosen:
        raise GffeError("; ".join(named(name, reason) for name, reason in broken.items()))
    return tuple(chosen), broken


def _videos(text: str | None) -> tuple[str, ...]:
    from gffe_cl.lab.table.cells import VIDEO_METRICS

    names = tuple(text.split(",")) if text else ()
    if unknown := [name for name in names if name not in VIDEO_METRICS]:
        raise GffeError(f"--metrics: '{unknown[0]}' is none of {', '.join(VIDEO_METRICS)}")
    return names


def _folder(path: Path) -> Path:
    """Return `path`, created if it is missing. Raises GffeError if it is no place for a report."""
    if path.exists() and not path.is_dir():
        raise GffeError(f"--out {path}: is a file (expected a folder)")
    if (path / "sequence.json").exists():
        raise GffeError(f"--out {path}: is a sequence (expected another folder)")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GffeError(f"--out {path}: cannot be made ({error.strerror or error})") from None
    return path


def _write(output: Path, results: dict) -> None:
    from gffe_cl.lab.table.cells import to_csv

    files = {
        "results.json": json.dumps(results, indent=1, allow_nan=False) + "\n",
        "results.csv": to_csv(results),
    }
    for name, text in files.items():
        try:
            write_text(output / name, text)
        except OSError as error:
            raise GffeError(f"{output / name}: cannot be written ({error.strerror or error})") from None
    out.print(f"{plain(output / 'results.json')}, results.csv")


def _print(results: dict, with_regions: bool) -> None:
    from gffe_cl.lab.table.cells import columns_of

    columns = columns_of(results)
    titles = {method["name"]: method["title"] for method in results["methods"]}
    groups = {method["name"]: method["group"] for method in results["methods"]}
    table = Table("method", "", *(c.title for c in columns), box=None, header_style="bold")
    before = None
    for mean in results["means"]:
        name = mean["method"]
        if before is not None and groups[name] != before:
            table.add_section()
        before = groups[name]
        missing = len(results["sequences"]) - mean["sequences"]
        note = f" [dim](not on {missing})[/]" if missing else ""
        table.add_row(name, plain(titles[name]) + note, *(c.text(mean[c.name], c.name == "against") for c in columns))
    out.print(table)
    count = len(results["sequences"])
    out.print(f"Means over {count} sequence{'s' if count > 1 else ''}. Flicker: `gffe_cl.lab.metrics.Flicker`.")
    if with_regions:
        _print_regions(results)
    _print_gains(results)
    for skip in results["skipped"]:
        where = f" ({', '.join(skip['sequences'])})" if skip["sequences"] else ""
        warn(f"left out: {skip['what']}{where}: {skip['reason']}")


def _print_regions(results: dict) -> None:
    """Print PSNR by method and region, of all sequences together."""
    from gffe_cl.lab.metrics import METRICS

    regions, shares = list(results["regions"]), [sequence["shares"] for sequence in results["sequences"]]
    heads = (f"{region} ({sum(share[region] for share in shares) / len(shares):.2%})" for region in regions)
    out.print("PSNR, dB, by region (share of the pixels):")
    table = Table("", *heads, box=None, header_style="bold")
    for mean in results["means"]:
        values = (mean["regions"][region]["psnr"] for region in regions)
        table.add_row(mean["method"], *("–" if value is None else METRICS["psnr"].text(value) for value in values))
    out.print(table)


def _print_gains(results: dict) -> None:
    if not results["gains"]:
        return
    table = Table("gain of a part, dB", "whole frame", "in its region", "", "paper", box=None, header_style="bold")
    for gain in results["gains"]:
        figures = [_db(gain[key]) for key in ("mean", "in_region")]
        table.add_row(gain["title"], *figures, gain["region"], _db(gain["paper"]))
    out.print(table)


def _db(value: float | None) -> str:
    return "" if value is None else f"{value + 0.0:+.2f}"
