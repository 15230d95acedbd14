"""Command `gffe devices`, which lists devices."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    JsonOption,
    OverwriteOption,
    app,
    duration,
    out,
    plain,
    write_json,
)


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
        when = "just now" if age is None else f"{duration(age)} ago"
        out.print(f"tested {when}; other programs slow the test down: --refresh repeats it")
        out.print(f"the default runs the network {RUNS_ON['gpu' if default.kind == 'gpu' else 'cpu']} (--scn-provider)")
    document = {"devices": [asdict(i) | {"default": i is default} for i in infos], "age_seconds": age or 0.0}
    write_json(json_path, document)
    if not working:
        raise none_works(infos or every, kind)
