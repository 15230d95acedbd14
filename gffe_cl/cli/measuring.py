"""The commands that measure pictures: compare, study."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    DeviceOption,
    FollowLinksOption,
    JsonOption,
    app,
    out,
    output_file,
    parse_size,
    plain,
    progress_bars,
    steps,
    warn,
    write_json,
)
from gffe_cl.cli.options import takes_options
from gffe_cl.errors import GffeError
from gffe_cl.files import replacing

if TYPE_CHECKING:
    from gffe_cl.evaluation.compare import Comparison
    from gffe_cl.evaluation.disocclusions import DisocclusionStudy
    from gffe_cl.evaluation.methods import SceneStudy
    from gffe_cl.evaluation.shading import ShadingStudy
    from gffe_cl.evaluation.windows import WindowStudy
    from gffe_cl.metrics import Metric
    from gffe_cl.options import Options


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(help="Sequence with extrapolated frames.")],
    b: Annotated[Path, typer.Argument(help="Sequence with ground truth.")],
    mask: Annotated[
        str | None,
        typer.Option(
            help="Measure only where this channel of A is not 0 (mask.dynamic …); or 'focus': where shading is wrong."
        ),
    ] = None,
    gae: Annotated[
        Path | None, typer.Option(help="With --mask focus: the same without shading correction (`gffe run --no-scn`).")
    ] = None,
    fail_under: Annotated[float | None, typer.Option(help="Exit with 1 if the mean PSNR is lower, dB.")] = None,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
) -> None:
    """Measure extrapolated frames of A against the ground truth of B."""
    from gffe_cl.evaluation.compare import compare as compare_sequences
    from gffe_cl.formats import open_capture
    from gffe_cl.metrics import measurable, missing_metrics

    if gae is not None and mask != "focus":
        raise GffeError("--gae goes with --mask focus")
    first, second, third = open_capture(a), open_capture(b), None if gae is None else open_capture(gae)
    for sequence in (first, second, third):
        if sequence is not None and sequence.unfinished:
            warn(sequence.warnings()[0])
    with progress_bars() as progress:
        advance = steps(progress)("Comparing", len(first.extrapolated))
        result = compare_sequences(first, second, mask, lambda done, total: advance(), third)
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
    if result.regions:
        _print_regions(result, metrics)
    for reason in missing_metrics():
        out.print(plain(reason))
    write_json(json_path, result.to_json())
    if fail_under is not None and not result.mean["psnr"] >= fail_under:
        raise typer.Exit(1)


def _print_regions(result: Comparison, metrics: list[Metric]) -> None:
    """Where `--gae` is given, each metric without and with shading correction, and the gain."""
    heads = ("GAE", "final", "gain") if result.gae else ("",)
    table = Table("all frames together", "share", "metric", *heads, box=None, header_style="bold")
    for region, figures in result.regions.items():
        name, share = region, f"{figures['share']:.2%}"
        for metric in metrics:
            cells = [metric.text(figures[metric.name])]
            if result.gae:
                before, gain = result.gae[region][metric.name], result.gain[region][metric.name]
                cells = [metric.text(before), *cells, metric.text(gain, signed=True)]
            table.add_row(name, share, metric.title, *cells)
            name = share = ""
    out.print(table)


@app.command()
@takes_options("scn_model", "scn_provider", shading_correction=True)
def study(
    scenes: Annotated[
        list[str] | None, typer.Argument(help="Built-in scenes and situations [dim](default: the eight scenes)[/].")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Seeds 0 … N−1 of each.")] = 3,
    size: Annotated[str, typer.Option(help="Width × height, pixels.")] = "480x270",
    frames: Annotated[int, typer.Option(help="Rendered frames per scene and seed.")] = 10,
    alpha: Annotated[float, typer.Option(help="Time of the extrapolated frames, in intervals.")] = 0.5,
    fps: Annotated[float, typer.Option(help="Rendered frames per second.")] = 30.0,
    disocclusions: Annotated[
        bool, typer.Option("--disocclusions", help="Measure how disocclusions are filled instead.")
    ] = False,
    windows: Annotated[
        bool, typer.Option("--windows", help="Measure rendering windows instead, the camera turning quickly.")
    ] = False,
    shading: Annotated[bool, typer.Option("--shading", help="Measure shading correction instead.")] = False,
    sheet: Annotated[
        Path | None,
        typer.Option(
            help="With --shading: also write pictures of it to this file (PNG, JPEG).", callback=output_file("--sheet")
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="With --windows: degrees per second [dim](default 150)[/].")
    ] = None,
    device: DeviceOption = None,
    json_path: JsonOption = None,
    *,
    options: Options,
) -> None:
    """Measure the parts of the method on built-in scenes, against an oracle that knows the true motion."""
    from dataclasses import asdict

    from gffe_cl.evaluation.disocclusions import DisocclusionStudy, study_disocclusions
    from gffe_cl.evaluation.methods import study_scene
    from gffe_cl.evaluation.shading import study_shading
    from gffe_cl.evaluation.windows import MODES, study_windows
    from gffe_cl.opencl.device import open_device
    from gffe_cl.scenes import SCENES

    if disocclusions + windows + shading > 1:
        raise GffeError("study: --disocclusions, --windows and --shading exclude each other")
    if (options.scn_model or sheet) and not shading:
        raise GffeError(f"study: {'--scn-model' if options.scn_model else '--sheet'} goes with --shading")
    if rate is not None and not (windows and 0 < rate <= 1000):
        raise GffeError(f"study: --rate goes with --windows and must be within 0 and 1000 degrees/s, got {rate:g}")
    width, height = parse_size(size)
    if min(width, height) < 16 or not 1 <= seeds <= 10_000 or frames < 4 or not 0 < alpha <= 8:
        raise GffeError(
            "study: --size must be at least 16x16, --seeds 1 to 10000, --frames at least 4, and --alpha within 0 and 8"
        )
    opened = open_device(device)
    names = scenes or list(SCENES)
    with progress_bars() as progress:
        advance = steps(progress)("Measuring", len(names) * seeds * frames * (len(MODES) if windows else 1))
        measure = study_scene
        if windows:
            measure = partial(study_windows, rate=rate or 150.0)
        elif disocclusions:
            measure = study_disocclusions
        elif shading:
            measure = partial(study_shading, options=options)
        results = {
            name: [measure(opened, name, seed, width, height, frames, fps, alpha, advance) for seed in range(seeds)]
            for name in names
        }
    flat = [study for studies in results.values() for study in studies]
    if disocclusions:
        pooled = {name: DisocclusionStudy.pooled(studies) for name, studies in results.items()}
        pooled["all"] = DisocclusionStudy.pooled(flat)
        _print_disocclusions(pooled)
        write_json(json_path, {name: study.to_json() for name, study in pooled.items()})
    elif windows:
        _print_windows(flat)
        write_json(json_path, {"results": [asdict(r) for r in flat]})
    elif shading:
        _print_shading(results)
        write_json(json_path, {"results": [study.figures() for study in flat]})
        if sheet:
            _write_sheet(sheet, flat)
    else:
        _print_studies(flat)
        write_json(json_path, {"results": [study.to_json() for study in flat]})


def _print_disocclusions(pooled: dict[str, DisocclusionStudy]) -> None:
    from gffe_cl.evaluation.disocclusions import CATEGORIES, METHODS
    from gffe_cl.metrics import METRICS

    for name, r in pooled.items():
        shares = {c: r.pixels[c] / r.pixels["all"] for c in CATEGORIES}
        heads = [f"{c} ({share:.2%} of pixels)" for c, share in shares.items()]
        table = Table(name, *heads, "left by the background", box=None, header_style="bold")
        for method in METHODS:
            left = f"{r.unfilled[method] / r.pixels['all']:.2%}"
            table.add_row(method, *(METRICS["psnr"].text(r.psnr(method, c)) for c in CATEGORIES), left)
        out.print(table)


def _print_windows(studies: list[WindowStudy]) -> None:
    import numpy as np

    heads = ("out-of-screen holes", "PSNR", "PSNR, interior", "PSNR of rendered frames, as shown", "texel, px")
    for part, title in (("steady", "turning steadily"), ("reversing", "within an interval of a reversal")):
        table = Table(title, *heads, box=None, header_style="bold")
        for mode in getattr(studies[0], part):
            figures = [getattr(study, part)[mode] for study in studies]
            mean = {name: np.mean([getattr(f, name) for f in figures]) for name in vars(figures[0])}
            table.add_row(
                mode,
                f"{mean['holes']:.2%} (most {max(f.holes for f in figures):.2%})",
                *(f"{mean[name]:.2f}" for name in ("whole", "interior", "shown")),
                f"{mean['texel']:.3f}",
            )
        out.print(table)
    out.print("Means over scenes and seeds; PSNR in dB. The last two render more pixels, as small as the display's.")


def _print_shading(results: dict[str, list[ShadingStudy]]) -> None:
    from gffe_cl.evaluation.shading import METHODS, REGIONS
    from gffe_cl.metrics import RegionErrors, measurable, missing_metrics

    flat = [study for studies in results.values() for study in studies]
    for metric in measurable():
        for region in REGIONS:
            heads = (f"{metric.title}: {region} pixels", "share", *METHODS, "gain")
            table = Table(*heads, box=None, header_style="bold")
            for name, studies in (*results.items(), ("all", flat)):
                pooled = [RegionErrors.pooled(study.errors[m] for study in studies) for m in METHODS]
                figures = [errors.figure(metric.name, region) for errors in pooled]
                gain = metric.text(metric.gain(*figures[:2]), signed=True)
                table.add_row(name, f"{pooled[0].share(region):.2%}", *map(metric.text, figures), gain)
            out.print(table)
    out.print("All frames together. Focus pixels: shading is wrong in GAE, neither disoccluded nor dynamic.")
    for reason in missing_metrics():
        out.print(plain(reason))


def _write_sheet(path: Path, studies: list[ShadingStudy]) -> None:
    from gffe_cl.evaluation.report import contact_sheet

    groups = [(f"{study.scene}, seed {study.seed}", crop) for study in studies for crop in study.crops]
    if not groups:
        out.print("No focus pixels: nothing for the sheet.")
        return
    try:
        with replacing(path) as part:
            contact_sheet(groups, columns=len(groups[0][1]), cell_width=400).save(part)
    except (OSError, ValueError) as error:
        raise GffeError(f"{path}: cannot write the picture (expected .png or .jpg): {error}") from None
    out.print(f"Pictures are in {plain(path)}")


def _print_studies(studies: list[SceneStudy]) -> None:
    from gffe_cl.evaluation.methods import METHODS
    from gffe_cl.metrics import measurable

    metrics = measurable()
    table = Table("scene", "seed", *METHODS, "gap closed", "disoccluded", "dynamic", box=None, header_style="bold")
    for r in studies:
        figures = [f"{r.visible[m]:.2f}" for m in METHODS]
        table.add_row(r.scene, str(r.seed), *figures, f"{r.share:.0%}", f"{r.disoccluded:.1%}", f"{r.dynamic:.1%}")
    out.print(table)
    out.print("PSNR in dB over pixels that are not disoccluded.")
    table = Table("whole frame", "seed", *METHODS, box=None, header_style="bold")
    for r in studies:
        figures = (" ".join(metric.text(r.whole[metric.name][m]) for metric in metrics) for m in METHODS)
        table.add_row(r.scene, str(r.seed), *figures)
    out.print(table)
    out.print(f"{'; '.join(metric.title for metric in metrics)}.")
