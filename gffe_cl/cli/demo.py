"""Command `gffe demo`, which gives a first result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from gffe_cl.cli.common import (
    DeviceOption,
    WindowOption,
    app,
    out,
    parse_size,
    plain,
    progress_bars,
    steps,
    takes_options,
)
from gffe_cl.engine.core.errors import GffeError, require_packages

if TYPE_CHECKING:
    from gffe_cl.engine.options import Options


@app.command()
@takes_options("shading_correction", "scn_model", "scn_provider")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("out/demo"),
    size: Annotated[str, typer.Option(help="Frame size: width × height, pixels.")] = "960x540",
    seed: Annotated[int, typer.Option(help="Random seed of the scene's variation.")] = 0,
    window: WindowOption = "off",
    device: DeviceOption = None,
    *,
    options: Options,
) -> None:
    """Render the scene 'corridor', extrapolate it, and measure the result against ground truth."""
    require_packages("demo", "lab,video", "skimage", "imageio_ffmpeg")
    from gffe_cl.engine.opencl.device import open_device
    from gffe_cl.lab.demo import METHODS
    from gffe_cl.lab.demo import demo as run_demo
    from gffe_cl.lab.metrics import measurable

    width, height = parse_size(size)
    if min(width, height) < 32 or max(width, height) > 4096:
        raise GffeError(f"demo: --size must be 32 to 4096 pixels each way, got '{size}'")
    opened = open_device(device, profiling=True)
    out.print(plain(f"Device: {opened.info.name} ({opened.info.platform})"))
    with progress_bars() as progress:
        metrics = run_demo(output, opened, width, height, seed, window, options, steps(progress))
    measured = measurable()
    heads = (metric.title for metric in measured)
    table = Table("against ground truth at t + ½", *heads, box=None, header_style="bold")
    for name, figures in metrics.items():
        table.add_row(METHODS[name], *(metric.text(figures[metric.name]) for metric in measured))
    out.print(table)
    out.print(f"Results are in {plain(output)}: contact_sheet.png, side_by_side.mp4, metrics.json, extrapolated/")
