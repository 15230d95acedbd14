"""Command `gffe check`, which finds faults of sequences."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gffe_cl.cli.common import (
    FollowLinksOption,
    JsonOption,
    app,
    out,
    plain,
    progress_bars,
    steps,
    write_json,
)
from gffe_cl.engine.core.errors import GffeError

if TYPE_CHECKING:
    from gffe_cl.captures.doctor import Diagnosis
    from gffe_cl.captures.sequence import Sequence

_STYLES = {"fault": "bold red", "warning": "bold yellow", "note": "yellow", "cannot tell": "cyan"}


@app.command()
def check(
    sequence: Annotated[Path, typer.Argument(help="Folder of the capture to examine; see `gffe formats`.")],
    fix: Annotated[
        Path | None, typer.Option("--fix", help="Folder for a copy of the sequence with the faults repaired.")
    ] = None,
    follow_links: FollowLinksOption = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only", metavar="FINDING", help="Finding that --fix repairs, and no other; may be given several times."
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            "--except", metavar="FINDING", help="Finding that --fix leaves as it is; may be given several times."
        ),
    ] = None,
    json_path: JsonOption = None,
) -> None:
    """Report faults of a sequence: in motion vectors, depth, cameras, colors and the order of frames.

    Exit code 0: nothing, warnings or notes; 1: faults, which break results.
    """
    from gffe_cl.captures.doctor import examine, open_for_check, require_findings, selected
    from gffe_cl.captures.doctor.choosing import fixed_by
    from gffe_cl.captures.doctor.findings import finding
    from gffe_cl.captures.doctor.report import as_json, summary

    require_findings(only or (), "--only")
    require_findings(without or (), "--except")
    if fix is None and (only or without):
        raise GffeError("--only and --except select findings for --fix (expected --fix FOLDER)")
    opened, repaired = open_for_check(sequence)
    diagnosis = examine(opened, opened.exposure)
    diagnosis.findings[:0] = repaired + [finding("frames: of the reader", note=text) for text in opened.notes]
    title = f"{sequence}: {len(opened.rendered)} rendered frames, {opened.width}×{opened.height}"
    looked = "" if diagnosis.frames == len(opened.rendered) else f"; {diagnosis.frames} of them looked at"
    out.print(plain(title + looked))
    for one in diagnosis.findings:
        name = f" ({plain(one.id)})" if one.fix else ""
        out.print(f"[{_STYLES[one.kind]}]{one.kind}[/] {plain(one)}{name}", soft_wrap=True)
    for line in summary(diagnosis):
        out.print(plain(line), soft_wrap=True)
    chosen = selected(diagnosis, only or (), without or ())
    document = as_json(diagnosis)
    if fix is not None:
        document |= _repair(opened, diagnosis, chosen, fix)
    elif diagnosis.faults and fixed_by(diagnosis):
        out.print("`--fix OUT` writes a sequence without these faults", soft_wrap=True)
    write_json(json_path, document)
    if diagnosis.faults:
        raise typer.Exit(1)


def _repair(opened: Sequence, diagnosis: Diagnosis, chosen: Diagnosis, fix: Path) -> dict:
    """Write the sequence with `chosen` repaired to `fix`, check it again, and print the changes. Returns them for
    the JSON."""
    from gffe_cl.captures.doctor import examine, write_repaired
    from gffe_cl.captures.doctor.choosing import ON_REQUEST, fixed_by
    from gffe_cl.captures.doctor.report import as_json, changes
    from gffe_cl.captures.sequence import open_sequence

    for line in changes(chosen):
        out.print(f"to change: {plain(line)}", soft_wrap=True)
    with progress_bars() as progress:
        total = len(opened.rendered) + len(opened.ground_truth)
        write_repaired(opened, chosen, fix, steps(progress)("Writing", total))
    again = examine(open_sequence(fix), opened.exposure)
    changed = fixed_by(chosen)
    left = [name for name in fixed_by(diagnosis) if name not in changed]
    out.print(plain(f"{fix}: changed {', '.join(changed) or 'nothing'}"), soft_wrap=True)
    if left:
        asked = f" ({ON_REQUEST} is changed only where --only names it)" if ON_REQUEST in left else ""
        out.print(plain(f"left as given: {', '.join(left)}{asked}"), soft_wrap=True)
    faults = ", ".join(finding.id for finding in again.faults)
    fits = "it fits now" if again.compared else "nothing could be compared"
    verdict = f"still with faults: {faults}" if faults else fits
    out.print(plain(f"{fix}: checked again, {verdict}"), soft_wrap=True)
    return {"changed": changed, "left": left, "fixed": as_json(again)}
