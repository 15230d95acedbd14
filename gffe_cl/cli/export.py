"""Command `gffe export`, which writes the pipeline as C."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gffe_cl.cli.common import DeviceOption, app, counted, out, plain, takes_options
from gffe_cl.cli.run import open_source
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.options import OPTIONS

if TYPE_CHECKING:
    from gffe_cl.engine.options import Options

_OF_PYTHON_ALONE = ("overlays", "scn_provider", "camera_order")
_EXPORTED = [name for name, option in OPTIONS.items() if option.flag and name not in _OF_PYTHON_ALONE]


@app.command()
@takes_options(*_EXPORTED)
def export(
    output: Annotated[Path, typer.Argument(help="Folder for the C code: new, empty or of an earlier export.")],
    frames: Annotated[
        Path | None,
        typer.Option(help="Capture or built-in scene whose frames are written for the example program."),
    ] = None,
    count: Annotated[int, typer.Option(help="Number of frames that --frames writes.", min=1, max=1000)] = 10,
    size: Annotated[
        str | None,
        typer.Option(
            help="Frame size of a built-in scene for --frames: width × height, pixels [dim](default: 960x540)[/]."
        ),
    ] = None,
    device: DeviceOption = None,
    *,
    options: Options,
) -> None:
    """Write the pipeline as C for engines: C99 and OpenCL alone, no Python. Options are fixed by it, sizes are not."""
    from gffe_cl.captures.offline.source import write_frames
    from gffe_cl.captures.scenes import is_scene
    from gffe_cl.engine.export import export as write
    from gffe_cl.engine.opencl.device import open_device

    if frames is None and size is not None:
        raise GffeError("--size is for --frames of a built-in scene")
    opened, source = open_device(device), None
    if frames is not None:
        made = count if is_scene(str(frames)) else None  # a capture has its own
        live = {"--size": size, "--frames": made, "--fps": None, "--seed": None}
        opened, source = open_source(frames, None, device, live, options.upscale)
    written = write(output, opened, options)
    out.print(f"{len(written)} files in {plain(output)}: README.md explains how to build and call them.")
    if source:
        made = write_frames(output / "frames", source, count)
        out.print(f"{counted(made, 'rendered frame')} in {plain(output / 'frames')} for the example, gffe_example.")
