"""Commands that measure and test devices: `gffe bench`, `gffe devices`, `gffe selftest`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    DeviceOption,
    JsonOption,
    OverwriteOption,
    app,
    counted,
    err,
    out,
    output_file,
    parse_size,
    plain,
    progress_bars,
    steps,
    takes_options,
    write_json,
)
from gffe_cl.engine.core.errors import GffeError

if TYPE_CHECKING:
    from gffe_cl.engine.opencl.device import DeviceInfo
    from gffe_cl.engine.options import Options
    from gffe_cl.engine.selftest.report import DeviceResult, NetworkResult
    from gffe_cl.engine.timing.bench import SizeBench

_SIZES = "960x540,1280x720,1920x1080,3840x2160"


@app.command()
@takes_options()
def bench(
    scene: Annotated[str, typer.Argument(help="Built-in scene.")] = "plaza",
    sizes: Annotated[str, typer.Option(help="Frame sizes: WxH,…")] = _SIZES,
    repeats: Annotated[int, typer.Option(help="Number of timed frames per size.")] = 15,
    frame: Annotated[int, typer.Option(help="Index of the timed rendered frame.")] = 31,
    kernels: Annotated[
        bool, typer.Option("--kernels", help="Kernel times: also print the time of every kernel.")
    ] = False,
    device: Annotated[
        str | None, typer.Option("--device", help="OpenCL device to time [dim](default: every device that works)[/].")
    ] = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    *,
    options: Options,
) -> None:
    """Time every stage, in milliseconds and in bytes per pixel, and every preset; compare with the paper's table."""
    from gffe_cl.engine.opencl.device import list_devices, open_device, open_info
    from gffe_cl.engine.timing.bench import PAPER, Copier, bench_size, growth
    from gffe_cl.lab.bench import loop_of

    if repeats < 1:
        raise GffeError(f"--repeats must be at least 1, got {repeats}")
    chosen = [parse_size(text) for text in sizes.split(",")]
    if device is None:
        opened = [open_info(info, profiling=True) for info in list_devices() if info.works] or [open_device()]
    else:
        opened = [open_device(device, profiling=True)]
    report = []
    for one in opened:
        results, name = [], ""
        with progress_bars() as progress:
            advance = steps(progress)(_label(one.info), len(chosen) * repeats)
            copier = Copier(one)
            for size in chosen:
                loop = loop_of(one, scene, size, frame, options.upscale)
                results.append(bench_size(one, copier, loop, options, repeats, advance))
                name = loop.name
        _print_bench(one.info, name, results)
        if kernels:
            _print_kernels(results)
        named = {"device": one.info.name, "platform": one.info.platform, "of": name, "copied by": copier.way}
        report.append(named | {"growth": growth(results), "sizes": [asdict(r) for r in results]})
    write_json(json_path, {"devices": report, "paper": PAPER})


def _label(info: DeviceInfo) -> str:
    return f"{info.name} ({info.platform})"


def _print_bench(info: DeviceInfo, name: str, results: list[SizeBench]) -> None:
    from gffe_cl.engine.timing.bench import PAPER, growth

    heads = (*(f"{r.width}×{r.height}" for r in results), "paper, 1080p")
    title = plain(f"{name}, {_label(info)}")
    table = Table("bytes per pixel (ms)", *heads, title=title, box=None, header_style="bold")
    last = results[-1]
    for part in results[0].milliseconds:
        parts = [(r.bytes_per_pixel.get(part), r.milliseconds.get(part)) for r in results]  # small frames lack some
        figures = ["–" if ms is None else f"{moved:.0f} ({ms:.2f})" for moved, ms in parts]
        style = "bold" if part in ("GAE", "SCN") else None
        table.add_row(part, *figures, str(PAPER.get(part) or ""), style=style)
    table.add_row("wall time, ms", *(f"{r.wall:.2f}" for r in results), "")
    for preset in last.presets:
        times = (r.presets[preset] for r in results)
        table.add_row(f"preset {preset}, ms", *("–" if ms is None else f"{ms:.2f}" for ms in times), "")
    table.add_row("copy bandwidth, GB/s", *(f"{r.bandwidth:.1f}" for r in results), "672")
    table.add_row("device memory, MiB", *(f"{r.memory / 2**20:.0f}" for r in results), "")
    table.add_row("of which GAE's", *(f"{r.memory_gae / 2**20:.0f}" for r in results), "")
    commands = (" + ".join(f"{n} {part}" for part, n in r.commands.items()) for r in results)
    table.add_row("commands for both frames", *commands, "")
    if last.provider:
        table.add_row("the network ran on", *(r.provider.removesuffix("ExecutionProvider") for r in results), "")
    out.print(table)
    if last.reason:
        out.print(f"What runs the network: {plain(last.provider)}, {plain(last.reason)}.")
    if "misc" in last.milliseconds:
        out.print(
            "misc: choosing the adaptive window on the host and presenting. Here it is part of neither GAE nor the wall"
            " time; the paper's GAE contains it, 1400 bytes per pixel in all."
        )
    if (power := growth(results)) is not None:
        out.print(f"GAE grows as pixels^{power:.2f}.")
    sizes = ", ".join(f"{stage} {nbytes / 2**20:.1f}" for stage, nbytes in last.memory_by_stage.items())
    out.print(f"Device memory at these sizes, MiB: {sizes}; two rendered frames beside, motion of one.")


def _print_kernels(results: list[SizeBench]) -> None:
    table = Table("kernel, ms", *(f"{r.width}×{r.height}" for r in results), box=None, header_style="bold")
    for name in results[0].kernels:
        table.add_row(name, *(f"{r.kernels.get(name, 0):.2f}" for r in results))
    out.print(table)


@app.command()
def devices(
    kind: Annotated[str | None, typer.Option(help="Kind of the devices to list: gpu, cpu or other.")] = None,
    refresh: Annotated[
        bool, typer.Option("--refresh", help="Device cache: ignore it and probe every device again.")
    ] = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """List every OpenCL device with the result of a test kernel and its missing features."""
    from dataclasses import asdict

    from gffe_cl.engine.inference.network import RUNS_ON
    from gffe_cl.engine.opencl.device import best_of, known_devices, none_works

    every, age = known_devices(refresh)
    infos = [info for info in every if kind in (None, info.kind)]
    table = Table("", "index", "device", "platform", "kernel runs", "Mpixel/s", "lacks", box=None, header_style="bold")
    working = [info for info in infos if info.works]
    default = best_of(working) if working else None
    for info in infos:
        table.add_row(
            "*" if info is default else "",
            info.index,
            plain(info.name),
            plain(info.platform + (f" ({info.driver})" if info.driver else "")),
            "[green]yes[/]" if info.works else f"[red]no[/]: {plain(info.problem)}",
            f"{info.megapixels_per_second:.3g}" if info.works else "",
            ", ".join(info.lacks) or "nothing",
        )
    if infos:
        out.print(table)
    if default:
        out.print("* the default: the most Mpixel/s in a test of arithmetic and memory, or about as many on a GPU")
        out.print("choose another with --device or GFFE_DEVICE")
        out.print(f"tested {_ago(age)}; other programs slow the test down: --refresh repeats it")
        out.print(f"the default runs the network {RUNS_ON['gpu' if default.kind == 'gpu' else 'cpu']} (--scn-provider)")
    document = {"devices": [asdict(i) | {"default": i is default} for i in infos], "age_seconds": age or 0.0}
    write_json(json_path, document)
    if not working:
        raise none_works(infos or every, kind)


def _ago(seconds: float | None) -> str:
    """Return how long ago something was: "just now" (None), "20 minutes ago", "3 days ago"."""
    for name, unit in (("day", 86400), ("hour", 3600), ("minute", 60)):
        if seconds is not None and seconds >= unit:
            return f"{counted(int(seconds / unit), name)} ago"
    return "just now"


_COLORS = {"equal": "green", "differs": "red", "failed": "red", "refused": "yellow"}
_MOST_ROWS = 40


@app.command()
def selftest(
    device: DeviceOption = None,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            help="File for a fault report: devices, drivers, versions, and everything that differs.",
            callback=output_file("--report"),
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="Quick test: only the kernel variants that the device chooses itself; a quarter of the time.",
        ),
    ] = False,
    seconds: Annotated[float, typer.Option("--timeout", help="Time limit per device, seconds.", min=1.0)] = 600.0,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Run a fixed workload on every device, and compare every buffer with recorded references, bit by bit.

    Exit code 1: something differs; 2: something could not be run.
    """
    from gffe_cl.engine.selftest import report as running

    wanted = {"forms": ["own"]} if quick else None
    found = running.selftest(device, seconds=seconds, wanted=wanted, on_device=_announce)
    out.print(_devices_table(found.devices))
    for network in found.networks:
        _print_network(network)
    _print_differences(found.devices)
    document = found.document()
    write_json(json_path, document)
    write_json(report, {"machine": running.machine(), **document} if report else {})
    if report:
        out.print(plain(f"Report: {report}"))
    elif found.exit_code:
        out.print("To report it: gffe selftest --report FILE")
    raise typer.Exit(found.exit_code)


def _announce(info: DeviceInfo) -> None:
    if info.works:
        err.print(plain(f"Testing {info.name} ({info.platform}), about a minute"))


def _devices_table(results: list[DeviceResult]) -> Table:
    heads = ("index", "device", "platform", "verdict", "compared")
    table = Table(*heads, box=None, header_style="bold")
    for result in results:
        info = result.info
        forms = ", ".join(form["name"] for form in result.forms)
        problem = f": {plain(result.problem)}" if result.problem else ""
        table.add_row(
            info.index,
            plain(info.name),
            plain(info.platform + (f" ({info.driver})" if info.driver else "")),
            f"[{_COLORS[result.verdict]}]{result.verdict}[/]{problem}",
            f"{len(result.buffers)} buffers ({forms})" if forms else "",
        )
    return table


def _print_network(result: NetworkResult) -> None:
    told = result.problem or (f"largest difference {result.largest:.1e}" if result.largest else "bit for bit")
    out.print(f"network on {result.provider}: [{_COLORS[result.verdict]}]{result.verdict}[/], {plain(told)}")


def _print_differences(results: list[DeviceResult]) -> None:
    """Print the differences by device and buffer, of the buffers that differ anywhere."""
    others = sorted({case for result in results for case in result.other_inputs})
    if others:
        out.print(f"NumPy makes other frames here than were recorded ({', '.join(others)}): no device's fault.")
    worst = [(result, result.worst()) for result in results if result.forms]
    names = sorted({name for _, found in worst for name in found})
    if not names:
        return
    table = Table("differs: largest ulp, pixels", *(plain(result.info.index) for result, _ in worst), box=None)
    for name in names[:_MOST_ROWS]:
        table.add_row(plain(name), *(_cell(found.get(name)) for _, found in worst))
    out.print(table)
    if len(names) > _MOST_ROWS:
        out.print(f"… and {len(names) - _MOST_ROWS} more buffers")


def _cell(told: dict | None) -> str:
    if told is None:
        return "equal"
    where = ", ".join(sorted(told["forms"])) + "; " + ", ".join(sorted(told["cases"]))
    if told["ulp"] is None:
        return f"at {told['moments']} moments ({where})"
    return f"{told['ulp']} ulp, {told['pixels']} px ({where})"
