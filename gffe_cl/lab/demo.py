"""Demonstration: render `corridor`, extrapolate it, measure it, show it (`gffe demo`)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.sequences import render_sequence
from gffe_cl.captures.sequence import Sequence, open_sequence
from gffe_cl.captures.video import write_video
from gffe_cl.engine.core.files import replacing
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.lab.compare import baseline_repeat, compare, shown_color
from gffe_cl.lab.metrics import psnr, to_display
from gffe_cl.lab.report import contact_sheet, error_image, side_by_side

METHODS = {
    "repeat": "repeat the last frame",
    "static": "warp, all static",
    "gae": "GAE",
    "scn": "GAE and shading correction",
}
_FRAMES = 16
_SLOWDOWN = 4


def demo(output: Path, device: Device, width: int, height: int, seed: int, window: str, options: Options, step) -> dict:
    """Fill the folder `output` and return the metrics. The files are `rendered/`, `extrapolated/`, `contact_sheet.png`,
    `side_by_side.mp4`, `metrics.json`.

    `window` is the rendering window: "adaptive", "fixed:FACTOR" or "off". `options`: of the displayed frames; the
    others are made without shading correction. `step(text, total)` opens a progress step and returns a function to call
    after each unit of it. The metrics are {"repeat": {"psnr", "ssim"}, "static": {…}, "gae": {…}}, and "scn" where that
    is on.
    """
    scene = load_scene("corridor", seed)
    rendered, extrapolated = output / "rendered", output / "extrapolated"
    on_frame = step("Rendering the scene 'corridor'", 2 * _FRAMES)
    render_sequence(
        scene, rendered, device, width, height, _FRAMES, 30.0, ground_truth=True, window=window, on_frame=on_frame
    )
    source = open_sequence(rendered)
    plain = replace(options, shading_correction=False)
    runs = {"static": (output / "static", replace(plain, motion=False)), "gae": (extrapolated, plain)}
    if options.corrects_shading:
        runs |= {"gae": (output / "gae", plain), "scn": (extrapolated, options)}
    for name, (folder, how) in runs.items():
        on_frame = step(f"Extrapolating ({METHODS[name]})", _FRAMES)
        run_sequence(Recorded(source, device), folder, device, how, [0.5], on_frame=on_frame)

    on_frame = step("Measuring against ground truth", (1 + len(runs)) * _FRAMES)
    progress = lambda done, total: on_frame()  # noqa: E731
    results = {"repeat": baseline_repeat(source, progress, device)}
    for name, (folder, _) in runs.items():
        results[name] = compare(open_sequence(folder), source, progress=progress)
    metrics = {name: result.to_json()["mean"] for name, result in results.items()}
    with replacing(output / "metrics.json") as part:
        part.write_text(json.dumps(metrics, indent=1) + "\n")

    made = open_sequence(extrapolated)
    on_frame = step("Drawing the contact sheet and the video", _FRAMES)
    with replacing(output / "contact_sheet.png") as part:
        _contact_sheet(source, made, device).save(part)
    with replacing(output / "side_by_side.mp4") as part:
        write_video(part, _video_frames(source, made, device, on_frame), 60.0)
    return metrics


def _contact_sheet(source: Sequence, made: Sequence, device: Device):
    """Return a contact sheet of three times: truth, last frame repeated and extrapolated frame, their errors, and
    the other outputs of an extrapolated frame."""
    groups = []
    for index in np.linspace(_FRAMES // 4, _FRAMES - 1, 3).astype(int):
        now, new, truth = source.rendered[index], made.extrapolated[index], source.ground_truth[index]
        repeated, predicted, wanted = (
            to_display(shown_color(s, e, device), source.exposure)
            for s, e in ((source, now), (made, new), (source, truth))
        )
        other = made.read_channels(new, ["Z", "mask.dynamic", "mask.disoccluded"])
        nearness = 1 / other["Z"].astype(np.float32)  # 0 for sky
        images = [
            ("ground truth (t + 1/2)", wanted),
            (f"repeat the last frame (t): {psnr(repeated, wanted):.1f} dB", repeated),
            (f"extrapolated (t + 1/2): {psnr(predicted, wanted):.1f} dB", predicted),
            ("dynamic fragments", other["mask.dynamic"].astype(np.float32)),
            ("extrapolated depth", nearness / max(float(nearness.max()), 1e-9)),
            ("error of repeating x 4", error_image(repeated, wanted)),
            ("error of extrapolating x 4", error_image(predicted, wanted)),
            ("disocclusions", other["mask.disoccluded"].astype(np.float32)),
        ]
        groups.append((f"frame {index}, t = {now.time:.3f} s", images))
    return contact_sheet(groups, columns=4, cell_width=480)


def _video_frames(source: Sequence, made: Sequence, device: Device, on_frame) -> Iterator[np.ndarray]:
    """Yield video frames: left the rendered frames at 30 Hz, right with the extrapolated ones at 60 Hz, slowed down."""

    def pairs():
        for now, new in zip(source.rendered, made.extrapolated, strict=True):
            rendered = to_display(shown_color(source, now, device), source.exposure)
            extrapolated = to_display(made.read_color(new), source.exposure)
            yield rendered, rendered
            yield rendered, extrapolated
            on_frame()

    labels = (
        f"rendered, 30 Hz (1/{_SLOWDOWN} speed)",
        f"with extrapolated frames, 60 Hz (1/{_SLOWDOWN} speed)",
    )
    for image in side_by_side(pairs(), labels):
        for _ in range(_SLOWDOWN):
            yield image
