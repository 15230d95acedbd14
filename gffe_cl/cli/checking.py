"""The command that finds faults of sequences: check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gffe_cl.cli.common import (
    FollowLinksOption,
    JsonOption,
    app,
    out,
    output_file,
    plain,
    progress_bars,
    steps,
    write_json,
)
from gffe_cl.files import write_text

_STYLES = {"fault": "bold red", "note": "yellow", "cannot tell": "cyan"}


@app.command()
def check(
    sequence: Annotated[Path, typer.Argument(help="Sequence to examine.")],
    fix: Annotated[
        Path | None, typer.Option("--fix", help="Write the sequence with the faults mended to this folder.")
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html", help="Also write a page with residuals before and after.", callback=output_file("--html")
        ),
    ] = None,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
) -> None:
    """Say what does not fit in a sequence: motion vectors, depth, cameras, colours, the order of frames.

    Exit code 0: nothing, or notes only; 1: faults, which break results.
    """
    from gffe_cl.doctor import examine, open_for_check, write_mended
    from gffe_cl.doctor.report import as_json, html_report, summary
    from gffe_cl.sequence import open_sequence

    opened, mended = open_for_check(sequence)
    diagnosis = examine(opened, opened.exposure)
    diagnosis.findings[:0] = mended
    title = f"{sequence}: {len(opened.rendered)} rendered frames, {opened.width}×{opened.height}"
    looked = "" if diagnosis.frames == len(opened.rendered) else f"; {diagnosis.frames} of them looked at"
    out.print(plain(title + looked))
    for finding in diagnosis.findings:
        out.print(f"[{_STYLES[finding.kind]}]{finding.kind}[/] {plain(finding)}", soft_wrap=True)
    for line in summary(diagnosis):
        out.print(plain(line), soft_wrap=True)
    document = as_json(diagnosis)
    if html is not None:
        write_text(html, html_report(opened, diagnosis, title, opened.exposure))
    if fix is not None:
        with progress_bars() as progress:
            total = len(opened.rendered) + len(opened.ground_truth)
            write_mended(opened, diagnosis, fix, steps(progress)("Writing", total))
        again = examine(open_sequence(fix), opened.exposure)
        left = ", ".join(finding.name for finding in again.faults)
        verdict = f"still with faults: {left}" if left else "it fits now"
        out.print(f"{plain(fix)}: checked again, {plain(verdict)}")
        document["fixed"] = as_json(again)
    elif diagnosis.faults:
        out.print("`--fix OUT` writes a sequence without these faults", soft_wrap=True)
    write_json(json_path, document)
    if diagnosis.faults:
        raise typer.Exit(1)
