"""The command line: `gffe`. Exit codes: 0 done, 1 findings, 2 could not, 130 interrupted."""

from __future__ import annotations

import json
import math
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from gffe_cl import __version__
from gffe_cl.errors import GffeError

app = typer.Typer(
    help="G-buffer free frame extrapolation: makes the frames after the ones your renderer has finished.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
)
out = Console(highlight=False, width=None if sys.stdout.isatty() else 120)
err = Console(stderr=True, highlight=False, soft_wrap=True)

_INTERRUPTED = 130

DeviceOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="Part of a device's or platform's name, its index (0:0), 'gpu' or 'cpu'; see `gffe devices`.",
    ),
]


def _json_path(path: Path | None) -> Path | None:
    """Checked before the work, not after it."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        raise GffeError(f"--json {path}: must be a file in a folder that exists")
    return path


JsonOption = Annotated[
    Path | None, typer.Option("--json", help="Also write the report to this file.", callback=_json_path)
]


def main() -> None:
    """Entry point: structural faults become one line and exit code 2."""
    try:
        code = app(args=sys.argv[1:] or ["--help"], standalone_mode=False)
    except GffeError as error:
        fail(str(error))
    except MemoryError:
        fail("not enough memory (expected smaller images)")
    except (OSError, UnicodeError) as error:
        fail(f"{getattr(error, 'filename', None) or 'system'}: {getattr(error, 'strerror', None) or error}")
    except (KeyboardInterrupt, typer.Abort):
        code = _INTERRUPTED
    except Exception as error:
        if hasattr(error, "format_message"):  # usage errors of the command line library
            fail(f"{error.format_message()} (see `gffe --help`)")
        raise
    if code == _INTERRUPTED:
        err.print("interrupted: what was finished is kept")
    sys.exit(code or 0)


def fail(message: str) -> None:
    err.print(f"[bold red]error:[/] {_plain(message)}")
    sys.exit(2)


@app.callback()
def _gffe(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if version:
        out.print(f"gffe-cl {__version__}")
        raise typer.Exit()


@app.command()
def devices(
    kind: Annotated[str | None, typer.Option(help="Only devices of this kind: gpu, cpu or other.")] = None,
    json_path: JsonOption = None,
) -> None:
    """List every OpenCL device: whether a kernel really runs on it, and what it lacks."""
    from dataclasses import asdict

    from gffe_cl.device import HOW_TO_GET_ONE, best_of, list_devices

    infos = [info for info in list_devices() if kind in (None, info.kind)]
    table = Table("", "index", "device", "platform", "kernel runs", "lacks", box=None, header_style="bold")
    working = [info for info in infos if info.works]
    default = best_of(working) if working else None
    for info in infos:
        table.add_row(
            "*" if info is default else "",
            info.index,
            info.name,
            f"{info.platform} ({info.driver})",
            "[green]yes[/]" if info.works else f"[red]no[/]: {_plain(info.problem)}",
            ", ".join(info.lacks) or "nothing",
        )
    if infos:
        out.print(table)
    if default:
        out.print("* the default; choose another with --device or GFFE_DEVICE")
    _write_json(json_path, {"devices": [asdict(i) | {"default": i is default} for i in infos]})
    if not working:
        raise GffeError(f"no OpenCL device{f' of kind {kind}' if kind else ''} runs a kernel: {HOW_TO_GET_ONE}")


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("out/demo"),
    size: Annotated[str, typer.Option(help="Width × height, pixels.")] = "960x540",
    seed: Annotated[int, typer.Option(help="Variation of the scene.")] = 0,
    device: DeviceOption = None,
) -> None:
    """Render the scene 'corridor', extrapolate it, and measure the result against ground truth."""
    from gffe_cl.demo import METHODS
    from gffe_cl.demo import demo as run_demo
    from gffe_cl.device import open_device

    width, height = parse_size(size)
    if min(width, height) < 32 or max(width, height) > 4096:
        raise GffeError(f"demo: --size must be 32 to 4096 pixels each way, got '{size}'")
    opened = open_device(device)
    out.print(f"Device: {opened.info.name} ({opened.info.platform})")
    with _progress() as progress:
        metrics = run_demo(output, opened, width, height, seed, _steps(progress))
    table = Table("against ground truth at t + ½", "PSNR, dB", "SSIM", box=None, header_style="bold")
    for name, text in METHODS.items():
        table.add_row(text, f"{metrics[name]['psnr']:.2f}", f"{metrics[name]['ssim']:.4f}")
    out.print(table)
    out.print(f"Results are in {output}: contact_sheet.png, side_by_side.mp4, metrics.json, extrapolated/")


@app.command()
def render(
    scene: Annotated[str, typer.Argument(help="Name of a built-in scene: corridor, plaza, room, forest.")],
    output: Annotated[Path, typer.Argument(help="Folder for the sequence.")],
    size: Annotated[str, typer.Option(help="Width × height, pixels.")] = "960x540",
    frames: Annotated[int, typer.Option(help="Rendered frames.")] = 30,
    fps: Annotated[float, typer.Option(help="Rendered frames per second.")] = 30.0,
    seed: Annotated[int, typer.Option(help="Variation of layout, textures, lights and camera path.")] = 0,
    ground_truth: Annotated[
        bool, typer.Option("--ground-truth", help="Also the frames in between, for measuring.")
    ] = False,
    per_frame: Annotated[int, typer.Option("-n", help="Ground-truth frames per rendered frame.")] = 1,
    samples: Annotated[int, typer.Option(help="Colour samples per pixel at edges.")] = 8,
    device: DeviceOption = None,
) -> None:
    """Render a built-in scene to a sequence: colour, depth, motion vectors and cameras."""
    from gffe_cl.device import open_device
    from gffe_cl.render import render_sequence
    from gffe_cl.scenes import load_scene

    width, height = parse_size(size)
    built = load_scene(scene, seed)
    opened = open_device(device)
    with _progress() as progress:
        total = frames * (1 + per_frame * ground_truth)
        count = render_sequence(
            built, output, opened, width, height, frames, fps,
            ground_truth=ground_truth, per_frame=per_frame, samples=samples,
            on_frame=_steps(progress)(f"Rendering '{scene}'", total),
        )  # fmt: skip
    out.print(f"{count} frames in {output}")


@app.command()
def run(
    sequence: Annotated[Path, typer.Argument(help="Folder of the sequence to extrapolate.")],
    output: Annotated[Path, typer.Argument(help="Folder for the result, a sequence again.")],
    n: Annotated[
        int | None,
        typer.Option("-n", help="Extrapolated frames per rendered frame, 1 to 7 [dim](default 1)[/]."),
    ] = None,
    alpha: Annotated[str | None, typer.Option(help="Times instead, in intervals after each frame: 0.25,0.5.")] = None,
    device: DeviceOption = None,
    history: Annotated[int, typer.Option(help="Positions kept per fragment, 2 to 5.")] = 2,
    order: Annotated[int, typer.Option(help="Degree of the position prediction, below --history.")] = 1,
    static_threshold: Annotated[
        str, typer.Option(help="Pixels of motion from which a fragment is dynamic, or auto.")
    ] = "auto",
    no_motion: Annotated[bool, typer.Option("--no-motion", help="Treat everything as static.")] = False,
    no_crack_closing: Annotated[
        bool, typer.Option("--no-crack-closing", help="Splat single pixels, as in the paper.")
    ] = False,
    layers: Annotated[int, typer.Option(help="Levels of the background, 0 to 4.")] = 2,
    no_background: Annotated[bool, typer.Option("--no-background", help="The same as --layers 0.")] = False,
    hole_filling: Annotated[
        str, typer.Option(help="What the background leaves: far-side, push-pull, downsample (the paper's) or none.")
    ] = "far-side",
    camera: Annotated[
        str, typer.Option(help="'truth': of the ground-truth frame where there is one; 'predicted'.")
    ] = "truth",
    dump_stages: Annotated[
        bool, typer.Option("--dump-stages", help="Write every buffer of every stage to OUTPUT/stages.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Bad pixels are errors.")] = False,
    json_path: JsonOption = None,
) -> None:
    """Extrapolate after every rendered frame of a sequence."""
    from gffe_cl.device import open_device
    from gffe_cl.pipeline import Options
    from gffe_cl.run import alphas_for, run_sequence
    from gffe_cl.sequence import open_sequence

    if n is not None and alpha is not None:
        raise GffeError("-n and --alpha exclude each other")
    alphas = alphas_for(n if n is not None else 1) if alpha is None else parse_numbers(alpha, "--alpha")
    if camera not in ("truth", "predicted"):
        raise GffeError(f"--camera must be 'truth' or 'predicted', got '{camera}'")
    threshold = None
    if static_threshold != "auto":
        numbers = parse_numbers(static_threshold, "--static-threshold")
        if len(numbers) != 1 or not 0 <= numbers[0] <= 1e6:
            raise GffeError(f"--static-threshold must be one number of pixels or auto, got '{static_threshold}'")
        threshold = numbers[0]
    options = Options(
        history=history,
        order=order,
        static_threshold=threshold,
        motion=not no_motion,
        crack_closing=not no_crack_closing,
        levels=0 if no_background else layers,
        hole_filling=hole_filling,
        shading_inputs=dump_stages,
    )  # fmt: skip
    source = open_sequence(sequence)
    opened = open_device(device)
    with _progress() as progress:
        report = run_sequence(
            source, output, opened, options, alphas,
            predicted_camera=camera == "predicted", strict=strict, dump_stages=dump_stages,
            on_frame=_steps(progress)("Extrapolating", len(source.rendered) * len(alphas)),
        )  # fmt: skip
    for warning in report.warnings:
        err.print(f"[yellow]warning:[/] {_plain(warning)}")
    if report.bad_pixels:
        err.print(f"[yellow]warning:[/] bad pixels in the input, survived: {report.bad_pixels}")
    times = ", ".join(f"{name} {ms:.1f}" for name, ms in report.milliseconds.items())
    out.print(f"{report.extrapolated} extrapolated frames in {output} (kernel ms per frame: {times})")
    _write_json(
        json_path,
        {
            "extrapolated": report.extrapolated,
            "device": opened.info.name,
            "platform": opened.info.platform,
            "milliseconds": report.milliseconds,
            "bad_pixels": vars(report.bad_pixels),
            "warnings": report.warnings,
        },
    )


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(help="Sequence with extrapolated frames.")],
    b: Annotated[Path, typer.Argument(help="Sequence with ground truth.")],
    mask: Annotated[
        str | None, typer.Option(help="Take PSNR only where this channel of A is not 0 (mask.dynamic …).")
    ] = None,
    fail_under: Annotated[float | None, typer.Option(help="Exit with 1 if the mean PSNR is lower, dB.")] = None,
    json_path: JsonOption = None,
) -> None:
    """Measure extrapolated frames of A against the ground truth of B."""
    from gffe_cl.evaluate import compare as compare_sequences
    from gffe_cl.sequence import open_sequence

    first, second = open_sequence(a), open_sequence(b)
    with _progress() as progress:
        advance = _steps(progress)("Comparing", len(first.extrapolated))
        result = compare_sequences(first, second, mask, lambda done, total: advance())
    table = Table("frame", "PSNR, dB", "SSIM", box=None, header_style="bold")
    for frame in result.frames:
        style = None if frame.counted else "dim"
        table.add_row(frame.file, f"{frame.psnr:.2f}", f"{frame.ssim:.4f}", style=style)
    out.print(table)
    for note in result.notes:
        out.print(_plain(note))
    left_out = sum(not frame.counted for frame in result.frames)
    dim = f" ({left_out} frames without history left out)" if left_out else ""
    out.print(f"[bold]mean[/]{dim}: PSNR {result.psnr:.2f} dB, SSIM {result.ssim:.4f}")
    _write_json(json_path, result.to_json())
    if fail_under is not None and not result.psnr >= fail_under:
        raise typer.Exit(1)


@app.command()
def study(
    scenes: Annotated[list[str] | None, typer.Argument(help="Built-in scenes [dim](default: all)[/].")] = None,
    seeds: Annotated[int, typer.Option(help="Seeds 0 … N−1 of each.")] = 3,
    size: Annotated[str, typer.Option(help="Width × height, pixels.")] = "480x270",
    frames: Annotated[int, typer.Option(help="Rendered frames per scene and seed.")] = 10,
    alpha: Annotated[float, typer.Option(help="Time of the extrapolated frames, in intervals.")] = 0.5,
    fps: Annotated[float, typer.Option(help="Rendered frames per second.")] = 30.0,
    disocclusions: Annotated[
        bool, typer.Option("--disocclusions", help="Measure how disocclusions are filled instead.")
    ] = False,
    device: DeviceOption = None,
    json_path: JsonOption = None,
) -> None:
    """Measure the parts of the method on built-in scenes, against an oracle that knows the true motion."""
    from dataclasses import asdict

    from gffe_cl.device import open_device
    from gffe_cl.disocclusion import CATEGORIES, DisocclusionStudy, study_disocclusions
    from gffe_cl.disocclusion import METHODS as FILLINGS
    from gffe_cl.scenes import SCENES
    from gffe_cl.study import METHODS, study_scene

    width, height = parse_size(size)
    if min(width, height) < 16 or seeds < 1 or frames < 4 or not 0 < alpha <= 8:
        raise GffeError("study: --size must be at least 16x16, --seeds 1, --frames 4, and --alpha within 0 and 8")
    opened = open_device(device)
    names = scenes or list(SCENES)
    with _progress() as progress:
        advance = _steps(progress)("Measuring", len(names) * seeds * frames)
        measure = study_disocclusions if disocclusions else study_scene
        results = {
            name: [measure(opened, name, seed, width, height, frames, fps, alpha, advance) for seed in range(seeds)]
            for name in names
        }
    if disocclusions:
        pooled = {name: DisocclusionStudy.pooled(studies) for name, studies in results.items()}
        pooled["all"] = DisocclusionStudy.pooled([study for studies in results.values() for study in studies])
        for name, r in pooled.items():
            shares = {c: r.pixels[c] / r.pixels["all"] for c in CATEGORIES}
            heads = [f"{c} ({share:.2%} of pixels)" for c, share in shares.items()]
            table = Table(name, *heads, "left by the background", box=None, header_style="bold")
            for method in FILLINGS:
                left = f"{r.unfilled[method] / r.pixels['all']:.2%}"
                table.add_row(method, *(f"{r.psnr(method, c):.2f}" for c in CATEGORIES), left)
            out.print(table)
        _write_json(json_path, {name: asdict(r) for name, r in pooled.items()})
        return
    table = Table("scene", "seed", *METHODS, "gap closed", "disoccluded", "dynamic", box=None, header_style="bold")
    for r in (study for studies in results.values() for study in studies):
        figures = [f"{r.visible[m]:.2f}" for m in METHODS]
        table.add_row(r.scene, str(r.seed), *figures, f"{r.share:.0%}", f"{r.disoccluded:.1%}", f"{r.dynamic:.1%}")
    out.print(table)
    out.print("PSNR in dB over pixels that are not disoccluded.")
    table = Table("whole frame", "seed", *METHODS, box=None, header_style="bold")
    for r in (study for studies in results.values() for study in studies):
        table.add_row(r.scene, str(r.seed), *(f"{r.whole[m]:.2f} {r.ssim[m]:.4f}" for m in METHODS))
    out.print(table)
    out.print("PSNR in dB and SSIM.")
    _write_json(
        json_path, {"results": [asdict(r) | {"share": r.share} for studies in results.values() for r in studies]}
    )


@app.command()
def bench(
    sizes: Annotated[
        str, typer.Option(help="Width × height, separated by commas.")
    ] = "960x540,1280x720,1920x1080,3840x2160",
    repeats: Annotated[int, typer.Option(help="Timed frames per size.")] = 15,
    layers: Annotated[int, typer.Option(help="Levels of the background, 0 to 4.")] = 2,
    device: Annotated[
        str | None, typer.Option("--device", help="One device [dim](default: every device that works)[/].")
    ] = None,
    json_path: JsonOption = None,
) -> None:
    """Time every stage, in milliseconds and in bytes per pixel, beside the paper's table."""
    from dataclasses import asdict

    from gffe_cl.bench import PAPER, Copier, bench_size
    from gffe_cl.device import list_devices, open_device, open_info
    from gffe_cl.pipeline import Options

    if repeats < 1:
        raise GffeError(f"--repeats must be at least 1, got {repeats}")
    options = Options(levels=layers)
    parsed = [parse_size(text) for text in sizes.split(",")]
    if device is None:
        opened = [open_info(info) for info in list_devices() if info.works] or [open_device()]
    else:
        opened = [open_device(device)]
    report = []
    for one in opened:
        with _progress() as progress:
            advance = _steps(progress)(f"{one.info.name} ({one.info.platform})", len(parsed) * (repeats + 3))
            copier = Copier(one)
            results = [bench_size(one, copier, *size, options, repeats, advance) for size in parsed]
        table = Table("bytes per pixel (ms)", *(f"{r.width}×{r.height}" for r in results), "paper, 1080p",
                      title=f"{one.info.name} ({one.info.platform})", box=None, header_style="bold")  # fmt: skip
        for name in results[0].milliseconds:
            figures = [f"{r.bytes_per_pixel[name]:.0f} ({r.milliseconds[name]:.2f})" for r in results]
            table.add_row(name, *figures, str(PAPER.get(name) or ""), style="bold" if name == "GAE" else None)
        table.add_row("wall time, ms", *(f"{r.wall:.2f}" for r in results), "")
        table.add_row("copy bandwidth, GB/s", *(f"{r.bandwidth:.1f}" for r in results), "672")
        table.add_row("device memory, MiB", *(f"{r.memory / 2**20:.0f}" for r in results), "")
        out.print(table)
        report.append({"device": one.info.name, "platform": one.info.platform, "copied by": copier.way,
                       "sizes": [asdict(r) for r in results]})  # fmt: skip
    _write_json(json_path, {"devices": report, "paper": PAPER})


# ---- helpers -------------------------------------------------------------------------------------------


def parse_size(text: str) -> tuple[int, int]:
    """'1920x1080' → (1920, 1080)."""
    try:
        width, height = (int(part) for part in text.lower().replace("×", "x").split("x"))
    except ValueError:
        raise GffeError(f"size must look like 1920x1080, got '{text}'") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise GffeError(f"size must be 1 to 16384 pixels each way, got '{text}'")
    return width, height


def parse_numbers(text: str, option: str) -> list[float]:
    """'0.25,0.5' → [0.25, 0.5]."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise GffeError(f"{option} must be numbers separated by commas, got '{text}'") from None


@contextmanager
def _progress():
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, disable=not err.is_terminal) as progress:
        yield progress


def _steps(progress: Progress):
    """A function that opens a progress bar and returns its `advance`."""

    def step(text: str, total: int):
        task = progress.add_task(text, total=total)
        return lambda: progress.advance(task)

    return step


def _write_json(path: Path | None, document: dict) -> None:
    if path is None:
        return
    try:
        path.write_text(json.dumps(_finite(document), indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise GffeError(f"{path}: cannot write: {error.strerror}") from None


def _finite(value):
    """`value` with null for numbers that JSON cannot hold."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(text)
