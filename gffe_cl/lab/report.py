"""Pictures of results for people: contact sheet and frames side by side. Display values are sRGB in [0, 1]."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

_MARGIN = 8
_BAR = 28  # of a line of text
_INK = (225, 225, 225)
_FAINT = (165, 165, 165)
_PAPER = (24, 24, 26)


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
