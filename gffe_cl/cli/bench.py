"""Command `gffe bench`, which measures cost."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    FollowLinksOption,
    JsonOption,
    OverwriteOption,
    app,
    out,
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
    from gffe_cl.engine.timing.bench import SizeBench

_SIZES = "960x540,1280x720,1920x1080,3840x2160"


@app.command()
@takes_options()
def bench(
    subject: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE|SEQUENCE", help="Built-in scene, or folder of a sequence [dim](default: plaza)[/]."
        ),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(help=f"Frame sizes of a built-in scene, WxH,… [dim](default: {_SIZES}; a sequence's own)[/]."),
    ] = None,
    repeats: Annotated[int, typer.Option(help="Number of timed frames per size.")] = 15,
    frame: Annotated[
        int | None,
        typer.Option(
            help="Index of the timed rendered frame [dim](default: 31 of a scene, the middle one of a sequence)[/]."
        ),
    ] = None,
    kernels: Annotated[
        bool, typer.Option("--kernels", help="Kernel times: also print the time of every kernel.")
    ] = False,
    device: Annotated[
        str | None, typer.Option("--device", help="OpenCL device to time [dim](default: every device that works)[/].")
    ] = None,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    *,
    options: Options,
) -> None:
    """Time every stage, in milliseconds and in bytes per pixel, and every preset; compare with the paper's table."""
    from gffe_cl.engine.opencl.device import list_devices, open_device, open_info
    from gffe_cl.engine.timing.bench import PAPER, Copier, bench_size, growth
    from gffe_cl.lab.bench import is_sequence, loop_of

    if repeats < 1:
        raise GffeError(f"--repeats must be at least 1, got {repeats}")
    parsed = None if sizes is None else [parse_size(text) for text in sizes.split(",")]
    if device is None:
        opened = [open_info(info, profiling=True) for info in list_devices() if info.works] or [open_device()]
    else:
        opened = [open_device(device, profiling=True)]
    of_sequence = parsed is None and is_sequence(subject)  # at its own size
    chosen = [None] if of_sequence else parsed or [parse_size(text) for text in _SIZES.split(",")]
    report = []
    for one in opened:
        results, name = [], ""
        with progress_bars() as progress:
            advance = steps(progress)(_label(one.info), len(chosen) * repeats)
            copier = Copier(one)
            for size in chosen:
                loop = loop_of(one, subject, size, frame, options.upscale)
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
