"""Extrapolation of a sequence, on disk or rendered meanwhile, into another one (`gffe run`)."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from gffe_cl.captures.offline.source import Source
from gffe_cl.captures.sequence import FrameEntry, SequenceWriter, named_channels
from gffe_cl.captures.sequence.description import FILE_NAME, parse_description, read_text
from gffe_cl.captures.sequence.exr import DEFAULT_COMPRESSION, write_channels
from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.public_names import __version__
from gffe_cl.engine.frame.camera import Camera
from gffe_cl.engine.frame.rendered_frame import BadPixels
from gffe_cl.engine.inference import network as inference
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.opencl.program import kernel_digest
from gffe_cl.engine.options import Options
from gffe_cl.engine.pipeline.made_frame import ExtrapolatedFrame, PresentedFrame
from gffe_cl.engine.pipeline.pipeline import Pipeline
from gffe_cl.engine.stages.base import pictures_of

GENERATOR = "gffe-cl run"
_MOST_ALPHA = 100
_CHECKED, _LEAST_SHARE = 5, 0.002  # first frames, and the share of their pixels, that show a user interface
_MOTION_STEPS = np.float32(1024)  # per pixel, of motion in files
MASKS = {"mask.dynamic": "dynamic", "mask.disoccluded": "disoccluded", "mask.filled_by": "filled_by"}


@dataclass
class RunReport:
    """Summary of a run: frames made, bad pixels met, warnings, milliseconds per stage and frame (kernels; "network":
    wall time), seconds of the whole run: "wall", of these until kernels were ready ("start"), in "kernels" and in
    "network"; how many frames were rendered ones, how many more an interrupted run had made, and the files of those
    that were found to be cuts; the device, and whether a user interface was looked for."""

    extrapolated: int
    bad_pixels: BadPixels
    warnings: list[str]
    milliseconds: dict[str, float]
    seconds: dict[str, float] = field(default_factory=dict)
    rendered: int = 0
    taken_up: int = 0
    cuts: list[str] = field(default_factory=list)
    device: str = ""
    platform: str = ""
    ui_detection: bool = False


def alphas_for(n: int) -> list[float]:
    """Return α = j/(n+1) for j = 1 … n (paper: 'Position estimation')."""
    if not 1 <= n <= 7:
        raise GffeError(f"-n must be 1 to 7 extrapolated frames per rendered frame, got {n}")
    return [j / (n + 1) for j in range(1, n + 1)]


def run_sequence(
    source: Source,
    output: Path,
    device: Device,
    options: Options,
    alphas: list[float],
    *,
    predicted_camera: bool = False,
    strict: bool = False,
    dump_stages: bool = False,
    compression: str = DEFAULT_COMPRESSION,
    overwrite: bool = False,
    once: bool = False,
    on_frame: Callable[[], None] = lambda: None,
) -> RunReport:
    """Extrapolate after every rendered frame of `source`, write the result to `output`, and return a summary.

    The cameras after a rendered frame come from `source`, for the times of all new frames there; if it lacks one, or
    with `predicted_camera`, all of them are predicted (C̄). `compression` is that of new EXRs (see `SequenceWriter`).
    `on_frame` is called after each extrapolated frame. Rendered frames that are found to be cuts become resets in
    `output`. An interrupted run of the same input and settings is continued unless it is to `overwrite`: rendered
    frames are submitted again, finished frames are taken up, and the result has the same bits. With `once` nothing is
    made where such a result is complete. Dumps of stages are made anew.

    Raises GffeError for structural faults; then `output` is as it was before.
    """
    start = perf_counter()
    alphas = sorted(alphas)
    twice = [a for a, b in zip(alphas, alphas[1:], strict=False) if a == b]
    if twice:
        raise GffeError(f"alpha {twice[0]:g} is given twice (expected times that differ)")
    if not alphas or not all(0 < a <= _MOST_ALPHA for a in alphas):
        given = ", ".join(f"{a:g}" for a in alphas) or "none"
        raise GffeError(f"alpha must be positive numbers up to {_MOST_ALPHA}, got {given}")
    source.refuse(output)
    settings = None if dump_stages else settings_of(source, options, alphas, predicted_camera, compression)
    if once and not overwrite and is_complete(output, settings):
        for _ in range(source.count * len(alphas)):
            on_frame()
        return RunReport(0, BadPixels(), [], {}, taken_up=source.count * len(alphas))
    size = (source.width, source.height)
    writing = SequenceWriter(
        output,
        *size,
        source.fps,
        source.exposure,
        generator=GENERATOR,
        compression=compression,
        format=source.format,
        settings=settings,
    )
    frames = source.frames(alphas, strict)  # the first ones are read while kernels are built
    pipeline = Pipeline(device, *size, options, render_size=source.render_size, fps=source.fps)
    pipeline.exposure = source.exposure
    started = perf_counter()
    suffixes = _suffixes(alphas)
    of_device = {"device": device.info.name, "platform": device.info.platform}
    report = RunReport(0, BadPixels(), [], {}, ui_detection=options.ui_detection, **of_device)
    timings: dict[str, float] = defaultdict(float)
    if dump_stages:
        pipeline.keep()
    with writing as writer:
        for entry, frame in frames:
            pipeline.submit(frame)
            report.rendered += 1
            if pipeline.is_cut:
                report.cuts.append(entry.file)
                entry = replace(entry, reset=True)
            if "rendered" in pictures_of(pipeline.stages.values()):
                writer.add(*shown_frame(entry, pipeline.present(), frame.color.dtype), owned=True)
            else:
                source.store(writer, entry, frame)
            if dump_stages:
                pipeline.present()
            times = [frame.time + alpha * pipeline.interval for alpha in alphas]
            cameras = None if predicted_camera else source.cameras_at(times)
            for alpha, time, camera in zip(alphas, times, cameras or [None] * len(times), strict=True):
                file = f"extrapolated_{source.number_of(entry)}_{suffixes[alpha]}.exr"
                if file in writer.finished and not overwrite:
                    writer.take_up(writer.finished[file])
                    report.taken_up += 1
                    on_frame()
                    continue
                extrapolated = pipeline.extrapolate(camera, time)
                made = FrameEntry(
                    file=file,
                    time=time,
                    kind="extrapolated",
                    source=entry.file,
                    alpha=alpha,
                    display_camera=extrapolated.camera,
                )
                if dump_stages:
                    dump_buffers(pipeline, writer.folder("stages") / Path(made.file).stem)
                writer.add(
                    made,
                    output_channels(extrapolated, frame.camera, pipeline.shown_camera, frame.color.dtype),
                    owned=True,
                )
                report.extrapolated += 1
                on_frame()
            for name, milliseconds in (pipeline.take_timings() if device.profiles else {}).items():
                timings[name] += milliseconds
    report.bad_pixels = pipeline.bad_pixels
    report.warnings = source.warnings() + _network_warnings(pipeline)
    report.milliseconds = {name: total / max(report.extrapolated, 1) for name, total in timings.items()}
    network = (timings.pop("network", 0.0) + timings.pop("network copies", 0.0)) * 1e-3
    report.seconds = {
        "wall": perf_counter() - start,
        "start": started - start,
        "kernels": sum(timings.values()) * 1e-3,
        "network": network,
    }
    return report


def shows_interface(source: Source, device: Device) -> bool:
    """Return whether the first frames of `source` have a user interface in the color. Raises GffeError if one cannot
    be read."""
    pipeline = Pipeline(device, *source.render_size, Options.preset("performance", ui_detection=True))
    pipeline.exposure, shares = source.exposure, [0.0]
    for k in range(min(source.count, _CHECKED)):
        frame = source.rendered(k)
        pipeline.submit(replace(frame, display_camera=None, overlays=None))
        found = pipeline.stages["user_interface"].read("mask") > 0
        if frame.overlays is not None and frame.overlays.fixed_mask is not None:
            found &= np.asarray(frame.overlays.fixed_mask) == 0
        shares.append(float(found.mean()))
    return max(shares) >= _LEAST_SHARE


def settings_of(source: Source, options: Options, alphas: list[float], predicted_camera: bool, compression: str) -> str:
    """Return a digest of everything that the frames of a run depend on: input, settings and kernels. All devices and
    providers of the network give the same bits."""
    given: list = [asdict(replace(options, scn_provider=None)), sorted(alphas), predicted_camera, compression]
    weights = Path(options.scn_model) if options.scn_model else inference.default_model()
    if options.corrects_shading and weights:
        with suppress(OSError):  # the pipeline refuses it
            given.append(inference.digest_of_weights(weights))
    known = [__version__, kernel_digest(), source.identity(), *given]
    return hashlib.sha256(json.dumps(known, default=str).encode()).hexdigest()[:32]


def is_complete(output: Path, settings: str | None) -> bool:
    """Return whether the folder `output` has the whole result of a run with these `settings`."""
    try:
        description = parse_description(read_text(output / FILE_NAME))
    except GffeError:
        return False
    return description.settings == settings is not None and not description.unfinished


def shown_frame(entry: FrameEntry, shown: PresentedFrame, color_dtype) -> tuple[FrameEntry, dict[str, np.ndarray]]:
    """Return entry and channels of a rendered frame as displayed, with motion between displayed images."""
    plain = FrameEntry(entry.file, entry.time, reset=entry.reset, render_camera=shown.camera)
    dtype = np.float32 if color_dtype == np.float32 else np.float16
    color = shown.numpy("color").astype(dtype, copy=False)
    return plain, named_channels(color, shown.numpy("depth"), _rounded(shown.numpy("motion")))


def _network_warnings(pipeline: Pipeline) -> list[str]:
    correction = pipeline.stages.get("correction")
    if correction is None:
        return []
    remarks = [correction.network.remark] if correction.network.remark else []
    if not correction.unusable_pixels:
        return remarks
    model, pixels = correction.network.path.name, correction.unusable_pixels
    return remarks + [
        f"{model}: the network gave NaN or infinity for about {pixels:,} pixels of the new frames; they keep the"
        " extrapolated color"
    ]


def output_channels(
    extrapolated: ExtrapolatedFrame, render_camera: Camera, display_camera: Camera, color_dtype=np.float16
) -> dict[str, np.ndarray]:
    """Return the EXR channels of an extrapolated frame: R G B, Z, motion.x motion.y, mask.*, and `motion.display.*`
    (pixels, into the source frame as displayed) where it was rendered through another window. Motion is rounded to
    1/1024 px: the bits below are noise, which no compression shrinks."""
    motion = _rounded(extrapolated.numpy("motion"))
    dtype = np.float32 if color_dtype == np.float32 else np.float16
    color = extrapolated.numpy("color").astype(dtype, copy=False)
    channels = named_channels(color, extrapolated.numpy("depth"), motion)
    channels |= {channel: extrapolated.numpy(name) for channel, name in MASKS.items()}
    if extrapolated.expected_error:
        channels["mask.expected_error"] = extrapolated.numpy("expected_error")
    if render_camera != display_camera:
        height, width = motion.shape[:2]
        for axis, name in enumerate("xy"):
            center = np.arange((width, height)[axis]) + 0.5
            center = center[None, :] if axis == 0 else center[:, None]
            focal = [(c.fx, c.fy)[axis] for c in (render_camera, display_camera)]
            middle = [(c.cx, c.cy)[axis] for c in (render_camera, display_camera)]
            shown = (motion[..., axis] + center - middle[0]) * (focal[1] / focal[0]) + middle[1]
            channels[f"motion.display.{name}"] = _rounded((shown - center).astype(np.float32))
    return channels


def _rounded(motion: np.ndarray) -> np.ndarray:
    """Return `motion` itself, rounded in place to 1/1024 px."""
    np.multiply(motion, _MOTION_STEPS, out=motion)
    np.rint(motion, out=motion)
    return np.multiply(motion, 1 / _MOTION_STEPS, out=motion)


def dump_buffers(pipeline: Pipeline, folder: Path) -> None:
    """Write every named buffer of every stage to `folder`: `<stage>.<buffer>.exr`, and `once.json` for buffers that
    are no images."""
    once = {}
    try:
        folder.mkdir()
        for stage, spec in pipeline.named_buffers():
            array = stage.read(spec.name)
            if spec.grid == "once":
                once[f"{stage.name}.{spec.name}"] = array.tolist()
            else:
                write_channels(folder / f"{stage.name}.{spec.name}.exr", _dump_channels(spec, array))
        (folder / "once.json").write_text(json.dumps(once, indent=1))
    except OSError as error:
        raise GffeError(f"{folder}: cannot write the stage dump: {error.strerror or error}") from None


def _dump_channels(spec: Any, array: np.ndarray) -> dict[str, np.ndarray]:
    """Return the channels of a dumped buffer: its components ("Y" for a single one), numbered "1.x" … per plane."""
    channels = {}
    for k, plane in enumerate(array if spec.planes > 1 else array[None]):
        prefix = f"{k + 1}." if spec.planes > 1 else ""
        for c, component in enumerate(spec.components or ("Y",)):
            image = plane[..., c] if spec.components else plane
            channels[prefix + component] = image if image.dtype == np.float16 else image.astype(np.float32)
    return channels


def _suffixes(alphas: list[float]) -> dict[float, str]:
    """Return suffixes of file names by α: in thousandths (0.5 → `0500`), in smaller units where thousandths would be
    equal."""
    for digits in range(3, 18):
        suffixes = {alpha: f"{round(alpha * 10**digits):0{digits + 1}d}" for alpha in alphas}
        if len(set(suffixes.values())) == len(alphas):
            break
    return suffixes
