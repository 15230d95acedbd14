"""The commands that make frames: devices, demo, render, run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    CompressionOption,
    DeviceOption,
    FollowLinksOption,
    JsonOption,
    NoCheckOption,
    SchedulerOption,
    WindowOption,
    app,
    cluster_at,
    out,
    parse_numbers,
    parse_size,
    plain,
    progress_bars,
    steps,
    warn,
    write_json,
)
from gffe_cl.cli.options import takes_options
from gffe_cl.core.errors import GffeError

if TYPE_CHECKING:
    from gffe_cl.inference.provider_check import Verdict
    from gffe_cl.opencl.device import Device, DeviceInfo
    from gffe_cl.pipeline.options import Options
    from gffe_cl.pipeline.run import RunReport
    from gffe_cl.pipeline.source import Live, Recorded


_MANY_CUTS = 0.2  # of the rendered frames


@app.command()
def devices(
    kind: Annotated[str | None, typer.Option(help="Only devices of this kind: gpu, cpu or other.")] = None,
    refresh: Annotated[
        bool, typer.Option("--refresh", help="Probe them anew, whatever is known of them from before.")
    ] = False,
    json_path: JsonOption = None,
) -> None:
    """List every OpenCL device: whether a kernel really runs on it, and what it lacks; and what may run the network."""
    from dataclasses import asdict

    from gffe_cl.opencl.device import HOW_TO_GET_ONE, best_of, list_devices

    infos = [info for info in list_devices(refresh) if kind in (None, info.kind)]
    table = Table("", "index", "device", "platform", "kernel runs", "lacks", box=None, header_style="bold")
    working = [info for info in infos if info.works]
    default = best_of(working) if working else None
    for info in infos:
        table.add_row(
            "*" if info is default else "",
            info.index,
            plain(info.name),
            plain(info.platform + (f" ({info.driver})" if info.driver else "")),
            "[green]yes[/]" if info.works else f"[red]no[/]: {plain(info.problem)}",
            ", ".join(info.lacks) or "nothing",
        )
    if infos:
        out.print(table)
    if default:
        out.print("* the default; choose another with --device or GFFE_DEVICE (--refresh probes anew)")
    verdicts = _provider_verdicts(refresh)
    for found in verdicts:
        out.print(plain(f"network's provider {found.provider}: {found.summary()}"))
    document = {"devices": [asdict(i) | {"default": i is default} for i in infos]}
    write_json(json_path, document | {"providers": [asdict(found) for found in verdicts]})
    if not working:
        raise GffeError(f"no OpenCL device{f' of kind {kind}' if kind else ''} runs a kernel: {HOW_TO_GET_ONE}")


def _provider_verdicts(refresh: bool) -> list[Verdict]:
    """Of all providers that are installed, but the CPU's, with the package's own network."""
    from gffe_cl.inference.network import default_model
    from gffe_cl.inference.provider_check import verdict
    from gffe_cl.inference.providers import CPU, installed_providers

    model = default_model()
    others = [provider for provider in installed_providers() if provider != CPU] if model else []
    return [verdict(model, provider, refresh) for provider in others]


@app.command()
@takes_options("shading_correction", "scn_model", "scn_provider")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("out/demo"),
    size: Annotated[str, typer.Option(help="Width × height, pixels.")] = "960x540",
    seed: Annotated[int, typer.Option(help="Variation of the scene.")] = 0,
    window: WindowOption = "off",
    device: DeviceOption = None,
    *,
    options: Options,
) -> None:
    """Render the scene 'corridor', extrapolate it, and measure the result against ground truth."""
    from gffe_cl.cli.demo import METHODS
    from gffe_cl.cli.demo import demo as run_demo
    from gffe_cl.evaluation.metrics import measurable
    from gffe_cl.opencl.device import open_device

    width, height = parse_size(size)
    if min(width, height) < 32 or max(width, height) > 4096:
        raise GffeError(f"demo: --size must be 32 to 4096 pixels each way, got '{size}'")
    opened = open_device(device)
    out.print(plain(f"Device: {opened.info.name} ({opened.info.platform})"))
    with progress_bars() as progress:
        metrics = run_demo(output, opened, width, height, seed, window, options, steps(progress))
    measured = measurable()
    heads = (metric.title for metric in measured)
    table = Table("against ground truth at t + ½", *heads, box=None, header_style="bold")
    for name, figures in metrics.items():
        table.add_row(METHODS[name], *(metric.text(figures[metric.name]) for metric in measured))
    out.print(table)
    out.print(f"Results are in {plain(output)}: contact_sheet.png, side_by_side.mp4, metrics.json, extrapolated/")


@app.command()
def render(
    scene: Annotated[
        str,
        typer.Argument(
            help="Name of a built-in scene: corridor, plaza, room, forest, gallery, street, factory, courtyard. Or of a"
            " situation: bars, ropes, balls, rotors, handheld, lamps, shadows, fan, screen, quantised."
        ),
    ],
    output: Annotated[Path, typer.Argument(help="Folder for the sequence.")],
    size: Annotated[str, typer.Option(help="Width × height, pixels.")] = "960x540",
    frames: Annotated[int, typer.Option(help="Rendered frames.")] = 30,
    fps: Annotated[float, typer.Option(help="Rendered frames per second.")] = 30.0,
    seed: Annotated[int, typer.Option(help="Variation of layout, textures, lights and camera path.")] = 0,
    ground_truth: Annotated[
        bool, typer.Option("--ground-truth", help="Also the frames in between, for measuring.")
    ] = False,
    per_frame: Annotated[
        int, typer.Option("-n", help="Frames in between per rendered frame, for --ground-truth and --window adaptive.")
    ] = 1,
    samples: Annotated[
        int | None, typer.Option(help="Colour samples per pixel at edges [dim](default 8; 1 with --jitter)[/].")
    ] = None,
    window: Annotated[
        str,
        typer.Option(
            help="Rendering window: adaptive (covers frames in between, see -n), fixed:1.2 (times the display) or off."
        ),
    ] = "off",
    jitter: Annotated[str, typer.Option(help="Of the camera, for upscaling: halton:16 (points), or off.")] = "off",
    scale: Annotated[
        float, typer.Option(help="Rendered frames are so many times smaller than --size, each way; truth is not.")
    ] = 1.0,
    compression: CompressionOption = "zip",
    scheduler: SchedulerOption = None,
    device: DeviceOption = None,
) -> None:
    """Render a built-in scene to a sequence: colour, depth, motion vectors and cameras."""
    from gffe_cl.frame.jitter import Jitter
    from gffe_cl.opencl.device import open_device
    from gffe_cl.scenes import load_scene
    from gffe_cl.scenes.render import render_sequence

    width, height = parse_size(size)
    built, jittered = load_scene(scene, seed), Jitter.parse(jitter)
    with cluster_at(scheduler) as workers, progress_bars() as progress:
        opened = None if workers else open_device(device)
        total = frames * (1 + per_frame * ground_truth)
        count = render_sequence(
            built, output, opened, width, height, frames, fps,
            ground_truth=ground_truth, per_frame=per_frame, samples=samples, window=window, jitter=jittered,
            scale=scale, compression=compression, cluster=workers,
            on_frame=steps(progress)(f"Rendering '{scene}'", total),
        )  # fmt: skip
    out.print(f"{count} frames in {plain(output)}")


@app.command()
@takes_options()
def run(
    sequence: Annotated[Path, typer.Argument(help="Folder of a capture (`gffe formats`), or a built-in scene.")],
    output: Annotated[Path, typer.Argument(help="Folder for the result, a sequence again.")],
    n: Annotated[
        int | None,
        typer.Option("-n", help="Extrapolated frames per rendered frame, 1 to 7 [dim](default 1)[/]."),
    ] = None,
    alpha: Annotated[str | None, typer.Option(help="Times instead, in intervals after each frame: 0.25,0.5.")] = None,
    device: DeviceOption = None,
    camera: Annotated[
        str, typer.Option(help="'truth': of ground truth, where each new frame of an interval has some; 'predicted'.")
    ] = "truth",
    dump_stages: Annotated[
        bool, typer.Option("--dump-stages", help="Write every buffer of every stage to OUTPUT/stages.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Bad pixels are errors.")] = False,
    window: Annotated[
        str | None,
        typer.Option(
            help="Rendering window of a built-in scene: adaptive, fixed:1.2 or off. Of a recorded sequence: as"
            " recorded, or off to use its display part only."
        ),
    ] = None,
    size: Annotated[
        str | None, typer.Option(help="Of a built-in scene: width × height, pixels [dim](default 960x540)[/].")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(help="Of a built-in scene: rendered frames [dim](default 30)[/].")
    ] = None,
    fps: Annotated[
        float | None, typer.Option(help="Of a built-in scene: rendered frames per second [dim](default 30)[/].")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of a built-in scene: its variation [dim](default 0)[/].")] = None,
    compression: CompressionOption = "zip",
    no_check: NoCheckOption = False,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
    *,
    options: Options,
) -> None:
    """Extrapolate after every rendered frame of a sequence, or of a built-in scene that is rendered meanwhile."""
    from gffe_cl.opencl.malloc_tuning import keep_freed_memory
    from gffe_cl.pipeline.run import alphas_for, run_sequence

    if n is not None and alpha is not None:
        raise GffeError("-n and --alpha exclude each other")
    alphas = alphas_for(n if n is not None else 1) if alpha is None else parse_numbers(alpha, "--alpha")
    if camera not in ("truth", "predicted"):
        raise GffeError(f"--camera must be 'truth' or 'predicted', got '{camera}'")
    options = replace(options, shading_inputs=dump_stages)
    live = {"--size": size, "--frames": frames, "--fps": fps, "--seed": seed}
    keep_freed_memory()
    opened, source = open_source(sequence, window, device, live, options.upscale)
    if not no_check:
        _check_quickly(source, sequence)
    with progress_bars() as progress:
        report = run_sequence(
            source, output, opened, options, alphas,
            predicted_camera=camera == "predicted", strict=strict, dump_stages=dump_stages, compression=compression,
            on_frame=steps(progress)("Extrapolating", source.count * len(alphas)),
        )  # fmt: skip
    _print_report(report, output)
    write_json(json_path, _report_json(report, opened.info))


def _check_quickly(source: Recorded | Live, target: Path) -> None:
    from gffe_cl.doctor import quick_warning
    from gffe_cl.pipeline.source import Recorded

    suspicion = quick_warning(source.sequence, source.exposure) if isinstance(source, Recorded) else None
    if suspicion:
        warn(f"{suspicion}; `gffe check {target}` says more")


def open_source(
    sequence: Path,
    window: str | None,
    device: str | None,
    live: dict[str, str | float | None],
    upscale: float = 0.0,
) -> tuple[Device, Recorded | Live]:
    """A folder is a sequence; what is none may be the name of a scene, which `live` says how to render."""
    from gffe_cl.formats import open_capture
    from gffe_cl.opencl.device import open_device
    from gffe_cl.pipeline.source import Live, Recorded
    from gffe_cl.scenes import is_scene, load_scene, scene_names

    if is_scene(str(sequence)):
        size, frames, fps, seed = live.values()
        size = parse_size("960x540" if size is None else size)
        scene, opened = load_scene(str(sequence), 0 if seed is None else seed), open_device(device)
        frames, fps = 30 if frames is None else frames, 30.0 if fps is None else fps
        return opened, Live(scene, opened, *size, frames, fps, window or "off", upscale)
    given = [option for option, value in live.items() if value is not None]
    if given:
        raise GffeError(f"{given[0]} is for built-in scenes ({scene_names()}), {sequence} is none")
    recorded, opened = open_capture(sequence), open_device(device)
    return opened, Recorded(recorded, opened, window, upscale)


def _print_report(report: RunReport, output: Path) -> None:
    from gffe_cl.sequence.read_ahead import usable_cores

    for warning in report.warnings:
        warn(warning)
    if report.bad_pixels:
        warn(f"bad pixels in the input, survived: {report.bad_pixels}")
    for file in report.cuts:
        out.print(plain(f"cut at {file}: what was before is not used"))
    if 1 < len(report.cuts) > _MANY_CUTS * report.rendered:
        warn(f"{len(report.cuts)} of {report.rendered} rendered frames look like cuts: do the motion vectors fit?")
    times = ", ".join(f"{name} {ms:.1f}" for name, ms in report.milliseconds.items() if ms)
    out.print(f"{report.extrapolated} extrapolated frames in {plain(output)} (ms per frame: {times})")
    spent = report.seconds
    out.print(
        f"{spent['wall']:.1f} s: kernels {spent['kernels']:.1f}, network {spent['network']:.1f}, meanwhile EXRs"
        f" {spent['codec_cpu']:.1f} of CPU time on {usable_cores()} cores"
    )


def _report_json(report: RunReport, info: DeviceInfo) -> dict:
    return {
        "extrapolated": report.extrapolated,
        "device": info.name,
        "platform": info.platform,
        "milliseconds": report.milliseconds,
        "seconds": report.seconds,
        "bad_pixels": vars(report.bad_pixels),
        "cuts": report.cuts,
        "warnings": report.warnings,
    }
