"""Commands for captures of other programs: `gffe formats`, `gffe import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    CompressionOption,
    EncodeOption,
    FollowLinksOption,
    JsonOption,
    OverwriteOption,
    app,
    counted,
    out,
    parse_encoding,
    plain,
    progress_bars,
    steps,
    warn,
    write_json,
)


@app.command()
def formats(json_path: JsonOption = None, overwrite: OverwriteOption = False) -> None:
    """List the forms of captures that every command opens, with an example of each."""
    from gffe_cl.captures.formats import FORMATS

    table = Table("form", "description", "the folder, for example", box=None, header_style="bold")
    for one in FORMATS.values():
        table.add_row(one.name, plain(one.sentence), "\n".join(plain(line) for line in one.example.splitlines()))
        table.add_row()
    out.print(table)
    out.print("The form of a folder follows from its files. How to write one from your program: docs/formats.md")
    listed = [{"name": one.name, "sentence": one.sentence, "example": one.example} for one in FORMATS.values()]
    write_json(json_path, {"formats": listed})


@app.command("import")
def import_(
    sequence: Annotated[Path, typer.Argument(help="Folder of a capture; see `gffe formats`.")],
    output: Annotated[Path, typer.Argument(help="Folder for the new sequence.")],
    every: Annotated[
        int,
        typer.Option(
            help="Interval N: every N-th frame stays rendered, the others become ground truth; motion vectors are"
            " added up."
        ),
    ] = 1,
    format_path: Annotated[
        Path | None,
        typer.Option(
            "--format",
            metavar="JSON",
            help="Format of the capture in place of its own one: a file of `gffe check --format-out`.",
        ),
    ] = None,
    encode: EncodeOption = None,
    compression: CompressionOption = "zip",
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Convert a capture of any known form into a sequence of our own."""
    from gffe_cl.captures.doctor import FoundFormat, with_format
    from gffe_cl.captures.formats import open_capture
    from gffe_cl.captures.formats.importing import import_capture

    found = None if format_path is None else FoundFormat.open(format_path)
    encoding, opened = parse_encoding(encode), open_capture(sequence)
    if found is not None:
        opened = with_format(opened, found)
    total = len(opened.rendered) + len(opened.ground_truth)
    with progress_bars() as progress:
        report = import_capture(
            opened,
            output,
            every,
            encoding=encoding,
            compression=compression,
            on_frame=steps(progress)("Importing", total),
        )
    for warning in report.warnings:
        warn(warning)
    out.print(
        f"{counted(report.rendered, 'rendered frame')} and {report.ground_truth} of ground truth in {plain(output)}"
    )
    write_json(json_path, vars(report))
