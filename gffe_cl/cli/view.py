"""Command `gffe view`, which opens the viewer."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gffe_cl.cli.common import (
    DeviceOption,
    FollowLinksOption,
    JsonOption,
    NoCheckOption,
    app,
    out,
    output_file,
    parse_size,
    write_json,
)
from gffe_cl.cli.options import takes_options
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_seed

if TYPE_CHECKING:
    from gffe_cl.engine.options import Options


def _list_actions(wanted: bool) -> None:
    """Print all actions by their ids, with their labels and shortcuts."""
    if not wanted:
        return
    _require_packages()
    from gffe_cl.viewer.automation.steps import unopened

    for action in unopened().actions:
        shortcut = f" ({action.shortcut})" if action.shortcut else ""
        print(f"{action.id:32}{action.group}: {action.label}{shortcut}")
    print("layer NAME                      any layer of the sequence, by its name, such as layer final")
    raise typer.Exit


@app.command()
@takes_options("shading_correction", "scn_model", "scn_provider")
def view(
    target: Annotated[
        str | None,
        typer.Argument(help="Folder of a capture (see `gffe formats`), or a built-in scene [dim](default: none)[/]."),
    ] = None,
    n: Annotated[int, typer.Option("-n", help="Number of generated frames per rendered frame, 1 to 7.")] = 1,
    window: Annotated[
        str | None,
        typer.Option(
            "--window", help="Rendering window: adaptive, fixed:1.2 (times the display size) or off; see `gffe run`."
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Frame size of a built-in scene: width × height, pixels.")] = "480x270",
    seed: Annotated[int, typer.Option(help="Random seed of a built-in scene's variation.")] = 0,
    device: DeviceOption = None,
    window_size: Annotated[
        str | None,
        typer.Option(
            help="Size of the viewer's window in logical pixels, which a scaled screen enlarges [dim](default: the last"
            " one; screenshots 1600x900, measuring 1280x720)[/]."
        ),
    ] = None,
    screenshot: Annotated[
        Path | None,
        typer.Option(
            help="PNG file for a screenshot of the whole window, after which the viewer exits.",
            callback=output_file("--screenshot"),
        ),
    ] = None,
    frame: Annotated[
        str,
        typer.Option(
            help="Frame in the screenshot: its number on the timeline (9, generated frames counted), or the rendered"
            " frame and the way to the next (4+1/2)."
        ),
    ] = "0",
    layer: Annotated[
        str,
        typer.Option(
            help="Layer in the screenshot or while measuring, such as final, disoccluded, history.dynamic_mask."
        ),
    ] = "final",
    other: Annotated[
        str | None, typer.Option("--with", help="Layer to compare with, in the screenshot or while measuring.")
    ] = None,
    compare: Annotated[
        str,
        typer.Option(
            help="Comparison in the screenshot or while measuring: off, split, difference, error or 'flip error'."
        ),
    ] = "off",
    pixel: Annotated[str | None, typer.Option(help="Pixel that the screenshot explains: X,Y, such as 120,45.")] = None,
    overview: Annotated[
        bool, typer.Option("--overview", help="Overview: the screenshot shows all layers as tiles.")
    ] = False,
    measure: Annotated[
        float | None,
        typer.Option(
            help="Measurement: seconds to play every frame, then again from the cache; prints frame rates and times,"
            " and exits."
        ),
    ] = None,
    script: Annotated[
        Path | None,
        typer.Option(
            help="Script file with one step per line (docs/guide.md); the viewer exits at its end.", exists=False
        ),
    ] = None,
    actions: Annotated[
        bool,
        typer.Option(
            "--actions",
            help="Actions of scripts (`do ACTION`): list them and exit.",
            is_eager=True,
            callback=_list_actions,
        ),
    ] = False,
    film: Annotated[
        Path | None,
        typer.Option(
            help="File for a film of the window while the script waits: .webp or .gif.", callback=output_file("--film")
        ),
    ] = None,
    cache: Annotated[int, typer.Option(help="Memory for frames, pipelines and textures, MiB; 0: no cache.")] = 2048,
    no_check: NoCheckOption = False,
    follow_links: FollowLinksOption = False,
    json_path: JsonOption = None,
    *,
    options: Options,
) -> None:
    """Open the viewer: play, look into every stage, find out why a pixel is wrong."""
    _require_packages()
    from gffe_cl.captures.scenes import is_scene
    from gffe_cl.engine.inference.network import load_network
    from gffe_cl.viewer.automation.measuring import measure as measure_playback
    from gffe_cl.viewer.automation.screenshot import Look, Shot, take_screenshot
    from gffe_cl.viewer.automation.scripting import play_script, require_film
    from gffe_cl.viewer.automation.steps import parse, read_place
    from gffe_cl.viewer.engine.sources.opening import ScenePlan
    from gffe_cl.viewer.state.comparing import WAYS
    from gffe_cl.viewer.state.model import Model
    from gffe_cl.viewer.state.settings import LEAST_WINDOW, Settings
    from gffe_cl.viewer.window.start import leaving, require_display
    from gffe_cl.viewer.window.start import view as run_viewer

    if not 1 <= n <= 7:
        raise GffeError(f"-n must be 1 to 7 generated frames per rendered frame, got {n}")
    alone = [
        name for name, given in (("--screenshot", screenshot), ("--measure", measure), ("--script", script)) if given
    ]
    if target is None and alone:
        raise GffeError(f"{alone[0]} needs a sequence or a scene")
    if len(alone) > 1:
        raise GffeError(f"{' and '.join(alone)} exclude each other")
    if film is not None:
        require_film(film)
        if script is None:
            raise GffeError("--film needs a --script with the steps to film")
    steps = [] if script is None else parse(script)
    if measure is not None and not 0 < measure <= 3600:
        raise GffeError(f"--measure must be seconds, up to 3600, got {measure:g}")
    if compare not in WAYS:
        raise GffeError(f"--compare must be {', '.join(WAYS[:-1])} or '{WAYS[-1]}', got '{compare}'")
    if window not in (None, "off") and target is not None and not is_scene(target):
        raise GffeError(f"--window {window}: only built-in scenes are rendered through a chosen window (expected off)")
    if not 0 <= cache <= 1 << 20:
        raise GffeError(f"--cache must be 0 to 1048576 MiB, got {cache}")
    plan = ScenePlan(*parse_size(size), require_seed(seed, "--seed"))
    viewer_size = None if window_size is None else parse_size(window_size)
    if viewer_size is not None and min(viewer_size) < LEAST_WINDOW:
        raise GffeError(f"--window-size must be at least {LEAST_WINDOW} pixels each way, got '{window_size}'")
    look, shot = Look(layer, compare, other), None
    if screenshot is not None:
        shot = Shot(screenshot, read_place(frame, "--frame"), look, _pixel(pixel), overview)
    asked = options.shading_correction, options.scn_model, options.scn_provider
    remark = ""
    if options.corrects_shading and asked != (None, None, None):
        remark = load_network(options.scn_model, options.scn_provider).remark  # an explicit request must work
    require_display()
    by_hand = not alone
    settings, warning = Settings.load() if by_hand else (Settings(), None)
    model = Model(
        settings, device=device, n=n, window=window, plan=plan, options=options, save_settings=by_hand,
        check=not no_check, cache_mib=cache,
    )  # fmt: skip
    for text in filter(None, (warning, remark)):
        model.say(text)
    with leaving(model):
        if target is not None:
            model.open(target)
        if script is not None:
            play_script(model, script, steps, film, viewer_size)
            return
        if shot is not None:
            take_screenshot(model, shot, viewer_size)
            return
        if measure is None:
            run_viewer(model, viewer_size)
            return
        figures = measure_playback(model, measure, viewer_size, look)
        nothing = {"first_picture": " not known on this system", "cached": " there is no cache"}
        for title, values in figures.items():
            out.print(f"{title.replace('_', ' ')}:{'' if values else nothing[title]}")
            for name, value in values.items():
                out.print(f"  {name.replace('_', ' ')}: {value:.2f}")
        write_json(json_path, figures | {"device": model.engine.device_name})


def _require_packages() -> None:
    """Raise GffeError unless the packages that only the viewer needs are there and work."""
    for name in ("imgui_bundle", "glfw", "moderngl"):  # in this order
        try:
            import_module(name)
        except Exception as error:  # whatever a broken package throws
            reason = " ".join(str(error).split()) or type(error).__name__
            raise GffeError(
                f"the viewer needs {name.replace('_', '-')}: {reason} (expected: pip install --force-reinstall"
                " imgui-bundle glfw moderngl; all other commands work without)"
            ) from None


def _pixel(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        raise GffeError(f"--pixel must look like 120,45, got '{text}'") from None
    return x, y
