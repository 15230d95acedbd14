"""Command `gffe compare`, which measures pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    FollowLinksOption,
    JsonOption,
    OverwriteOption,
    app,
    named,
    out,
    plain,
    progress_bars,
    steps,
    warn,
    write_json,
)
from gffe_cl.engine.core.errors import GffeError

if TYPE_CHECKING:
    from gffe_cl.captures.sequence import Sequence


@app.command()
def compare(
    a: Annotated[Path, typer.Argument(help="Folder of the sequence with extrapolated frames.")],
    b: Annotated[Path, typer.Argument(help="Folder of the sequence with ground truth.")],
    mask: Annotated[
        str | None,
        typer.Option(help="Mask of the measured pixels: a channel of A that is not 0 there, such as mask.dynamic."),
    ] = None,
    fail_under: Annotated[
        float | None, typer.Option(help="Lowest mean PSNR for exit code 0, dB; below it the exit code is 1.")
    ] = None,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Measure extrapolated frames of A against the ground truth of B."""
    from gffe_cl.lab.compare import compare as compare_sequences
    from gffe_cl.lab.metrics import measurable, missing_metrics

    first, second = (_opened(folder) for folder in (a, b))
    for sequence in (first, second):
        if sequence.unfinished:
            warn(sequence.warnings()[0])
    with progress_bars() as progress:
        advance = steps(progress)("Comparing", len(first.extrapolated))
        result = compare_sequences(first, second, mask, lambda done, total: advance())
    metrics = measurable()
    table = Table("frame", *(metric.title for metric in metrics), box=None, header_style="bold")
    for frame in result.frames:
        figures = (metric.text(frame.values[metric.name]) for metric in metrics)
        table.add_row(plain(frame.file), *figures, style=None if frame.counted else "dim")
    out.print(table)
    for note in result.notes:
        out.print(plain(note))
    left_out = sum(not frame.counted for frame in result.frames)
    dim = f" ({left_out} frames without history left out)" if left_out else ""
    means = (metric.sentence(result.mean[metric.name]) for metric in metrics)
    out.print(f"[bold]mean[/]{dim}: {', '.join(means)}")
    for reason in missing_metrics():
        out.print(plain(reason))
    write_json(json_path, result.to_json())
    if fail_under is not None and not result.mean["psnr"] >= fail_under:
        raise typer.Exit(1)


def _opened(folder: Path) -> Sequence:
    """Return the sequence in `folder`. Raises GffeError, which names the folder."""
    from gffe_cl.captures.formats import open_capture

    try:
        return open_capture(folder)
    except GffeError as error:
        raise GffeError(named(folder, str(error))) from None
