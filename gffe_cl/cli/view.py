"""Command `gffe view`, which opens the viewer."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gffe_cl.cli.common import (
    DeviceOption,
    NoCheckOption,
    OverwriteOption,
    app,
    out,
    output_file,
    parse_size,
    plain,
    progress_bars,
    takes_options,
)
from gffe_cl.cli.common import steps as steps_of
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_seed

if TYPE_CHECKING:
    from gffe_cl.engine.options import Options


def _list_actions(wanted: bool) -> None:
    """Print all actions by their ids, with what they take, their labels and shortcuts."""
    if not wanted:
        return
    _require_packages()
    from gffe_cl.viewer.window.script import unopened

    for action in unopened().actions:
        shortcut = f" ({action.shortcut})" if action.shortcut else ""
        takes = f". {action.id} {action.takes}" if action.takes else ""
        print(f"{action.id:32}{action.group}: {action.label}{shortcut}{takes}")
    raise typer.Exit


WindowOption = Annotated[
    str | None,
    typer.Option("--window", help="Rendering window: adaptive, fixed:1.2 (times the display size) or off."),
]
WindowSizeOption = Annotated[
    str | None,
    typer.Option(
        help="Size of the viewer's window in logical pixels, which a scaled screen enlarges [dim](default: the last"
        " one; screenshots 1600x900)[/]."
    ),
]
ScreenshotOption = Annotated[
    Path | None,
    typer.Option(
        help="PNG file for a screenshot of the whole window, after which the viewer exits.",
        callback=output_file("--screenshot", media=True),
    ),
]
ExportOption = Annotated[
    Path | None,
    typer.Option(
        help="Folder for a page with pictures, values and figures, which any browser opens from the disk; needs no"
        " display."
    ),
]
FrameOption = Annotated[
    str | None,
    typer.Option(
        help="Frame in the screenshot: its number on the timeline (9, generated frames counted), or the rendered"
        " frame and the way to the next (4+1/2). Of a page several, with commas, or 4..9"
        " [dim](default: 0; of a page all generated ones)[/]."
    ),
]
ActionsOption = Annotated[
    bool,
    typer.Option("--actions", help="Actions of scripts: list them and exit.", is_eager=True, callback=_list_actions),
]
FilmOption = Annotated[
    Path | None,
    typer.Option(
        help="File for a film of the window while the script waits: .webp or .gif.",
        callback=output_file("--film", media=True),
    ),
]


@app.command()
@takes_options("shading_correction", "scn_model", "scn_provider")
def view(
    target: Annotated[
        str | None,
        typer.Argument(help="Folder of a capture (see `gffe formats`), or a built-in scene [dim](default: none)[/]."),
    ] = None,
    n: Annotated[int, typer.Option("-n", help="Number of generated frames per rendered frame, 1 to 7.")] = 1,
    window: WindowOption = None,
    size: Annotated[str, typer.Option(help="Frame size of a built-in scene: width × height, pixels.")] = "480x270",
    seed: Annotated[int, typer.Option(help="Random seed of a built-in scene's variation.")] = 0,
    device: DeviceOption = None,
    window_size: WindowSizeOption = None,
    screenshot: ScreenshotOption = None,
    export: ExportOption = None,
    frame: FrameOption = None,
    layer: Annotated[
        str, typer.Option(help="Layer in the screenshot, such as final or disoccluded; of a page several, with commas.")
    ] = "final",
    other: Annotated[
        str | None,
        typer.Option("--with", help="B: a layer, or a folder with a sequence, an output of `gffe run`, or kernels."),
    ] = None,
    compare: Annotated[
        str | None, typer.Option(help="Comparison in the screenshot: off, split, difference, error or 'flip error'.")
    ] = None,
    pixel: Annotated[str | None, typer.Option(help="Pixel that the screenshot explains: X,Y, such as 120,45.")] = None,
    overview: Annotated[bool, typer.Option("--overview", help="All layers, in the screenshot as tiles.")] = False,
    script: Annotated[
        Path | None, typer.Option(help="Script with one action per line (docs/guide.md); the viewer exits at its end.")
    ] = None,
    actions: ActionsOption = False,
    film: FilmOption = None,
    cache: Annotated[int, typer.Option(help="Memory for frames, pipelines and textures, MiB; 0: no cache.")] = 2048,
    no_check: NoCheckOption = False,
    overwrite: OverwriteOption = False,
    *,
    options: Options,
) -> None:
    """Open the viewer: play, look into every stage, find out why a pixel is wrong."""
    if export is None:
        _require_packages()
    from gffe_cl.captures.scenes import is_scene
    from gffe_cl.engine.inference.network import load_network
    from gffe_cl.viewer.engine.jobs import leaving
    from gffe_cl.viewer.engine.sources.opening import ScenePlan
    from gffe_cl.viewer.state.page import Exporter, Plan

    if not 1 <= n <= 7:
        raise GffeError(f"-n must be 1 to 7 generated frames per rendered frame, got {n}")
    alone = [
        name for name, given in (("--screenshot", screenshot), ("--script", script), ("--export", export)) if given
    ]
    if target is None and alone:
        raise GffeError(f"{alone[0]} needs a sequence or a scene")
    if len(alone) > 1:
        raise GffeError(f"{' and '.join(alone)} exclude each other")
    if window not in (None, "off") and target is not None and not is_scene(target):
        raise GffeError(f"--window {window}: only built-in scenes are rendered through a chosen window (expected off)")
    if not 0 <= cache <= 1 << 20:
        raise GffeError(f"--cache must be 0 to 1048576 MiB, got {cache}")
    plan = ScenePlan(*parse_size(size), require_seed(seed, "--seed"))
    asked = options.shading_correction, options.scn_model, options.scn_provider
    remark = ""
    if options.corrects_shading and asked != (None, None, None):
        remark = load_network(options.scn_model, options.scn_provider).remark  # an explicit request must work
    if export is not None and target is not None:
        layers = "" if overview else layer
        page = Plan(target, plan, options, device, n, window, frame or "", layers, other, compare or "split")
        with leaving(exporter := Exporter(page)), progress_bars() as progress:
            out.print(plain(exporter.write(export, overwrite, steps_of(progress))))
        return
    from gffe_cl.viewer.state.model import Model
    from gffe_cl.viewer.state.saving import require_file
    from gffe_cl.viewer.state.settings import LEAST_WINDOW, Settings
    from gffe_cl.viewer.window.running import new_app, require_display, run
    from gffe_cl.viewer.window.script import FILMS, parse, play_script, take_screenshot, unopened

    if film is not None:
        require_file(film, "film", FILMS)
        if script is None:
            raise GffeError("--film needs a --script with the steps to film")
    steps = [] if script is None else parse(script, unopened().actions)
    viewer_size = None if window_size is None else parse_size(window_size)
    if viewer_size is not None and min(viewer_size) < LEAST_WINDOW:
        raise GffeError(f"--window-size must be at least {LEAST_WINDOW} pixels each way, got '{window_size}'")
    require_display()
    by_hand = not alone
    settings, warning = Settings.load() if by_hand else (Settings(), None)
    model = Model(
        settings,
        device=device,
        n=n,
        window=window,
        plan=plan,
        options=options,
        save_settings=by_hand,
        check=not no_check,
        cache_mib=cache,
    )
    for text in filter(None, (warning, remark)):
        model.say(text)
    with leaving(model):
        if target is not None:
            model.open(target)
        if script is not None:
            play_script(model, steps, film, viewer_size)
        elif screenshot is not None:
            listed = [
                ("--frame", "seek", frame),
                ("--layer", "layer", layer),
                ("--with", "from" if other is not None and Path(other).is_dir() else "with", other),
                ("--compare", "compare", compare),
                ("--pixel", "pixel", pixel),
                ("--overview", "overview", "" if overview else None),
            ]
            given = [(option, action, argument) for option, action, argument in listed if argument is not None]
            take_screenshot(model, screenshot, given, viewer_size)
        else:
            run(new_app(model), viewer_size)


def _require_packages() -> None:
    """Raise GffeError unless the packages that only the viewer needs are there and work."""
    for name in ("imgui_bundle", "glfw", "moderngl"):  # in this order
        try:
            import_module(name)
        except (ImportError, OSError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise GffeError(
                f"the viewer needs {name.replace('_', '-')}: {reason} (expected: pip install --force-reinstall"
                " imgui-bundle glfw moderngl; all other commands work without)"
            ) from None
