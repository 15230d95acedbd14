"""Command `gffe calibrate`, which recovers cameras."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gffe_cl.cli.common import FollowLinksOption, JsonOption, app, out, plain, progress_bars, steps, write_json
from gffe_cl.engine.core.errors import GffeError


@app.command()
def calibrate(
    sequence: Annotated[Path, typer.Argument(help="Folder of a sequence; cameras in it are ignored.")],
    output: Annotated[Path, typer.Argument(help="Folder for the new sequence with cameras.")],
    fov: Annotated[
        float | None,
        typer.Option(
            help="Horizontal field of view of the rendered images, degrees [dim](default: from the motion)[/]."
        ),
    ] = None,
    cx: Annotated[
        float | None,
        typer.Option(help="Principal point, horizontal, pixels from the left [dim](default: the middle)[/]."),
    ] = None,
    cy: Annotated[
        float | None, typer.Option(help="Principal point, vertical, pixels from the top [dim](default: the middle)[/].")
    ] = None,
    aspect: Annotated[float, typer.Option(help="Pixel aspect fx / fy; 1 for square pixels.")] = 1.0,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
) -> None:
    """Recover the cameras of a sequence from depth and motion vectors alone."""
    from gffe_cl.captures.calibration.calibrate import calibrate_sequence
    from gffe_cl.captures.formats import open_capture

    if fov is not None and not 1 <= fov <= 170:
        raise GffeError(f"--fov must be 1 to 170 degrees, got {fov:g}")
    if not 0.1 <= aspect <= 10:
        raise GffeError(f"--aspect must be 0.1 to 10, got {aspect:g}")
    opened = open_capture(sequence, cameras="optional")
    for option, value, side in (("--cx", cx, opened.width), ("--cy", cy, opened.height)):
        if value is not None and not -side <= value <= 2 * side:
            raise GffeError(f"{option} must be pixels of the image or near it, got {value:g}")
    with progress_bars() as progress:
        advance = steps(progress)("Reading", len(opened.rendered) + len(opened.ground_truth))
        found = calibrate_sequence(opened, output, view=fov, center=(cx, cy), aspect=aspect, on_frame=advance)
    known = "given" if found.deviation is None else f"± {100 * found.deviation:.2f}%"
    out.print(
        f"focal length {found.focal[0]:.2f} px ({found.view:.2f}° across, {known}); the camera turns by"
        f" {found.turned:.1f}° in all"
    )
    out.print(
        f"{100 * found.static:.0f}% of the samples are static; reprojected they are off by {found.median:.3f} px"
        f" (median), {found.percentile_90:.3f} px (90th percentile)"
    )
    for file in found.cuts:
        out.print(plain(f"cut at {file}: no movement of the camera explains its motion vectors"))
    out.print(f"[bold]{found.verdict}[/]")
    truths = f" and {found.truths} ground-truth ones" if found.truths else ""
    out.print(f"{found.frames} rendered frames{truths} with cameras in {plain(output)}")
    write_json(json_path, asdict(found) | {"verdict": found.verdict})
