"""Commands for captures: `gffe check`, which finds their faults, `gffe formats` and `gffe import`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    CompressionOption,
    EncodeOption,
    JsonOption,
    OverwriteOption,
    app,
    counted,
    out,
    output_file,
    parse_encoding,
    plain,
    progress_bars,
    steps,
    warn,
    write_json,
)
from gffe_cl.engine.core.files import write_text

if TYPE_CHECKING:
    from gffe_cl.captures.doctor import Diagnosis

_STYLES = {"fault": "bold red", "note": "yellow", "cannot tell": "cyan"}


@app.command()
def check(
    sequence: Annotated[Path, typer.Argument(help="Folder of the capture to examine; see `gffe formats`.")],
    format_out: Annotated[
        Path | None,
        typer.Option(
            "--format-out",
            help="JSON file for the format that undoes the faults, if one does, for `gffe import --format`.",
            callback=output_file("--format-out"),
        ),
    ] = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Report faults of a sequence: in motion vectors, depth, cameras, colors and the order of frames.

    Exit code 0: nothing, or notes; 1: faults, which break results.
    """
    from gffe_cl.captures.doctor import examine
    from gffe_cl.captures.formats import open_capture

    opened = open_capture(sequence)
    diagnosis = examine(opened, opened.exposure)
    title = f"{sequence}: {counted(len(opened.rendered), 'rendered frame')}, {opened.width}×{opened.height}"
    looked = "" if diagnosis.frames == len(opened.rendered) else f"; {diagnosis.frames} of them looked at"
    out.print(plain(title + looked))
    for note in opened.notes:
        out.print(f"[{_STYLES['note']}]note[/] {plain(f'frames: {note}')}", soft_wrap=True)
    for one in diagnosis.findings:
        out.print(f"[{_STYLES[one.kind]}]{one.kind}[/] {plain(one)}", soft_wrap=True)
    for line in _residuals(diagnosis):
        out.print(plain(line), soft_wrap=True)
    if diagnosis.found is not None:
        text = json.dumps(diagnosis.found.to_json())
        out.print(plain(f"format to paste: {text}"), soft_wrap=True)
        if format_out is not None:
            write_text(format_out, text + "\n")
            out.print(plain(f"`gffe import --format {format_out} {sequence} OUT` converts it"), soft_wrap=True)
    write_json(json_path, diagnosis.as_json())
    if diagnosis.faults:
        raise typer.Exit(1)


def _residuals(diagnosis: Diagnosis) -> list[str]:
    """Return sentences on how well the frames fit as given and as read."""
    pairs = [("as given", diagnosis.given), ("with this format", diagnosis.read)]
    if diagnosis.found is None or diagnosis.read is diagnosis.given:
        pairs = pairs[:1]
    return [
        f"{name}: median residual {one.median:.3g} px, {one.share:.0%} of the samples agree"
        for name, one in pairs
        if one is not None
    ]


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
