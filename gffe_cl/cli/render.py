"""The command that renders built-in scenes: render."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gffe_cl.cli.common import (
    CompressionOption,
    DeviceOption,
    EncodeOption,
    SchedulerOption,
    app,
    cluster_at,
    out,
    parse_encoding,
    parse_size,
    plain,
    progress_bars,
    steps,
)


@app.command()
def render(
    scene: Annotated[
        str,
        typer.Argument(
            help="Name of a built-in scene: corridor, plaza, room, forest, gallery, street, factory, courtyard. Or of a"
            " situation: bars, ropes, balls, rotors, handheld, cab, wipers, lamps, shadows, fan, screen, quantized."
        ),
    ],
    output: Annotated[Path, typer.Argument(help="Folder for the sequence.")],
    size: Annotated[str, typer.Option(help="Width × height, pixels.")] = "960x540",
    frames: Annotated[int, typer.Option(help="Rendered frames.")] = 30,
    fps: Annotated[float, typer.Option(help="Rendered frames per second.")] = 30.0,
    seed: Annotated[int, typer.Option(help="Variation of layout, textures, lights and camera path.")] = 0,
    ground_truth: Annotated[
        bool, typer.Option("--ground-truth", help="Also the frames in between, for measuring.")
    ] = False,
    per_frame: Annotated[
        int, typer.Option("-n", help="Frames in between per rendered frame, for --ground-truth and --window adaptive.")
    ] = 1,
    samples: Annotated[
        int | None, typer.Option(help="Color samples per pixel at edges [dim](default 8; 1 with --jitter)[/].")
    ] = None,
    window: Annotated[
        str,
        typer.Option(
            help="Rendering window: adaptive (covers frames in between, see -n), fixed:1.2 (times the display) or off."
        ),
    ] = "off",
    jitter: Annotated[str, typer.Option(help="Of the camera, for upscaling: halton:16 (points), or off.")] = "off",
    scale: Annotated[
        float, typer.Option(help="Rendered frames are so many times smaller than --size, each way; truth is not.")
    ] = 1.0,
    encode: EncodeOption = None,
    compression: CompressionOption = "zip",
    scheduler: SchedulerOption = None,
    device: DeviceOption = None,
) -> None:
    """Render a built-in scene to a sequence: color, depth, motion vectors and cameras."""
    from gffe_cl.frame.jitter import Jitter
    from gffe_cl.opencl.device import open_device
    from gffe_cl.scenes import load_scene
    from gffe_cl.scenes.render import render_sequence

    width, height = parse_size(size)
    built, jittered, encoding = load_scene(scene, seed), Jitter.parse(jitter), parse_encoding(encode)
    with cluster_at(scheduler) as workers, progress_bars() as progress:
        opened = None if workers else open_device(device)
        total = frames * (1 + per_frame * ground_truth)
        count = render_sequence(
            built, output, opened, width, height, frames, fps,
            ground_truth=ground_truth, per_frame=per_frame, samples=samples, window=window, jitter=jittered,
            scale=scale, encoding=encoding, compression=compression, cluster=workers,
            on_frame=steps(progress)(f"Rendering '{scene}'", total),
        )  # fmt: skip
    out.print(f"{count} frames in {plain(output)}")
