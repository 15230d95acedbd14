"""Commands `gffe run`, which extrapolates, and `gffe export`, which writes the pipeline as C."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gffe_cl.cli.common import (
    CompressionOption,
    DeviceOption,
    JsonOption,
    NoCheckOption,
    OverwriteOption,
    app,
    counted,
    named,
    out,
    parse_numbers,
    parse_size,
    plain,
    progress_bars,
    steps,
    takes_options,
    takes_scheduler,
    warn,
    write_json,
)
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.files import VIDEOS, require_output_file
from gffe_cl.engine.core.validation import require_choice
from gffe_cl.engine.options import OPTIONS

if TYPE_CHECKING:
    from gffe_cl.captures.offline.run import RunReport
    from gffe_cl.captures.offline.source import Live, Recorded
    from gffe_cl.engine.opencl.device import Device
    from gffe_cl.engine.options import Options

_MANY_CUTS = 0.2  # of the rendered frames
# Suffixes of files that nobody gives to a folder.
_FILES = (".avi", ".webm", ".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".webp", ".gif", ".json", ".csv", ".npz")


@app.command()
@takes_options(*(name for name in OPTIONS if name != "ui_detection"))  # it has a third value here
@takes_scheduler
def run(
    sequence: Annotated[
        Path,
        typer.Argument(help="Folder of a capture (see `gffe formats`) or of several, or a built-in scene."),
    ],
    output: Annotated[Path, typer.Argument(help="Folder for the result, which is a sequence; or a video: out.mp4.")],
    n: Annotated[
        int | None,
        typer.Option("-n", help="Number of extrapolated frames per rendered frame, 1 to 7 [dim](default: 1)[/]."),
    ] = None,
    alpha: Annotated[
        str | None,
        typer.Option(help="Times of the new frames, in intervals after each rendered frame, in place of -n: 0.25,0.5."),
    ] = None,
    device: DeviceOption = None,
    camera: Annotated[
        str,
        typer.Option(
            help="Camera of new frames: truth (of the ground truth, where every new frame of an interval has one) or"
            " predicted."
        ),
    ] = "truth",
    dump_stages: Annotated[
        bool, typer.Option("--dump-stages", help="Buffers of all stages: write them to OUTPUT/stages.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Bad pixels: treat them as errors.")] = False,
    window: Annotated[
        str | None,
        typer.Option(
            help="Rendering window of a built-in scene: adaptive, fixed:1.2 or off. Of a sequence: as recorded, or off"
            " for its display part only."
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(help="Frame size of a built-in scene: width × height, pixels [dim](default: 960x540)[/]."),
    ] = None,
    frames: Annotated[
        int | None, typer.Option(help="Number of rendered frames of a built-in scene [dim](default: 30)[/].")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(help="Frame rate of a built-in scene, rendered frames per second [dim](default: 30)[/]."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Random seed of a built-in scene's variation [dim](default: 0)[/].")
    ] = None,
    compression: CompressionOption = "zip",
    ui_detection: Annotated[
        str,
        typer.Option(
            "--ui-detection",
            help="Detection of a user interface in the color, whose pixels keep their place: on, off, or auto, on where"
            " the check of the first frames sees one.",
        ),
    ] = "auto",
    no_check: NoCheckOption = False,
    overwrite: OverwriteOption = False,
    json_path: JsonOption = None,
    *,
    options: Options,
    cluster: Any,
) -> None:
    """Extrapolate after every rendered frame of a sequence, of all sequences in a folder, or of a built-in scene.

    The same command continues an interrupted run: finished frames are taken up where input and settings are the same.
    """
    from gffe_cl.captures.formats import captures_in, open_capture
    from gffe_cl.captures.offline.run import alphas_for, run_sequence
    from gffe_cl.captures.offline.source import Recorded
    from gffe_cl.engine.opencl.runtimes import keep_freed_memory

    if n is not None and alpha is not None:
        raise GffeError("-n and --alpha exclude each other")
    alphas = alphas_for(n if n is not None else 1) if alpha is None else parse_numbers(alpha, "--alpha")
    if camera not in ("truth", "predicted"):
        raise GffeError(f"--camera must be 'truth' or 'predicted', got '{camera}'")
    require_choice(ui_detection, ("auto", "on", "off"), "--ui-detection")
    options = replace(options, shading_inputs=dump_stages, ui_detection=ui_detection == "on")
    several = captures_in(sequence)
    as_video = _is_video(output, several, alphas, overwrite)
    live = {"--size": size, "--frames": frames, "--fps": fps, "--seed": seed}
    keep_freed_memory()
    opened: Any = None
    sources, broken = [], {}
    with cluster as workers, progress_bars() as progress:
        if workers and (dump_stages or not several):
            raise GffeError("--scheduler: expected a folder of several sequences, and no --dump-stages")
        for path in several or [sequence]:
            try:
                if workers:
                    source = Recorded(open_capture(path), None, window, options.upscale)
                else:
                    opened, source = open_source(path, window, opened or device, live, options.upscale)
            except GffeError as error:
                if not several:
                    raise
                broken[path.name] = str(error)
            else:
                sources.append((path, source))
        if not sources:
            raise GffeError("; ".join(named(name, reason) for name, reason in broken.items()))
        advance = steps(progress)("Extrapolating", sum(source.count for _, source in sources) * len(alphas))
        how: dict[str, Any] = {"predicted_camera": camera == "predicted", "strict": strict, "compression": compression}
        how |= {"alphas": alphas, "detection": None if no_check else ui_detection}
        answers = _on_workers(workers, sources, output, overwrite, options, device, window, **how) if workers else None
        how |= {"dump_stages": dump_stages, "overwrite": overwrite, "once": bool(several), "on_frame": advance}
        reports = {}
        for path, source in sources:
            place = output / path.name if several else output
            try:
                if answers:
                    report = _report_of(next(answers))
                    for _ in range(source.count * len(alphas)):
                        advance()
                else:
                    way = _run_to_video if as_video else run_sequence
                    report = _run_one(way, source, path, place, opened, options, **how)
            except GffeError as error:
                if not several:
                    raise
                broken[path.name] = str(error)
            else:
                _print_report(report, place, options)
                reports[path.name] = asdict(report)
    write_json(json_path, {"sequences": reports} if several else next(iter(reports.values())))
    for name, reason in broken.items():
        warn(named(name, reason))
    if broken:
        raise GffeError(f"run: {len(broken)} of {len(several)} sequences failed: {', '.join(broken)}")


def _is_video(output: Path, several: list[Path], alphas: list[float], overwrite: bool) -> bool:
    """Return whether the output is a video. Raises GffeError for files of other kinds, and for videos that cannot be
    written."""
    from gffe_cl.captures.offline.run import alphas_for
    from gffe_cl.captures.video import require_video

    if output.suffix.lower() not in VIDEOS:
        if output.suffix.lower() in _FILES and not output.is_dir():
            raise GffeError(f"{output}: is no name of a folder (expected one, or a video: {', '.join(VIDEOS)})")
        return False
    if several:
        raise GffeError(f"{output}: the input has {len(several)} sequences (expected a folder for the results)")
    if len(alphas) > 7 or sorted(alphas) != alphas_for(len(alphas)):
        raise GffeError(f"{output}: the new frames of a video are equally spaced (expected -n in place of --alpha)")
    require_video()
    require_output_file(output, "OUTPUT", overwrite, media=True)
    return True


def _run_to_video(source, place: Path, device, options, alphas, **how) -> RunReport:
    """Run into a folder beside the video `place`, join rendered and new frames, and return the report."""
    from gffe_cl.captures.offline.run import run_sequence
    from gffe_cl.captures.sequence import open_sequence
    from gffe_cl.captures.video import write_video
    from gffe_cl.engine.core.files import replacing
    from gffe_cl.engine.frame.transfer_function import to_display
    from gffe_cl.lab.compare import shown_color

    if how["dump_stages"]:
        raise GffeError(f"--dump-stages needs a folder for the result, got the video {place}")
    folder = place.with_name(f".{place.name}.frames")
    report = run_sequence(source, folder, device, options, alphas, **how)
    made = open_sequence(folder)
    shown = (to_display(shown_color(made, entry, device), made.exposure) for entry in made.frames)
    with replacing(place) as part:
        write_video(part, ((255 * color + 0.5).astype("uint8") for color in shown), made.fps * (1 + len(alphas)))
    shutil.rmtree(folder, ignore_errors=True)
    return report


def _run_one(way, source, target: Path | str, place: Path, device, options, *, alphas, detection, **how) -> RunReport:
    """Run a sequence in the `way` of `run_sequence`, after a quick check unless `detection` is None. `target`: its name
    for the user."""
    detects, suspicion = _check_quickly(source, device, detection) if detection else (False, None)
    suspicions = [f"{suspicion}; `gffe check {target}` has details"] if suspicion else []
    for text in suspicions:
        warn(text)
    report = way(source, place, device, replace(options, ui_detection=True) if detects else options, alphas, **how)
    return replace(report, warnings=suspicions + report.warnings)


def _check_quickly(source: Recorded | Live, device: Device, ui_detection: str) -> tuple[bool, str | None]:
    """Return whether the first frames of a sequence show a user interface and `ui_detection` is "auto", and a sentence
    if they do not fit."""
    from gffe_cl.captures.doctor import quick_warning
    from gffe_cl.captures.offline.run import shows_interface
    from gffe_cl.captures.offline.source import Recorded

    if not isinstance(source, Recorded):
        return False, None
    return ui_detection == "auto" and shows_interface(source, device), quick_warning(source.sequence, source.exposure)


def _on_workers(workers, sources, output, overwrite, options, device, window, alphas, detection, **how) -> Iterator:
    """Run sequences on the workers of a cluster, write their results into folders of `output`, and yield what
    `run_on_worker` returns. Complete results stay as they are."""
    from gffe_cl.captures.offline.run import GENERATOR, RunReport, is_complete, settings_of
    from gffe_cl.captures.sequence.writer import write_parts
    from gffe_cl.engine.frame.rendered_frame import BadPixels

    def settings(source, with_detection: bool) -> str:
        chosen = replace(options, ui_detection=with_detection)
        return settings_of(source, chosen, alphas, how["predicted_camera"], how["compression"])

    possible = {options.ui_detection, detection == "auto"}
    done = [
        not overwrite and any(is_complete(output / path.name, settings(source, one)) for one in possible)
        for path, source in sources
    ]
    call = {"device": device, "window": window, "alphas": alphas, "detection": detection, **how}
    call["options"] = asdict(options) | {"scn_model": options.scn_model and Path(options.scn_model)}
    left = [path for (path, _), is_kept in zip(sources, done, strict=True) if not is_kept]
    results = workers.map(run_on_worker, ({"path": path, "target": str(path), **call} for path in left))
    for (path, source), is_kept in zip(sources, done, strict=True):
        if is_kept:
            yield asdict(RunReport(0, BadPixels(), [], {}, taken_up=source.count * len(alphas)))
            continue
        answer, files = next(results)
        try:
            if "error" not in answer:
                source.refuse(output / path.name)
                write_parts(output / path.name, GENERATOR, [files], settings(source, answer["ui_detection"]), path)
        except GffeError as error:
            answer = {"error": str(error)}
        yield answer


def run_on_worker(output: Path, path: Path, target: str, device: str | None, window, options: dict, **how) -> dict:
    """Run a sequence on a worker of a cluster. Return the report, or why it failed, for JSON."""
    from gffe_cl.captures.formats import open_capture
    from gffe_cl.captures.offline.run import run_sequence
    from gffe_cl.captures.offline.source import Recorded
    from gffe_cl.engine.opencl.device import device_of_process
    from gffe_cl.engine.options import Options

    model = options.pop("scn_model")
    chosen = Options(**options, scn_model=model and str(model))
    try:
        opened = device_of_process(device)
        source = Recorded(open_capture(path), opened, window, chosen.upscale)
        return asdict(_run_one(run_sequence, source, target, output, opened, chosen, **how))
    except GffeError as error:
        return {"error": str(error)}


def _report_of(answer: Any) -> RunReport:
    from gffe_cl.captures.offline.run import RunReport
    from gffe_cl.engine.frame.rendered_frame import BadPixels

    if "error" in answer:
        raise GffeError(answer["error"])
    return replace(RunReport(**answer), bad_pixels=BadPixels(**answer["bad_pixels"]))


def open_source(
    sequence: Path,
    window: str | None,
    device: str | Device | None,
    live: dict[str, Any],
    scale: float = 0.0,
) -> tuple[Device, Recorded | Live]:
    """Open a folder as a sequence, and return device and source; `device`: its name, or an open one. Other names may be
    built-in scenes, rendered as `live` describes."""
    from gffe_cl.captures.formats import open_capture
    from gffe_cl.captures.offline.source import Live, Recorded
    from gffe_cl.captures.scenes import is_scene, load_scene, scene_names
    from gffe_cl.engine.opencl.device import open_device

    def opened() -> Device:
        return open_device(device, profiling=True) if device is None or isinstance(device, str) else device

    if is_scene(str(sequence)):
        size, frames, fps, seed = live.values()
        size = parse_size("960x540" if size is None else size)
        scene, chosen = load_scene(str(sequence), 0 if seed is None else seed), opened()
        frames, fps = 30 if frames is None else frames, 30.0 if fps is None else fps
        return chosen, Live(scene, chosen, *size, frames, fps, window or "off", scale)
    given = [option for option, value in live.items() if value is not None]
    if given:
        raise GffeError(f"{given[0]} is for built-in scenes ({scene_names()}), {sequence} is none")
    if not sequence.exists() and sequence.name == str(sequence):
        raise GffeError(f"{sequence}: no such folder, and no built-in scene (there is: {scene_names()})")
    recorded, chosen = open_capture(sequence), opened()
    return chosen, Recorded(recorded, chosen, window, scale)


def _print_report(report: RunReport, output: Path, options: Options) -> None:
    if not report.extrapolated:
        out.print(f"{plain(output)} is complete (--overwrite makes it anew)")
        return
    if report.ui_detection and not options.ui_detection:
        out.print("user interface detection is on; `--ui-detection off` leaves it out", soft_wrap=True)
    for warning in report.warnings:
        warn(warning)
    if report.bad_pixels:
        warn(f"bad pixels in the input, survived: {report.bad_pixels}")
    for file in report.cuts:
        out.print(plain(f"cut at {file}: earlier frames are not used"))
    if 1 < len(report.cuts) > _MANY_CUTS * report.rendered:
        warn(f"{len(report.cuts)} of {report.rendered} rendered frames look like cuts: do the motion vectors fit?")
    times = ", ".join(f"{name} {ms:.1f}" for name, ms in report.milliseconds.items() if ms)
    if report.taken_up:
        out.print(f"{counted(report.taken_up, 'frame')} of an interrupted run taken up")
    out.print(f"{counted(report.extrapolated, 'extrapolated frame')} in {plain(output)} (ms per frame: {times})")
    spent = report.seconds
    out.print(f"{spent['wall']:.1f} s: kernels {spent['kernels']:.1f}, network {spent['network']:.1f}")


_OF_PYTHON_ALONE = ("overlays", "scn_provider", "camera_order")
_EXPORTED = [name for name, option in OPTIONS.items() if option.flag and name not in _OF_PYTHON_ALONE]


@app.command()
@takes_options(*_EXPORTED)
def export(
    output: Annotated[Path, typer.Argument(help="Folder for the C code: new, empty or of an earlier export.")],
    device: DeviceOption = None,
    *,
    options: Options,
) -> None:
    """Write the pipeline as C for engines: C99 and OpenCL alone, no Python. Options are fixed by it, sizes are not."""
    from gffe_cl.engine.export import export as write
    from gffe_cl.engine.opencl.device import open_device

    written = write(output, open_device(device), options)
    out.print(f"{len(written)} files in {plain(output)}: README.md explains how to build and call them.")
