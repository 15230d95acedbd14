"""Commands of built-in scenes: `gffe render`, and `gffe demo`, which gives a first result."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gffe_cl.cli.common import (
    CompressionOption,
    DeviceOption,
    EncodeOption,
    OverwriteOption,
    WindowOption,
    app,
    counted,
    out,
    parse_encoding,
    parse_size,
    plain,
    progress_bars,
    say,
    steps,
    takes_options,
    takes_scheduler,
)
from gffe_cl.engine.core.errors import GffeError, require_packages
from gffe_cl.engine.core.files import require_output_file

if TYPE_CHECKING:
    from gffe_cl.engine.options import Options


@app.command()
@takes_scheduler
def render(
    scene: Annotated[
        str,
        typer.Argument(
            help="Built-in scene: corridor, plaza, room, forest, gallery, street, factory or courtyard; or one of"
            " the situations above."
        ),
    ],
    output: Annotated[Path, typer.Argument(help="Folder for the new sequence.")],
    size: Annotated[str, typer.Option(help="Frame size: width × height, pixels.")] = "960x540",
    frames: Annotated[int, typer.Option(help="Number of rendered frames.")] = 30,
    fps: Annotated[float, typer.Option(help="Frame rate, rendered frames per second.")] = 30.0,
    seed: Annotated[int, typer.Option(help="Random seed of layout, textures, lights and camera path.")] = 0,
    ground_truth: Annotated[
        bool, typer.Option("--ground-truth", help="Ground truth: also render the frames in between, for measuring.")
    ] = False,
    per_frame: Annotated[
        int,
        typer.Option(
            "-n", help="Number of frames in between per rendered frame, for --ground-truth and --window adaptive."
        ),
    ] = 1,
    samples: Annotated[
        int | None,
        typer.Option(help="Number of color samples per pixel at edges [dim](default: 8; 1 with --jitter)[/]."),
    ] = None,
    window: Annotated[
        str,
        typer.Option(
            help="Rendering window: adaptive (covers the frames in between, see -n), fixed:1.2 (times the display"
            " size) or off."
        ),
    ] = "off",
    jitter: Annotated[
        str, typer.Option(help="Camera jitter for upscaling: halton:N (N-point Halton sequence) or off.")
    ] = "off",
    scale: Annotated[
        float,
        typer.Option(help="Scale by which rendered frames are smaller than --size, each way; ground truth is not."),
    ] = 1.0,
    encode: EncodeOption = None,
    compression: CompressionOption = "zip",
    device: DeviceOption = None,
    *,
    cluster: Any,
) -> None:
    """Render a built-in scene to a sequence: color, depth, motion vectors and cameras.

    Situations, small scenes of one difficulty each: bars, railings, balls, rotors, handheld, cab, wipers, shadows, fan.
    """
    from gffe_cl.captures.scenes.renderer import GENERATOR
    from gffe_cl.captures.sequence.writer import write_parts
    from gffe_cl.engine.opencl.device import open_device

    call: dict[str, Any] = {
        "scene": scene,
        "seed": seed,
        "size": parse_size(size),
        "frames": frames,
        "fps": fps,
        "ground_truth": ground_truth,
        "per_frame": per_frame,
        "samples": samples,
        "window": window,
        "jitter": jitter,
        "scale": scale,
        "encode": encode,
        "compression": compression,
        "device": device,
    }
    with cluster as workers, progress_bars() as progress:
        advance = steps(progress)(f"Rendering '{scene}'", frames * (1 + per_frame * ground_truth))
        if workers:
            parts = ({"part": (k, min(k + _PART, frames)), **call} for k in range(0, max(frames, 1), _PART))
            count = write_parts(output, GENERATOR, _with_progress(workers.map(rendered, parts), advance))
        else:
            call["device"] = open_device(device)
            count = rendered(output, **call, on_frame=advance)
    out.print(f"{counted(count, 'frame')} in {plain(output)}")


_PART = 4  # rendered frames that a worker of a cluster renders at a time


def _with_progress(results, advance):
    """Yield the files of each result, whose document is a number of frames."""
    for count, files in results:
        yield files
        for _ in range(count):
            advance()


def rendered(output: Path, scene: str, seed: int, size, jitter: str, encode, device, part=None, **rest) -> int:
    """Render a scene, here or on a worker of a cluster, and return the number of frames. `part`: the first and one past
    the last rendered frame to write; None: all. Other arguments: as of `gffe render`."""
    from gffe_cl.captures.scenes import load_scene
    from gffe_cl.captures.scenes.renderer import render_sequence
    from gffe_cl.engine.frame.window import Jitter
    from gffe_cl.engine.opencl.device import device_of_process

    rest |= {"jitter": Jitter.parse(jitter), "encoding": parse_encoding(encode), "part": part and range(*part)}
    opened = device_of_process(device) if device is None or isinstance(device, str) else device
    return render_sequence(load_scene(scene, seed), output, opened, *size, **rest)


@app.command()
@takes_options("shading_correction", "scn_model", "scn_provider")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")] = Path("out/demo"),
    size: Annotated[str, typer.Option(help="Frame size: width × height, pixels.")] = "640x360",
    seed: Annotated[int, typer.Option(help="Random seed of the scene's variation.")] = 0,
    window: WindowOption = "off",
    device: DeviceOption = None,
    overwrite: OverwriteOption = False,
    *,
    options: Options,
) -> None:
    """Render the scene 'corridor', extrapolate it, show it, and measure the result against ground truth."""
    start = time.monotonic()
    require_packages("demo", "lab,video", "skimage", "imageio_ffmpeg")
    from gffe_cl.engine.opencl.device import open_device
    from gffe_cl.lab.demo import EVERY, METHODS
    from gffe_cl.lab.demo import demo as run_demo
    from gffe_cl.lab.metrics import measurable

    width, height = parse_size(size)
    if min(width, height) < 32 or max(width, height) > 4096:
        raise GffeError(f"demo: --size must be 32 to 4096 pixels each way, got '{size}'")
    for name in ("contact_sheet.png", "side_by_side.mp4", "metrics.json") if output.is_dir() else ():
        require_output_file(output / name, "--output", overwrite, media=name != "metrics.json")
    opened = open_device(device, profiling=True)
    out.print(plain(f"Device: {opened.info.name} ({opened.info.platform})"))

    taken = []  # seconds to each picture and figure
    with progress_bars() as progress:
        for name, figures in run_demo(output, opened, width, height, seed, window, options, steps(progress)):
            taken.append(time.monotonic() - start)
            if not figures:
                out.print(plain(f"{output / name}"), soft_wrap=True)
                continue
            measured = measurable()  # its packages load slowly: after the pictures
            heads = [f"after every {EVERY}th frame, against truth", *(metric.title for metric in measured)]
            rows = [METHODS[name], *(metric.text(figures[metric.name]) for metric in measured)]
            for row in (heads, rows) if name == "repeat" else (rows,):
                out.print(f"{row[0]:<38}" + "".join(f"{cell:>10}" for cell in row[1:]))
    out.print(f"All results are in {plain(output)}", soft_wrap=True)
    say(f"first picture after {taken[0]:.0f} s, everything after {taken[-1]:.0f} s")
