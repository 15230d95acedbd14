"""The command that shows: view."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gffe_cl.cli.common import (
    DeviceOption,
    JsonOption,
    NoCheckOption,
    app,
    out,
    output_file,
    parse_size,
    write_json,
)
from gffe_cl.cli.options import takes_options
from gffe_cl.errors import GffeError
from gffe_cl.values import require_seed

if TYPE_CHECKING:
    from gffe_cl.options import Options


@app.command()
@takes_options("shading_correction", "scn_model", "scn_provider")
def view(
    target: Annotated[
        str | None,
        typer.Argument(help="Folder of a capture (`gffe formats`), or a built-in scene [dim](default: none)[/]."),
    ] = None,
    n: Annotated[int, typer.Option("-n", help="Generated frames per rendered frame, 1 to 7.")] = 1,
    window: Annotated[
        str | None, typer.Option("--window", help="Rendering window: adaptive, fixed:1.2 or off; see `gffe run`.")
    ] = None,
    size: Annotated[str, typer.Option(help="Of a built-in scene: width × height, pixels.")] = "480x270",
    seed: Annotated[int, typer.Option(help="Of a built-in scene: its variation.")] = 0,
    device: DeviceOption = None,
    window_size: Annotated[
        str | None,
        typer.Option(help="Of the viewer's own window, pixels [dim](default: as last time; for reports 1600x900)[/]."),
    ] = None,
    screenshot: Annotated[
        Path | None,
        typer.Option(
            help="Write one picture of the whole window to this PNG, and exit.", callback=output_file("--screenshot")
        ),
    ] = None,
    frame: Annotated[int, typer.Option(help="Screenshot: which one of the frames shown, generated ones counted.")] = 0,
    layer: Annotated[
        str, typer.Option(help="Screenshot: layer shown, such as final, disoccluded, history.dynamic_mask.")
    ] = "final",
    other: Annotated[str | None, typer.Option("--with", help="Screenshot: layer compared with.")] = None,
    compare: Annotated[str, typer.Option(help="Screenshot: off, split, difference, error or 'flip error'.")] = "off",
    pixel: Annotated[str | None, typer.Option(help="Screenshot: pixel whose story is told, as 120,45.")] = None,
    overview: Annotated[bool, typer.Option("--overview", help="Screenshot: all layers as tiles.")] = False,
    measure: Annotated[
        float | None, typer.Option(help="Play every frame for so many seconds, print how fast that was, and exit.")
    ] = None,
    no_check: NoCheckOption = False,
    json_path: JsonOption = None,
    *,
    options: Options,
) -> None:
    """Open the viewer: play, look into every stage, find out why a pixel is wrong."""
    from gffe_cl.inference import load_network
    from gffe_cl.scenes import is_scene
    from gffe_cl.viewer.engine.opening import ScenePlan
    from gffe_cl.viewer.start import Shot, leaving, require_display
    from gffe_cl.viewer.start import measure as measure_playback
    from gffe_cl.viewer.start import view as run_viewer
    from gffe_cl.viewer.state.comparing import WAYS
    from gffe_cl.viewer.state.model import Model
    from gffe_cl.viewer.state.settings import LEAST_WINDOW, Settings

    if not 1 <= n <= 7:
        raise GffeError(f"-n must be 1 to 7 generated frames per rendered frame, got {n}")
    if target is None and (screenshot is not None or measure is not None):
        raise GffeError("--screenshot and --measure need a sequence or a scene")
    if measure is not None and not 0 < measure <= 3600:
        raise GffeError(f"--measure must be seconds, up to 3600, got {measure:g}")
    if compare not in WAYS:
        raise GffeError(f"--compare must be {', '.join(WAYS[:-1])} or '{WAYS[-1]}', got '{compare}'")
    if window not in (None, "off") and target is not None and not is_scene(target):
        raise GffeError(f"--window {window}: only built-in scenes are rendered through a chosen window (expected off)")
    plan = ScenePlan(*parse_size(size), require_seed(seed, "--seed"))
    viewer_size = None if window_size is None else parse_size(window_size)
    if viewer_size is not None and min(viewer_size) < LEAST_WINDOW:
        raise GffeError(f"--window-size must be at least {LEAST_WINDOW} pixels each way, got '{window_size}'")
    shot = None
    if screenshot is not None:
        shot = Shot(screenshot, frame, layer, compare, other, _pixel(pixel), overview)
    asked = options.shading_correction, options.scn_model, options.scn_provider
    if options.corrects_shading and asked != (None, None, "cpu"):
        load_network(options.scn_model, options.scn_provider)  # what was asked for must work
    require_display()
    by_hand = shot is None and measure is None
    settings, warning = Settings.load() if by_hand else (Settings(), None)
    model = Model(
        settings, device=device, n=n, window=window, plan=plan, options=options, save_settings=by_hand,
        check=not no_check,
    )  # fmt: skip
    if warning:
        model.say(warning)
    with leaving(model):
        if target is not None:
            model.open(target)
        if measure is None:
            run_viewer(model, viewer_size, shot)
            return
        figures = measure_playback(model, measure, viewer_size)
        for name, value in figures.items():
            out.print(f"{name}: {value:.1f}")
        write_json(json_path, figures | {"device": model.engine.device_name})


def _pixel(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        raise GffeError(f"--pixel must look like 120,45, got '{text}'") from None
    return x, y
