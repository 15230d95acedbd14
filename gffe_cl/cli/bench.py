"""Command `gffe bench`, which measures cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    FollowLinksOption,
    JsonOption,
    app,
    out,
    parse_size,
    plain,
    progress_bars,
    steps,
    write_json,
)
from gffe_cl.cli.options import takes_options
from gffe_cl.engine.core.errors import GffeError

if TYPE_CHECKING:
    from gffe_cl.engine.opencl.device import Device, DeviceInfo
    from gffe_cl.engine.options import Options
    from gffe_cl.engine.timing.bench import SizeBench
    from gffe_cl.engine.timing.footage import FrameLoop
    from gffe_cl.lab.bench.counting import KernelTraffic

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
        typer.Option(help=f"Frame sizes: WxH,…; sequences are enlarged [dim](default: {_SIZES}; a sequence's own)[/]."),
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
    traffic: Annotated[
        bool,
        typer.Option(
            "--traffic",
            help="Memory traffic: count with Oclgrind the bytes that each kernel loads and stores, instead of timing"
            " [dim](default size: 1920x1080)[/].",
        ),
    ] = False,
    host: Annotated[
        bool,
        typer.Option(
            "--host",
            help="Host cost: processor time of the calling thread in submit and extrapolate"
            " [dim](default size: 320x180, where kernels are short)[/].",
        ),
    ] = False,
    lanes: Annotated[
        str, typer.Option(help="Pixels per work-item that --traffic counts: 1 as on GPUs, 8 as on CPUs, or 1,8.")
    ] = "1",
    device: Annotated[
        str | None, typer.Option("--device", help="OpenCL device to time [dim](default: every device that works)[/].")
    ] = None,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
    *,
    options: Options,
) -> None:
    """Time every stage, in milliseconds and in bytes per pixel, and compare with the paper's table."""
    from gffe_cl.engine.opencl.device import list_devices, open_device, open_info

    if repeats < 1:
        raise GffeError(f"--repeats must be at least 1, got {repeats}")
    parsed = None if sizes is None else [parse_size(text) for text in sizes.split(",")]
    if traffic:
        on = open_device(device, profiling=True)
        _bench_traffic(on, subject, parsed, frame, _parse_lanes(lanes), options, json_path)
        return
    if device is None:
        opened = [open_info(info, profiling=True) for info in list_devices() if info.works] or [open_device()]
    else:
        opened = [open_device(device, profiling=True)]
    asked = _Asked(opened, subject, parsed, frame, repeats, options)
    write_json(json_path, _bench_host(asked) if host else _bench_times(asked, kernels))


@dataclass(frozen=True)
class _Asked:
    """The frames to measure, on each of the devices; `sizes` is None for the default ones."""

    devices: list[Device]
    subject: str | None
    sizes: list[tuple[int, int]] | None
    frame: int | None
    repeats: int
    options: Options

    def sizes_or(self, *default: tuple[int, int]) -> Sequence[tuple[int, int] | None]:
        """Return the sizes to measure; None is a sequence's own."""
        from gffe_cl.lab.bench.footage import is_sequence

        return self.sizes or ([None] if is_sequence(self.subject) else default)

    def loop(self, device: Device, size: tuple[int, int] | None, upscale: float = 0.0) -> FrameLoop:
        from gffe_cl.lab.bench.footage import loop_of

        return loop_of(device, self.subject, size, self.frame, upscale)


def _label(info: DeviceInfo) -> str:
    return f"{info.name} ({info.platform})"


def _named(info: DeviceInfo) -> dict[str, str]:
    return {"device": info.name, "platform": info.platform}


def _bench_times(asked: _Asked, kernels: bool) -> dict:
    from gffe_cl.engine.timing.bench import PAPER, Copier, bench_size, growth

    sizes, report = asked.sizes_or(*map(parse_size, _SIZES.split(","))), []
    for device in asked.devices:
        results, name = [], ""
        with progress_bars() as progress:
            advance = steps(progress)(_label(device.info), len(sizes) * asked.repeats)
            copier = Copier(device)
            for size in sizes:
                loop = asked.loop(device, size, asked.options.upscale)
                results.append(bench_size(device, copier, loop, asked.options, asked.repeats, advance))
                name = loop.name
        _print_bench(device.info, name, results)
        if kernels:
            _print_kernels(results)
        figures = {"of": name, "growth": growth(results), "sizes": [asdict(r) for r in results]}
        report.append(_named(device.info) | {"copied by": copier.way} | figures)
    return {"devices": report, "paper": PAPER}


def _bench_host(asked: _Asked) -> dict:
    from gffe_cl.lab.bench.host_times import SIZE, measure_host

    report = []
    table = Table("device", "size", "submit, ms", "extrapolate, ms", "both, ms", box=None, header_style="bold")
    for device in asked.devices:
        results = []
        for size in asked.sizes_or(SIZE):
            loop = asked.loop(device, size)
            with progress_bars() as progress:
                advance = steps(progress)(_label(device.info), asked.repeats)
                results.append(measure_host(device, loop, asked.options, asked.repeats, advance))
        for result in results:
            times = (f"{milliseconds:.3f}" for milliseconds in (result.submit, result.extrapolate, result.sum))
            table.add_row(plain(device.info.platform), f"{result.width}×{result.height}", *times)
        figures = {"repeats": asked.repeats, "sizes": [asdict(result) for result in results]}
        report.append(_named(device.info) | figures)
    out.print(table)
    return {"devices": report}


def _bench_traffic(
    device: Device,
    subject: str | None,
    sizes: list[tuple[int, int]] | None,
    frame: int | None,
    lanes: list[int],
    options: Options,
    json_path: Path | None,
) -> None:
    from gffe_cl.lab.bench.counting import SIZE, count, report
    from gffe_cl.lab.bench.footage import loop_of

    if sizes and len(sizes) > 1:
        raise GffeError(f"--traffic takes one size, got {len(sizes)}")
    loop = loop_of(device, subject, sizes[0] if sizes else SIZE, frame)
    counted = {n: count(loop, options, n) for n in lanes}
    for n, kernels in counted.items():
        _print_traffic(loop, n, kernels)
    write_json(json_path, report(counted, loop))


def _parse_lanes(text: str) -> list[int]:
    lanes = text.split(",")
    if not set(lanes) <= {"1", "8"}:
        raise GffeError(f"--lanes must be 1, 8 or 1,8, got '{text}'")
    return [int(n) for n in lanes]


def _print_bench(info: DeviceInfo, name: str, results: list[SizeBench]) -> None:
    from gffe_cl.engine.timing.bench import PAPER, growth

    heads = (*(f"{r.width}×{r.height}" for r in results), "paper, 1080p")
    title = plain(f"{name}, {_label(info)}")
    table = Table("bytes per pixel (ms)", *heads, title=title, box=None, header_style="bold")
    last = results[-1]
    for part in results[0].milliseconds:
        figures = [f"{r.bytes_per_pixel[part]:.0f} ({r.milliseconds[part]:.2f})" for r in results]
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


def _print_traffic(loop: FrameLoop, lanes: int, kernels: dict[str, KernelTraffic]) -> None:
    from gffe_cl.engine.timing.parts import group

    form = "one pixel per work-item, as on GPUs" if lanes == 1 else f"{lanes} pixels per work-item, as on CPUs"
    title = plain(f"{loop.name}, a part of {loop.width}×{loop.height}, {form}")
    heads = ("bytes loaded", "bytes stored", "instructions")
    table = Table("per pixel", *heads, title=title, box=None, header_style="bold")
    gae = {name: moved for name, moved in kernels.items() if group(name.partition(".")[0]) == "GAE"}
    for name, moved in kernels.items():
        table.add_row(name, *(f"{n:.1f}" for n in astuple(moved)))
    sums = map(sum, zip(*map(astuple, gae.values()), strict=True))
    table.add_row("GAE", *(f"{n:.1f}" for n in sums), style="bold")
    out.print(table)
    out.print("Counted by Oclgrind: bytes without caches, and instructions of LLVM that compute or reach memory.")
