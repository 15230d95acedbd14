"""Demonstration: render `corridor`, extrapolate it, measure it, show it (`gffe demo`)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gffe_cl.captures.offline.run import run_sequence
from gffe_cl.captures.offline.source import Recorded
from gffe_cl.captures.scenes import load_scene
from gffe_cl.captures.scenes.renderer import render_sequence
from gffe_cl.captures.sequence import Sequence, open_sequence
from gffe_cl.captures.video import write_video
from gffe_cl.engine.core.files import replacing
from gffe_cl.engine.opencl.device import Device
from gffe_cl.engine.options import Options
from gffe_cl.lab.compare import baseline_repeat, compare, shown_color
from gffe_cl.lab.metrics import psnr, to_display

METHODS = {
    "repeat": "repeat the last frame",
    "static": "warp, all static",
    "gae": "GAE",
    "scn": "GAE and shading correction",
}
_FRAMES = 16
_SLOWDOWN = 4
_MARGIN = 8
_BAR = 28  # of a line of text
_INK = (225, 225, 225)
_FAINT = (165, 165, 165)
_PAPER = (24, 24, 26)


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


# ---- pictures for people: display values are sRGB in [0, 1] ---------------------------------------------


def contact_sheet(groups: list[tuple[str, list[tuple[str, np.ndarray]]]], columns: int = 3, cell_width: int = 640):
    """Return a PIL image of groups of images (H, W, 3) or (H, W), values in [0, 1], all of one size; labels of groups
    and captions of images stand above them."""
    from PIL import Image, ImageDraw

    height, width = groups[0][1][0][1].shape[:2]
    cell = (cell_width, round(cell_width * height / width))
    row, font = _BAR + cell[1], _font(18)
    rows = sum(-(-len(images) // columns) for _, images in groups)
    sheet_size = (_MARGIN + columns * (cell[0] + _MARGIN), len(groups) * (_BAR + _MARGIN) + rows * row)
    sheet = Image.new("RGB", sheet_size, _PAPER)
    draw = ImageDraw.Draw(sheet)
    top = 0
    for label, images in groups:
        draw.text((_MARGIN, top + 5), label, _INK, font)
        top += _BAR
        for index, (caption, image) in enumerate(images):
            x, y = _MARGIN + index % columns * (cell[0] + _MARGIN), top + index // columns * row
            draw.text((x, y + 5), caption, _FAINT, font)
            sheet.paste(to_image(image).resize(cell, Image.Resampling.LANCZOS), (x, y + _BAR))
        top += -(-len(images) // columns) * row + _MARGIN
    return sheet


def to_image(values: np.ndarray):
    """Return a PIL image of display values (H, W, 3) or (H, W) in [0, 1]."""
    from PIL import Image

    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, -1)
    return Image.fromarray((np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8))


def error_image(a: np.ndarray, b: np.ndarray, gain: float = 4.0) -> np.ndarray:
    """Return the mean absolute difference of display values times `gain`, on a black–red–yellow–white scale (H, W,
    3)."""
    error = np.abs(a - b).mean(-1) * gain
    return np.clip(np.stack([3 * error, 3 * error - 1, 3 * error - 2], -1), 0, 1)


def side_by_side(pairs: Iterable[tuple[np.ndarray, np.ndarray]], labels: tuple[str, str]) -> Iterator[np.ndarray]:
    """Join (left, right) display images with a label each, and yield (H, 2W + gap, 3) uint8, sides even."""
    from PIL import Image, ImageDraw

    font = _font(20)
    for left, right in pairs:
        height, width = left.shape[:2]
        frame = Image.new("RGB", (2 * width + 8 + (8 + 2 * width) % 2, height + 32 + height % 2), _PAPER)
        draw = ImageDraw.Draw(frame)
        for image, x, label in ((left, 0, labels[0]), (right, width + 8, labels[1])):
            frame.paste(to_image(image), (x, 32))
            draw.text((x + 8, 5), label, _INK, font)
        yield np.asarray(frame)


def _font(size: int):
    from PIL import ImageFont

    return ImageFont.load_default(size)
