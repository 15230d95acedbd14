"""Demonstration: render `corridor`, extrapolate it, measure it, show it (`gffe demo`)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

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
EVERY = 4  # rendered frames from one ground truth to the next
_FRAMES = 16
_SLOWDOWN = 4
_MARGIN = 8
_BAR = 28  # of a line of text
_INK = (225, 225, 225)
_FAINT = (165, 165, 165)
_PAPER = (24, 24, 26)


def demo(
    output: Path, device: Device, width: int, height: int, seed: int, window: str, options: Options, step
) -> Iterator[tuple[str, dict]]:
    """Fill the folder `output` with `rendered/`, `extrapolated/`, `contact_sheet.png`, `side_by_side.mp4`, and at last
    `metrics.json`. Yield each picture and film when it is finished, (file name, {}), then each of `METHODS` with its
    mean metrics {"psnr", "ssim", …} where there is ground truth: after every fourth rendered frame.

    `window` is the rendering window: "adaptive", "fixed:FACTOR" or "off". `options`: of the displayed frames; the
    others are made without shading correction. `step(text, total)` opens a progress step and returns a function to call
    after each unit of it.
    """
    scene, count = load_scene("corridor", seed), _FRAMES + _FRAMES // EVERY
    how: Any = {"ground_truth": True, "truth_every": EVERY, "window": window}
    on_frame = step(f"Rendering the scene '{scene.name}'", count)
    render_sequence(scene, output / "rendered", device, width, height, _FRAMES, 30.0, **how, on_frame=on_frame)
    source, plain = open_sequence(output / "rendered"), replace(options, shading_correction=False)
    shown = "scn" if options.corrects_shading else "gae"
    runs = {"static": replace(plain, motion=False), "gae": plain, shown: options}

    def run(name: str) -> Sequence:
        folder = output / ("extrapolated" if name == shown else name)
        on_frame = step(f"Extrapolating ({METHODS[name]})", _FRAMES)
        run_sequence(Recorded(source, device), folder, device, runs[name], [0.5], on_frame=on_frame)
        return open_sequence(folder)

    made = run(shown)
    with replacing(output / "contact_sheet.png") as part:
        _contact_sheet(source, made, device).save(part)
    yield "contact_sheet.png", {}
    with replacing(output / "side_by_side.mp4") as part:
        frames = _video_frames(source, made, device, step("Drawing the film", _FRAMES))
        write_video(part, frames, 60.0 / _SLOWDOWN)
    yield "side_by_side.mp4", {}

    metrics = {}
    for name in ("repeat", *runs):
        other = source if name == "repeat" else made if name == shown else run(name)
        on_frame = step(f"Measuring ({METHODS[name]})", _FRAMES // EVERY)
        progress = lambda done, total, on_frame=on_frame: on_frame()  # noqa: E731
        score = (
            compare(other, source, progress=progress)
            if other.extrapolated
            else baseline_repeat(source, progress, device)
        )
        metrics[name] = score.to_json()["mean"]
        yield name, metrics[name]
    with replacing(output / "metrics.json") as part:
        part.write_text(json.dumps(metrics, indent=1) + "\n")


def _contact_sheet(source: Sequence, made: Sequence, device: Device):
    """Return a contact sheet of three times: truth, last frame repeated and extrapolated frame, their errors, and
    the other outputs of an extrapolated frame."""
    groups = []
    for index in range(EVERY - 1, _FRAMES, EVERY)[:3]:
        now, new = source.rendered[index], made.extrapolated[index]
        truth = source.ground_truth[index // EVERY]
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
    yield from side_by_side(pairs(), labels)


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
