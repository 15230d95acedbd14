"""Pictures of results for people: contact sheet and side-by-side video. Display values are sRGB in [0, 1]."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from gffe_cl.errors import GffeError

_MARGIN = 8
_INK = (225, 225, 225)
_FAINT = (165, 165, 165)
_PAPER = (24, 24, 26)


def contact_sheet(groups: list[tuple[str, list[tuple[str, np.ndarray]]]], columns: int = 3, cell_width: int = 640):
    """A PIL image of groups of captioned images (H, W, 3) or (H, W), values in [0, 1], all of one size."""
    from PIL import Image, ImageDraw

    height, width = groups[0][1][0][1].shape[:2]
    cell = (cell_width, round(cell_width * height / width))
    bar, font = 28, _font(18)
    rows = sum(-(-len(images) // columns) for _, images in groups)
    sheet_height = len(groups) * bar + rows * (cell[1] + bar)
    sheet = Image.new("RGB", (_MARGIN + columns * (cell[0] + _MARGIN), sheet_height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    top = 0
    for label, images in groups:
        draw.text((_MARGIN, top + 4), label, _INK, font)
        top += bar
        for index, (caption, image) in enumerate(images):
            column = index % columns
            if index and column == 0:
                top += cell[1] + bar
            x = _MARGIN + column * (cell[0] + _MARGIN)
            sheet.paste(to_image(image).resize(cell, Image.Resampling.LANCZOS), (x, top))
            draw.text((x, top + cell[1] + 3), caption, _FAINT, font)
        top += cell[1] + bar
    return sheet


def to_image(values: np.ndarray):
    """(H, W, 3) or (H, W) display values in [0, 1] → PIL image."""
    from PIL import Image

    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, -1)
    return Image.fromarray((np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8))


def error_image(a: np.ndarray, b: np.ndarray, gain: float = 4.0) -> np.ndarray:
    """Mean absolute difference of display values times `gain`, on a black–red–yellow–white scale (H, W, 3)."""
    e = np.abs(a - b).mean(-1) * gain
    return np.clip(np.stack([3 * e, 3 * e - 1, 3 * e - 2], -1), 0, 1)


def side_by_side(pairs: Iterable[tuple[np.ndarray, np.ndarray]], labels: tuple[str, str]) -> Iterator[np.ndarray]:
    """Join (left, right) display images with a label each; yields (H, 2W + gap, 3) uint8, sides even."""
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


def write_video(path: Path, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write (H, W, 3) uint8 frames as H.264 MP4. Raises GffeError when the encoder fails."""
    import imageio_ffmpeg

    frames = iter(frames)
    first = next(frames)
    try:
        writer = imageio_ffmpeg.write_frames(
            str(path),
            (first.shape[1], first.shape[0]),
            fps=fps,
            codec="libx264",
            macro_block_size=1,
            ffmpeg_log_level="error",
            output_params=["-crf", "16", "-preset", "fast", "-movflags", "+faststart"],
        )
        writer.send(None)
        writer.send(np.ascontiguousarray(first))
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
        writer.close()
    except (OSError, RuntimeError) as error:
        raise GffeError(f"{path}: cannot write the video: {' '.join(str(error).split())[:200]}") from None


def _font(size: int):
    from PIL import ImageFont

    return ImageFont.load_default(size)
